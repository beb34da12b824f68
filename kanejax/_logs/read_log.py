"""From files to a log: CSV, Parquet, NPZ and MCAP."""

import os
from collections.abc import Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from kanejax._errors import LogError
from kanejax._logs.columns import QUANTITIES, Columns, Units, selected
from kanejax._logs.joint_states import mcap_table
from kanejax._logs.log import Log, Run
from kanejax._logs.tables import Table, npz_table, parquet_table, text_table

FileFormat = Literal["csv", "parquet", "npz", "mcap"]
Range = tuple[int | None, int | None]
_FORMATS: dict[str, FileFormat] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".log"), "csv"),
    **dict.fromkeys((".parquet", ".pq"), "parquet"),
    ".npz": "npz",
    ".mcap": "mcap",
}
_NO_DELIMITERS = ('"', "\r", "\n", "\0")
_FIELDS = {"position": "q", "velocity": "u", "acceleration": "u_dot", "effort": "effort"}


def read_log(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    joints: Sequence[str] | Mapping[str, str],
    *,
    columns: Columns | None = None,
    units: Units | None = None,
    rows: Range | Sequence[Range | None] | None = None,
    bad_rows: Literal["error", "drop"] = "error",
    repeated: Literal["error", "drop"] = "error",
    file_format: FileFormat | None = None,
    delimiter: str | None = None,
    header: bool | None = None,
    topic: str | None = None,
) -> Log:
    """Read recordings of joint positions and torques or motor currents.

    MCAP files are read as tables with the columns "time" (the stamp in the header), "log_time", "publish_time", "position_{joint}",
    "velocity_{joint}" and "effort_{joint}", which is what `Columns()` asks for, but the velocities. Only the columns asked for
    are looked at.

    Args:
        path: a file, or several, each of which becomes a run.
        joints: names of the model's joints that were recorded; a mapping to the names in the file where those are others.
        columns: which columns hold what; None: `Columns()`.
        units: of the file's numbers; None: SI units and radians.
        rows: first and last row to use, counted from 1 without the header, both included; None for no bound. For several files a
            pair, or None, for each.
        bad_rows: what to do with rows that have too few or too many fields, text, NaN, or infinity.
        repeated: what to do with rows whose time is not later than that of all rows before.
        file_format: None: told by the file's suffix.
        delimiter: of text files; " " is any white space; None: the first of semicolon, tabulator and comma that the first line has.
        header: whether the first line of a text file names the columns; None: it does if it has no numbers.
        topic: of MCAP files; None: the only one with messages of the type JointState.

    Returns:
        The log. Its `notes` say what was dropped, if that was asked for.

    Raises:
        LogError: naming the file and, if one is at fault, the row, the column, the value, and what to do.
    """
    columns, units = columns or Columns(), units or Units()
    for option, value in (("bad_rows", bad_rows), ("repeated", repeated)):
        if value not in ("error", "drop"):
            raise LogError(f"{option} is {value!r}; use 'error' or 'drop'")
    if delimiter is not None and (len(delimiter) != 1 or delimiter in _NO_DELIMITERS):
        raise LogError(f"delimiter is {delimiter!r}; it must be one character, and no quote, line end or null")
    if isinstance(joints, str):
        raise LogError(f"joints is the text {joints!r}; give a sequence of names, such as ({joints!r},)")
    in_file = tuple(joints.values()) if isinstance(joints, Mapping) else tuple(joints)
    paths = [Path(path)] if isinstance(path, str | os.PathLike) else [Path(each) for each in path]
    runs = []
    for name, each, span in zip(_names(paths), paths, _ranges(rows, path, len(paths)), strict=True):
        table = _table(each, file_format, delimiter, header, topic)
        sheet = _sheet(table, in_file, columns, units)
        sheet = _without_repeated(_without_bad(_within(sheet, span), bad_rows), repeated)
        runs.append(_run(name, sheet))
    return Log(tuple(joints), runs)


