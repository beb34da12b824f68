"""What a simulation returns."""

import enum
from collections.abc import Mapping
from typing import Any, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import ArrayLike, Bool, Float, Int

from kanejax._errors import KanejaxError
from kanejax._kinematics.coordinate_rates import unit_quaternions
from kanejax._model.tree import Tree

# Arrays of JAX, or of numpy from `simulate_batch`.
Array = jax.Array | np.ndarray


class Status(enum.IntEnum):
    """How a simulation ended."""

    SUCCESSFUL = 0
    """It reached the last time."""
    EVENT = 1
    """An event stopped it; `Trajectory.event` says which."""
    MAX_STEPS = 2
    """It took `max_steps` steps."""
    MIN_STEP = 3
    """The step size shrank to nothing: the state goes to infinity, or a force is NaN or jumps."""
    NON_FINITE = 4
    """The state became infinite or NaN, or was at first."""
    SOLVER_FAILED = 5
    """The equations of an implicit step, or of an event's time, were not solved."""
    NOT_RUN = 6
    """`simulate_batch` was interrupted before."""
    SINGULAR_SPEEDS = 7
    """The speeds of `with_speeds` cease to determine the motion there; see `speed_conditioning`."""


class SimulationError(KanejaxError, RuntimeError):
    """A simulation with `throw=True` did not reach its end."""


@final
class Trajectory(eqx.Module):
    """Coordinates and speeds over time, and how the simulation ended; with a leading batch axis after `jax.vmap`.

    Attributes:
        ts: the times [s] asked for.
        q: generalized coordinates at those times, quaternions of unit length; NaN at times that were not reached.
        u: generalized speeds, likewise.
        t_end: the time at which the simulation ended; with equal steps, the last of `ts` before a failure.
        q_end: generalized coordinates at that time.
        u_end: generalized speeds at that time.
        status: a `Status`, as an integer.
        event: index into `event_names` of the event that ended it, or -1.
        num_events: events that were passed on to `on_event`.
        stats: "num_steps", "num_accepted_steps" and "num_rejected_steps".
        interpolation: the solution between the times, with `dense=True`.
        tree: of the model; static.
        event_names: what may end it; static.
    """

    ts: Float[Array, "*batch n"]
    q: Float[Array, "*batch n nq"]
    u: Float[Array, "*batch n nv"]
    t_end: Float[Array, "*batch"]
    q_end: Float[Array, "*batch nq"]
    u_end: Float[Array, "*batch nv"]
    status: Int[Array, "*batch"]
    event: Int[Array, "*batch"]
    num_events: Int[Array, "*batch"]
    stats: Mapping[str, Int[Array, "*batch"]]
    interpolation: Any
    tree: Tree = eqx.field(static=True)
    event_names: tuple[str, ...] = eqx.field(static=True)

    @property
    def ok(self) -> Bool[Array, "*batch"]:
        """Whether the simulation reached its last time or an event."""
        return (self.status == Status.SUCCESSFUL) | (self.status == Status.EVENT)

    @property
    def reached(self) -> Bool[Array, "*batch n"]:
        """Which of the times were reached, with finite `q` and `u`: a mask for losses over them."""
        finite = (abs(self.q) < np.inf).all(-1) & (abs(self.u) < np.inf).all(-1)
        return (self.ts <= self.t_end[..., None]) & finite

    def evaluate(self, t: Float[ArrayLike, ""]) -> tuple[Float[Array, " nq"], Float[Array, " nv"]]:
        """Coordinates and speeds at any time up to `t_end`, NaN beyond; vmap for many times or trajectories.

        Raises:
            ValueError: the simulation ran without `dense=True`.
        """
        if self.interpolation is None:
            raise ValueError("evaluate needs a simulation with dense=True")
        y = self.interpolation.evaluate(t)
        return unit_quaternions(self.tree, y[: self.tree.nq]), y[self.tree.nq :]


def status_of(result: diffrax.RESULTS, finite: jax.Array) -> jax.Array:
    """The status for diffrax's result, and whether the last state is finite."""
    status = jnp.asarray(int(Status.SOLVER_FAILED), jnp.int32)
    for found, meaning in (
        (diffrax.RESULTS.max_steps_reached, Status.MAX_STEPS),
        (diffrax.RESULTS.dt_min_reached, Status.MIN_STEP),
        (diffrax.RESULTS.event_occurred, Status.EVENT),
        (diffrax.RESULTS.successful, Status.SUCCESSFUL),
    ):
        status = jnp.where(result == found, jnp.asarray(int(meaning), jnp.int32), status)
    return jnp.where(finite, status, jnp.asarray(int(Status.NON_FINITE), jnp.int32))


def raise_unless_ok(trajectory: Trajectory) -> Trajectory:
    """The trajectory, if it reached its end.

    Raises:
        SimulationError: it did not; inside `jax.jit`, equinox's runtime error at run time.
    """
    message = "the simulation did not reach its end"
    if isinstance(trajectory.status, Tracer):
        return eqx.error_if(trajectory, ~trajectory.ok, message)
    if not bool(trajectory.ok):
        status = Status(int(trajectory.status))
        raise SimulationError(f"{message}: {status.name} at t = {float(trajectory.t_end):.6g} s. {explanation(status)}")
    return trajectory


def explanation(status: Status) -> str:
    """What may help."""
    return {
        Status.MAX_STEPS: "Raise max_steps, loosen the tolerances, or use an implicit solver such as diffrax.Kvaerno5().",
        Status.MIN_STEP: "The state may go to infinity, or the control may return NaN or jump.",
        Status.NON_FINITE: "The step may be too long, or the control may return NaN or infinity.",
        Status.SINGULAR_SPEEDS: "Go on in other speeds; rates_from_speeds(model.at(t_end), q_end, u_end) gives those of the model.",
        Status.SOLVER_FAILED: "Shorten the step or loosen the root finder's tolerances.",
    }.get(status, "")
