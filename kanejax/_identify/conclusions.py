"""What follows from a fit: the plant, every parameter with what the data say of it, and predictions beside measurements."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._identify.result import BaseEstimates, Comparison, Estimate, Identification, Stage
from kanejax._identify.sentences import determined, sentences
from kanejax._logs.motion import Motion
from kanejax._model.inertia import inertia_parameters
from kanejax._parameters.parameterization import Parameterization
from kanejax._parameters.pseudo_inertia import consistency
from kanejax._regression.base_parameters import BaseParameters
from kanejax._regression.compress import residuals
from kanejax._regression.information import Information, information, inverted
from kanejax._regression.linear_estimate import identifiable, robust_scale, signal_sizes
from kanejax._regression.samples import samples_of

# Of the standard normal distribution, 95 % lie within this.
_QUANTILE = 1.959963984540054


def conclusions(
    nominal: Parameterization,
    sought: Parameterization,
    theta: Float[Array, " m"],
    base: BaseParameters,
    training: Sequence[Motion],
    validation: Sequence[Motion],
    stages: Sequence[Stage],
    factor: Float[np.ndarray, "n1 n1"] | None = None,
    robust: bool = False,
) -> Identification:
    """Draw the conclusions from the `theta` that was found.

    Args:
        nominal: what is known without the data, of the same unknowns.
        sought: what was sought.
        theta: what was found.
        base: what motion can tell apart.
        training: runs that were fitted.
        validation: runs that were held out.
        stages: how they ended.
        factor: that of the simulation's residuals, where these were fitted.
        robust: whether inverse dynamics let errors far out count less.
    """
    phi, plant = sought.phi(theta), sought.plant(theta)
    base = base if sought.linear else identifiable(sought, phi)
    fits = tuple(_comparison(sought, phi, nominal, motion) for motion in training)
    said = _information(sought, phi, base, training, fits, robust)
    remarks = _remarks(nominal, sought)
    if factor is not None:
        inverse, condition, weak, unexcited = inverted(factor[:, base.independent].T @ factor[:, base.independent])
        said = said._replace(covariance=inverse, white=inverse, condition_number=condition, weak=weak, unexcited=unexcited)
        remarks.append("Intervals are for errors of the positions that are independent of each other; others make them too narrow.")
    bases = _base_estimates(sought, phi, base, said)
    edge = np.asarray(consistency(inertia_parameters(plant.model)), float)
    errors = np.concatenate([(fit.measured - fit.predicted) * (fit.weight > 0) for fit in fits])
    sizes = np.concatenate([fit.measured * (fit.weight > 0) for fit in fits])
    relative = float(np.linalg.norm(errors) / max(np.linalg.norm(sizes), np.finfo(float).tiny))
    rows = sorted({row for part in sought.blocks if part.leaf == "inertia" for row in part.rows})
    names = [sought.tree.body_names[row] for row in rows]
    words = sentences(base, bases, said.weak, said.unexcited, stages, relative, edge[rows], names)
    return Identification(
        plant=plant,
        nominal=nominal.given,
        parameterization=sought,
        phi=phi,
        estimates=_estimates(nominal, sought, phi, base, bases),
        base=bases,
        sentences=(*words, *remarks, *sought.notes, *dict.fromkeys(note for motion in training for note in motion.notes)),
        stages=tuple(stages),
        training=fits,
        validation=tuple(_comparison(sought, phi, nominal, motion) for motion in validation),
        noise=said.spectrum,
        consistency=edge,
    )


def _remarks(nominal: Parameterization, sought: Parameterization) -> list[str]:
    before, after = (np.asarray(x.given.model.friction_width, float) for x in (nominal, sought))
    if np.array_equal(before, after):
        return []
    widths = ", ".join(f"{width:.3g}" for width in after)
    return [
        f"The model has the widths of Coulomb friction that it was identified with, {widths}; for simulations, which need short "
        "steps for friction that sets in so fast, give it greater ones: model.replace(friction_width=...)."
    ]


def _comparison(sought: Parameterization, phi: Float[Array, " n"], nominal: Parameterization, motion: Motion) -> Comparison:
    measured = np.asarray(motion.effort, float)
    everywhere = Motion(motion.ts, motion.q, motion.u, motion.u_dot, jnp.nan_to_num(motion.effort))
    predicted, before = (_predicted(*pair, everywhere) for pair in ((sought, phi), (nominal, nominal.phi0)))
    weight = np.asarray(samples_of([motion], _delay(sought, phi)).weight, float)
    return Comparison(motion.name, np.asarray(motion.ts, float), measured, predicted, before, weight)


def _predicted(sought: Parameterization, phi: Float[Array, " n"], motion: Motion) -> np.ndarray:
    samples = samples_of([motion], _delay(sought, phi))
    samples = samples._replace(weight=jnp.ones_like(samples.weight))
    return np.asarray(motion.effort - residuals(sought, phi, samples), float)


def _delay(sought: Parameterization, phi: Float[Array, " n"]) -> Float[Array, ""] | None:
    """The delay of the signals; None where there is none."""
    delay = sought.assemble(phi)[0].drives.delay
    return delay if float(delay) else None


def _information(
    sought: Parameterization,
    phi: Float[Array, " n"],
    base: BaseParameters,
    training: Sequence[Motion],
    fits: Sequence[Comparison],
    robust: bool,
) -> Information:
    delay = sought.assemble(phi)[0].drives.delay if "delay" in sought.names else _delay(sought, phi)
    runs = [samples_of([motion], delay) for motion in training]
    errors = [jnp.asarray(np.where(fit.weight > 0, fit.measured - fit.predicted, 0.0), phi.dtype) for fit in fits]
    everything, weight = jnp.concatenate(errors), jnp.concatenate([run.weight for run in runs])
    sizes = signal_sizes(samples_of(training))
    if robust:
        sigma = robust_scale(everything, weight, sizes)
    else:
        counts = jnp.sum(weight > 0, 0).astype(phi.dtype)
        left = jnp.maximum(counts - len(base) / max(int(jnp.sum(counts > 0)), 1), 1.0)
        sigma = jnp.maximum(jnp.sqrt(jnp.sum(everything**2, 0) / left), 1e-10 * sizes)
    period = float(np.median(np.diff(np.asarray(training[0].ts, float))))
    return information(sought, phi, sigma, base, runs, errors, period, robust)


def _base_estimates(sought: Parameterization, phi: Float[Array, " n"], base: BaseParameters, said: Information) -> BaseEstimates:
    std = np.sqrt(np.diag(said.covariance))
    std[said.unexcited] = np.nan
    scale = np.where(std == 0, 1.0, std)
    correlation = said.covariance / scale[:, None] / scale[None, :]
    nominal, value = (base.matrix @ np.asarray(x, float) for x in (sought.phi0, phi))
    return BaseEstimates(base.formulas, nominal, value, std, correlation, said.condition_number)


def _estimates(
    nominal: Parameterization, sought: Parameterization, phi: Float[Array, " n"], base: BaseParameters, bases: BaseEstimates
) -> tuple[Estimate, ...]:
    found = []
    before, values = np.asarray(nominal.phi0, float), np.asarray(phi, float)
    for i, (name, unit) in enumerate(zip(sought.names, sought.units, strict=True)):
        own = base.alone(i)
        std = float(bases.std[own]) if own is not None else float("nan")
        lower, upper = (float(values[i] + sign * _QUANTILE * std) for sign in (-1, 1))
        kind = determined(base, i)
        if kind == "alone" and not np.isfinite(std):
            kind = "not by these data"
        found.append(Estimate(name, unit, float(before[i]), float(values[i]), std, lower, upper, kind))
    return tuple(found)
