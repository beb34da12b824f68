"""The inverse-dynamics stage: parameters that fit the signals best among those that rigid bodies and drives can have.

The data are compressed into as many rows as there are parameters (see compress), and optimistix minimises over the
free coordinates theta on that alone, so that many starts cost few times as much as one. Where the signals are not linear in the
parameters, data are linearised and compressed again at each solution; where errors of the signals are to be
weighted by their own size, or by Huber's function, the weights are found on the way.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._checkpoint import Checkpoint
from kanejax._parameters.parameterization import Parameterization
from kanejax._regression.compress import Compressed, combined, compress, residuals
from kanejax._regression.huber import huber_cost
from kanejax._regression.least_squares import change_between, cost_of, polished, rank, solved
from kanejax._regression.linear_estimate import error_scale, robust_scale, signal_sizes
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


Tell = Callable[[Step], None] | None


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
    progress: Tell = None,
    checkpoint: Checkpoint | None = None,
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
        checkpoint: to go on from, and to keep every round in.
    """
    checkpoint = checkpoint or Checkpoint()
    thetas = parameterization.theta0[None] if starts is None else starts
    signals = _Signals(parameterization, samples, samples_at, robust, sigma)
    with one_thread():
        if parameterization.linear:
            return _fit_linear(signals, thetas, max_rounds, progress, checkpoint)
        fits = [
            _fit_nonlinear(signals, theta, max_rounds, progress, checkpoint.part(f"start {number}"))
            for number, theta in enumerate(thetas)
        ]
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
            return float(cost_of(self.parameterization, compressed, sigma, theta))
        phi, prior = self.parameterization.phi(theta), self.parameterization.prior(theta)
        sizes = jnp.abs(residuals(self.parameterization, phi, self._at(phi))) / sigma[None]
        return float(jnp.sum(huber_cost(sizes)) + jnp.sum(prior * prior))


class _History(NamedTuple):
    """The steps that were taken, one a row."""

    cost: Float[np.ndarray, " n"]
    sigma: Float[np.ndarray, "n nv"]
    change: Float[np.ndarray, " n"]

    def with_step(self, step: Step) -> "_History":
        """One more row."""
        return _History(*(np.concatenate((before, np.asarray(now, float)[None])) for before, now in zip(self, step, strict=True)))

    def steps(self) -> tuple[Step, ...]:
        """One by one."""
        return tuple(Step(float(cost), sigma, float(change)) for cost, sigma, change in zip(*self, strict=True))


class _State(NamedTuple):
    """All that goes from round to round.

    Attributes:
        theta: free coordinates.
        phi: parameters.
        sigma: standard deviation of each signal's errors.
        compressed: the data, linearised at `phi`.
        damping: of the next step.
        is_holding: whether shapes are held.
        fitted: number of combinations of parameters that the data determine.
        rounds: so far.
        history: the steps that were taken.
        costs: that the starts came to.
        is_over: whether there is no more to do.
        converged: whether the last round changed nothing that matters.
    """

    theta: Float[Array, " m"]
    phi: Float[Array, " n"]
    sigma: Float[Array, " nv"]
    compressed: Compressed
    damping: float
    is_holding: bool
    fitted: int
    rounds: int
    history: _History
    costs: Float[np.ndarray, " starts"]
    is_over: bool
    converged: bool

    def fit(self, message: str) -> Fit:
        """What was found, and what there is to say of it."""
        message = _SETTLED if self.converged else message
        return Fit(self.theta, self.phi, self.sigma, self.compressed, self.converged, message, self.history.steps(), (1, 1))


def _first_state(theta: jax.Array, phi: jax.Array, sigma: jax.Array, compressed: Compressed, fitted: int) -> _State:
    none = _History(np.zeros(0), np.zeros((0, len(sigma))), np.zeros(0))
    return _State(theta, phi, sigma, compressed, _FIRST_DAMPING, False, fitted, 0, none, np.zeros(1), False, False)


def _fit_linear(signals: _Signals, thetas: jax.Array, max_rounds: int, progress: Tell, checkpoint: Checkpoint) -> Fit:
    """Solve, weight, and solve again; the data are linearised once, and about the first solution once more, see compress."""
    phi = signals.parameterization.phi(thetas[0])
    compressed = signals.compressed(phi, None)
    state = _first_state(thetas[0], phi, signals.sigma(phi, compressed, 0), compressed, rank(compressed))
    state = checkpoint.restored(state._replace(costs=np.zeros(len(thetas))))
    while not state.is_over and state.rounds < max_rounds:
        state = _linear_round(signals, state, thetas if state.rounds == 0 else state.theta[None])
        checkpoint.keep(state)
        if progress is not None:
            progress(state.history.steps()[-1])
    return _told(state.fit(f"did not settle in {max_rounds} rounds"), state.costs)


