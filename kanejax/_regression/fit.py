"""The inverse-dynamics stage: parameters that fit the signals best among those that rigid bodies and drives can have.

The data are compressed into as many rows as there are parameters (see compress), and optimistix minimises over the
free coordinates theta on that alone, so that many starts cost few times as much as one. Where the signals are not linear in the
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
from jax import lax
from jaxtyping import Array, Float

from kanejax._parameters.parameterization import Parameterization
from kanejax._regression.compress import Compressed, combined, compress, residuals, sums_of_squares
from kanejax._regression.huber import huber_cost
from kanejax._regression.linear_estimate import UNEXCITED, error_scale, robust_scale, scaled_gram, signal_sizes
from kanejax._regression.linearization import Samples, delay_index
from kanejax._regression.one_thread import one_thread

# How far a step may go, relative to the parameters' own scales, and how this changes when a step fails.
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-2, 1e-9, 1e9
_SETTLED = "neither the parameters nor the errors' sizes change any more"
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
    thetas = parameterization.theta0[None] if starts is None else starts
    signals = _Signals(parameterization, samples, samples_at, robust, sigma)
    with one_thread():
        if parameterization.linear:
            return _fit_linear(signals, thetas, max_rounds, progress)
        fits = [_fit_nonlinear(signals, theta, max_rounds, progress) for theta in thetas]
    costs = np.array([fit.history[-1].cost if fit.history else np.inf for fit in fits])
    best = int(np.argmin(costs))
    return _told(fits[best], costs)


class _Signals:
    """The data, linearised and weighted wherever the fit goes."""

    def __init__(
        self,
        parameterization: Parameterization,
        samples: Samples,
        samples_at: Callable[[Float[Array, ""]], Samples] | None,
        robust: bool,
        sigma: jax.Array | None,
    ) -> None:
        self.parameterization, self.robust = parameterization, robust
        self._samples, self._samples_at, self._given = samples, samples_at, sigma
        self._sizes = signal_sizes(samples)
        self._delay = delay_index(parameterization)

    def _at(self, phi: jax.Array) -> Samples:
        return self._samples if self._delay is None or self._samples_at is None else self._samples_at(phi[self._delay])

    def compressed(self, phi: jax.Array, sigma: jax.Array | None) -> Compressed:
        """The data, linearised about phi; far errors count less if that is wanted."""
        return compress(self.parameterization, phi, self._at(phi), sigma if self.robust else None)

    def sigma(self, phi: jax.Array, compressed: Compressed, fitted: int) -> jax.Array:
        """Standard deviation of each signal's errors at phi."""
        if self._given is not None:
            return self._given
        if not self.robust:
            return error_scale(compressed, phi, fitted, self._sizes)
        samples = self._at(phi)
        return robust_scale(residuals(self.parameterization, phi, samples), samples.weight, self._sizes)

    def cost(self, theta: jax.Array, compressed: Compressed, sigma: jax.Array) -> float:
        """Sum of squared residuals and priors at theta, where data were linearised there; with Huber's function if it is robust."""
        if not self.robust:
            return float(_cost(self.parameterization, compressed, sigma, theta))
        phi, prior = self.parameterization.phi(theta), self.parameterization.prior(theta)
        sizes = jnp.abs(residuals(self.parameterization, phi, self._at(phi))) / sigma[None]
        return float(jnp.sum(huber_cost(sizes)) + jnp.sum(prior * prior))


def _fit_linear(signals: _Signals, thetas: jax.Array, max_rounds: int, progress: Callable[[Step], None] | None) -> Fit:
    """Solve, weight, and solve again; the data are linearised once, and about the first solution once more, see compress."""
    parameterization = signals.parameterization
    phi = parameterization.phi(thetas[0])
    compressed = signals.compressed(phi, None)
    fitted = _rank(compressed)
    sigma = signals.sigma(phi, compressed, 0)
    held, history, costs = jnp.zeros(len(phi), bool), [], np.zeros(1)
    for _ in range(max_rounds):
        found, reached = _solved(parameterization, combined(compressed, sigma), thetas, compressed.center, 0.0, held)
        if not history:
            costs = np.asarray(reached, float)
        theta = _polished(parameterization, combined(compressed, sigma), compressed.center, found[int(jnp.nanargmin(reached))])
        new, thetas = parameterization.phi(theta), theta[None]
        change = _change(compressed, sigma, phi, new)
        phi, before = new, sigma
        if signals.robust or not history:
            compressed = signals.compressed(phi, sigma)
        sigma = signals.sigma(phi, compressed, fitted)
        history.append(Step(signals.cost(theta, compressed, sigma), np.asarray(sigma), change))
        if progress is not None:
            progress(history[-1])
        if change < _TOLERANCE and _stays(sigma, before):
            return _told(Fit(theta, phi, sigma, compressed, True, _SETTLED, tuple(history), (1, 1)), costs)
    message = f"did not settle in {max_rounds} rounds"
    return _told(Fit(thetas[0], phi, sigma, compressed, False, message, tuple(history), (1, 1)), costs)


