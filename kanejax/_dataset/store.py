"""A data set on disk: a Zarr store of arrays in chunks of trajectories, each of which is there as a whole or not at all."""

import json
import os
import shutil
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kanejax._errors import DatasetError
from kanejax._whole_file import to_disk

# Written last: where its chunk is, all of the others are.
LAST = "status"


class ArrayLayout(NamedTuple):
    """One array of a store.

    Attributes:
        shape: of the whole.
        dtype: its data type.
        dimensions: names of its axes; "trajectory" is the first of those that are cut into chunks.
        fill: what stands where no trajectory was written.
        attributes: units, and what it means.
        values: of arrays that all trajectories share, which are written at the beginning.
    """

    shape: tuple[int, ...]
    dtype: str
    dimensions: tuple[str, ...]
    fill: float
    attributes: dict[str, Any]
    values: np.ndarray | None = None


class Store:
    """A data set of one layout at a path."""

    def __init__(self, path: Path, layout: Mapping[str, ArrayLayout], chunk: int) -> None:
        """Open a store that `create` or `check` found to be of this layout."""
        zarr = zarr_package()
        self.path, self._layout, self._chunk = path, layout, chunk
        group = zarr.open_group(str(path), mode="r+")
        self._arrays: dict[str, Any] = {}
        for name, array in layout.items():
            if array.values is None:
                # Zarr leaves out chunks that have the fill value alone, but a chunk that is there is one that is done.
                self._arrays[name] = group[name].with_config({"write_empty_chunks": True})

    @property
    def trajectories(self) -> int:
        """How many there will be."""
        return self._layout[LAST].shape[0]

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return -(-self.trajectories // self._chunk)

    def done(self) -> np.ndarray:
        """Which chunks are there, with the files of all arrays, of which someone may have lost one.

        Raises:
            DatasetError: a link stands where a file or folder of the store should be.
        """
        found = np.zeros(self.chunks, bool)
        folder = self.path / LAST / "c"
        names = [entry.name for entry in os.scandir(folder)] if folder.is_dir() else []
        for chunk in (int(name) for name in names if name.isdecimal() and int(name) < self.chunks):
            parts = [self._parts(name, chunk) for name in self._arrays]
            for each in parts:
                self._refuse_links(each)
            found[chunk] = all(os.path.isfile(os.path.join(self.path, *each)) for each in parts)
        return found

    def rows(self, chunk: int) -> range:
        """Numbers of the trajectories of a chunk."""
        return range(chunk * self._chunk, min((chunk + 1) * self._chunk, self.trajectories))

    def write(self, chunk: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Write a chunk, so that whatever happens meanwhile it is there as a whole or not at all.

        Raises:
            DatasetError: a link stands where a file or folder of the store should be.
            OSError: the disk is full, or the store was taken away.
        """
        rows = self.rows(chunk)
        for name in (*(name for name in self._arrays if name != LAST), LAST):
            file = self._cleared(self._parts(name, chunk))
            self._arrays[name][rows.start : rows.stop] = arrays[name]
            to_disk(file)

    def _parts(self, name: str, chunk: int) -> tuple[str, ...]:
        """Folders and name of a file, below the store."""
        return name, "c", str(chunk), *("0" for _ in self._layout[name].shape[1:])

    def _cleared(self, parts: tuple[str, ...]) -> Path:
        """A file, without what an interrupted writing of this chunk left beside it."""
        self._refuse_links(parts)
        file = self.path.joinpath(*parts)
        for left in file.parent.glob(f"{file.name}.*.partial"):
            left.unlink(missing_ok=True)
        return file

    def _refuse_links(self, parts: tuple[str, ...]) -> None:
        """Links could lead out of the store."""
        place = os.fspath(self.path)
        # There may be millions: strings, since paths take five times as long.
        for part in parts:
            place = f"{place}{os.sep}{part}"
            if os.path.islink(place):
                raise DatasetError(f"{place} is a link; a data set has none, and nothing is read or written where it leads")


def link_free(path: Path) -> Any:
    """A store to read from, as zarr takes it, that refuses links in place of its files and folders with DatasetError."""
    zarr = zarr_package()

    class LinkFree(zarr.storage.LocalStore):
        async def get(self, key: str, *options: Any, **more: Any) -> Any:
            place = path
            for part in key.split("/"):
                place = place / part
                if place.is_symlink():
                    raise DatasetError(f"{place} is a link; a data set has none, and nothing is read where it leads")
            return await super().get(key, *options, **more)

    return LinkFree(path, read_only=True)


def create(path: Path, layout: Mapping[str, ArrayLayout], chunk: int, attributes: Mapping[str, Any]) -> None:
    """Make a store without trajectories; it appears under its name once it is complete.

    Raises:
        OSError: it cannot be written, or something is there.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        _write_empty(str(partial), layout, chunk, attributes)
        # Fails if there is a file, or a folder with something in it.
        partial.rename(path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def check(path: Path, layout: Mapping[str, ArrayLayout], chunk: int, attributes: Mapping[str, Any]) -> None:
    """Compare a store with what `create` would make of the same arguments; nothing in it is believed.

    Raises:
        DatasetError: they differ; the message says in what.
    """
    if path.is_symlink() or not path.is_dir():
        raise DatasetError(f"{path} is {'a link' if path.is_symlink() else 'no folder'}, so it is no data set to go on with")
    wanted: dict[str, Any] = {}
    _write_empty(wanted, layout, chunk, attributes)
    # The root first, whose attributes say most.
    for key in sorted(wanted, key=lambda key: ("/" in key, key)):
        _compare(path, key, wanted[key].to_bytes())


def _compare(path: Path, key: str, wanted: bytes) -> None:
    """Compare a file of the store with what it should be."""
    file = path / key
    if any(place.is_symlink() for place in (file, *file.parents) if place != path and path in place.parents):
        raise DatasetError(f"{file} is a link, or lies behind one; a data set has none")
    try:
        # One byte more tells that it is longer.
        with file.open("rb") as stream:
            found = stream.read(len(wanted) + 65536)
    except OSError as error:
        raise DatasetError(f"{path} is no data set to go on with: {file}: {error.strerror}") from error
    if found == wanted:
        return
    if key != "zarr.json":
        raise DatasetError(f"{path} holds other trajectories than are asked for: {key} differs; give another path")
    try:
        attributes = json.loads(found)["attributes"]
        pairs = {name: (attributes.get(name), value) for name, value in json.loads(wanted)["attributes"].items()}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise DatasetError(f"{path} is no data set to go on with: {file} cannot be understood") from None
    listed = [f"{name} is {_short(now)}, but was {_short(then)}" for name, (then, now) in pairs.items() if then != now]
    raise DatasetError(f"{path} holds other trajectories than are asked for: {'; '.join(listed) or f'{file} differs'}")


def _short(value: Any, length: int = 80) -> str:
    text = json.dumps(value)
    return text if len(text) <= length else f"{text[: length - 3]}..."


def _write_empty(store: Any, layout: Mapping[str, ArrayLayout], chunk: int, attributes: Mapping[str, Any]) -> None:
    """Write metadata, and the arrays that all trajectories share."""
    zarr = zarr_package()
    with warnings.catch_warnings():
        # Version 3 of the format has no word on metadata in one place; xarray asks for it.
        warnings.filterwarnings("ignore", "Consolidated metadata", category=UserWarning)
        group = zarr.create_group(store, attributes=dict(attributes))
        for name, array in layout.items():
            shared = array.values is not None
            made = group.create_array(
                name,
                shape=array.shape,
                dtype=array.dtype,
                chunks=array.shape if shared else (min(chunk, array.shape[0]), *array.shape[1:]),
                fill_value=array.fill,
                dimension_names=array.dimensions,
                attributes=array.attributes,
                # Digits of a simulation hardly compress; a sum of each chunk tells of damage.
                compressors=zarr.codecs.Crc32cCodec(),
            )
            if shared:
                made[...] = array.values
        zarr.consolidate_metadata(store)


def zarr_package() -> Any:
    """The package zarr.

    Raises:
        DatasetError: it is not installed.
    """
    try:
        import zarr
    except ImportError as error:
        raise DatasetError("data sets need zarr: pip install 'kanejax[dataset]'") from error
    return zarr
