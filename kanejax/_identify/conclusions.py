"""What follows from a fit: the plant, every parameter with what the data say of it, and predictions beside measurements."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._identify.base_parameters import BaseParameters
from kanejax._identify.compress import residuals
from kanejax._identify.information import Information, information, inverted
from kanejax._identify.linear_estimate import signal_sizes
from kanejax._identify.motion import Motion
from kanejax._identify.parameterization import Parameterization
from kanejax._identify.plant import Plant
from kanejax._identify.pseudo_inertia import consistency
from kanejax._identify.result import BaseEstimates, Comparison, Estimate, Identification, Stage
from kanejax._identify.samples import samples_of
from kanejax._identify.sentences import determined, sentences
from kanejax._model.inertia import inertia_parameters

# Of the standard normal distribution, 95 % lie within this.
_QUANTILE = 1.959963984540054


def conclusions(
    nominal: Plant,
    sought: Parameterization,
    theta: Float[Array, " m"],
    base: BaseParameters,
    training: Sequence[Motion],
    validation: Sequence[Motion],
    stages: Sequence[Stage],
    factor: Float[np.ndarray, "n1 n1"] | None = None,
) -> Identification:
    """Draw the conclusions from the `theta` that was found; `factor` is that of the simulation, where this was fitted."""
    phi, plant = sought.phi(theta), sought.plant(theta)
    fits = tuple(_comparison(sought, phi, motion) for motion in training)
    said = _information(sought, phi, base, training, fits)
    if factor is not None:
        inverse, condition, weak = inverted(factor[:, base.independent].T @ factor[:, base.independent])
        said = said._replace(covariance=inverse, white=inverse, condition_number=condition, weak=weak)
    bases = _base_estimates(sought, phi, base, said)
    edge = np.asarray(consistency(inertia_parameters(plant.model)), float)
    errors = np.concatenate([(fit.measured - fit.predicted) * (fit.weight > 0) for fit in fits])
    sizes = np.concatenate([fit.measured * (fit.weight > 0) for fit in fits])
    relative = float(np.linalg.norm(errors) / max(np.linalg.norm(sizes), np.finfo(float).tiny))
    words = sentences(base, bases, said.weak, stages, relative, edge, nominal.model.tree.body_names)
    return Identification(
        plant=plant,
        nominal=nominal,
        parameterization=sought,
        phi=phi,
        estimates=_estimates(sought, phi, base, bases),
        base=bases,
        sentences=(*words, *sought.notes, *dict.fromkeys(note for motion in training for note in motion.notes)),
        stages=tuple(stages),
        training=fits,
        validation=tuple(_comparison(sought, phi, motion) for motion in validation),
        noise=said.spectrum,
        consistency=edge,
    )


def _comparison(sought: Parameterization, phi: Float[Array, " n"], motion: Motion) -> Comparison:
    delay = sought.assemble(phi)[0].drives.delay
    samples = samples_of([motion], delay if float(delay) else None)
    measured = np.asarray(motion.effort, float)
    shown = np.where(np.asarray(samples.weight) > 0, measured, np.nan)
    predicted, nominal = (shown - np.asarray(residuals(sought, at, samples), float) for at in (phi, sought.phi0))
    return Comparison(motion.name, np.asarray(motion.ts, float), measured, predicted, nominal, np.asarray(samples.weight, float))


def _information(
    sought: Parameterization,
    phi: Float[Array, " n"],
    base: BaseParameters,
    training: Sequence[Motion],
    fits: Sequence[Comparison],
) -> Information:
    delay = sought.assemble(phi)[0].drives.delay
    has_delay = "delay" in sought.names or bool(float(delay))
    runs = [samples_of([motion], delay if has_delay else None) for motion in training]
    errors = [np.where(fit.weight > 0, fit.measured - fit.predicted, 0.0) for fit in fits]
    counts = sum(np.sum(fit.weight > 0, 0) for fit in fits)
    left = np.maximum(counts - len(base) / max(np.count_nonzero(counts), 1), 1.0)
    sizes = np.asarray(signal_sizes(samples_of(training)), float)
    sigma = np.maximum(np.sqrt(sum(np.sum(error**2, 0) for error in errors) / left), 1e-10 * sizes)
    period = float(np.median(np.diff(np.asarray(training[0].ts, float))))
    dtype = phi.dtype
    return information(sought, phi, jnp.asarray(sigma, dtype), base, runs, [jnp.asarray(x, dtype) for x in errors], period)


def _base_estimates(sought: Parameterization, phi: Float[Array, " n"], base: BaseParameters, said: Information) -> BaseEstimates:
    std = np.sqrt(np.diag(said.covariance))
    unexcited = sorted({i for shares in said.weak for i in shares})
    std[unexcited] = np.nan
    scale = np.where(std > 0, std, 1.0)
    correlation = said.covariance / scale[:, None] / scale[None, :]
    nominal, value = (base.matrix @ np.asarray(x, float) for x in (sought.phi0, phi))
    return BaseEstimates(base.formulas, nominal, value, std, correlation, said.condition_number)


def _estimates(
    sought: Parameterization, phi: Float[Array, " n"], base: BaseParameters, bases: BaseEstimates
) -> tuple[Estimate, ...]:
    found = []
    nominal, values = np.asarray(sought.phi0, float), np.asarray(phi, float)
    for i, (name, unit) in enumerate(zip(sought.names, sought.units, strict=True)):
        own = base.alone(i)
        std = float(bases.std[own]) if own is not None else float("nan")
        lower, upper = (float(values[i] + sign * _QUANTILE * std) for sign in (-1, 1))
        found.append(Estimate(name, unit, float(nominal[i]), float(values[i]), std, lower, upper, determined(base, i)))
    return tuple(found)
