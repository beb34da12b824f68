"""What the columns of a log file mean: which belong to which joint, and their units."""

import dataclasses
import math
from collections.abc import Sequence
from typing import final

import numpy as np

from kanejax._errors import LogError

Selection = str | Sequence[str | int]
Unit = str | float
QUANTITIES = ("position", "velocity", "acceleration", "effort")
_DEGREE = math.pi / 180.0
_UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "position": {"rad": 1.0, "deg": _DEGREE, "turn": 2.0 * math.pi, "m": 1.0, "mm": 1e-3},
    "velocity": {"rad/s": 1.0, "deg/s": _DEGREE, "rpm": math.pi / 30.0, "m/s": 1.0, "mm/s": 1e-3},
    "acceleration": {"rad/s^2": 1.0, "deg/s^2": _DEGREE, "m/s^2": 1.0, "mm/s^2": 1e-3},
    "effort": {"N m": 1.0, "mN m": 1e-3, "N": 1.0, "A": 1.0, "mA": 1e-3},
}
_MOST_NAMES, _LONGEST_NAME = 60, 100


@final
@dataclasses.dataclass(frozen=True)
class Columns:
    """Which columns of a file hold what.

    For each quantity either a pattern such as "q_{joint}", in which the joints' names are put; the name of one column whose entries
    are arrays, one number a joint (in NPZ and Parquet files); or a sequence with a column for each joint, by name or by
    number. Columns are numbered from 0.

    Attributes:
        time: the column with the times.
        position: of the joints.
        velocity: of the joints; None: not read.
        acceleration: of the joints; None: not read.
        effort: torque, force or motor current.
    """

    time: str | int = "time"
    position: Selection = "position_{joint}"
    velocity: Selection | None = None
    acceleration: Selection | None = None
    effort: Selection = "effort_{joint}"


@final
@dataclasses.dataclass(frozen=True)
class Units:
    """Units of a file's numbers: names, or factors that bring them to SI units. One for all joints, or a sequence with one a joint.

    Attributes:
        time: "s", "ms", "us", "ns", or a factor. Columns of a type for times, as Parquet files have, need none.
        position: "rad", "deg", "turn", "m", "mm", or a factor.
        velocity: "rad/s", "deg/s", "rpm", "m/s", "mm/s", or a factor; None: the unit of position, a second.
        acceleration: "rad/s^2", "deg/s^2", "m/s^2", "mm/s^2", or a factor; None: the unit of position, a second squared.
        effort: "N m", "mN m", "N", "A", "mA", or a factor. Current stays current: what force it makes is for the drives to say.
    """

    time: Unit = "s"
    position: Unit | Sequence[Unit] = "rad"
    velocity: Unit | Sequence[Unit] | None = None
    acceleration: Unit | Sequence[Unit] | None = None
    effort: Unit | Sequence[Unit] = "N m"

    def factors(self, quantity: str, njoint: int) -> np.ndarray:
        """Factors to SI units: (njoint,), or () for "time".

        Args:
            quantity: an attribute's name.
            njoint: number of joints.

        Raises:
            LogError: a unit is unknown, a factor is zero or not finite, or there are not as many as joints.
        """
        given = getattr(self, quantity)
        if quantity == "time":
            return np.array(_factor(quantity, given))
        if given is None:
            return self.factors("position", njoint)
        each = [given] * njoint if isinstance(given, str | float | int) else list(given)
        if len(each) != njoint:
            raise LogError(f"units.{quantity} has {len(each)} entries for {njoint} joints; give one for all, or one a joint")
        return np.array([_factor(quantity, unit) for unit in each])


def selected(columns: Columns, joints: Sequence[str], names: Sequence[str] | None, width: int, origin: str) -> dict[str, list[int]]:
    """The places of the columns of each quantity, and of "time", in a file.

    Args:
        columns: which are asked for.
        joints: names of the joints in the file.
        names: of the file's columns, None where it has none.
        width: number of the file's columns.
        origin: the file, for errors.

    Raises:
        LogError: a column is missing or ambiguous, or there are not as many as joints.
    """
    places = {"time": [_place("time", columns.time, names, width, origin)]}
    for quantity in QUANTITIES:
        selection = getattr(columns, quantity)
        if selection is not None:
            keys = _keys(quantity, selection, joints)
            places[quantity] = [_place(quantity, key, names, width, origin) for key in keys]
    return places


def listed(names: Sequence[str]) -> str:
    """Names for a message, not too many of them."""
    shown = ", ".join(repr(name[:_LONGEST_NAME]) for name in names[:_MOST_NAMES]) or "none"
    return shown if len(names) <= _MOST_NAMES else f"{shown} and {len(names) - _MOST_NAMES} more"


def _keys(quantity: str, selection: Selection, joints: Sequence[str]) -> list[str | int]:
    if isinstance(selection, str):
        return [selection.replace("{joint}", joint) for joint in joints] if "{joint}" in selection else [selection]
    if len(selection) != len(joints):
        raise LogError(f"columns.{quantity} lists {len(selection)} columns for {len(joints)} joints: {', '.join(joints)}")
    return list(selection)


def _place(quantity: str, key: str | int, names: Sequence[str] | None, width: int, origin: str) -> int:
    if not isinstance(key, str):
        if not 0 <= key < width:
            raise LogError(f"{origin}: {quantity} is asked of column {key}, but the columns are 0 to {width - 1}")
        return int(key)
    if names is None:
        raise LogError(f"{origin}: {quantity} is asked of column {key!r}, but there is no header; give a number up to {width - 1}")
    if (count := list(names).count(key)) != 1:
        problem = "there is no such column" if count == 0 else f"{count} columns have that name; give their numbers"
        raise LogError(f"{origin}: {quantity} is asked of column {key!r}, but {problem}; the columns are: {listed(names)}")
    return list(names).index(key)


def _factor(quantity: str, unit: Unit) -> float:
    known = _UNITS[quantity]
    if isinstance(unit, str):
        if unit not in known:
            raise LogError(f"units.{quantity} is {unit!r}; use one of {', '.join(map(repr, known))}, or a factor")
        return known[unit]
    if not math.isfinite(unit) or unit == 0 or (quantity == "time" and unit < 0):
        raise LogError(f"units.{quantity} is {unit}; a factor must be finite and not zero, and that of time positive")
    return float(unit)
