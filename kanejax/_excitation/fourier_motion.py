"""Motions that are Fourier series of time: periodic, with exact derivatives, and with no frequency above a chosen one."""

import csv
import os
from collections.abc import Sequence
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

from kanejax._dynamics.equations_of_motion import inverse_dynamics
from kanejax._errors import UnsupportedModelError
from kanejax._model.model import Model

# Arrays, numbers, and lists of them.
Numbers = ArrayLike | Sequence[Any]


@final
class FourierMotion(eqx.Module):
    """A periodic motion of joints with one coordinate each, as Swevers et al. (1997) write it.

    q(t) = offset + sum over k of a_k / (k w) sin(k w t) - b_k / (k w) cos(k w t), with w = 2 pi / period and k = 1, 2, ...: a and b
    are amplitudes of speed. Signals that are measured over whole periods can be averaged, and filtered without distortion.

    Attributes:
        joints: names of the joints, in the order of the coordinates.
        period: time [s] after which the motion repeats.
        offset: mean coordinates [rad or m].
        a: amplitudes of the cosines in the speeds [rad/s or m/s].
        b: amplitudes of the sines in the speeds [rad/s or m/s].
    """

    joints: tuple[str, ...] = eqx.field(static=True)
    period: Float[Array, ""]
    offset: Float[Array, " nv"]
    a: Float[Array, "nv harmonics"]
    b: Float[Array, "nv harmonics"]

    def __init__(self, joints: Sequence[str], period: Numbers, offset: Numbers, a: Numbers, b: Numbers) -> None:
        """Store the series.

        Raises:
            ValueError: the shapes do not fit, or the period is not positive.
        """
        self.joints = tuple(joints)
        self.offset, self.a, self.b = jnp.asarray(offset), jnp.asarray(a), jnp.asarray(b)
        self.period = jnp.asarray(period).astype(self.a.dtype)

    def __check_init__(self) -> None:
        """Compare the shapes, and check the period where it is known."""
        count = len(self.joints)
        if self.offset.shape != (count,):
            raise ValueError(f"offset has shape {self.offset.shape}, but {count} joints need ({count},)")
        if self.a.ndim != 2 or self.a.shape[0] != count or self.a.shape[1] < 1 or self.a.shape != self.b.shape:
            raise ValueError(f"a and b have shapes {self.a.shape} and {self.b.shape}, but {count} joints need ({count}, harmonics)")
        check_period(self.period)

    @property
    def harmonics(self) -> int:
        """Number of frequencies: 1 / period and its multiples."""
        return self.a.shape[1]

    def q(self, t: Numbers) -> Float[Array, " nv"]:
        """Coordinates at time t [s]."""
        cosines, sines, rates = self._waves(t)
        return self.offset + _product(self.a / rates[None], sines) - _product(self.b / rates[None], cosines)

    def u(self, t: Numbers) -> Float[Array, " nv"]:
        """Speeds at time t [s]."""
        cosines, sines, _ = self._waves(t)
        return _product(self.a, cosines) + _product(self.b, sines)

    def u_dot(self, t: Numbers) -> Float[Array, " nv"]:
        """Rates of the speeds at time t [s]."""
        cosines, sines, rates = self._waves(t)
        return _product(self.b * rates[None], cosines) - _product(self.a * rates[None], sines)

    def scaled(self, factor: Numbers) -> "FourierMotion":
        """The motion with other amplitudes about the same offset; one factor for all joints, or one for each."""
        factor = jnp.broadcast_to(jnp.asarray(factor, self.a.dtype), self.offset.shape)[:, None]
        return FourierMotion(self.joints, self.period, self.offset, factor * self.a, factor * self.b)

    def _waves(self, t: Numbers) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Cosines and sines of k w t, and k w."""
        k = jnp.arange(1, self.harmonics + 1).astype(self.a.dtype)
        turns = jnp.asarray(t).astype(self.a.dtype) / self.period
        # Whole turns are taken off first, where sine and cosine are most exact.
        angles = 2.0 * jnp.pi * k * (turns - jnp.floor(turns))
        return jnp.cos(angles), jnp.sin(angles), 2.0 * jnp.pi * k / self.period


class MotionTable(NamedTuple):
    """States at equally spaced times: ts (n,) [s] from 0, and q, u, u_dot (n, nv), float64, NumPy."""

    ts: Float[np.ndarray, " n"]
    q: Float[np.ndarray, "n nv"]
    u: Float[np.ndarray, "n nv"]
    u_dot: Float[np.ndarray, "n nv"]


def motion_table(
    motion: FourierMotion, rate: float, *, periods: int = 1, start: Numbers | None = None, blend: float | None = None
) -> MotionTable:
    """Sample a motion from rest to rest.

    Args:
        motion: what to sample.
        rate: samples a second [Hz].
        periods: how often the motion is repeated.
        start: coordinates [rad or m] in which the robot rests before and after; without, it rests at the motion's own start.
        blend: time [s] that the way from there to the motion takes, and that back: a polynomial of fifth degree with continuous
            speed and acceleration. To a motion that starts at rest it stays between both positions, its greatest speed is
            15/8 distance / blend, and its greatest acceleration 10/sqrt(3) distance / blend^2.

    Raises:
        ValueError: a number is not positive, samples do not fit a whole number of times, a shape is wrong, or the motion does not
            start at rest and there is no blend.
    """
    if (start is None) != (blend is None):
        raise ValueError(f"start is {start} and blend is {blend}; give both for a way from rest to the motion, or none")
    if periods != int(periods) or periods < 1:
        raise ValueError(f"periods is {periods}; it must be a whole number of at least 1")
    for name, value in (("rate", rate), ("blend", 1.0 if blend is None else blend)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value}; it must be positive and finite")
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda x: x.astype(jnp.float64), motion)
        middle = _sampled(wide, _times("periods * period", periods * float(wide.period), rate))
        if start is None or blend is None:
            _check_rest(motion)
            return middle
        at_rest = np.asarray(start, float)
        if at_rest.shape != motion.offset.shape:
            raise ValueError(f"start has shape {at_rest.shape}, but this motion needs {motion.offset.shape} = (nv,)")
        there = _blend(at_rest, (middle.q[0], middle.u[0], middle.u_dot[0]), blend, _times("blend", blend, rate))
    # The same way backwards in time returns; speeds change their sign once more where the motion does not start at rest.
    back = _blend(at_rest, (middle.q[-1], -middle.u[-1], middle.u_dot[-1]), blend, there.ts)
    back = MotionTable(back.ts, back.q[::-1], -back.u[::-1], back.u_dot[::-1])
    whole = [np.concatenate((a[:-1], b, c[1:])) for a, b, c in zip(there[1:], middle[1:], back[1:], strict=True)]
    return MotionTable(np.arange(len(whole[0])) / rate, *whole)


def write_csv(
    motion: FourierMotion,
    path: str | os.PathLike[str],
    *,
    rate: float,
    periods: int = 1,
    start: Numbers | None = None,
    blend: float | None = None,
    model: Model | None = None,
) -> None:
    """Write a motion for a robot: columns time, position_JOINT, velocity_JOINT and acceleration_JOINT of every joint, SI units.

    Numbers have all their digits. `read_log` reads the file back.

    Args:
        motion: what to write.
        path: the file.
        rate: samples a second [Hz].
        periods: how often the motion is repeated.
        start: coordinates in which the robot rests before and after, see `motion_table`.
        blend: time of the way from there to the motion, see `motion_table`.
        model: adds columns effort_JOINT, the forces that `inverse_dynamics` of this model says the motion takes.

    Raises:
        ValueError: see `motion_table`; or the model has other joints than the motion.
    """
    table = motion_table(motion, rate, periods=periods, start=start, blend=blend)
    names, columns = ["position", "velocity", "acceleration"], [table.q, table.u, table.u_dot]
    if model is not None:
        if model.tree.joint_names != motion.joints:
            raise ValueError(f"the model's joints are {', '.join(model.tree.joint_names)}, the motion's {', '.join(motion.joints)}")
        with jax.enable_x64(True):
            forces = jax.jit(jax.vmap(inverse_dynamics, (None, 0, 0, 0)))
            columns.append(np.asarray(forces(model.astype(jnp.float64), *(jnp.asarray(x) for x in table[1:]))))
        names.append("effort")
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", *(f"{name}_{joint}" for name in names for joint in motion.joints)])
        writer.writerows(np.column_stack((table.ts, *columns)).tolist())


def rest_directions(harmonics: int) -> tuple[Float[np.ndarray, "harmonics free"], Float[np.ndarray, "harmonics free"]]:
    """Orthonormal bases of the a and of the b with which a motion starts at rest, without speed and without acceleration.

    The speed at time 0 is the sum of a_k, the acceleration that of w k b_k.

    Raises:
        ValueError: there are fewer than two harmonics, with which only standing still starts at rest.
    """
    if harmonics != int(harmonics) or harmonics < 2:
        raise ValueError(f"harmonics is {harmonics}; it must be a whole number of at least 2 for a motion that starts at rest")
    return _orthogonal_to(np.ones(harmonics)), _orthogonal_to(np.arange(1.0, harmonics + 1))


def one_coordinate_joints(model: Model) -> tuple[str, ...]:
    """Names of the joints of a model whose joints all have one coordinate.

    Raises:
        ValueError: there are no joints.
        UnsupportedModelError: naming the first joint that has several coordinates.
    """
    if model.nv == 0:
        raise ValueError("the model has no joints that could move")
    for name, kind in zip(model.tree.joint_names, model.tree.joint_types, strict=True):
        if kind not in ("revolute", "prismatic"):
            raise UnsupportedModelError(
                f"joint {name!r} is {kind}; Fourier motions need joints with one coordinate each, revolute or prismatic"
            )
    return model.tree.joint_names


def check_period(period: Numbers) -> None:
    """Check that a period that is known is positive.

    Raises:
        ValueError: it is not.
    """
    if not isinstance(period, Tracer) and not (np.isfinite(period) and np.asarray(period) > 0):
        raise ValueError(f"period is {period}; it must be positive and finite")


def _product(amplitudes: jax.Array, waves: jax.Array) -> jax.Array:
    return jnp.matmul(amplitudes, waves, precision="highest")


def _orthogonal_to(vector: np.ndarray) -> np.ndarray:
    return np.linalg.svd(vector[None])[2][1:].T


def _times(name: str, duration: float, rate: float) -> np.ndarray:
    steps = round(duration * rate)
    if steps < 1 or abs(steps - duration * rate) > 1e-6 * steps:
        raise ValueError(f"{name} is {duration} s, {duration * rate:g} samples at {rate} Hz; it must be a whole number of them")
    return np.arange(steps + 1) / rate


def _sampled(motion: FourierMotion, ts: np.ndarray) -> MotionTable:
    states = jax.jit(jax.vmap(lambda t: (motion.q(t), motion.u(t), motion.u_dot(t))))(jnp.asarray(ts))
    return MotionTable(ts, *(np.asarray(x) for x in states))


def _check_rest(motion: FourierMotion) -> None:
    speed, rate = np.abs(motion.u(0.0)), np.abs(motion.u_dot(0.0))
    largest = np.sum(np.hypot(motion.a, motion.b), axis=1)
    k = 2.0 * np.pi * motion.harmonics / float(motion.period)
    least = 1e3 * float(jnp.finfo(motion.a.dtype).eps) * largest
    for joint, moves in enumerate((speed > least) | (rate > k * least)):
        if moves:
            raise ValueError(
                f"the motion starts with speed {float(speed[joint]):g} and acceleration {float(rate[joint]):g} of joint "
                f"{motion.joints[joint]!r}; give start and blend for a way there from rest"
            )


def _blend(start: np.ndarray, end: tuple[np.ndarray, np.ndarray, np.ndarray], duration: float, ts: np.ndarray) -> MotionTable:
    """From rest at `start` to the coordinates, speeds and accelerations of `end` by the polynomial of fifth degree."""
    way, speed, rate = end[0] - start, end[1] * duration, end[2] * duration**2
    # Coefficients of s^3, s^4 and s^5 for s = t / duration.
    cubic = 10.0 * way - 4.0 * speed + 0.5 * rate
    quartic = -15.0 * way + 7.0 * speed - rate
    quintic = 6.0 * way - 3.0 * speed + 0.5 * rate
    s = (ts / duration)[:, None]
    q = start + s**3 * (cubic + s * (quartic + s * quintic))
    u = s**2 * (3.0 * cubic + s * (4.0 * quartic + s * 5.0 * quintic)) / duration
    u_dot = s * (6.0 * cubic + s * (12.0 * quartic + s * 20.0 * quintic)) / duration**2
    return MotionTable(ts, q, u, u_dot)
