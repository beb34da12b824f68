"""Limits of a robot along its motion."""

from collections.abc import Sequence
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from kanejax._model.model import Model

FIELDS = ("q", "u", "u_dot", "tau", "tau_rate", "jerk", "power")


@final
class Limits(eqx.Module):
    """Least and greatest values along the motion, (2, nv) each, infinite where there is none; None without any.

    `Limits(model, u=2.0, tau=[87.0, 87.0, 12.0])`: a number or (nv,) is a limit in both directions, a pair (least, greatest) gives
    each. Coordinates have the model's joint ranges unless given.

    Attributes:
        q: coordinates of revolute and prismatic joints [rad], [m], by their speeds; infinite for others.
        u: generalized speeds.
        u_dot: their rates.
        tau: forces at the joints [N], [N m].
        tau_rate: their change a unit of time, from step to step.
        jerk: change of u_dot a unit of time, from step to step.
        power: mechanical power of each force, tau * u [W].
    """

    q: Float[Array, "2 nv"]
    u: Float[Array, "2 nv"] | None
    u_dot: Float[Array, "2 nv"] | None
    tau: Float[Array, "2 nv"] | None
    tau_rate: Float[Array, "2 nv"] | None
    jerk: Float[Array, "2 nv"] | None
    power: Float[Array, "2 nv"] | None

    def __init__(self, model: Model, *, passive: Sequence[str] = (), **values: Any) -> None:
        """Bring all to one form.

        Args:
            model: of the robot.
            passive: joints without a motor, whose force is zero.
            values: limits of the attributes' names.

        Raises:
            ValueError: a shape does not fit, a limit is not a number, or the least is above the greatest.
            TypeError: there is no such limit.
            UnknownNameError: a passive joint is not in the model.
        """
        if unknown := set(values) - set(FIELDS):
            raise TypeError(f"there are no limits of {', '.join(sorted(unknown))}; there are {', '.join(FIELDS)}")
        if passive:
            values.setdefault("tau", np.inf)
        for field in FIELDS:
            setattr(self, field, None if values.get(field) is None else _pair(model, field, values[field]))
        if self.q is None:
            self.q = joint_ranges(model)
        for name in passive:
            assert self.tau is not None
            self.tau = self.tau.at[:, model.joint(name).speeds].set(0.0)


def joint_ranges(model: Model) -> Float[Array, "2 nv"]:
    """The ranges of revolute and prismatic joints by their speeds."""
    tree, found = model.tree, jnp.full((2, model.nv), jnp.inf, model.dtype).at[0].multiply(-1.0)
    for joint, (kind, v) in enumerate(zip(tree.joint_types, tree.v_start, strict=True)):
        if kind in ("revolute", "prismatic"):
            found = found.at[:, v].set(model.joint_range[joint])
    return found


def _pair(model: Model, field: str, value: Any) -> Float[Array, "2 nv"]:
    given = value if isinstance(value, tuple) and len(value) == 2 else (-jnp.asarray(value), jnp.asarray(value))
    for each in given:
        if jnp.shape(each) not in ((), (model.nv,)):
            allowed = f"give a number, ({model.nv},) = (nv,), or a pair of these"
            raise ValueError(f"a limit of {field} has shape {jnp.shape(each)}; {allowed}")
    pair = jnp.stack([jnp.broadcast_to(jnp.asarray(each, model.dtype), (model.nv,)) for each in given])
    if not isinstance(pair, Tracer) and not np.all(pair[0] <= pair[1]):
        index = int(np.flatnonzero(~(np.asarray(pair[0]) <= np.asarray(pair[1])))[0])
        least, greatest = float(pair[0, index]), float(pair[1, index])
        raise ValueError(f"limits of {field}[{index}] are {least:g} and {greatest:g}; the least has to be below the greatest")
    return pair
