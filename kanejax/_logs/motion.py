"""The motion of a model over time with the efforts that belong to it: what parameters are fitted to."""

from collections.abc import Iterable
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float


@final
class Motion(eqx.Module):
    """One run on a model's coordinates.

    Attributes:
        ts: times [s] from the first sample of the run, strictly increasing.
        q: coordinates [rad or m].
        u: speeds [rad/s or m/s].
        u_dot: accelerations [rad/s^2 or m/s^2].
        effort: measured of the actuators, in its own unit: torque [N m], force [N], or motor current [A].
        weight: 1 where an effort counts, 0 where it was not measured.
        name: of the run. Static, as are the notes: a jitted function of a motion is compiled again for another name.
        notes: sentences on how it was made from the log.
    """

    ts: Float[Array, " n"]
    q: Float[Array, "n nq"]
    u: Float[Array, "n nv"]
    u_dot: Float[Array, "n nv"]
    effort: Float[Array, "n nv"]
    weight: Float[Array, "n nv"]
    name: str = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        ts: ArrayLike,
        q: ArrayLike,
        u: ArrayLike,
        u_dot: ArrayLike,
        effort: ArrayLike,
        weight: ArrayLike | None = None,
        *,
        name: str = "motion",
        notes: Iterable[str] = (),
    ) -> None:
        """Store the arrays; without a `weight` all efforts count.

        Raises:
            ValueError: the shapes do not fit, there are no times, or they do not increase.
        """
        self.ts, self.q, self.u, self.u_dot, self.effort = (jnp.asarray(array) for array in (ts, q, u, u_dot, effort))
        self.weight = jnp.ones_like(self.effort) if weight is None else jnp.asarray(weight)
        self.name, self.notes = name, tuple(notes)

    def __check_init__(self) -> None:
        """Check the shapes, and the times where they are known."""
        if self.ts.ndim != 1 or len(self.ts) < 1:
            raise ValueError(f"motion {self.name!r}: ts has shape {self.ts.shape}, but needs (n,) with n of at least 1")
        for key in ("q", "u", "u_dot", "effort", "weight"):
            shape = getattr(self, key).shape
            if len(shape) != 2 or shape[0] != len(self.ts) or (key != "q" and shape[1] != self.u.shape[1]):
                wanted = f"({len(self.ts)}, {'nq' if key == 'q' else 'nv'})"
                raise ValueError(f"motion {self.name!r}: {key} has shape {shape}, but needs {wanted}, and u has {self.u.shape}")
        if not isinstance(self.ts, Tracer) and not np.all(np.diff(self.ts) > 0):
            raise ValueError(f"motion {self.name!r}: ts must be strictly increasing")

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.ts)

    def __getitem__(self, samples: slice) -> "Motion":
        """Some of the samples: `motion[100:]`, `motion[::2]`.

        Raises:
            TypeError: it is no slice.
        """
        if not isinstance(samples, slice):
            raise TypeError(f"motion {self.name!r} takes slices, such as motion[100:200], not {samples!r}")
        return jax.tree.map(lambda array: array[samples], self)

    def at(self, times: Float[Array, " m"]) -> "Motion":
        """The motion at other times, by piecewise cubics; can be differentiated, also with respect to the times.

        Coordinates have the measured speeds as slopes, speeds the accelerations, and accelerations and efforts those of the
        parabola through three neighbours. Outside of the motion's times its first or last state holds, with weight 0. The weight
        between two samples is the lesser of theirs.

        Raises:
            ValueError: there is but one sample, or a joint has several coordinates: rates of quaternions are no speeds.
        """
        if len(self) < 2:
            raise ValueError(f"motion {self.name!r} cannot be interpolated: it has one sample")
        if self.q.shape != self.u.shape:
            raise ValueError(
                f"motion {self.name!r} cannot be interpolated: q has shape {self.q.shape} and u {self.u.shape}: u is not q's rate"
            )
        ts = jax.lax.stop_gradient(self.ts)
        before, after = times < ts[0], times > ts[-1]
        # Unlike jnp.clip, this has the slope 1 at both ends.
        inside = jnp.where(before, ts[0], jnp.where(after, ts[-1], times))
        left = jnp.clip(jnp.searchsorted(ts, inside, side="right") - 1, 0, len(ts) - 2)
        h = (ts[left + 1] - ts[left])[:, None]
        s = (inside - ts[left])[:, None] / h
        curves = ((self.q, self.u), (self.u, self.u_dot), *((x, _slopes(ts, x)) for x in (self.u_dot, self.effort)))
        q, u, u_dot, effort = (_hermite(values, rates, left, h, s) for values, rates in curves)
        first, second = self.weight[left], self.weight[left + 1]
        between = jnp.where(s <= 0.0, first, jnp.where(s >= 1.0, second, jnp.minimum(first, second)))
        weight = jnp.where((before | after)[:, None], 0.0, between)
        return Motion(times, q, u, u_dot, effort, weight, name=self.name, notes=self.notes)

    def delayed(self, delay: Float[ArrayLike, ""]) -> "Motion":
        """The states that efforts belong to which lag by `delay` [s]: those of times `ts - delay`, beside the efforts of `ts`.

        Efforts of states before the start have weight 0, and after the end if the delay is negative. Can be differentiated with
        respect to the delay.
        """
        then = self.at(self.ts - jnp.asarray(delay, self.ts.dtype))
        weight = jnp.minimum(then.weight, self.weight)
        return Motion(self.ts, then.q, then.u, then.u_dot, self.effort, weight, name=self.name, notes=self.notes)


