"""What stops a simulation: zero crossings of functions of the state, located in time."""

from collections.abc import Callable, Mapping
from typing import Any, Literal, final

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx

from kanejax._dynamics.equations_of_motion import forward_dynamics
from kanejax._kinematics.change_of_speeds import chosen_speeds, own_speeds
from kanejax._kinematics.coordinate_rates import unit_quaternions
from kanejax._model.generalized_speeds import WithSpeeds
from kanejax._model.model import Model
from kanejax._model.specialized import Specialized, whole
from kanejax._model.tree import Tree
from kanejax._simulate.checks import check_within_limits, joint_ranges
from kanejax._types import Coordinates, Speeds

JOINT_LIMIT = "joint limit"


@final
class StateEvent(eqx.Module):
    """A zero crossing of `function(t, q, u)`, a scalar: `simulate(..., events={"name": StateEvent(function, "falling")})`.

    Attributes:
        function: a scalar of time [s], generalized coordinates and speeds.
        direction: the crossings that count: "falling", "rising", or "both".
    """

    function: Callable[..., Any]
    direction: Literal["falling", "rising", "both"] = eqx.field(static=True, default="both")

    def __check_init__(self) -> None:
        """Check the direction."""
        if self.direction not in ("falling", "rising", "both"):
            raise ValueError(f"direction is {self.direction!r}; use 'falling', 'rising' or 'both'")


@final
class Falling(eqx.Module):
    """A scalar function of (t, q, u), or minus it, as a condition of diffrax: an event is its fall through zero."""

    function: Callable[..., Any]
    sign: int = eqx.field(static=True)
    tree: Tree = eqx.field(static=True)

    def __call__(self, t: jax.Array, y: jax.Array, args: Any, **kwargs: Any) -> jax.Array:
        """Evaluate for diffrax."""
        q = unit_quaternions(self.tree, y[: self.tree.nq])
        # The data type of the constant zero that diffrax has for events that did not happen.
        return self.sign * jnp.asarray(self.function(t, q, y[self.tree.nq :])).astype(jnp.result_type(float))


def as_conditions(
    model: Model | Specialized, q0: jax.Array, events: Any, joint_limits: bool, need_direction: bool
) -> tuple[tuple[Falling, ...], tuple[str, ...]]:
    """Conditions for diffrax, and the event's name for each.

    Raises:
        TypeError: `events` is neither a function, a StateEvent, nor a mapping of names to those.
        ValueError: `need_direction`, and an event has none: the restart would look like another crossing. `joint_limits`, and the
            model has no ranges, or q0 is outside of one.
    """
    named: dict[str, Any] = dict(events) if isinstance(events, Mapping) else {} if events is None else {"event": events}
    if joint_limits:
        ranges = joint_ranges(model)
        check_within_limits(model.tree, ranges, q0)
        named = {JOINT_LIMIT: StateEvent(_LimitDistance(ranges, model.tree), "falling"), **named}
    conditions, names = [], []
    for name, event in named.items():
        if not callable(event) and not isinstance(event, StateEvent):
            raise TypeError(f"event {name!r} is {type(event).__name__}; give a function of (t, q, u) or a StateEvent")
        event = event if isinstance(event, StateEvent) else StateEvent(event)
        if need_direction and event.direction == "both":
            raise ValueError(
                f"event {name!r} has no direction, which on_event needs; give StateEvent(function, 'falling') or 'rising'"
            )
        signs = {"falling": (1,), "rising": (-1,), "both": (1, -1)}[event.direction]
        conditions += [Falling(event.function, sign, model.tree) for sign in signs]
        names += [name] * len(signs)
    return tuple(conditions), tuple(names)


@final
class _LimitDistance(eqx.Module):
    """Least distance of a coordinate to its range, negative outside."""

    joint_range: jax.Array
    tree: Tree = eqx.field(static=True)

    def __call__(self, t: jax.Array, q: jax.Array, u: jax.Array) -> jax.Array:
        low, high = limit_distances(self.tree, self.joint_range, q)
        return jnp.min(jnp.minimum(low, high))


