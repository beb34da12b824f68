"""A node of a motion, and the step to the next one."""

from typing import NamedTuple

import jax
from jaxtyping import Array, Float

from kanejax._optimize.moment import Moment


class State(NamedTuple):
    """Of a node: coordinates, speeds, forces and accelerations of the step before if they are remembered, and the duration."""

    q: Float[Array, " nq"]
    u: Float[Array, " nv"]
    tau: Float[Array, " nv"] | None
    u_dot: Float[Array, " nv"] | None
    duration: Float[Array, ""]


class Step(NamedTuple):
    """One time step.

    Attributes:
        q: coordinates after it.
        u: speeds after it.
        moment: that stands for it: limits and constraints hold there.
        shares: of the moments below in the mean over the step.
        moments: one after another, on a leading axis.
    """

    q: jax.Array
    u: jax.Array
    moment: Moment
    shares: jax.Array
    moments: Moment
