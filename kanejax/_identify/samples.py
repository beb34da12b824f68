"""The samples of motions, for fits in which the order of time does not matter."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._identify.linearization import Samples
from kanejax._identify.motion import Motion


def samples_of(motions: Sequence[Motion], delay: Float[Array, ""] | None = None) -> Samples:
    """All samples of all motions.

    Args:
        motions: of the runs.
        delay: time [s] by which signals lag the motion. Then the samples have the rates that the derivative with respect to it
            needs, and signals that belong to no recorded state do not count. None: no delay, states as they were recorded.
    """
    each = [_samples(motion) if delay is None else _delayed(motion, delay) for motion in motions]
    return jax.tree.map(lambda *parts: jnp.concatenate(parts), *each)


def _samples(motion: Motion) -> Samples:
    return Samples(motion.q, motion.u, motion.u_dot, motion.effort, motion.weight)


@jax.jit
def _delayed(motion: Motion, delay: jax.Array) -> Samples:
    def states(delay: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        then = motion.delayed(delay)
        return then.q, then.u, then.u_dot

    state, slower = jax.jvp(states, (delay,), (jnp.ones_like(delay),))
    rates = tuple(-rate for rate in slower)
    return Samples(*state, motion.effort, motion.delayed(delay).weight, rates)  # type: ignore[arg-type]