def limit_distances(tree: Tree, joint_range: jax.Array, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    """How far each revolute and prismatic joint is above its least and below its greatest coordinate, (joints,) each.

    Raises:
        ValueError: the model has neither revolute nor prismatic joints.
    """
    joints = limited_joints(tree)
    if not joints:
        raise ValueError("joint_limits needs a revolute or prismatic joint, and this model has none")
    coordinates = q[jnp.array([tree.q_start[joint] for joint in joints])]
    ranges = joint_range[jnp.array(joints)]
    # An infinite limit is out of reach; a finite distance keeps the interpolations and gradients free of NaN.
    far = jnp.asarray(1e30, q.dtype)
    low = jnp.where(jnp.isfinite(ranges[:, 0]), coordinates - jnp.where(jnp.isfinite(ranges[:, 0]), ranges[:, 0], 0.0), far)
    high = jnp.where(jnp.isfinite(ranges[:, 1]), jnp.where(jnp.isfinite(ranges[:, 1]), ranges[:, 1], 0.0) - coordinates, far)
    return low, high


def limited_joints(tree: Tree) -> list[int]:
    """Revolute and prismatic joints."""
    return [joint for joint, kind in enumerate(tree.joint_types) if kind in ("revolute", "prismatic")]


@final
class JointLimitBounce(eqx.Module):
    """An impact at the joint limit that was reached: `simulate(model, ..., joint_limits=True, on_event=JointLimitBounce(model))`.

    The stop gives an impulse along the joint, as large as it takes to send the joint back at `restitution` times its speed; the
    other joints feel it through the mass matrix.

    Attributes:
        model: the mechanism; in chosen speeds if the one that is simulated is.
        restitution: ratio of the joint's speeds after and before, from 0 to 1; 1 conserves the energy.
    """

    model: Model | WithSpeeds
    restitution: Any = 1.0

    def __call__(self, t: jax.Array, q: Coordinates, u: Speeds) -> tuple[Coordinates, Speeds]:
        """The state after the impact at the joint that is nearest to its limit."""
        if isinstance(self.model, WithSpeeds):
            model = self.model.at(t)
            bounce = JointLimitBounce(whole(model.model), self.restitution)
            return q, chosen_speeds(model, q, bounce(t, q, own_speeds(model, q, u))[1])
        tree = self.model.tree
        low, high = limit_distances(tree, self.model.joint_range, q)
        hit = jnp.array([tree.v_start[joint] for joint in limited_joints(tree)])[jnp.argmin(jnp.minimum(low, high))]
        along = jnp.zeros_like(u).at[hit].set(1.0)
        # F^-1 times a unit impulse: the acceleration is linear in the forces.
        response = jax.jvp(lambda tau: forward_dynamics(self.model, q, u, tau), (jnp.zeros_like(u),), (along,))[1]
        return q, u - (1.0 + self.restitution) * u[hit] / response[hit] * response


@final
class FallBisection(optx.AbstractRootFinder):
    """Where a function falls through zero between `lower` and `upper`, by halving the interval down to rounding errors.

    It cannot leave the step, unlike Newton's method, and it raises nothing in batches, unlike optimistix's own bisection.
    Of several results it takes the sum: diffrax sets those of the events that did not happen to zero.
    """

    rtol: float
    atol: float
    norm: Callable = optx.max_norm

    def init(self, fn: Any, y: Any, args: Any, options: dict[str, Any], f_struct: Any, aux_struct: Any, tags: frozenset) -> Any:
        """The interval."""
        return jnp.asarray(options["lower"], y.dtype), jnp.asarray(options["upper"], y.dtype)

    def step(self, fn: Any, y: Any, args: Any, options: dict[str, Any], state: Any, tags: frozenset) -> tuple:
        """Halve it."""
        lower, upper = state
        middle = lower + 0.5 * (upper - lower)
        values, aux = fn(middle, args)
        before = sum(jnp.asarray(value, y.dtype) for value in jax.tree.leaves(values)) > 0
        lower, upper = jnp.where(before, middle, lower), jnp.where(before, upper, middle)
        return upper, (lower, upper), aux

    def terminate(self, fn: Any, y: Any, args: Any, options: dict[str, Any], state: Any, tags: frozenset) -> tuple:
        """Stop when the interval is a few rounding errors wide."""
        lower, upper = state
        return upper - lower <= self.atol + self.rtol * jnp.abs(upper), optx.RESULTS.successful

    def postprocess(
        self, fn: Any, y: Any, aux: Any, args: Any, options: dict[str, Any], state: Any, tags: frozenset, result: optx.RESULTS
    ) -> tuple:
        """Nothing to add."""
        return y, aux, {}


def event_time_finder(dtype: jnp.dtype) -> FallBisection:
    """The root finder for times of the given data type."""
    epsilon = float(jnp.finfo(dtype).eps)
    return FallBisection(rtol=4 * epsilon, atol=4 * epsilon)