def split(motions: Iterable[Motion], validation: float = 0.25) -> tuple[tuple[Motion, ...], tuple[Motion, ...]]:
    """Part motions into those to fit and those to validate with: the end of each in time, a block without holes.

    Args:
        motions: to part.
        validation: fraction of the time of each that goes to validation.

    Returns:
        The motions to fit, and those to validate with.

    Raises:
        ValueError: the fraction is not between 0 and 1, or leaves fewer than two samples on a side.
    """
    if not 0.0 < validation < 1.0:
        raise ValueError(f"validation is {validation}; it must be between 0 and 1")
    fitted, kept = [], []
    for motion in motions:
        ts = np.asarray(motion.ts, np.float64)
        count = int(np.searchsorted(ts, ts[-1] - validation * (ts[-1] - ts[0])))
        if min(count, len(ts) - count) < 2:
            raise ValueError(f"motion {motion.name!r} has {len(ts)} samples, too few to keep a part of {validation} for validation")
        fitted.append(motion[:count])
        kept.append(motion[count:])
    return tuple(fitted), tuple(kept)


def _hermite(values: jax.Array, rates: jax.Array, left: jax.Array, h: jax.Array, s: jax.Array) -> jax.Array:
    """The cubic with given values and rates at both ends of an interval of length h, at the fraction s of it."""
    rise = values[left + 1] - values[left]
    # Less the straight line.
    start, end = h * rates[left] - rise, h * rates[left + 1] - rise
    return values[left] + s * rise + s * (1.0 - s) * ((1.0 - s) * start - s * end)


def _slopes(ts: jax.Array, values: jax.Array) -> jax.Array:
    """Slopes of the parabolas through three neighbours, at the ends of those through the nearest three."""
    steps = jnp.diff(ts)[:, None]
    rises = jnp.diff(values, axis=0) / steps
    if len(ts) == 2:
        return jnp.concatenate((rises, rises))
    middle = (steps[1:] * rises[:-1] + steps[:-1] * rises[1:]) / (steps[1:] + steps[:-1])
    return jnp.concatenate((2.0 * rises[:1] - middle[:1], middle, 2.0 * rises[-1:] - middle[-1:]))
