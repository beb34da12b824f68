"""The search for the motion that tells most: from many random motions at once, by Adam on an augmented Lagrangian.

Limits of position, speed and acceleration hold by construction: a joint's amplitudes are divided by what its largest value would
exceed them by. Torques and other conditions are constraints of an augmented Lagrangian (Nocedal and Wright 2006, 17.4), which
Adam's steps (Kingma and Ba 2015) minimise. What is left of violations on a finer grid is taken out by making the motion smaller.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import lax
from jaxtyping import Array, Float, Int

from kanejax._dynamics.equations_of_motion import inverse_dynamics
from kanejax._excitation.fourier_motion import FourierMotion
from kanejax._excitation.motion_information import force_columns
from kanejax._excitation.motion_limits import Margins, MotionLimits
from kanejax._model.model import Model

Objective = Literal["log det", "condition number"]
PathConstraint = Callable[[Float[Array, " nq"]], Float[Array, " constraints"]]
# Times a period for each harmonic: of information and constraints while searching, of limits of single joints, of the final check.
SAMPLES, CONSTRAINED, LIMITED, CHECKED = 12, 24, 64, 192
# Steps between two updates of the multipliers, and two reports.
ROUND = 25
_FIRST_STEP = 0.05
# Of the norm that stands for the largest value, so that all values near it count.
_POWER = 1024.0
# How far constraints are kept inside while searching, and their weight at the beginning and at the end.
_RESERVE = 0.005
_WEIGHTS = (10.0, 1e3)
# What rounding to single precision takes.
_ROUNDING = 1.0 + 2e-6
# Factors that the final check tries, one after another.
_SMALLER = (1.0, 0.999, 0.998, 0.996, 0.993, 0.99, 0.985, 0.98, 0.97, 0.95, 0.925, 0.9, 0.85, 0.8, 0.7, 0.6, 0.45, 0.3, 0.15, 0.05)


@final
class Problem(eqx.Module):
    """What is sought, and within which limits, in float64.

    Attributes:
        model: the robot.
        limits: that the motion must keep.
        period: of the motion.
        rest: orthonormal bases of a and b that start at rest, (harmonics, free) each.
        typical_speed: of each joint.
        weight: one over the standard deviations of the errors of torques.
        independent: columns of the base parameters.
        size: what columns are multiplied by for the condition number; None: one over their lengths.
        unknowns: what the columns are of.
        objective: "log det" or "condition number".
        path_constraint: function of q in data type `dtype`, or None.
        has_torque_limits: whether some torque is limited.
        dtype: the user's.
    """

    model: Model
    limits: MotionLimits
    period: Float[Array, ""]
    rest: tuple[Float[Array, "harmonics free"], Float[Array, "harmonics free"]]
    typical_speed: Float[Array, " nv"]
    weight: Float[Array, " nv"]
    independent: Int[Array, " nbase"]
    size: Float[Array, " nbase"] | None
    unknowns: tuple[str, ...] = eqx.field(static=True)
    objective: Objective = eqx.field(static=True)
    path_constraint: PathConstraint | None = eqx.field(static=True)
    has_torque_limits: bool = eqx.field(static=True)
    dtype: str = eqx.field(static=True)

    @property
    def harmonics(self) -> int:
        """Number of frequencies."""
        return self.rest[0].shape[0]

    @property
    def constrained(self) -> bool:
        """Whether there is more than what holds by construction."""
        return self.has_torque_limits or self.path_constraint is not None

    def times(self, per_harmonic: int) -> Float[Array, " n"]:
        """Equally spaced times of one period."""
        count = per_harmonic * self.harmonics
        return jnp.arange(count) / count * self.period

    def motion(self, x: Float[Array, "nv parameters"]) -> FourierMotion:
        """The motion at free parameters; any give one within the limits of position, speed and acceleration."""
        a, b, offset = jnp.split(x, (self.rest[0].shape[1], x.shape[1] - 1), axis=1)
        amplitudes = [
            self.typical_speed[:, None] * jnp.matmul(part, basis.T, precision="highest")
            for part, basis in zip((a, b), self.rest, strict=True)
        ]
        bounded = jnp.isfinite(self.limits.low)
        low, high = (jnp.where(bounded, limit, 0.0) for limit in (self.limits.low, self.limits.high))
        offset = jnp.where(bounded, 0.5 * (low + high) + 0.475 * (high - low) * jnp.tanh(offset[:, 0]), offset[:, 0])
        motion = FourierMotion(self.model.tree.joint_names, self.period, offset, *amplitudes)
        return motion.scaled(1.0 / self._excess(motion))

    def _excess(self, motion: FourierMotion) -> Float[Array, " nv"]:
        """By what each joint's amplitudes must be divided; 1 for those well within limits."""
        q, u, u_dot = states(motion, self.times(LIMITED))
        way, limits = q - motion.offset[None], self.limits
        ratios = jnp.stack(
            (
                jnp.maximum(way / (limits.high - motion.offset)[None], way / (limits.low - motion.offset)[None]),
                jnp.abs(u) / limits.speed[None],
                jnp.abs(u_dot) / limits.acceleration[None],
            )
        )
        ratios = ratios.reshape(-1, self.model.nv) * (_ROUNDING * between_times(LIMITED))
        # A norm is homogeneous: dividing by the largest first changes neither it nor its derivative, and nothing overflows.
        largest = lax.stop_gradient(jnp.maximum(1.0, jnp.max(ratios, 0)))
        powers = jnp.sum((ratios / largest[None]) ** _POWER, 0) + (1.0 / largest) ** _POWER
        return largest * powers ** (1.0 / _POWER)

    def cost(self, motion: FourierMotion) -> Float[Array, ""]:
        """What is minimised: minus the logarithm of the determinant, or the logarithm of the condition number."""
        q, u, u_dot = states(motion, self.times(SAMPLES))
        columns = jax.vmap(force_columns, (None, None, 0, 0, 0))(self.model, self.unknowns, q, u, u_dot)
        rows = columns[:, :, self.independent] * self.weight[None, :, None]
        rows = rows.reshape(-1, rows.shape[-1]) / np.sqrt(len(q))
        lengths = jnp.sqrt(jnp.maximum(jnp.sum(rows * rows, 0), 1e-200))
        scaled = rows / lengths[None] if self.size is None or self.objective == "log det" else rows * self.size[None]
        gram = jnp.matmul(scaled.T, scaled, precision="highest")
        if self.objective == "condition number":
            sizes = jnp.linalg.eigvalsh(gram)
            return 0.5 * (jnp.log(sizes[-1]) - jnp.log(jnp.maximum(sizes[0], 1e-18 * sizes[-1])))
        # Where something is not excited, the determinant is not quite zero, and its derivative says what would excite it.
        root = jnp.linalg.cholesky(gram + 1e-14 * jnp.eye(len(gram)))
        return -2.0 * jnp.sum(jnp.log(jnp.diagonal(root))) - 2.0 * jnp.sum(jnp.log(lengths))

    def constraints(self, motion: FourierMotion, per_harmonic: int) -> Float[Array, "n constraints"]:
        """Numbers that must not be positive: torques over their limits, less 1, and the path constraint."""
        torque, path = self.torque_and_path(motion, per_harmonic)
        return jnp.concatenate((jnp.abs(torque) / self.limits.torque[None] - 1.0, path), 1)

    def torque_and_path(self, motion: FourierMotion, per_harmonic: int) -> tuple[Float[Array, "n nv"], Float[Array, "n path"]]:
        """Torques, and the path constraint, at equally spaced times."""
        q, u, u_dot = states(motion, self.times(per_harmonic))
        torque = jax.vmap(inverse_dynamics, (None, 0, 0, 0))(self.model, q, u, u_dot)
        constraint = self.path_constraint
        if constraint is None:
            return torque, jnp.zeros((len(q), 0))
        path = jax.vmap(lambda q: jnp.ravel(jnp.asarray(constraint(q.astype(self.dtype)))).astype(jnp.float64))(q)
        return torque, path


