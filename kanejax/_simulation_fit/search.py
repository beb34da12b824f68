"""The loop over steps of the simulation stage, for many starts side by side, and what it found."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._parameters.parameterization import Parameterization
from kanejax._regression.huber import HUBER
from kanejax._simulation_fit.levenberg_marquardt import FIRST_DAMPING, MOST_DAMPING, Proposal, cost, next_damping, proposal
from kanejax._simulation_fit.recorded import Recorded
from kanejax._simulation_fit.shooting import Linearization, Shooting, linearized
from kanejax._simulation_fit.simulation_fit import Iteration, Prediction, SimulationFit

# Standard deviations that change by less than this are not estimated again, and not more often than this.
_SIGMA_CHANGE, _SIGMA_ROUNDS = 0.05, 4
# The weight of gaps [s/rad], relative to that of one standard deviation, at first, and by how much it grows.
_LOOSE, _TIGHTEN = 1.0, 30.0
# A fit is at its end where a step promises less than this fraction of the cost; with windows before the last, than a greater one.
_ENOUGH, _LITTLE = 1e-7, 1e-2
# At a minimum the residuals are orthogonal to what the parameters change; the cosine where rounding errors stop the descent.
_ORTHOGONAL = 1e-3


class _Point(NamedTuple):
    """Where each of the starts is: all that has a leading axis of starts."""

    thetas: Float[Array, "starts m"]
    states: Float[Array, "starts pieces nx"]
    at: Linearization
    cost: Float[Array, " starts"]
    gaps: Float[Array, " starts"]


class Search:
    """Steps of all starts, through all lengths of windows.

    Attributes:
        history: of the iterations.
        sigma: standard deviations of the outputs, (noutput, nv).
    """

    def __init__(
        self, parameterization: Parameterization, thetas: jax.Array, data: Recorded, progress: Callable[[Iteration], None] | None
    ) -> None:
        self.parameterization, self.data, self.progress = parameterization, data, progress
        self.thetas, self.sigma, self.history = thetas, data.sigma, []
        # States at all samples, from which the pieces of the next windows start.
        self.samples = np.repeat(data.states[None], len(thetas), 0)
        self.ends: list[tuple[bool, str]] = [(False, "not begun")] * len(thetas)

    def run(self, shooting: Shooting, window: float | None, max_iterations: int, is_last: bool) -> None:
        """Go on with windows of this length until every start has come to an end, and to standard deviations that stay.

        Unless it is the last length, an end is where little would change.
        """
        self.is_last, index = is_last, np.asarray(shooting.pieces.index)
        self.has_gaps = bool(np.any(np.asarray(shooting.pieces.joined)))
        self.tightness = np.full(len(self.thetas), _LOOSE)
        states = jnp.asarray(self.samples[:, index[:, 0]], self.thetas.dtype)
        left, settled, ended = max_iterations, None, False
        try:
            for _ in range(_SIGMA_ROUNDS):
                # An interrupt finds both or neither of the new ones.
                self.point, self.shooting = self._point(shooting, self.thetas, states, self.tightness), shooting
                ended = False
                left = self._descend(window, left)
                ended = self.ends[self.best][0]
                self._keep()
                if ended:
                    settled = self.point, self.thetas, self.tightness, self.sigma
                if not self._estimate_sigma() or left <= 0:
                    break
                states = self.point.states
                if shooting.robust:
                    # Other residuals are far out now, and the fit moves, which tight gaps would make a long way.
                    self.tightness = np.full(len(self.thetas), _LOOSE)
        finally:
            # What has open gaps yet, as after an interrupt, is no motion; that of the deviations before is.
            if shooting.robust and settled is not None and not ended:
                self.point, self.thetas, self.tightness, self.sigma = settled

    def _point(self, shooting: Shooting, thetas: jax.Array, states: jax.Array, tightness: np.ndarray) -> _Point:
        return _point(shooting, thetas, states, self.sigma, jnp.asarray(tightness, thetas.dtype))

    def _descend(self, window: float | None, left: int) -> int:
        """Take steps until every start has come to an end; how many iterations are left."""
        count = len(self.thetas)
        costs, gaps = np.asarray(self.point.cost, float), np.asarray(self.point.gaps, float)
        dampings, factors, failures = np.full(count, FIRST_DAMPING), np.full(count, _TIGHTEN), np.zeros(count, int)
        ends = [None if np.isfinite(costs[i] + gaps[i]) else (False, _NOTHING) for i in range(count)]
        while True:
            point = self.point
            step = _proposals(self.parameterization, point.thetas, point.states, point.at, jnp.asarray(dampings, self.thetas.dtype))
            promised = np.asarray(step.promised, float)
            self._look(costs, gaps, dampings, promised, np.asarray(step.slope), ends)
            if left <= 0 or all(ends):
                break
            left -= 1
            # What is judged by the tightness of now is linearised with that of the next step.
            weights, tighter = self.tightness**2, self._tighter(costs, gaps, factors)
            new = self._point(self.shooting, step.theta, step.starts, tighter)
            taken = np.zeros(count, bool)
            for i in np.flatnonzero([end is None for end in ends]):
                after = float(new.cost[i]) + weights[i] * float(new.gaps[i])
                reached = costs[i] + weights[i] * gaps[i] - after
                taken[i], dampings[i] = next_damping(dampings[i], reached, promised[i], int(failures[i]))
            failures = np.where(taken, 0, failures + 1)
            self.point = _chosen(taken, new, point)
            self.thetas, self.tightness = self.point.thetas, np.where(taken, tighter, self.tightness)
            costs, gaps = np.asarray(self.point.cost, float), np.asarray(self.point.gaps, float)
            self._loosen((failures > 1) & np.array([end is None for end in ends]), factors)
            self._tell(window, costs, gaps, dampings, taken)
        self.ends = [end or (False, "did not come to an end in the iterations that were allowed") for end in ends]
        return left

    def _tighter(self, costs: np.ndarray, gaps: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """The tightness for the next step: more of it, until the gaps do not matter."""
        if not self.has_gaps:
            return self.tightness
        return np.where(self._is_tight(costs, gaps), self.tightness, np.minimum(self.tightness * factors, 1e-2 / self._least_gap))

    @property
    def _least_gap(self) -> float:
        """Gap that rounding errors make."""
        return 1e3 * float(jnp.finfo(self.thetas.dtype).eps) * float(np.abs(self.data.states).max())

    def _is_tight(self, costs: np.ndarray, gaps: np.ndarray) -> np.ndarray:
        if not self.has_gaps:
            return np.ones(len(gaps), bool)
        small = (self.tightness**2 * gaps <= 1e-7 * costs) | (gaps <= self._least_gap**2)
        return (small & (self.tightness > _LOOSE)) | (self.tightness >= 1e-2 / self._least_gap)

    def _loosen(self, failed: np.ndarray, factors: np.ndarray) -> None:
        """Where steps go on failing, go back to gaps that weigh less, and from there on in smaller strides."""
        failed = failed & (self.tightness > _LOOSE)
        if self.has_gaps and failed.any():
            self.tightness = np.where(failed, np.maximum(self.tightness / factors, _LOOSE), self.tightness)
            factors[failed] = np.maximum(np.sqrt(factors[failed]), 2.0)
            self.point = self._point(self.shooting, self.point.thetas, self.point.states, self.tightness)

    def _look(
        self, costs: np.ndarray, gaps: np.ndarray, dampings: np.ndarray, promised: np.ndarray, slopes: np.ndarray, ends: list
    ) -> None:
        """Note which starts are at their end."""
        eps, rounding = float(jnp.finfo(self.thetas.dtype).eps), self.data.rounding(self.sigma)
        tolerance = max(_ENOUGH, 1e2 * eps) if self.is_last else _LITTLE
        tight, values = self._is_tight(costs, gaps), costs + self.tightness**2 * gaps
        noise = (self.tightness * self._least_gap) ** 2 if self.has_gaps else np.zeros(len(costs))
        for i in np.flatnonzero([end is None for end in ends]):
            if tight[i] and values[i] <= rounding:
                ends[i] = (True, "the residuals are rounding errors")
            elif tight[i] and dampings[i] <= 1.0 and promised[i] <= tolerance * values[i] + noise[i]:
                ends[i] = (True, f"no step lowers the cost by more than a fraction of {tolerance:.0e}")
            elif not np.isfinite(promised[i]):
                ends[i] = (False, "the sensitivities of the simulation are not finite")
            elif dampings[i] > MOST_DAMPING:
                ends[i] = (bool(tight[i] and slopes[i] < _ORTHOGONAL), "no step lowers the cost any more")

    def _tell(self, window: float | None, costs: np.ndarray, gaps: np.ndarray, dampings: np.ndarray, taken: np.ndarray) -> None:
        best = int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))
        where = float(costs[best]), float(np.sqrt(gaps[best])), float(dampings[best]), bool(taken[best])
        self.history.append(Iteration(window, len(self.history) + 1, *where))
        if self.progress is not None:
            self.progress(self.history[-1])

    def _keep(self) -> None:
        """Keep the states at all samples for other windows."""
        inside, index = np.asarray(self.shooting.inside), np.asarray(self.shooting.pieces.index)[:, :-1]
        states = np.asarray(self.point.at.states)
        finite = np.isfinite(states).all((1, 2, 3))
        for i in np.flatnonzero(finite):
            self.samples[i, index[inside]] = states[i][inside]

    @property
    def best(self) -> int:
        """The start with the least cost, of those that converged if there are such."""
        costs = np.asarray(self.point.cost, float)
        order = [(not end[0], value if np.isfinite(value) else np.inf) for end, value in zip(self.ends, costs, strict=True)]
        return min(range(len(order)), key=order.__getitem__)

    def _sizes(self) -> np.ndarray:
        """Standard deviations of each output's errors at the best start."""
        count = self.data.count
        left = np.maximum(count * self._share_left(), 1.0)
        if not self.shooting.robust:
            return np.sqrt(np.asarray(self.point.at.squares[self.best], float) / left)
        sizes = np.where(self._counting(), np.asarray(self.point.at.sizes[self.best], float), np.nan)
        missing = np.isnan(sizes).all((0, 1))
        median = 1.4826 * np.nanmedian(np.where(missing, 0.0, sizes), (0, 1))
        return np.asarray(self.sigma, float) * median * np.sqrt(count / left)

    def _share_left(self) -> float:
        """Of the residuals' freedom, what the fit has not taken up."""
        return 1.0 - self._fitted() / max(int(self.data.count.sum()), 1)

    def _counting(self) -> np.ndarray:
        """Which residuals of the pieces count."""
        index = np.asarray(self.shooting.pieces.index)[:, :-1]
        weight = np.where(np.asarray(self.shooting.inside)[..., None], np.asarray(self.shooting.measured.weight)[index], 0.0)
        return np.broadcast_to((weight > 0)[:, :, None], (*index.shape, *self.sigma.shape))

    def _precision(self) -> float:
        """What a robust fit's factor has to be multiplied by to be that of its covariance (Huber 1964); 1 for others."""
        if not self.shooting.robust:
            return 1.0
        sizes = np.asarray(self.point.at.sizes[self.best], float)[self._counting()]
        spread = float(np.mean(np.minimum(sizes, HUBER) ** 2)) / max(self._share_left(), 1e-3)
        weight = float(np.mean(HUBER / np.maximum(sizes, HUBER)))
        return float(np.mean(sizes < HUBER)) / np.sqrt(spread * weight) if spread > 0 else 1.0

    def _estimate_sigma(self) -> bool:
        """Standard deviations from the residuals, for outputs whose is not given; whether one has changed."""
        count = self.data.count
        found = np.maximum(self._sizes(), 100.0 * self.data.least)
        old = np.asarray(self.sigma, float)
        new = np.where(self.data.is_given | ~np.isfinite(found) | (count == 0), old, found)
        if np.all(np.abs(new / old - 1.0) < _SIGMA_CHANGE):
            return False
        self.sigma = jnp.asarray(new, self.sigma.dtype)
        return True

    def _fitted(self) -> int:
        """Number of unknowns that were fitted to the data."""
        pieces = self.shooting.pieces
        sought = ~np.append(False, np.asarray(pieces.joined)[:-1]) & ~np.asarray(self.shooting.given)
        return self.thetas.shape[1] + int(np.sum(sought)) * self.point.states.shape[-1]

    def fit(self, interrupted: bool = False) -> SimulationFit:
        """What was found until now."""
        best, data = self.best, self.data
        at: Linearization = jax.tree.map(lambda x: x[best], self.point.at)
        converged, message = (False, "interrupted") if interrupted else self.ends[best]
        costs = np.where(np.isfinite(np.asarray(self.point.cost)), np.asarray(self.point.cost, float), np.inf)
        agreeing = int(np.sum(costs <= costs[best] * (1 + 1e-6) + data.rounding(self.sigma))), len(costs)
        if len(costs) > 1:
            message += f"; {agreeing[0]} of {agreeing[1]} starts agree"
        theta = self.point.thetas[best]
        sizes = np.sqrt(np.asarray(at.squares, float) / np.maximum(data.count, 1))
        names = self.shooting.outputs
        return SimulationFit(
            theta=theta,
            phi=self.parameterization.phi(theta),
            converged=converged,
            message=message,
            iterations=len(self.history),
            cost=float(costs[best]),
            history=tuple(self.history),
            factor=at.factor * self._precision(),
            count=int(data.count.sum()) - (self._fitted() - len(theta)),
            sigma=dict(zip(names, np.asarray(self.sigma, float), strict=True)),
            rms=dict(zip(names, sizes, strict=True)),
            predicted=self._predictions(at),
            starts=costs,
            agreeing=agreeing,
        )

    def _predictions(self, at: Linearization) -> tuple[Prediction, ...]:
        inside, index = np.asarray(self.shooting.inside), np.asarray(self.shooting.pieces.index)[:, :-1]
        states, outputs = np.empty(self.data.states.shape), np.empty((len(self.data.states), *self.sigma.shape))
        states[index[inside]], outputs[index[inside]] = np.asarray(at.states)[inside], np.asarray(at.predicted)[inside]
        names, nq, found, first = self.shooting.outputs, self.parameterization.tree.nq, [], 0
        for ts in self.data.times:
            here = slice(first, first + len(ts))
            first += len(ts)
            effort = outputs[here, names.index("effort")] if "effort" in names else None
            found.append(Prediction(ts, states[here, :nq], states[here, nq:], effort))
        return tuple(found)


_NOTHING = "the simulation from the start comes to nothing; start with short windows, such as windows=(0.1, None)"


@eqx.filter_jit
def _point(shooting: Shooting, thetas: jax.Array, states: jax.Array, sigma: jax.Array, tightness: jax.Array) -> _Point:
    def one(theta: jax.Array, states: jax.Array, tightness: jax.Array) -> _Point:
        at = linearized(shooting, shooting.parameterization.phi(theta), states, sigma, tightness)
        return _Point(theta, states, at, *cost(shooting.parameterization, theta, at))

    return jax.vmap(one)(thetas, states, tightness)


@eqx.filter_jit
def _proposals(
    parameterization: Parameterization, thetas: jax.Array, states: jax.Array, at: Linearization, dampings: jax.Array
) -> Proposal:
    return jax.vmap(proposal, (None, 0, 0, 0, 0))(parameterization, thetas, states, at, dampings)


def _chosen(taken: np.ndarray, new: _Point, old: _Point) -> _Point:
    """The new point for the starts whose step was taken."""
    if taken.all():
        return new
    if not taken.any():
        return old
    return jax.tree.map(lambda a, b: jnp.where(taken.reshape(-1, *(1,) * (a.ndim - 1)), a, b), new, old)