def _fit_nonlinear(signals: _Signals, theta: jax.Array, max_rounds: int, progress: Callable[[Step], None] | None) -> Fit:
    """Linearise, take a step that is held back by damping, and weight again."""
    parameterization = signals.parameterization
    phi = parameterization.phi(theta)
    compressed = signals.compressed(phi, None)
    sigma = signals.sigma(phi, compressed, 0)
    compressed = signals.compressed(phi, sigma)
    fitted, damping, history = _rank(compressed), _FIRST_DAMPING, []
    shapes = jnp.asarray([any(name.endswith(shape) for shape in _SHAPES) for name in parameterization.names])
    holding = bool(jnp.any(shapes))
    converged, message = False, f"did not settle in {max_rounds} rounds: the fit goes on improving"
    for _ in range(max_rounds):
        cost, root = signals.cost(theta, compressed, sigma), combined(compressed, sigma)
        found, promised = _solved(parameterization, root, theta[None], compressed.center, damping, shapes & holding)
        new = parameterization.phi(found[0])
        after = signals.compressed(new, sigma)
        linearised = float(_cost(parameterization, compressed, sigma, theta))
        gain = cost - signals.cost(found[0], after, sigma)
        taken, damping = _next_damping(damping, gain, linearised - float(promised[0]), cost)
        settled = damping > _MOST_DAMPING
        if taken:
            change = _change(compressed, sigma, phi, new)
            theta, phi, compressed, before = found[0], new, after, sigma
            sigma = signals.sigma(phi, compressed, fitted)
            history.append(Step(signals.cost(theta, compressed, sigma), np.asarray(sigma), change))
            if progress is not None:
                progress(history[-1])
            settled = change < _TOLERANCE and _stays(sigma, before)
        if settled and holding:
            holding, damping = False, _FIRST_DAMPING
        elif settled:
            # A step may be short because it was held back: converged is where one that is not promises nothing.
            free = _solved(parameterization, combined(compressed, sigma), theta[None], compressed.center, 0.0, shapes & False)[1]
            left = float(_cost(parameterization, compressed, sigma, theta)) - float(free[0])
            converged = bool(left <= 1e-6 * float(jnp.sum(compressed.count)) + 1e-3)
            message = _SETTLED if converged else "no step improves the fit, though it is at no minimum"
            break
    return Fit(theta, phi, sigma, compressed, converged, message, tuple(history), (1, 1))


def _told(fit: Fit, costs: np.ndarray) -> Fit:
    """The fit, with how many starts came to it."""
    agreeing = int(np.sum(costs < costs.min() * (1 + 1e-6) + 1e-9)), len(costs)
    if len(costs) == 1:
        return fit._replace(agreeing=agreeing)
    return fit._replace(agreeing=agreeing, message=f"{fit.message}; {agreeing[0]} of {agreeing[1]} starts agree")


def _stays(sigma: jax.Array, before: jax.Array) -> bool:
    return float(jnp.max(jnp.abs(sigma / before - 1.0))) < _TOLERANCE


