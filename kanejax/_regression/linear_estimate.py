"""The linear stage: base parameters by least squares, without regard to what rigid bodies can have."""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._logs.motion import Motion
from kanejax._model.inertia import NAMES
from kanejax._parameters.parameterization import Parameterization
from kanejax._regression.base_parameters import BaseParameters, enough_states, grouped, random_states
from kanejax._regression.compress import Compressed, compress, residuals, sums_of_squares
from kanejax._regression.linearization import Samples, derivatives, linearization
from kanejax._regression.samples import samples_of

Method = Literal["ordinary", "weighted", "huber"]
# Of the parameters of a body, those that are rather grouped into others come last; see base_parameters.
_LAST = ("Iyy", "mcz", "m")
# A signal's standard deviation is at least this fraction of its size: also a perfect fit has one.
_LEAST = 1e-10
# A combination of base parameters is not excited if it moves the signals this little beside others.
UNEXCITED = 1e-6
# A column is nothing but rounding errors if it is this small beside the largest.
_ROUNDING = 1e-12
_ROUNDS = 100


class LinearEstimate(NamedTuple):
    """Base parameters that fit the signals best.

    Attributes:
        base: what they are made of, with formulas.
        value: of each, (nbase,).
        covariance: of `value`, if errors are independent, (nbase, nbase).
        sigma: standard deviation of the errors of each signal, (nv,).
        condition_number: of the regressor, each row divided by its signal's standard deviation and each column by its length.
        converged: whether weighting again would change nothing that matters.
        phi: all parameters: of those that have these base parameters, the nearest to the nominal ones.
        compressed: the data, linearised and reduced.
    """

    base: BaseParameters
    value: Float[np.ndarray, " nbase"]
    covariance: Float[np.ndarray, "nbase nbase"]
    sigma: Float[Array, " nv"]
    condition_number: float
    converged: bool
    phi: Float[Array, " n"]
    compressed: Compressed


def linear_estimate(
    parameterization: Parameterization,
    data: Sequence[Motion] | Samples,
    *,
    method: Method = "weighted",
    base: BaseParameters | None = None,
) -> LinearEstimate:
    """Fit base parameters to signals by linear least squares.

    Args:
        parameterization: what is sought; the signals must be linear in it.
        data: motions of the runs, or their samples.
        method: "ordinary": all signals count alike; "weighted": each is divided by the standard deviation of its own errors, and
            again until that stays; "huber": the same, and errors far out count less (Huber 1964), also until that stays.
        base: what `identifiable` returns, if it is known.

    Raises:
        ValueError: the signals are not linear in what is sought.
    """
    if not parameterization.linear:
        raise ValueError(
            "the signals are not linear in what is sought; the linear stage needs all but inertias and forces to be fixed"
        )
    samples = data if isinstance(data, Samples) else samples_of(data)
    base = identifiable(parameterization) if base is None else base
    sizes, nearest = signal_sizes(samples), _nearest(parameterization, base)
    sigma = jnp.full_like(sizes, jnp.sqrt(jnp.mean(sizes**2)))
    compressed = compress(parameterization, parameterization.phi0, samples)
    value, covariance, condition = _solved(base, compressed, sigma)
    # Again about the solution, see compress.
    compressed = compress(parameterization, nearest(value), samples)
    value, covariance, condition = _solved(base, compressed, sigma)
    converged = method == "ordinary"
    for _ in range(_ROUNDS if method != "ordinary" else 0):
        phi = nearest(value)
        if method == "huber":
            sigma = robust_scale(residuals(parameterization, phi, samples), samples.weight, sizes)
            compressed = compress(parameterization, phi, samples, sigma)
        else:
            sigma = error_scale(compressed, phi, len(base), sizes)
        before, (value, covariance, condition) = value, _solved(base, compressed, sigma)
        if np.all(np.abs(value - before) <= 1e-4 * np.sqrt(np.diag(covariance)) + 1e-14 * np.abs(value)):
            converged = True
            break
    phi = nearest(value)
    if method == "ordinary":
        sigma = jnp.full_like(sizes, jnp.sqrt(jnp.sum(sums_of_squares(compressed, phi)) / (jnp.sum(compressed.count) - len(base))))
        sigma = jnp.maximum(sigma, _LEAST * sizes)
        value, covariance, condition = _solved(base, compressed, sigma)
    return LinearEstimate(base, value, covariance, sigma, condition, converged, phi, compressed)