class _Sheet(NamedTuple):
    """What was read of a file: times and quantities, the number of each row, what is wrong with some of them, and notes."""

    origin: str
    joints: tuple[str, ...]
    ts: np.ndarray
    values: dict[str, np.ndarray]
    rows: np.ndarray
    faults: dict[int, str]
    notes: tuple[str, ...]

    def kept(self, keep: np.ndarray, *notes: str) -> "_Sheet":
        """Some of the rows, and more notes."""
        values = {quantity: array[keep] for quantity, array in self.values.items()}
        return self._replace(ts=self.ts[keep], values=values, rows=self.rows[keep], notes=(*self.notes, *notes))


def _table(path: Path, file_format: FileFormat | None, delimiter: str | None, header: bool | None, topic: str | None) -> Table:
    if not path.is_file():
        raise LogError(f"{path}: {'this is a folder' if path.is_dir() else 'there is no such file'}")
    file_format = file_format or _FORMATS.get(path.suffix.lower())
    if file_format == "csv":
        return text_table(path, delimiter, header)
    if file_format == "mcap":
        return mcap_table(path, topic)
    if file_format in ("npz", "parquet"):
        return npz_table(path) if file_format == "npz" else parquet_table(path)
    suffixes = ", ".join(_FORMATS)
    raise LogError(f"{path}: cannot tell the format by the suffix {path.suffix!r}; known are {suffixes}; give file_format=...")


def _sheet(table: Table, joints: tuple[str, ...], columns: Columns, units: Units) -> _Sheet:
    """Read the columns and bring them to SI units."""
    places = selected(columns, joints, table.names, table.width, table.origin)
    flat = [place for group in places.values() for place in group]
    samples = table.samples(flat)
    _check_lengths(table, flat, samples.columns)
    arrays = iter(samples.columns)
    time, *others = ([next(arrays) for _ in group] for group in places.values())
    if time[0].ndim != 1:
        raise LogError(f"{table.origin}: the times have shape {time[0].shape}, but need (n,)")
    values = {}
    for quantity, group in zip((key for key in places if key != "time"), others, strict=True):
        if any(array.dtype.kind in "mM" for array in group):
            raise LogError(f"{table.origin}: {quantity} is asked of a column of times; only the column of 'time' may hold them")
        stacked = np.column_stack(group)
        if stacked.shape[1] != len(joints):
            raise LogError(
                f"{table.origin}: {quantity} has {stacked.shape[1]} columns for {len(joints)} joints ({', '.join(joints)}); put "
                "{joint} into the name, list a column for each joint, or name one whose entries are arrays"
            )
        values[quantity] = stacked * units.factors(quantity, len(joints))
    rows = np.arange(1, len(time[0]) + 1)
    return _Sheet(table.origin, joints, _seconds(time[0], units), values, rows, samples.faults, samples.notes)


def _check_lengths(table: Table, places: list[int], arrays: list[np.ndarray]) -> None:
    lengths = {len(array) for array in arrays}
    if len(lengths) > 1:
        names = table.names or range(table.width)
        each = dict.fromkeys(f"{names[place]!r} {len(array)}" for place, array in zip(places, arrays, strict=True))
        raise LogError(f"{table.origin}: the columns have different lengths: {', '.join(each)}")
    if lengths == {0}:
        raise LogError(f"{table.origin}: the file has no rows")


def _seconds(times: np.ndarray, units: Units) -> np.ndarray:
    if times.dtype.kind not in "mM":
        return times * units.factors("time", 1)
    whole = times.astype(f"{times.dtype.kind}8[ns]")
    return np.where(np.isnat(whole), np.nan, whole.astype(np.int64) * 1e-9)


def _within(sheet: _Sheet, span: Range | None) -> _Sheet:
    first, last = span or (None, None)
    count = len(sheet.rows)
    first, last = 1 if first is None else first, count if last is None else last
    if not 1 <= first <= last <= count:
        raise LogError(f"{sheet.origin}: rows {first} to {last} are asked for, but there are rows 1 to {count}")
    return sheet.kept(np.arange(first - 1, last))


