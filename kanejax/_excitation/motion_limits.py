"""Limits of a robot's motion, and what a motion leaves of them."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from kanejax._excitation.fourier_motion import Numbers
from kanejax._model.model import Model


class MotionLimits(NamedTuple):
    """Limits of joints with one coordinate each, infinite where there is none; all (nv,), float64.

    Attributes:
        low: least coordinate [rad or m].
        high: greatest coordinate.
        speed: greatest speed [rad/s or m/s].
        acceleration: greatest rate of it.
        torque: greatest torque [N m] or force [N].
    """

    low: Any
    high: Any
    speed: Any
    acceleration: Any
    torque: Any

    def less(self, margin: float) -> "MotionLimits":
        """With a fraction of each kept in reserve, of ranges on both sides."""
        middle, half = self.middle_and_half()
        rest = 1.0 - margin
        return MotionLimits(middle - rest * half, middle + rest * half, *(rest * limit for limit in self[2:]))

    def middle_and_half(self) -> tuple[np.ndarray, np.ndarray]:
        """The middle of each range, 0 where there is none, and half its width."""
        bounded = np.isfinite(self.low)
        low, high = (np.where(bounded, limit, 0.0) for limit in (self.low, self.high))
        return 0.5 * (low + high), np.where(bounded, 0.5 * (high - low), np.inf)


class Margins(NamedTuple):
    """What a motion leaves of each limit, in the limit's unit: negative where it is broken, infinite where there is none.

    Attributes:
        position: distance to the nearer end of each joint's range [rad or m], (nv,).
        speed: of each joint [rad/s or m/s].
        acceleration: of each joint.
        torque: of each joint [N m or N].
        path: minus the largest value of each number of the path constraint.
    """

    position: Float[Array | np.ndarray, " nv"]
    speed: Float[Array | np.ndarray, " nv"]
    acceleration: Float[Array | np.ndarray, " nv"]
    torque: Float[Array | np.ndarray, " nv"]
    path: Float[Array | np.ndarray, " constraints"]


def motion_limits(
    model: Model,
    position: Numbers | None,
    speed: Numbers | None,
    acceleration: Numbers | None,
    torque: Numbers | None,
) -> MotionLimits:
    """Limits from what is given and the model's joint ranges.

    Raises:
        ValueError: a shape does not fit, a limit is not positive, or a joint is left no range or no limit at all.
    """
    low, high = np.asarray(model.joint_range, float).T
    if position is not None:
        given = np.asarray(position, float)
        if given.shape != (model.nv, 2):
            raise ValueError(
                f"position has shape {given.shape}, but this model needs ({model.nv}, 2): least and greatest of each joint"
            )
        low, high = np.maximum(low, given[:, 0]), np.minimum(high, given[:, 1])
    others = {"speed": speed, "acceleration": acceleration, "torque": torque}
    limits = MotionLimits(low, high, *(_greatest(model, name, value) for name, value in others.items()))
    for joint, name in enumerate(model.tree.joint_names):
        ends = f"{low[joint]:g} to {high[joint]:g}"
        if not low[joint] < high[joint]:
            raise ValueError(f"joint {name!r} is left no position: its limits, with the model's joint_range, are {ends}")
        if np.isfinite(low[joint]) != np.isfinite(high[joint]):
            raise ValueError(f"joint {name!r} has a position limit on one side only, {ends}; give both, or none")
        if not any(np.isfinite(limit[joint]) for limit in limits[1:]):
            raise ValueError(
                f"joint {name!r} has no limit at all, and the faster it moves the more it tells; give position or speed"
            )
    return limits


def typical_speed(limits: MotionLimits, period: float, harmonics: int) -> Float[np.ndarray, " nv"]:
    """A speed of each joint [rad/s or m/s] with which it comes near its limits."""
    rate = np.pi * harmonics / period
    half = limits.middle_and_half()[1]
    found = np.minimum(np.minimum(limits.speed, limits.acceleration / rate), half * rate)
    return np.where(np.isfinite(found), found, 1.0)


def _greatest(model: Model, name: str, value: Numbers | None) -> Float[np.ndarray, " nv"]:
    limit = np.asarray(np.inf if value is None else value, float)
    if limit.shape not in ((), (model.nv,)):
        raise ValueError(
            f"{name} has shape {limit.shape}, but this model needs ({model.nv},) = (nv,), or one number for all joints"
        )
    limit = np.broadcast_to(limit, (model.nv,))
    for joint, greatest in zip(model.tree.joint_names, limit, strict=True):
        if not greatest > 0:
            raise ValueError(f"{name} of joint {joint!r} is {greatest}; a limit must be positive, or infinite for none")
    return limit
