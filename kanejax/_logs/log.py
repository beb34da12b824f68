"""Logs: what was recorded of a robot's joints, sample by sample, under the joints' names."""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import final

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from kanejax._errors import LogError


@final
@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class Run:
    """One recording without interruption; the columns are the joints of its log.

    Attributes:
        name: of the run; messages and reports use it.
        ts: times [s], strictly increasing.
        q: positions [rad or m].
        effort: what was measured of the actuators, in its own unit: torque [N m], force [N], or motor current [A]. NaN only where
            the weight is zero.
        u: speeds [rad/s or m/s], None where they were not measured.
        u_dot: accelerations [rad/s^2 or m/s^2], None where they were not measured.
        weight: 1 where an effort counts, 0 where it was not measured or cannot be trusted; None is 1 everywhere.
        notes: sentences on what was changed on the way from the file.
    """

    name: str
    ts: Float[np.ndarray, " n"]
    q: Float[np.ndarray, "n njoint"]
    effort: Float[np.ndarray, "n njoint"]
    u: Float[np.ndarray, "n njoint"] | None
    u_dot: Float[np.ndarray, "n njoint"] | None
    weight: Float[np.ndarray, "n njoint"] | None
    notes: tuple[str, ...]

    def __init__(
        self,
        name: str,
        ts: ArrayLike,
        q: ArrayLike,
        effort: ArrayLike,
        *,
        u: ArrayLike | None = None,
        u_dot: ArrayLike | None = None,
        weight: ArrayLike | None = None,
        notes: Iterable[str] = (),
    ) -> None:
        """Store copies of the arrays as float64 that cannot be written to.

        Raises:
            LogError: shapes do not agree, times do not increase, or a value is not finite.
        """
        given = {"ts": ts, "q": q, "effort": effort, "u": u, "u_dot": u_dot, "weight": weight}
        arrays = {key: None if value is None else _fixed(name, key, value) for key, value in given.items()}
        for key, value in {"name": name, **arrays, "notes": tuple(notes)}.items():
            object.__setattr__(self, key, value)
        self._check_shapes()
        self._check_times()
        self._check_values()

    @property
    def period(self) -> float:
        """Median time [s] between two samples."""
        return float(np.median(np.diff(self.ts)))

    @property
    def duration(self) -> float:
        """Time [s] from the first sample to the last."""
        return float(self.ts[-1] - self.ts[0])

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.ts)

    def __repr__(self) -> str:
        """Name it, and say how much there is."""
        return f"<run {self.name!r}: {len(self)} samples of {self.q.shape[1]} joints in {self.duration:.6g} s>"

    def _check_shapes(self) -> None:
        if self.ts.ndim != 1 or len(self.ts) < 2:
            raise LogError(f"run {self.name!r}: ts has shape {self.ts.shape}, but needs (n,) with n of at least 2")
        if self.q.ndim != 2 or len(self.q) != len(self.ts):
            raise LogError(f"run {self.name!r}: q has shape {self.q.shape}, but needs ({len(self.ts)}, njoint)")
        for key in ("effort", "u", "u_dot", "weight"):
            array = getattr(self, key)
            if array is not None and array.shape != self.q.shape:
                raise LogError(f"run {self.name!r}: {key} has shape {array.shape}, but q has {self.q.shape}")

    def _check_times(self) -> None:
        if not np.all(np.isfinite(self.ts)):
            raise LogError(f"run {self.name!r}: ts[{int(np.flatnonzero(~np.isfinite(self.ts))[0])}] is not finite")
        backward = np.flatnonzero(np.diff(self.ts) <= 0)
        if len(backward):
            k = int(backward[0])
            raise LogError(
                f"run {self.name!r}: ts must be strictly increasing, but ts[{k + 1}] = {self.ts[k + 1]} follows {self.ts[k]}, "
                f"and so {len(backward)} times in all; remove these samples"
            )

    def _check_values(self) -> None:
        weight = np.ones_like(self.q) if self.weight is None else self.weight
        if not np.all(np.isfinite(weight) & (weight >= 0)):
            raise LogError(f"run {self.name!r}: weight must be finite and not negative, usually 0 or 1")
        for key in ("q", "effort", "u", "u_dot"):
            array = getattr(self, key)
            if array is None:
                continue
            bad = ~np.isfinite(array) & ((weight > 0) | (key != "effort"))
            if np.any(bad):
                row, column = (int(i) for i in np.argwhere(bad)[0])
                remedy = "give it weight 0, or remove the sample" if key == "effort" else "remove the sample"
                raise LogError(f"run {self.name!r}: {key}[{row}, {column}] is {array[row, column]}; {remedy}")


@final
@dataclasses.dataclass(frozen=True, eq=False, init=False, repr=False)
class Log:
    """Recordings of one robot: `Log(("shoulder", "elbow"), Run("first", ts, q, effort))`.

    Attributes:
        joints: names of the model's joints, one for each column of the runs. Joints with one coordinate each.
        runs: one or several recordings.
    """

    joints: tuple[str, ...]
    runs: tuple[Run, ...]

    def __init__(self, joints: Iterable[str], runs: Run | Sequence[Run]) -> None:
        """Store one run or several.

        Raises:
            LogError: there is no run or joint, a name occurs twice, or a run has other numbers of columns than there are joints.
        """
        if isinstance(joints, str):
            raise LogError(f"joints is the text {joints!r}; give a sequence of names, such as ({joints!r},)")
        object.__setattr__(self, "joints", tuple(joints))
        object.__setattr__(self, "runs", (runs,) if isinstance(runs, Run) else tuple(runs))
        for kind, names in (("joint", self.joints), ("run", [run.name for run in self.runs])):
            if not names:
                raise LogError(f"a log needs at least one {kind}")
            if twice := sorted({name for name in names if names.count(name) > 1}):
                raise LogError(f"{kind} names must differ, but {', '.join(map(repr, twice))} occur more than once")
        for run in self.runs:
            if run.q.shape[1] != len(self.joints):
                raise LogError(f"run {run.name!r} has {run.q.shape[1]} columns, but the log's joints are {', '.join(self.joints)}")

    @property
    def notes(self) -> tuple[str, ...]:
        """What was changed on the way from the files, run by run."""
        return tuple(f"{run.name}: {note}" for run in self.runs for note in run.notes)

    def __repr__(self) -> str:
        """List the joints and the runs."""
        return f"<log of {', '.join(self.joints)}: {', '.join(map(repr, self.runs))}>"


def _fixed(run: str, key: str, value: ArrayLike) -> np.ndarray:
    try:
        array = np.array(value, np.float64)
    except (TypeError, ValueError) as error:
        raise LogError(f"run {run!r}: {key} is no array of numbers: {error}") from error
    array.setflags(write=False)
    return array