def _without_bad(sheet: _Sheet, bad_rows: str) -> _Sheet:
    broken = np.isin(sheet.rows - 1, list(sheet.faults))
    finite = [np.isfinite(sheet.ts), *(np.all(np.isfinite(array), axis=1) for array in sheet.values.values())]
    bad = np.flatnonzero(broken | ~np.all(finite, axis=0))
    if not len(bad):
        return sheet
    first = int(bad[0])
    row = int(sheet.rows[first])
    problem = f"row {row}: {sheet.faults.get(row - 1) or _not_finite(sheet, first)}"
    count = f"{len(bad)} of {len(sheet.rows)} rows"
    if bad_rows == "error":
        raise LogError(
            f"{sheet.origin}: {problem}; {count} are bad. Repair the file, choose rows=(first, last), or drop the bad ones with "
            "bad_rows='drop'"
        )
    return sheet.kept(np.delete(np.arange(len(sheet.rows)), bad), f"{count} are bad and were dropped, the first is {problem}")


def _not_finite(sheet: _Sheet, index: int) -> str:
    if not np.isfinite(sheet.ts[index]):
        return f"the time is {sheet.ts[index]}"
    quantity = next(key for key, array in sheet.values.items() if not np.all(np.isfinite(array[index])))
    joint = int(np.flatnonzero(~np.isfinite(sheet.values[quantity][index]))[0])
    return f"the {quantity} of joint {sheet.joints[joint]!r} is {sheet.values[quantity][index, joint]}"


def _without_repeated(sheet: _Sheet, repeated: str) -> _Sheet:
    latest = np.maximum.accumulate(sheet.ts[:-1]) if len(sheet.ts) else sheet.ts
    late = np.flatnonzero(sheet.ts[1:] <= latest) + 1
    if not len(late):
        return sheet
    first = int(late[0])
    count = f"{len(late)} of {len(sheet.ts)} rows"
    problem = f"row {sheet.rows[first]}: {sheet.ts[first]} s follows {latest[first - 1]} s"
    if repeated == "error":
        raise LogError(
            f"{sheet.origin}: times repeat or go back in {count}, first in {problem}. Repair the file, choose rows=(first, last), "
            "or drop the later ones with repeated='drop'"
        )
    keep = np.delete(np.arange(len(sheet.ts)), late)
    return sheet.kept(keep, f"times repeat or go back in {count}, which were dropped, first in {problem}")


def _run(name: str, sheet: _Sheet) -> Run:
    if len(sheet.ts) < 2:
        raise LogError(f"{sheet.origin}: {len(sheet.ts)} rows are left, but a run needs at least 2")
    fields = {_FIELDS[quantity]: sheet.values[quantity] for quantity in QUANTITIES if quantity in sheet.values}
    return Run(name, sheet.ts, fields.pop("q"), fields.pop("effort"), **fields, notes=sheet.notes)


def _names(paths: list[Path]) -> list[str]:
    """Names of the runs: those of the files without suffix, or as much of the paths as tells them apart."""
    for names in ([path.stem for path in paths], [path.name for path in paths], [str(path) for path in paths]):
        if len(set(names)) == len(names):
            return names
    twice = sorted({str(path) for path in paths if paths.count(path) > 1})
    raise LogError(f"{', '.join(twice)} is given more than once")


def _ranges(rows: Any, path: object, count: int) -> list[Range | None]:
    if rows is None:
        return [None] * count
    is_pair = (
        len(rows) == 2 and all(bound is None or isinstance(bound, Integral) for bound in rows) and any(b is not None for b in rows)
    )
    if isinstance(path, str | os.PathLike):
        if not is_pair:
            raise LogError(f"rows is {rows!r}; for one file it must be a pair (first, last)")
        return [(rows[0], rows[1])]
    if is_pair or len(rows) != count:
        raise LogError(f"rows is {rows!r}; for {count} files it must be a sequence with a pair (first, last), or None, for each")
    return list(rows)
