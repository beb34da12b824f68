"""The motion that Nie specifies for TORQUE and AUTOTF, equation (60): a cycloid for each of the six joints."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

DURATION = 2.0
"""T of Nie [s]."""


class Motion(NamedTuple):
    """Coordinates [rad], speeds [rad/s] and their rates [rad/s^2] of the six joints."""

    q: Float[Array, " 6"]
    u: Float[Array, " 6"]
    u_dot: Float[Array, " 6"]


def motion(t: Float[Array, ""], duration: float = DURATION) -> Motion:
    """State at time t [s] of the motion that turns all joints by 60 degrees, the second by -30 from 90, and rests at both ends."""
    rate = 2.0 * jnp.pi / duration
    # From 0 to 1: t / T - sin(2 pi t / T) / (2 pi), and its derivatives.
    phase = t / duration - jnp.sin(rate * t) / (2.0 * jnp.pi)
    phase_dot = (1.0 - jnp.cos(rate * t)) / duration
    phase_ddot = rate * jnp.sin(rate * t) / duration
    turn = jnp.pi / 3.0 * jnp.array([1.0, -0.5, 1.0, 1.0, 1.0, 1.0])
    start = jnp.array([0.0, jnp.pi / 2.0, 0.0, 0.0, 0.0, 0.0])
    return Motion(start + turn * phase, turn * phase_dot, turn * phase_ddot)


def motions(ts: Float[Array, " n"]) -> Motion:
    """States at many times, (n, 6) each."""
    return jax.jit(jax.vmap(motion))(ts)
