"""The inverse-dynamics stage: parameters that fit the signals best among those that rigid bodies and drives can have.

The data are compressed into as many rows as there are parameters (see compress), and optimistix minimises over the
free coordinates theta on that alone; many starts at once cost little more than one. Where the signals are not linear in the
parameters, data are linearised and compressed again at each solution; where errors of the signals are to be
weighted by their own size, or by Huber's function, the weights are found on the way.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from kanejax._identify.compress import Compressed, combined, compress, residuals, sums_of_squares
from kanejax._identify.linear_estimate import UNEXCITED, error_scale, robust_scale, signal_sizes
from kanejax._identify.linearization import Samples
from kanejax._identify.parameterization import Parameterization

# How far a step may go, relative to the parameters' own scales, and how this changes when a step fails.
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-2, 1e-9, 1e9
# Shapes of friction curves, which have no effect far from where they belong: they are held until all else has settled.
_SHAPES = ("friction_width", "stribeck_speed")
# A change this small beside the errors of the signals is far below what the data can tell.
_TOLERANCE = 1e-4


class Step(NamedTuple):
    """One round of the fit.

    Attributes:
        cost: sum of squared residuals, each divided by its standard deviation, plus that of the priors.
        sigma: standard deviation of each signal's errors, (nv,).
        change: greatest change of a signal's error, relative to sigma.
    """

    cost: float
    sigma: np.ndarray
    change: float


class Fit(NamedTuple):
    """What the inverse-dynamics stage found.

    Attributes:
        theta: free coordinates, (m,).
        phi: parameters, (n,).
        sigma: standard deviation of each signal's errors, (nv,).
        compressed: the data, linearised at `phi` and reduced.
        converged: whether the last round changed nothing that matters.
        message: the same in words.
        history: one entry a round.
        agreeing: how many of the starts ended at this cost, and of how many.
    """

    theta: Float[Array, " m"]
    phi: Float[Array, " n"]
    sigma: Float[Array, " nv"]
    compressed: Compressed
    converged: bool
    message: str
    history: tuple[Step, ...]
    agreeing: tuple[int, int]


def fit_inverse_dynamics(
    parameterization: Parameterization,
    samples: Samples,
    *,
    starts: Float[Array, "starts m"] | None = None,
    robust: bool = False,
    sigma: Float[Array, " nv"] | None = None,
    max_rounds: int = 50,
    samples_at: Callable[[Float[Array, ""]], Samples] | None = None,
    progress: Callable[[Step], None] | None = None,
) -> Fit:
    """Fit all that is sought to measured signals.

    Args:
        parameterization: what is sought.
        samples: states and signals.
        starts: of theta, one a row; all are tried and the best is kept. One, `theta0`, by default.
        robust: let errors far out count less, by Huber's function.
        sigma: standard deviation of each signal's errors, in place of the one that the residuals have.
        max_rounds: of linearising, or of weighting.
        samples_at: samples for another delay [s], where the delay is sought.
        progress: called after every round.
    """
    sizes = signal_sizes(samples)
    thetas = parameterization.theta0[None] if starts is None else starts
    given, again = sigma, robust or not parameterization.linear
    delay = parameterization.names.index("delay") if "delay" in parameterization.names else None

    def compressed_at(phi: jax.Array, scale: jax.Array | None) -> Compressed:
        moved = samples if delay is None or samples_at is None else samples_at(phi[delay])
        return compress(parameterization, phi, moved, scale if robust else None)

    phi = parameterization.phi(thetas[0])
    compressed = compressed_at(phi, None)
    sigma = error_scale(compressed, phi, 0, sizes) if given is None else given
    if robust and given is None:
        sigma = robust_scale(residuals(parameterization, phi, samples), samples.weight, sizes)
        compressed = compressed_at(phi, sigma)
    fitted = _rank(compressed)
    damping = 0.0 if parameterization.linear else _FIRST_DAMPING
    shapes = jnp.asarray([any(name.endswith(shape) for shape in _SHAPES) for name in parameterization.names])
    holding = bool(jnp.any(shapes))
    theta, agreeing, history = thetas[0], (1, 1), []
    converged, message = False, f"did not settle in {max_rounds} rounds: the fit goes on improving"
    for _ in range(max_rounds):
        cost = float(_cost(parameterization, compressed, sigma, theta))
        found, costs = _solved(
            parameterization,
            combined(compressed, sigma),
            thetas if not history else theta[None],
            compressed.center,
            damping,
            shapes & holding,
        )
        best = int(jnp.nanargmin(costs))
        new = found[best]
        if not history:
            agreeing = (int(jnp.sum(costs < costs[best] * (1 + 1e-6) + 1e-9)), len(thetas))
        new_phi = parameterization.phi(new)
        # Where they are linear, once more about the first solution, see compress.
        after = compressed_at(new_phi, sigma) if again or not history else compressed
        if not parameterization.linear:
            taken, damping = _next_damping(damping, cost, float(costs[best]), float(_cost(parameterization, after, sigma, new)))
            if not taken and damping > _MOST_DAMPING:
                converged, message = True, "no step improves the fit any more"
                break
            if not taken:
                continue
        change = _change(compressed, sigma, phi, new_phi)
        theta, phi, compressed = new, new_phi, after
        before = sigma
        if given is None:
            sigma = error_scale(compressed, phi, fitted, sizes)
            if robust:
                sigma = robust_scale(residuals(parameterization, phi, samples), samples.weight, sizes)
        history.append(Step(float(_cost(parameterization, compressed, sigma, theta)), np.asarray(sigma), change))
        if progress is not None:
            progress(history[-1])
        settled = change < _TOLERANCE and float(jnp.max(jnp.abs(sigma / before - 1.0))) < _TOLERANCE
        if settled and holding:
            holding, damping = False, _FIRST_DAMPING
        elif settled:
            converged, message = True, "neither the parameters nor the errors' sizes change any more"
            break
    if agreeing[1] > 1:
        message += f"; {agreeing[0]} of {agreeing[1]} starts agree"
    return Fit(theta, phi, sigma, compressed, converged, message, tuple(history), agreeing)


@jax.jit
def _solved(
    parameterization: Parameterization, root: jax.Array, thetas: jax.Array, center: jax.Array, damping: Any, held: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The best theta from each start, and their costs.

    `damping` holds phi near to where the data were linearised, and what is `held` right there.
    """
    columns, target = root[:, :-1], root[:, -1]
    lengths = jnp.linalg.norm(columns, axis=0)

    def errors(theta: jax.Array, _: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        change = parameterization.phi(theta) - center
        spring = jnp.sqrt(jnp.asarray(damping, change.dtype)) * jnp.where(held, 1e6, 1.0) * lengths * change
        return target - jnp.matmul(columns, change, precision="highest"), parameterization.prior(theta), spring

    tolerance = 1e-10 if thetas.dtype == jnp.float64 else 1e-5
    # Normal equations for the steps: the residuals, which say where they end, are not squared.
    solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance, linear_solver=lx.Normal(lx.Cholesky()))

    def solve(theta: jax.Array) -> tuple[jax.Array, jax.Array]:
        value = optx.least_squares(errors, solver, theta, max_steps=300, throw=False).value
        left = errors(value, None)
        cost = sum(jnp.sum(x * x) for x in left)
        return value, jnp.where(jnp.isfinite(cost), cost, jnp.inf)

    return jax.vmap(solve)(thetas)


