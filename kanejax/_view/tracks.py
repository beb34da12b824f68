"""Motions to be shown: coordinates over time, from what the library returns and writes."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np
from jaxtyping import Float

from kanejax._model.model import Model
from kanejax._view.shape import ViewError


@final
@dataclasses.dataclass(frozen=True)
class Track:
    """One motion of a robot; times begin at zero.

    Attributes:
        name: of the motion.
        ts: times [s], strictly increasing.
        q: generalized coordinates at those times.
        u: generalized speeds; None where they are not known.
        tau_ts: times of the forces, in which a step has two values at one time.
        tau: forces at the joints; None where they are not known.
    """

    name: str
    ts: Float[np.ndarray, " n"]
    q: Float[np.ndarray, "n nq"]
    u: Float[np.ndarray, "n nv"] | None = None
    tau_ts: Float[np.ndarray, " k"] | None = None
    tau: Float[np.ndarray, "k nv"] | None = None

    @property
    def duration(self) -> float:
        """Time [s] from the first to the last row."""
        return float(self.ts[-1])

    def at(self, model: Model, t: float) -> Float[np.ndarray, " nq"]:
        """Coordinates between the rows, and those of the first or last row beyond them; quaternions by the shorter way."""
        k = int(np.clip(np.searchsorted(self.ts, t, side="right") - 1, 0, max(len(self.ts) - 2, 0)))
        if len(self.ts) == 1:
            return self.q[0]
        part = float(np.clip((t - self.ts[k]) / (self.ts[k + 1] - self.ts[k]), 0.0, 1.0))
        before, after = self.q[k], self.q[k + 1].copy()
        starts = model.tree.turning_speeds[1]
        for start in starts:
            if before[start : start + 4] @ after[start : start + 4] < 0.0:
                after[start : start + 4] *= -1.0
        return (1.0 - part) * before + part * after


def tracks_of(arrays: Mapping[str, Any], model: Model, rows: Sequence[int] | None, origin: str) -> list[Track]:
    """Motions from arrays by name: "ts" and "q", perhaps "u" and "tau" with "tau_ts".

    With a leading axis of trajectories, `rows` are those to take, the first if None. What comes after the last row that is finite
    is left out, as simulations leave what they did not reach. Forces without times hold from each time to the next.

    Raises:
        ViewError: an array is missing, does not fit the model, or has no row that is finite; or there is no such trajectory.
    """
    q = _numbers(arrays, "q", origin)
    if q.ndim not in (2, 3) or q.shape[-1] != model.nq:
        raise ViewError(
            f"{origin}: q has shape {q.shape}, but this robot needs (times, {model.nq}), or (trajectories, times, {model.nq})"
        )
    chosen = (0,) if rows is None else tuple(rows)
    if q.ndim == 2 and chosen != (0,):
        raise ViewError(f"{origin} is one trajectory, but {', '.join(map(str, chosen))} are asked for; leave rows out")
    count = 1 if q.ndim == 2 else len(q)
    return [_track(arrays, model, _checked_row(row, count, origin), q.ndim == 3, origin) for row in chosen]


def _checked_row(row: int, count: int, origin: str) -> int:
    if not 0 <= row < count:
        raise ViewError(f"{origin}: there is no trajectory {row}; the {count} are numbered from 0 to {count - 1}")
    return row


def _track(arrays: Mapping[str, Any], model: Model, row: int, batched: bool, origin: str) -> Track:
    name = f"{origin}, trajectory {row}" if batched else origin

    def own(key: str, shape: tuple[int | None, ...]) -> np.ndarray:
        array = _numbers(arrays, key, origin)
        # Times may be those of all trajectories.
        array = array[row] if batched and array.ndim > len(shape) and row < len(array) else array
        if array.ndim != len(shape) or any(wanted not in (None, found) for wanted, found in zip(shape, array.shape, strict=True)):
            wanted = ", ".join("any" if length is None else str(length) for length in shape)
            raise ViewError(f"{name}: {key} has shape {array.shape}, but needs ({wanted})")
        return array

    q = own("q", (None, model.nq))
    ts = own("ts", (len(q),))
    u = own("u", (len(q), model.nv)) if arrays.get("u") is not None else None
    tau_ts, tau = None, None
    if arrays.get("tau") is not None:
        tau = own("tau", (None, model.nv))
        tau_ts, tau = _forces(own("tau_ts", (len(tau),)) if arrays.get("tau_ts") is not None else None, tau, ts, name)
    reached = np.logical_and.accumulate(np.isfinite(q).all(1) & np.isfinite(ts) & (np.abs(q) < 1e9).all(1))
    if not reached.any():
        raise ViewError(f"{name}: the first row of q, or its time, is not finite; there is nothing to show")
    ts, q, u = ts[reached], q[reached], None if u is None else u[reached]
    backward = np.flatnonzero(np.diff(ts) <= 0.0)
    if len(backward):
        k = int(backward[0])
        raise ViewError(f"{name}: times must increase, but ts[{k + 1}] = {ts[k + 1]:g} follows {ts[k]:g}")
    _check_quaternions(model, q, name)
    return Track(name, ts - ts[0], q, u, None if tau_ts is None else tau_ts - ts[0], tau)


def _forces(given: np.ndarray | None, tau: np.ndarray, ts: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of forces; of those that hold during a step, at both of its ends."""
    if given is not None:
        return given, tau
    if len(tau) == len(ts):
        return ts, tau
    if len(tau) != len(ts) - 1:
        raise ViewError(f"{name}: tau has {len(tau)} rows for {len(ts)} times; it needs as many, or one for each step between them")
    return np.repeat(ts, 2)[1:-1], np.repeat(tau, 2, axis=0)


def _check_quaternions(model: Model, q: np.ndarray, name: str) -> None:
    for start in model.tree.turning_speeds[1]:
        zero = ~np.any(q[:, start : start + 4], axis=1)
        if zero.any():
            raise ViewError(
                f"{name}: the quaternion q[{int(np.argmax(zero))}, {start}:{start + 4}] is zero; no rotation is 1, 0, 0, 0"
            )


def _numbers(arrays: Mapping[str, Any], key: str, origin: str) -> np.ndarray:
    value = arrays.get(key)
    if value is None:
        listed = ", ".join(sorted(map(str, arrays)))[:500] or "nothing"
        raise ViewError(f"{origin} has no {key!r}; it has {listed}")
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise ViewError(f"{origin}: {key} is of type {array.dtype}; it must be numbers")
    return array.astype(float)