def identifiable(parameterization: Parameterization, phi: jax.Array | None = None, *, seed: int = 0) -> BaseParameters:
    """Group what is sought into what motion can tell apart, at random states: by the regressor of the signals at `phi`.

    Args:
        parameterization: what is sought.
        phi: the physical parameters at which to look; those of the nominal plant if left out.
        seed: of the states.

    Returns:
        The groups: base parameters of what is sought.
    """
    names = parameterization.names
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda x: x.astype(jnp.float64) if hasattr(x, "astype") else x, parameterization)
        at_phi = wide.phi0 if phi is None else phi.astype(jnp.float64)
        model = wide.given.model
        q, u, u_dot = random_states(model, 2 * enough_states(len(names), model), seed)
        # Slow ones too: shapes of friction curves show nowhere else.
        u = u * jnp.asarray(10.0 ** np.random.default_rng(seed).uniform(-3.0, 0.0, (len(u), 1)))
        states = (q, u, u_dot)
        rates = random_states(model, len(q), seed + 1)
        samples = Samples(*states, jnp.zeros_like(states[1]), jnp.ones_like(states[1]), rates)
        rows = derivatives(wide, linearization(wide, at_phi), samples)
    return grouped(rows.reshape(-1, len(names)), names, _order(names))


def _nearest(parameterization: Parameterization, base: BaseParameters) -> Callable[[np.ndarray], jax.Array]:
    """Function from base parameters to all: to those nearest to the nominal ones, each relative to its size."""
    phi0 = np.asarray(parameterization.phi0, float)
    size = np.abs(phi0) + 1e-3 * np.abs(phi0).max(initial=0.0) + 1e-12
    back = size[:, None] * np.linalg.pinv(base.matrix * size)
    return lambda value: jnp.asarray(phi0 + back @ (value - base.matrix @ phi0), parameterization.phi0.dtype)


def signal_sizes(samples: Samples) -> Float[Array, " nv"]:
    """Root mean square of each signal; one where it is nothing but zero."""
    counts = jnp.maximum(jnp.sum(samples.weight, 0), 1.0)
    square = jnp.sum(jnp.where(samples.weight > 0, samples.effort, 0.0) ** 2, 0) / counts
    return jnp.where(square > 0, jnp.sqrt(square), 1.0)


def error_scale(compressed: Compressed, phi: jax.Array, fitted: int, sizes: jax.Array) -> Float[Array, " nv"]:
    """Standard deviation of each signal's errors, less the freedom that the fitted parameters took, shared equally."""
    measured = jnp.sum(compressed.count > 0)
    left = jnp.maximum(compressed.count - fitted / jnp.maximum(measured, 1), 1.0)
    return jnp.maximum(jnp.sqrt(sums_of_squares(compressed, phi) / left), _LEAST * sizes)


def robust_scale(errors: jax.Array, weight: jax.Array, sizes: jax.Array) -> Float[Array, " nv"]:
    """Standard deviation of each signal's errors from their median size, which few large ones do not change."""
    median = jnp.nanmedian(jnp.where(weight > 0, jnp.abs(errors), jnp.nan), axis=0)
    return jnp.maximum(1.4826 * jnp.where(jnp.isnan(median), 0.0, median), _LEAST * sizes)


def scaled_gram(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Products of columns of length one, and the lengths; columns that are no more than rounding errors become zero."""
    length = np.sqrt(np.maximum(np.diag(gram), 0.0))
    length = np.where(length > _ROUNDING * length.max(initial=0.0), length, np.inf)
    return gram / length[:, None] / length[None, :], length


def _solved(base: BaseParameters, compressed: Compressed, sigma: jax.Array) -> tuple[np.ndarray, np.ndarray, float]:
    """Base parameters, their covariance, and the condition number."""
    products = np.asarray(jnp.sum(compressed.products / jnp.square(sigma)[:, None, None], 0), float)
    own = base.independent
    scaled, length = scaled_gram(products[np.ix_(own, own)])
    values, vectors = np.linalg.eigh(scaled)
    # What the data do not excite at all stays as it is: `information` names it.
    kept = values > UNEXCITED**2 * values.max(initial=0.0)
    turned = vectors[:, kept] / np.sqrt(values[kept]) / length[:, None]
    condition = float(np.sqrt(values.max(initial=1.0) / max(values.min(initial=1.0), 1e-32)))
    start = base.matrix @ np.asarray(compressed.center, float)
    return start + turned @ (turned.T @ products[own, -1]), turned @ turned.T, condition


def _order(names: Sequence[str]) -> list[int]:
    """Base to tip, inertias before the rest, and the last ones of each body last of it."""

    def place(i: int) -> tuple[int, int, int]:
        owner, _, name = names[i].rpartition(".")
        if name not in NAMES:
            return (1, i, 0)
        first = names.index(f"{owner}.{NAMES[0]}") if f"{owner}.{NAMES[0]}" in names else i
        return (0, first, _LAST.index(name) + 1 if name in _LAST else 0)

    return sorted(range(len(names)), key=place)
