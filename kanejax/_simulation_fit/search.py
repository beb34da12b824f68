"""The loop over steps of the simulation stage, for many starts side by side, and what it found."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._checkpoint import Checkpoint
from kanejax._parameters.parameterization import Parameterization
from kanejax._simulation_fit.best import Best
from kanejax._simulation_fit.levenberg_marquardt import MOST_DAMPING, Proposal, cost, next_damping, proposal
from kanejax._simulation_fit.recorded import Recorded
from kanejax._simulation_fit.search_state import LOOSE, Place, State, first_state, in_round, on_device, with_ends
from kanejax._simulation_fit.shooting import NUMBERS, Linearization, Shooting, linearized
from kanejax._simulation_fit.simulation_fit import Iteration, SimulationFit

# Standard deviations that change by less than this are not estimated again, and not more often than this.
_SIGMA_CHANGE, _SIGMA_ROUNDS = 0.05, 4
# A fit is at its end where a step promises less than this fraction of the cost; with windows before the last, than a greater one.
_ENOUGH, _LITTLE = 1e-7, 1e-2
# At a minimum the residuals are orthogonal to what the parameters change; the cosine where rounding errors stop the descent.
_ORTHOGONAL = 1e-3


class _Point(NamedTuple):
    """What is found at a place, of each start."""

    at: Linearization
    cost: Float[Array, " starts"]
    gaps: Float[Array, " starts"]

    @property
    def costs_and_gaps(self) -> tuple[np.ndarray, np.ndarray]:
        """In double precision."""
        return np.asarray(self.cost, float), np.asarray(self.gaps, float)


class Search:
    """Steps of all starts, through all lengths of windows.

    Attributes:
        state: where it is; all else follows from it.
        has_point: whether there is something to tell of where it is.
    """

    def __init__(
        self,
        parameterization: Parameterization,
        thetas: jax.Array,
        data: Recorded,
        progress: Callable[[Iteration], None] | None,
        checkpoint: Checkpoint,
    ) -> None:
        self.parameterization, self.data, self.progress, self.checkpoint = parameterization, data, progress, checkpoint
        self.state = checkpoint.restored(first_state(thetas, data.states, data.sigma))
        self.has_point = False

    def run(self, number: int, shooting: Shooting, window: float | None, max_iterations: int, is_last: bool) -> None:
        """Go on with windows of this length until every start has come to an end, and to standard deviations that stay.

        Unless it is the last length, an end is where little would change. Those that were gone through before are passed over.
        """
        if self.state.window > number:
            return
        self.is_last, self.has_gaps = is_last, bool(np.any(np.asarray(shooting.pieces.joined)))
        begun = self.state if self.state.window == number else self._in_window(number, shooting)
        # An interrupt finds all or none of the new ones.
        self.state, self.point, self.shooting = begun, _point(shooting, *on_device(begun.place)), shooting
        self.has_point = True
        try:
            self._descend(window, max_iterations)
            while (following := self._next_round(max_iterations)) is not None:
                self.state, self.point = following, _point(shooting, *on_device(following.place))
                self._descend(window, max_iterations)
        finally:
            # What has open gaps yet, as after an interrupt, is no motion; that of the deviations before is.
            state = self.state
            if shooting.robust and state.has_settled and not state.converged[self.best]:
                self.state, self.point = state._replace(place=state.settled), _point(shooting, *on_device(state.settled))

    def _in_window(self, number: int, shooting: Shooting) -> State:
        """At the beginning of windows of the next length."""
        state, first = self.state, np.asarray(shooting.pieces.index)[:, 0]
        states = jnp.asarray(state.samples[:, first], state.place.thetas.dtype)
        place = state.place._replace(states=states, tightness=np.full(len(states), LOOSE))
        samples = state.samples[:, :0] if self.is_last else state.samples
        return in_round(state._replace(window=number, round=0, used=0, has_settled=False, samples=samples), place)

    def _next_round(self, max_iterations: int) -> State | None:
        """At the beginning of a round with other standard deviations, or None if there is none."""
        state = self._with_samples(self.state)
        if state.converged[self.best]:
            state = state._replace(settled=state.place, has_settled=True)
        sigma = self._sigma()
        is_other = sigma is not None
        self.state = state = state._replace(place=state.place._replace(sigma=sigma)) if is_other else state
        if not is_other or state.used >= max_iterations or state.round + 1 == _SIGMA_ROUNDS:
            return None
        # With other standard deviations the fit moves, which tight gaps would make a long way.
        place = state.place._replace(tightness=np.full(len(state.place.thetas), LOOSE))
        return in_round(state._replace(round=state.round + 1), place)

    def _descend(self, window: float | None, max_iterations: int) -> None:
        """Take steps until every start has come to an end."""
        while True:
            place, point = self.state.place, self.point
            dampings = jnp.asarray(self.state.dampings, place.thetas.dtype)
            step = _proposals(self.parameterization, place.thetas, place.states, point.at, dampings)
            self.state = self._with_ends(np.asarray(step.promised, float), np.asarray(step.slope))
            if self.state.used >= max_iterations or self.state.is_over.all():
                break
            self._iterate(step, window)
        left = np.flatnonzero(~self.state.is_over).tolist()
        unfinished = (False, "did not come to an end in the iterations that were allowed")
        self.state = with_ends(self.state, dict.fromkeys(left, unfinished))

    def _iterate(self, step: Proposal, window: float | None) -> None:
        """Take the step, for the starts where it lowers the cost as it should."""
        state, (costs, gaps) = self.state, self.point.costs_and_gaps
        # What is judged by the tightness of now is linearised with that of the next step.
        place, weights = state.place, state.place.tightness**2
        tried = Place(step.theta, step.starts, self._tighter(costs, gaps), place.sigma)
        new = _point(self.shooting, *on_device(tried))
        new_costs, new_gaps = new.costs_and_gaps
        taken, dampings, promised = np.zeros(len(costs), bool), state.dampings.copy(), np.asarray(step.promised, float)
        for i in np.flatnonzero(~state.is_over):
            reached = costs[i] + weights[i] * gaps[i] - (new_costs[i] + weights[i] * new_gaps[i])
            taken[i], dampings[i] = next_damping(dampings[i], reached, promised[i], int(state.failures[i]))
        point = _chosen(taken, new, self.point)
        thetas, states = _chosen(taken, (tried.thetas, tried.states), (place.thetas, place.states))
        place = Place(thetas, states, np.where(taken, tried.tightness, place.tightness), place.sigma)
        failures = np.where(taken, 0, state.failures + 1)
        state = state._replace(place=place, used=state.used + 1, dampings=dampings, failures=failures)
        state = self._with_history(state, point, taken, window)
        self.state, self.point = self._loosened(state, point)
        self.checkpoint.keep(self.state)
        if self.progress is not None:
            self.progress(self.state.iterations[-1])

    def _tighter(self, costs: np.ndarray, gaps: np.ndarray) -> np.ndarray:
        """The tightness for the next step: more of it, until the gaps do not matter."""
        tightness = self.state.place.tightness
        if not self.has_gaps:
            return tightness
        return np.where(self._is_tight(costs, gaps), tightness, np.minimum(tightness * self.state.factors, 1e-2 / self._least_gap))

    @property
    def _least_gap(self) -> float:
        """Gap that rounding errors make."""
        return 1e3 * float(jnp.finfo(self.state.place.thetas.dtype).eps) * float(np.abs(self.data.states).max())

    def _is_tight(self, costs: np.ndarray, gaps: np.ndarray) -> np.ndarray:
        if not self.has_gaps:
            return np.ones(len(gaps), bool)
        tightness = self.state.place.tightness
        small = (tightness**2 * gaps <= 1e-7 * costs) | (gaps <= self._least_gap**2)
        return (small & (tightness > LOOSE)) | (tightness >= 1e-2 / self._least_gap)

    def _loosened(self, state: State, point: _Point) -> tuple[State, _Point]:
        """Where steps go on failing, go back to gaps that weigh less, and from there on in smaller strides."""
        tightness, factors = state.place.tightness, state.factors
        failed = (state.failures > 1) & ~state.is_over & (tightness > LOOSE)
        if not self.has_gaps or not failed.any():
            return state, point
        place = state.place._replace(tightness=np.where(failed, np.maximum(tightness / factors, LOOSE), tightness))
        factors = np.where(failed, np.maximum(np.sqrt(factors), 2.0), factors)
        return state._replace(place=place, factors=factors), _point(self.shooting, *on_device(place))

    def _with_ends(self, promised: np.ndarray, slopes: np.ndarray) -> State:
        """The state, with starts that are at their end."""
        state, (costs, gaps) = self.state, self.point.costs_and_gaps
        sigma, tightness = state.place.sigma, state.place.tightness
        eps, rounding = float(jnp.finfo(state.place.thetas.dtype).eps), self.data.rounding(sigma)
        tolerance = max(_ENOUGH, 1e2 * eps) if self.is_last else _LITTLE
        tight, values = self._is_tight(costs, gaps), costs + tightness**2 * gaps
        noise = (tightness * self._least_gap) ** 2 if self.has_gaps else np.zeros(len(costs))
        ends = {}
        for i in np.flatnonzero(~state.is_over).tolist():
            if not np.isfinite(costs[i] + gaps[i]):
                ends[i] = (False, _NOTHING)
            elif tight[i] and values[i] <= rounding:
                ends[i] = (True, "the residuals are rounding errors")
            elif tight[i] and state.dampings[i] <= 1.0 and promised[i] <= tolerance * values[i] + noise[i]:
                ends[i] = (True, f"no step lowers the cost by more than a fraction of {tolerance:.0e}")
            elif not np.isfinite(promised[i]):
                ends[i] = (False, "the sensitivities of the simulation are not finite")
            elif state.dampings[i] > MOST_DAMPING:
                ends[i] = (bool(tight[i] and slopes[i] < _ORTHOGONAL), "no step lowers the cost any more")
        return with_ends(state, ends)

    def _with_history(self, state: State, point: _Point, taken: np.ndarray, window: float | None) -> State:
        costs, gaps = point.costs_and_gaps
        best = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
        number = len(state.history) + 1
        row = [np.nan if window is None else window, number, costs[best], np.sqrt(gaps[best]), state.dampings[best], taken[best]]
        return state._replace(history=np.concatenate((state.history, np.array(row, float)[None])))

    def _with_samples(self, state: State) -> State:
        """The state, with states at all samples for other windows."""
        if self.is_last:
            return state
        inside, index = np.asarray(self.shooting.inside), np.asarray(self.shooting.pieces.index)[:, :-1]
        states, samples = np.asarray(self.point.at.states), state.samples.copy()
        for i in np.flatnonzero(np.isfinite(states).all((1, 2, 3))):
            samples[i, index[inside]] = states[i][inside]
        return state._replace(samples=samples)

    @property
    def best(self) -> int:
        """The start with the least cost, of those that converged if there are such."""
        costs = np.asarray(self.point.cost, float)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        return int(np.lexsort((costs, ~self.state.converged))[0])

    def _of_best(self) -> Best:
        best, place = self.best, self.state.place
        at: Linearization = jax.tree.map(lambda x: x[best], self.point.at)
        return Best(self.shooting, self.data, place.sigma, place.thetas[best], at)

    def _sigma(self) -> jax.Array | None:
        """Standard deviations from the residuals, for outputs whose is not given; None if none has changed."""
        sigma = self.state.place.sigma
        found, old = np.maximum(self._of_best().sizes, 100.0 * self.data.least), np.asarray(sigma, float)
        new = np.where(self.data.is_given | ~np.isfinite(found) | (self.data.count == 0), old, found)
        return None if np.all(np.abs(new / old - 1.0) < _SIGMA_CHANGE) else jnp.asarray(new, sigma.dtype)

    def fit(self, interrupted: bool = False) -> SimulationFit:
        """What was found until now."""
        best, number, data, sigma, history = self._of_best(), self.best, self.data, self.state.place.sigma, self.state.iterations
        converged, message = bool(self.state.converged[number]), str(self.state.reasons[number])
        if interrupted:
            converged, message = False, "interrupted"
        costs = np.where(np.isfinite(np.asarray(self.point.cost)), np.asarray(self.point.cost, float), np.inf)
        agreeing = int(np.sum(costs <= costs[number] * (1 + 1e-6) + data.rounding(sigma))), len(costs)
        if len(costs) > 1:
            message += f"; {agreeing[0]} of {agreeing[1]} starts agree"
        sizes = np.sqrt(np.asarray(best.at.squares, float) / np.maximum(data.count, 1))
        names = self.shooting.outputs
        return SimulationFit(
            theta=best.theta,
            phi=self.parameterization.phi(best.theta),
            converged=converged,
            message=message,
            iterations=len(history),
            cost=float(costs[number]),
            history=history,
            factor=best.at.factor * best.precision,
            count=int(data.count.sum()) - (best.fitted - len(best.theta)),
            sigma=dict(zip(names, np.asarray(sigma, float), strict=True)),
            rms=dict(zip(names, sizes, strict=True)),
            predicted=best.predictions(self.parameterization),
            starts=costs,
            agreeing=agreeing,
        )


_NOTHING = "the simulation from the start comes to nothing; start with short windows, such as windows=(0.1, None)"


@eqx.filter_jit
def _point(shooting: Shooting, thetas: jax.Array, states: jax.Array, sigma: jax.Array, tightness: jax.Array) -> _Point:
    def one(theta: jax.Array, states: jax.Array, tightness: jax.Array) -> _Point:
        at = linearized(shooting, shooting.parameterization.phi(theta), states, sigma, tightness, max(NUMBERS // len(thetas), 1))
        return _Point(at, *cost(shooting.parameterization, theta, at))

    return jax.vmap(one)(thetas, states, tightness)


@eqx.filter_jit
def _proposals(
    parameterization: Parameterization, thetas: jax.Array, states: jax.Array, at: Linearization, dampings: jax.Array
) -> Proposal:
    return jax.vmap(proposal, (None, 0, 0, 0, 0))(parameterization, thetas, states, at, dampings)


def _chosen[T](taken: np.ndarray, new: T, old: T) -> T:
    """The new one for the starts whose step was taken."""
    if taken.all():
        return new
    if not taken.any():
        return old
    return jax.tree.map(lambda a, b: jnp.where(taken.reshape(-1, *(1,) * (a.ndim - 1)), a, b), new, old)