class Candidates(NamedTuple):
    """Motions (with a leading axis), their costs, and by how much they break torque limits and path constraint, at least 0."""

    motion: FourierMotion
    cost: Float[Array | np.ndarray, " starts"]
    violation: Float[Array | np.ndarray, " starts"]


class Progress(NamedTuple):
    """How far a search is: steps done, of how many; the best objective of all starts, and the violation of that motion."""

    step: int
    steps: int
    value: float
    violation: float


class _State(NamedTuple):
    x: Float[Array, "starts nv parameters"]
    adam: Any
    multipliers: Float[Array, "starts n constraints"]


def states(motion: FourierMotion, ts: Float[Array, " n"]) -> tuple[Array, Array, Array]:
    """Coordinates, speeds and accelerations at many times, (n, nv) each."""
    return jax.vmap(lambda t: (motion.q(t), motion.u(t), motion.u_dot(t)))(ts)


def between_times(per_harmonic: int) -> float:
    """What a trigonometric polynomial can exceed its largest value on a grid by (Jetter, Pfander and Zimmermann 2001)."""
    return float(1.0 / np.cos(np.pi / per_harmonic))


def objective_value(objective: Objective, cost: Float[Array | np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """The objective, from the cost that stands for it."""
    cost = np.asarray(cost)
    return -cost if objective == "log det" else np.asarray(np.exp(cost))


def searched(
    problem: Problem, x: Float[Array, "starts nv parameters"], steps: int, progress: Callable[[Progress], object] | None
) -> Float[Array, "starts nv parameters"]:
    """Improve the motions of all starts."""
    shape = eqx.filter_eval_shape(lambda problem, x: problem.constraints(problem.motion(x), CONSTRAINED), problem, x[0]).shape
    state = _State(x, optax.scale_by_adam().init(x), jnp.zeros((len(x), *shape)))
    for first in range(0, steps, ROUND):
        last = min(first + ROUND, steps)
        weight = _WEIGHTS[0] * (_WEIGHTS[1] / _WEIGHTS[0]) ** (last / steps)
        state, cost, violation = _round(problem, state, *(jnp.asarray(float(n)) for n in (first, last, steps, weight)))
        if progress is not None:
            best = int(np.nanargmin(np.where(np.isnan(cost), np.inf, cost)))
            value = float(objective_value(problem.objective, cost[best]))
            progress(Progress(last, steps, value, float(violation[best])))
    return state.x


@eqx.filter_jit
def _round(
    problem: Problem, state: _State, first: jax.Array, last: jax.Array, steps: jax.Array, weight: jax.Array
) -> tuple[_State, jax.Array, jax.Array]:
    """Steps from the first to the last at the same multipliers; new multipliers, costs and violations, as before the last step."""
    adam = optax.scale_by_adam()

    def lagrangian(x: jax.Array, multipliers: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        motion = problem.motion(x)
        cost = problem.cost(motion)
        if not problem.constrained:
            return cost, (cost, jnp.zeros_like(multipliers))
        broken = problem.constraints(motion, CONSTRAINED)
        pushed = jnp.maximum(multipliers + weight * (broken + _RESERVE), 0.0)
        return cost + 0.5 * jnp.sum(pushed * pushed) / weight, (cost, broken)

    def step(number: jax.Array, now: tuple) -> tuple:
        x, memory, _ = now
        gradient, found = jax.vmap(jax.grad(lagrangian, has_aux=True))(x, state.multipliers)
        # Optax raises a float to the power of an integer array.
        with jax.numpy_dtype_promotion("standard"):
            direction, memory = adam.update(gradient, memory)
        length = _FIRST_STEP * (0.01 + 0.99 * 0.5 * (1.0 + jnp.cos(jnp.pi * number.astype(float) / steps)))
        return x - length * jnp.asarray(direction), memory, found

    nothing = jnp.zeros(len(state.x)), jnp.zeros_like(state.multipliers)
    begin = state.x, state.adam, nothing
    x, memory, (cost, broken) = lax.fori_loop(first.astype(int), last.astype(int), step, begin)
    multipliers = jnp.maximum(state.multipliers + weight * (broken + _RESERVE), 0.0)
    return _State(x, memory, multipliers), cost, jnp.max(broken, (1, 2), initial=0.0)


@eqx.filter_jit
def repaired(problem: Problem, x: Float[Array, "starts nv parameters"]) -> Candidates:
    """The motions, each made smaller until it keeps torque limits and path constraint, or breaks them least."""
    motions = jax.vmap(problem.motion)(x)
    if not problem.constrained:
        return Candidates(motions, jax.vmap(problem.cost)(motions), jnp.zeros(len(x)))
    factors = jnp.asarray(_SMALLER)

    def violations(factor: jax.Array) -> jax.Array:
        def largest(motion: FourierMotion) -> jax.Array:
            return jnp.max(problem.constraints(motion.scaled(factor), CHECKED), initial=0.0)

        return lax.map(largest, motions)

    found = lax.map(violations, factors)
    # The first of the least.
    chosen = jnp.argmin(found, 0)
    smaller = jax.vmap(lambda motion, factor: motion.scaled(factor))(motions, factors[chosen])
    return Candidates(smaller, jax.vmap(problem.cost)(smaller), jnp.min(found, 0))


@eqx.filter_jit
def margins(problem: Problem, motion: FourierMotion, limits: MotionLimits) -> Margins:
    """What a motion leaves of limits, which may be others than those of the search."""
    q, u, u_dot = states(motion, problem.times(CHECKED))
    torque, path = problem.torque_and_path(motion, CHECKED)
    more = between_times(CHECKED)
    way = q - motion.offset[None]
    position = jnp.minimum(
        limits.high - motion.offset - more * jnp.max(way, 0), motion.offset - limits.low + more * jnp.min(way, 0)
    )
    largest = [jnp.max(jnp.abs(x), 0) for x in (u, u_dot, torque)]
    return Margins(
        position,
        limits.speed - more * largest[0],
        limits.acceleration - more * largest[1],
        limits.torque - largest[2],
        -jnp.max(path, 0),
    )
