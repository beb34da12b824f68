"""The samples of motions, for fits in which the order of time does not matter."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._errors import LogError
from kanejax._logs.motion import Motion
from kanejax._regression.linearization import Samples


def check_motions(motions: Sequence[Motion]) -> None:
    """Refuse what no fit could use.

    Raises:
        LogError: a number that counts is not finite, a weight is neither 0 nor 1, nothing counts, or periods differ.
    """
    for motion in motions:
        weight = np.asarray(motion.weight)
        if not np.all((weight == 0) | (weight == 1)):
            raise LogError(f"motion {motion.name!r}: weights must be 0 or 1, but {np.unique(weight)[:5]} occur")
        for name in ("q", "u", "u_dot", "effort"):
            values = np.asarray(getattr(motion, name))
            bad = ~np.isfinite(values) & ((weight > 0) if name == "effort" else True)
            if np.any(bad):
                row, column = np.argwhere(bad)[0]
                raise LogError(
                    f"motion {motion.name!r}: {name}[{row}, {column}] is {values[row, column]}; remove the sample"
                    + (", or give it weight 0" if name == "effort" else "")
                )
    if motions and not any(np.any(np.asarray(motion.weight) > 0) for motion in motions):
        raise LogError("no signal of any motion counts: all weights are 0")
    periods = [float(np.median(np.diff(np.asarray(motion.ts, float)))) for motion in motions]
    if motions and max(periods) > 1.05 * min(periods):
        listed = ", ".join(f"{motion.name!r} {period:.4g} s" for motion, period in zip(motions, periods, strict=True))
        raise LogError(f"motions have different periods: {listed}; sample them alike, with the option `rate` of motions")


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