@jax.jit
def _cost(parameterization: Parameterization, compressed: Compressed, sigma: jax.Array, theta: jax.Array) -> jax.Array:
    prior = parameterization.prior(theta)
    return jnp.sum(sums_of_squares(compressed, parameterization.phi(theta)) / sigma**2) + jnp.sum(prior * prior)


@jax.jit
def _largest_change(compressed: Compressed, sigma: jax.Array, before: jax.Array, after: jax.Array) -> jax.Array:
    moved = after - before
    square = jnp.einsum("i,rij,j->r", moved, compressed.products[:, :-1, :-1], moved, precision="highest")
    return jnp.sqrt(jnp.max(jnp.maximum(square, 0.0) / jnp.maximum(compressed.count, 1.0) / sigma**2))


def _next_damping(damping: float, cost: float, promised: float, reached: float) -> tuple[bool, float]:
    """Whether to take a step, and the damping of the next, from the costs before it, as it was linearised, and after it."""
    share = (cost - reached) / max(cost - promised, np.finfo(float).tiny)
    if not reached <= cost * (1.0 + 1e-12):
        return False, damping * 10.0
    if share < 0.25:
        return True, damping * 4.0
    return True, max(damping * 0.1, _LEAST_DAMPING) if share > 0.75 else damping


def _change(compressed: Compressed, sigma: jax.Array, before: jax.Array, after: jax.Array) -> float:
    """Root mean square by which a signal's prediction changes, relative to its errors, of the signal where that is most."""
    return float(_largest_change(compressed, sigma, before, after))


def _rank(compressed: Compressed) -> int:
    """Number of combinations of parameters that the data determine."""
    products = np.asarray(jnp.sum(compressed.products, 0), float)[:-1, :-1]
    lengths = np.sqrt(np.diag(products))
    scale = np.where(lengths > 0, lengths, 1.0)
    values = np.linalg.eigvalsh(products / scale[:, None] / scale[None, :])
    return int(np.sum(values > UNEXCITED**2 * values.max(initial=0.0)))
