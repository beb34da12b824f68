"""Log files that are tables: text (CSV), NumPy's NPZ, and Parquet."""

import array
import contextlib
import csv
import functools
import importlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kanejax._errors import LogError

# Letters of a value in a message.
_LONGEST = 200
# A packed file may unpack to this many bytes, or else to this many times its size.
_MOST_BYTES, _MOST_TIMES = 2**28, 100


class Samples(NamedTuple):
    """Some columns of a file.

    `columns` are numbers, NaN where there is none, or NumPy's times; (n,) or (n, njoint) each. `faults` says what is wrong with a
    row, by index. `notes` are sentences on what was left out.
    """

    columns: list[np.ndarray]
    faults: dict[int, str]
    notes: tuple[str, ...] = ()


class Table(NamedTuple):
    """A file: names of its columns, None where it has none; their number; and what reads some of them, given by their places."""

    origin: str
    names: tuple[str, ...] | None
    width: int
    samples: Callable[[Sequence[int]], Samples]


def package(module: str, extra: str, origin: str) -> Any:
    """Import a module of a package that the library does not depend on.

    Raises:
        LogError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise LogError(f"{origin}: reading this file needs the package of {module}: pip install 'kanejax[{extra}]'") from error


def shortened(value: object) -> str:
    """What a file has, or what a library says of it, for a message of one line."""
    text = " ".join((str(value) if isinstance(value, Exception) else repr(value)).split())
    return text if len(text) <= _LONGEST else text[:_LONGEST] + "..."


def text_table(path: Path, delimiter: str | None, header: bool | None) -> Table:
    """Open a text file with one sample a line."""
    with _text(path) as lines:
        first = next((line for line in lines if line.strip()), None)
        if first is None:
            raise LogError(f"{path}: the file is empty")
        delimiter = delimiter or next((mark for mark in ";\t," if mark in first), " ")
        fields = [field.strip() for field in next(_split([first.lstrip("# ")], delimiter))]
    named = _is_header(path, fields) if header is None else header
    read = functools.partial(_text_samples, path, delimiter, named, fields)
    return Table(str(path), tuple(fields) if named else None, len(fields), read)


def _is_header(path: Path, fields: list[str]) -> bool:
    numbers = [field for field in fields if _is_number(field)]
    if numbers and len(numbers) < len(fields):
        raise LogError(f"{path}: the first line has numbers and text, {shortened(fields)}; say header=True or header=False")
    return not numbers


def _text_samples(path: Path, delimiter: str, named: bool, first: list[str], places: Sequence[int]) -> Samples:
    numbers, faults, count = array.array("d"), {}, -int(named)
    with _text(path) as lines:
        rows = _split(lines, delimiter)
        for fields in rows:
            if not fields or fields == [""]:
                continue
            if count >= 0:
                numbers.extend(_parsed(fields, places, len(first), faults, count, first if named else None))
            count += 1
    values = np.frombuffer(numbers, np.float64).reshape(max(count, 0), len(places))
    return Samples(list(values.T), faults)


def _parsed(
    fields: list[str], places: Sequence[int], width: int, faults: dict[int, str], row: int, names: list[str] | None
) -> list[float]:
    """The numbers of a row; what is wrong with it goes to `faults`."""
    if len(fields) != width:
        faults[row] = f"there are {len(fields)} fields instead of {width}"
        return [np.nan] * len(places)
    try:
        return [float(fields[place]) for place in places]
    except ValueError:
        place = next(place for place in places if not _is_number(fields[place]))
        faults[row] = f"column {names[place] if names else place!r} is {shortened(fields[place])}, not a number"
        return [np.nan] * len(places)


@contextlib.contextmanager
def _text(path: Path) -> Iterator[Iterator[str]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as lines:
            yield lines
    except (UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path}: not a text file with columns, in UTF-8: {shortened(error)}") from error


def _split(lines: Any, delimiter: str) -> Iterator[list[str]]:
    return (line.split() for line in lines) if delimiter == " " else csv.reader(lines, delimiter=delimiter)


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def npz_table(path: Path) -> Table:
    """Open an NPZ file; its arrays are the columns, or one of them holds all joints of a quantity."""
    try:
        # NumPy does not close a file that is no archive.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            names = tuple(archive.files)
    except Exception as error:
        raise LogError(f"{path}: not an NPZ file: {shortened(error)}") from error
    return Table(str(path), names, len(names), functools.partial(_npz_samples, path, names))


def _npz_samples(path: Path, names: Sequence[str], places: Sequence[int]) -> Samples:
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            entries = {entry.filename: entry.file_size for entry in archive.zip.infolist()}
            wanted = {names[place] for place in places}
            _check_unpacked(path, sum(entries.get(f"{name}.npy", entries.get(name, 0)) for name in wanted))
            for name in wanted:
                if promises_too_much(archive, name):
                    raise LogError(f"{path}: the array {name!r} says that it is larger than it is; write the file anew")
            arrays = {place: archive[names[place]] for place in places}
    except LogError:
        raise
    except Exception as error:
        # What is wrong with an array shows only when it is read.
        raise LogError(f"{path}: an array is not of numbers, or broken: {shortened(error)}") from error
    return Samples([_numbers(path, names[place], arrays[place]) for place in places], {})


def promises_too_much(archive: Any, name: str) -> bool:
    """Whether the header of an array in an NPZ file tells of more than follows: NumPy would get memory for that first."""
    try:
        # Of several of one name NumPy takes the one that this gives.
        entry = archive.zip.getinfo(f"{name}.npy")
    except KeyError:
        return False
    with archive.zip.open(entry) as file:
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0)):
            return True
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, kind = read(file)
    # Objects are pickled, and refused for that.
    return not kind.hasobject and float(np.prod(shape, dtype=float)) * kind.itemsize > entry.file_size


def parquet_table(path: Path) -> Table:
    """Open a Parquet file; a column may hold lists, one number a joint."""
    parquet = package("pyarrow.parquet", "parquet", str(path))
    try:
        names = tuple(parquet.ParquetFile(path).schema_arrow.names)
    except Exception as error:
        raise LogError(f"{path}: not a Parquet file: {shortened(error)}") from error
    return Table(str(path), names, len(names), functools.partial(_parquet_samples, parquet, path, names))


def _parquet_samples(parquet: Any, path: Path, names: Sequence[str], places: Sequence[int]) -> Samples:
    try:
        file = parquet.ParquetFile(path)
        # What Arrow has of single columns ends the process if a file contradicts itself.
        unpacked = sum(file.metadata.row_group(i).total_byte_size for i in range(file.metadata.num_row_groups))
        _check_unpacked(path, max(unpacked, 8 * file.metadata.num_rows * len(places)))
        table = file.read(columns=[names[place] for place in dict.fromkeys(places)])
        columns = [table.column(names[place]) for place in places]
        arrays = [_stacked(column) if "list" in str(column.type) else column.to_numpy() for column in columns]
    except LogError:
        raise
    except Exception as error:
        raise LogError(f"{path}: the columns cannot be read: {shortened(error)}") from error
    return Samples([_numbers(path, names[place], values) for place, values in zip(places, arrays, strict=True)], {})


def _stacked(column: Any) -> np.ndarray:
    """A column of lists as an array, NaN where a list is missing."""
    rows = column.to_pylist()
    widths = {len(row) for row in rows if row is not None}
    if len(widths) != 1:
        return np.array(rows, object)
    missing = [np.nan] * widths.pop()
    return np.array([missing if row is None else row for row in rows])


def _check_unpacked(path: Path, count: int) -> None:
    """Refuse a small file that says that it unpacks to a large one."""
    size = path.stat().st_size
    if count > max(_MOST_BYTES, _MOST_TIMES * size):
        raise LogError(f"{path}: its columns unpack to {count} bytes, from a file of {size}; write it anew without compression")


def _numbers(path: Path, name: str, values: np.ndarray) -> np.ndarray:
    if values.dtype.kind not in "fiumM" or values.ndim not in (1, 2):
        kind = f"type {values.dtype} and shape {values.shape}"
        raise LogError(f"{path}: column {name!r} has {kind}, but needs numbers, (n,) or (n, njoint)")
    return values if values.dtype.kind in "mM" else values.astype(np.float64)