def _linear_round(signals: _Signals, state: _State, starts: jax.Array) -> _State:
    """Solve with the standard deviations of the errors before, and find new ones."""
    parameterization, compressed = signals.parameterization, state.compressed
    root = combined(compressed, state.sigma)
    held = jnp.zeros(len(state.phi), bool)
    found, reached = solved(parameterization, root, starts, compressed.center, 0.0, held)
    theta = polished(parameterization, root, compressed.center, found[int(jnp.nanargmin(reached))])
    phi = parameterization.phi(theta)
    change = change_between(compressed, state.sigma, state.phi, phi)
    if signals.robust or state.rounds == 0:
        compressed = signals.compressed(phi, state.sigma)
    sigma = signals.sigma(phi, compressed, state.fitted)
    settled = change < _TOLERANCE and _stays(sigma, state.sigma)
    return state._replace(
        theta=theta,
        phi=phi,
        sigma=sigma,
        compressed=compressed,
        rounds=state.rounds + 1,
        history=state.history.with_step(Step(signals.cost(theta, compressed, sigma), np.asarray(sigma), change)),
        costs=np.asarray(reached, float) if state.rounds == 0 else state.costs,
        is_over=settled,
        converged=settled,
    )


def _fit_nonlinear(signals: _Signals, theta: jax.Array, max_rounds: int, progress: Tell, checkpoint: Checkpoint) -> Fit:
    """Linearise, take a step that is held back by damping, and weight again."""
    parameterization = signals.parameterization
    phi = parameterization.phi(theta)
    compressed = signals.compressed(phi, None)
    sigma = signals.sigma(phi, compressed, 0)
    compressed = signals.compressed(phi, sigma)
    shapes = jnp.asarray([any(name.endswith(shape) for shape in _SHAPES) for name in parameterization.names])
    state = _first_state(theta, phi, sigma, compressed, rank(compressed))
    state = checkpoint.restored(state._replace(is_holding=bool(jnp.any(shapes))))
    while not state.is_over and state.rounds < max_rounds:
        taken = len(state.history.change)
        state = _nonlinear_round(signals, state, shapes)
        checkpoint.keep(state)
        if progress is not None and len(state.history.change) > taken:
            progress(state.history.steps()[-1])
    at_end = "no step improves the fit, though it is at no minimum"
    return state.fit(at_end if state.is_over else f"did not settle in {max_rounds} rounds: the fit goes on improving")


def _nonlinear_round(signals: _Signals, state: _State, shapes: jax.Array) -> _State:
    """Try a step, and see whether it was the last."""
    parameterization, compressed, sigma = signals.parameterization, state.compressed, state.sigma
    cost, root = signals.cost(state.theta, compressed, sigma), combined(compressed, sigma)
    held = shapes & state.is_holding
    found, promised = solved(parameterization, root, state.theta[None], compressed.center, state.damping, held)
    new = parameterization.phi(found[0])
    after = signals.compressed(new, sigma)
    linearised = float(cost_of(parameterization, compressed, sigma, state.theta))
    gain = cost - signals.cost(found[0], after, sigma)
    taken, damping = _next_damping(state.damping, gain, linearised - float(promised[0]), cost)
    state = state._replace(damping=damping, rounds=state.rounds + 1)
    settled = damping > _MOST_DAMPING
    if taken:
        change = change_between(compressed, sigma, state.phi, new)
        state = state._replace(theta=found[0], phi=new, compressed=after, sigma=signals.sigma(new, after, state.fitted))
        step = Step(signals.cost(state.theta, after, state.sigma), np.asarray(state.sigma), change)
        state = state._replace(history=state.history.with_step(step))
        settled = change < _TOLERANCE and _stays(state.sigma, sigma)
    if settled and state.is_holding:
        return state._replace(is_holding=False, damping=_FIRST_DAMPING)
    return state._replace(is_over=True, converged=_is_minimum(parameterization, state)) if settled else state


def _is_minimum(parameterization: Parameterization, state: _State) -> bool:
    """Whether a step that is not held back promises nothing; one that is may be short because of that."""
    compressed, sigma, free = state.compressed, state.sigma, jnp.zeros(len(state.phi), bool)
    promised = solved(parameterization, combined(compressed, sigma), state.theta[None], compressed.center, 0.0, free)[1]
    left = float(cost_of(parameterization, compressed, sigma, state.theta)) - float(promised[0])
    return bool(left <= 1e-6 * float(jnp.sum(compressed.count)) + 1e-3)


def _told(fit: Fit, costs: np.ndarray) -> Fit:
    """The fit, with how many starts came to it."""
    agreeing = int(np.sum(costs < costs.min() * (1 + 1e-6) + 1e-9)), len(costs)
    if len(costs) == 1:
        return fit._replace(agreeing=agreeing)
    return fit._replace(agreeing=agreeing, message=f"{fit.message}; {agreeing[0]} of {agreeing[1]} starts agree")


def _stays(sigma: jax.Array, before: jax.Array) -> bool:
    return float(jnp.max(jnp.abs(sigma / before - 1.0))) < _TOLERANCE


def _next_damping(damping: float, gain: float, promised: float, cost: float) -> tuple[bool, float]:
    """Whether to take a step, and the damping of the next, from what it lowers the cost by and what it promised."""
    if not gain >= -1e-12 * cost:
        return False, damping * 10.0
    share = gain / max(promised, np.finfo(float).tiny)
    if share < 0.25:
        return True, damping * 4.0
    return True, max(damping * 0.1, _LEAST_DAMPING) if share > 0.75 else damping
