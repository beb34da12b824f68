"""Files that are either whole or not there, also after a crash or a loss of power."""

import contextlib
import glob
import os
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Where to write a file, which takes its name once it is on the disk; until then the old one stays."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        partial.unlink(missing_ok=True)
        # A new file: what a link of this name points to is not written to, and `replace` does not follow links either.
        partial.open("xb").close()
        yield partial
        _wait_for(partial)
        partial.replace(path)
        # Where folders cannot be opened for that, the name comes to the disk when it may.
        with contextlib.suppress(OSError):
            _wait_for(path.parent)
    finally:
        partial.unlink(missing_ok=True)


def remove_leftovers(path: Path) -> None:
    """Remove what processes that were killed while they wrote this file have left."""
    for leftover in path.parent.glob(f".{glob.escape(path.name)}.*.partial"):
        leftover.unlink(missing_ok=True)


def to_disk(file: Path) -> None:
    """Wait until a file and its name are on the disk."""
    _wait_for(file)
    _wait_for(file.parent)


def _wait_for(place: Path) -> None:
    descriptor = os.open(place, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
