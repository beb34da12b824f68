"""What an optimal motion is asked for."""

from typing import Any, Literal, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from kanejax._model.model import Model
from kanejax._optimize.limits import Limits
from kanejax._optimize.moment import Constraint, Cost

Integrator = Literal["midpoint", "euler", "rk4"]
Dynamics = Literal["inverse", "forward"]


@final
class Boundary(eqx.Module):
    """The state at the start or the end of a motion.

    Attributes:
        q: coordinates, or None where they are free but for the limits.
        u: speeds, or None where they are free; at rest by default.
        constraints: that hold there, such as a pose of a body.
    """

    q: Float[Array, " nq"] | None
    u: Float[Array, " nv"] | None
    constraints: tuple[Constraint, ...]

    def __init__(self, q: Any = None, u: Any = 0.0, constraints: tuple[Constraint, ...] | Constraint = ()) -> None:
        """Store the state; a number for u stands for all speeds."""
        self.q = None if q is None else jnp.asarray(q)
        self.u = None if u is None else jnp.asarray(u)
        self.constraints = (constraints,) if isinstance(constraints, Constraint) else tuple(constraints)


@final
class MotionTask(eqx.Module):
    """A motion to be found: from a start to a goal, within limits, at the least cost.

    Everything but the names, the number of steps and the way of integration is an array, so that tasks with the same shape share a
    compiled program, can be batched by `jax.vmap`, and optima can be differentiated.

    Attributes:
        model: of the robot.
        start: state at the first node.
        goal: state at the last node.
        duration: least and greatest [s].
        limits: along the motion.
        costs: whose sum is the least.
        constraints: that hold along the motion or at its end.
        steps: number of equal time steps, in each of which forces or accelerations are constant.
        dynamics: "inverse": accelerations are sought, and forces follow by inverse dynamics, which is cheaper than forward dynamics
            and makes the steps linear; or "forward": forces are sought.
        integrator: "midpoint" (second order: forces hold in the middle of each step) or "euler" (the semi-implicit method of Euler,
            MuJoCo's) for inverse dynamics; "rk4" (the classical method of Runge and Kutta) or "euler" for forward dynamics.
        substeps: of the integrator "rk4" in each step.
        is_free_in_time: whether the duration is sought.
    """

    model: Model
    start: Boundary
    goal: Boundary
    duration: Float[Array, "2"]
    limits: Limits
    costs: tuple[Cost, ...]
    constraints: tuple[Constraint, ...]
    steps: int = eqx.field(static=True)
    dynamics: Dynamics = eqx.field(static=True)
    integrator: Integrator = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    is_free_in_time: bool = eqx.field(static=True)

    def __init__(
        self,
        model: Model,
        start: Any,
        goal: Any,
        duration: Any,
        costs: tuple[Cost, ...] | Cost,
        *,
        limits: Limits | None = None,
        constraints: tuple[Constraint, ...] | Constraint = (),
        steps: int = 50,
        dynamics: Dynamics = "inverse",
        integrator: Integrator | None = None,
        substeps: int = 1,
    ) -> None:
        """Check and store.

        Args:
            model: of the robot.
            start: coordinates of a start at rest, or a `Boundary`.
            goal: coordinates of a goal at rest, or a `Boundary`.
            duration: [s], or a pair of the least and the greatest, where it is sought too.
            costs: one or more terms; see `kanejax.costs`.
            limits: the model's joint ranges by default.
            constraints: one or more; see `kanejax.constraints`.
            steps: number of time steps.
            dynamics: "inverse" or "forward".
            integrator: by default "midpoint" for inverse and "rk4" for forward dynamics.
            substeps: of "rk4".

        Raises:
            ValueError: a shape or an option does not fit.
        """
        self.model = model
        self.start, self.goal = (_boundary(model, name, given) for name, given in (("start", start), ("goal", goal)))
        self.duration, self.is_free_in_time = _duration(duration, model.dtype), isinstance(duration, tuple)
        self.limits = _in_dtype(Limits(model) if limits is None else limits, model.dtype)
        self.costs = _in_dtype((costs,) if isinstance(costs, Cost) else tuple(costs), model.dtype)
        constraints = (constraints,) if isinstance(constraints, Constraint) else tuple(constraints)
        self.constraints = _in_dtype(constraints, model.dtype)
        self.steps, self.substeps, self.dynamics = int(steps), int(substeps), dynamics
        self.integrator = integrator if integrator is not None else "midpoint" if dynamics == "inverse" else "rk4"

    def __check_init__(self) -> None:
        """Check the options, and values that are known."""
        for name in ("steps", "substeps"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; give at least 1")
        schemes = {"inverse": ("midpoint", "euler"), "forward": ("rk4", "euler")}
        if self.dynamics not in schemes:
            raise ValueError(f"dynamics is {self.dynamics!r}; use 'inverse' or 'forward'")
        if self.integrator not in schemes[self.dynamics]:
            allowed = " or ".join(map(repr, schemes[self.dynamics]))
            raise ValueError(f"integrator is {self.integrator!r}; with {self.dynamics} dynamics use {allowed}")
        if not self.costs:
            raise ValueError("costs is empty; give at least one, such as kanejax.costs.torque()")
        names = [term.name for term in (*self.costs, *self.constraints)]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"several costs or constraints are called {', '.join(repeated)}; give each a name of its own")

    @property
    def remembers(self) -> tuple[str, ...]:
        """What of "tau" and "u_dot" is part of the state, since something depends on its change from step to step."""
        needs = {need for term in (*self.costs, *self.constraints) for need in term.needs}
        rates = (("tau", "tau_rate"), ("u_dot", "jerk"))
        return tuple(what for what, rate in rates if rate in needs or getattr(self.limits, rate) is not None)


def _boundary(model: Model, name: str, given: Any) -> Boundary:
    boundary = given if isinstance(given, Boundary) else Boundary(given)
    q, u = boundary.q, boundary.u
    if q is not None:
        _check_shape(f"{name}.q", q, (model.nq,), "nq")
        q = q.astype(model.dtype)
    if u is not None:
        u = jnp.broadcast_to(u, (model.nv,)) if jnp.shape(u) == () else u
        _check_shape(f"{name}.u", u, (model.nv,), "nv")
        u = u.astype(model.dtype)
    return Boundary(q, u, _in_dtype(boundary.constraints, model.dtype))


def _in_dtype(tree: Any, dtype: jnp.dtype) -> Any:
    """The data type follows the model's."""
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf, tree)


def _check_shape(name: str, value: jax.Array, shape: tuple[int, ...], size: str) -> None:
    if jnp.shape(value) != shape:
        raise ValueError(f"{name} has shape {jnp.shape(value)}, but this model needs {shape} = ({size},)")
    if not isinstance(value, Tracer) and not np.all(np.isfinite(value)):
        index = int(np.flatnonzero(~np.isfinite(value))[0])
        raise ValueError(f"{name}[{index}] is {float(value[index])}")


def _duration(given: Any, dtype: jnp.dtype) -> Float[Array, "2"]:
    pair = given if isinstance(given, tuple) else (given, given)
    found = jnp.stack([jnp.asarray(each, dtype) for each in pair])
    if found.shape != (2,):
        raise ValueError(f"duration has shape {found.shape}; give a number of seconds, or a pair of the least and the greatest")
    if not isinstance(found, Tracer) and not (0 < found[0] <= found[1] and np.isfinite(found[1])):
        raise ValueError(f"duration is {given}; give a positive number of seconds, or the least and the greatest")
    return found