@jax.jit
def _solved(
    parameterization: Parameterization, root: jax.Array, thetas: jax.Array, center: jax.Array, damping: Any, held: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The best theta from each start, and their costs.

    `damping` holds phi near to where the data were linearised, and what is `held` right there.
    """
    lengths = jnp.linalg.norm(root[:, :-1], axis=0)

    def errors(theta: jax.Array, _: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        spring = jnp.sqrt(jnp.asarray(damping, theta.dtype)) * jnp.where(held, 1e6, 1.0) * lengths
        return *_errors(parameterization, root, center, theta), spring * (parameterization.phi(theta) - center)

    # Of many starts the best is solved for again in the next round.
    tolerance = (1e-10 if len(thetas) == 1 else 1e-6) if thetas.dtype == jnp.float64 else 1e-5
    # Normal equations for the steps: the residuals, which say where they end, are not squared.
    solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance, linear_solver=lx.Normal(lx.Cholesky()))

    def solve(theta: jax.Array) -> tuple[jax.Array, jax.Array]:
        value = optx.least_squares(errors, solver, theta, max_steps=300, throw=False).value
        left = errors(value, None)
        cost = sum(jnp.sum(x * x) for x in left)
        return value, jnp.where(jnp.isfinite(cost), cost, jnp.inf)

    # One after another: side by side all would take as many steps as the slowest, in matrices that leave the cache.
    return lax.map(solve, thetas)


def _errors(
    parameterization: Parameterization, root: jax.Array, center: jax.Array, theta: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Residuals of the data, and of the priors."""
    change = parameterization.phi(theta) - center
    return root[:, -1] - jnp.matmul(root[:, :-1], change, precision="highest"), parameterization.prior(theta)


@jax.jit
def _system(
    parameterization: Parameterization, root: jax.Array, center: jax.Array, theta: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """All residuals, and their derivatives."""

    def errors(theta: jax.Array) -> jax.Array:
        return jnp.concatenate(_errors(parameterization, root, center, theta))

    return errors(theta), jax.jacfwd(errors)(theta)


def _polished(parameterization: Parameterization, root: jax.Array, center: jax.Array, theta: jax.Array) -> jax.Array:
    """Theta after steps of Gauss and Newton by orthogonal transformations, for what normal equations leave of exact data."""
    for _ in range(3):
        error, columns = (np.asarray(x, float) for x in _system(parameterization, root, center, theta))
        length = np.linalg.norm(columns, axis=0)
        length = np.where(length > 0, length, 1.0)
        new = theta - jnp.asarray(np.linalg.lstsq(columns / length, error, rcond=None)[0] / length, theta.dtype)
        after = np.asarray(_system(parameterization, root, center, new)[0], float)
        if not np.sum(after**2) < np.sum(error**2):
            break
        theta = new
    return theta


@jax.jit
def _cost(parameterization: Parameterization, compressed: Compressed, sigma: jax.Array, theta: jax.Array) -> jax.Array:
    prior = parameterization.prior(theta)
    return jnp.sum(sums_of_squares(compressed, parameterization.phi(theta)) / sigma**2) + jnp.sum(prior * prior)


@jax.jit
def _largest_change(compressed: Compressed, sigma: jax.Array, before: jax.Array, after: jax.Array) -> jax.Array:
    moved = after - before
    square = jnp.einsum("i,rij,j->r", moved, compressed.products[:, :-1, :-1], moved, precision="highest")
    return jnp.sqrt(jnp.max(jnp.maximum(square, 0.0) / jnp.maximum(compressed.count, 1.0) / sigma**2))


def _next_damping(damping: float, gain: float, promised: float, cost: float) -> tuple[bool, float]:
    """Whether to take a step, and the damping of the next, from what it lowers the cost by and what it promised."""
    if not gain >= -1e-12 * cost:
        return False, damping * 10.0
    share = gain / max(promised, np.finfo(float).tiny)
    if share < 0.25:
        return True, damping * 4.0
    return True, max(damping * 0.1, _LEAST_DAMPING) if share > 0.75 else damping


def _change(compressed: Compressed, sigma: jax.Array, before: jax.Array, after: jax.Array) -> float:
    """Root mean square by which a signal's prediction changes, relative to its errors, of the signal where that is most."""
    return float(_largest_change(compressed, sigma, before, after))


def _rank(compressed: Compressed) -> int:
    """Number of combinations of parameters that the data determine."""
    products = np.asarray(jnp.sum(compressed.products, 0), float)[:-1, :-1]
    values = np.linalg.eigvalsh(scaled_gram(products)[0])
    return int(np.sum(values > UNEXCITED**2 * values.max(initial=0.0)))
