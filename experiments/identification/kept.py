"""Results of long computations that are kept on disk, so that a run which was cut off goes on where it was."""

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.progress import track

SOURCES = Path(__file__).parents[2]
BLOCK = 25


def kept_runs[T: tuple](kind: type[T], of_one: Callable[[int], T], runs: int, folder: Path | None, name: str) -> T:
    """What `of_one` finds for each of the seeds 0 to `runs` - 1, its arrays stacked.

    Blocks of seeds are files in the folder, if one is given, and are read where they exist: those of the same source only.

    Args:
        kind: a named tuple of arrays.
        of_one: the computation for one seed.
        runs: number of seeds.
        folder: of the files, or None to keep nothing.
        name: of the computation, for the files and the progress bar.
    """
    blocks = []
    for first in track(range(0, runs, BLOCK), description=name, transient=True):
        seeds = range(first, min(first + BLOCK, runs))
        path = None if folder is None else folder / f"{name.replace(' ', '_')}_{source_hash()}_{seeds[0]}_{seeds[-1]}.npz"
        if path is not None and path.exists():
            with np.load(path) as file:
                blocks.append(kind(*(file[field] for field in file.files)))
            continue
        block = kind(*(np.stack(part) for part in zip(*map(of_one, seeds), strict=True)))
        blocks.append(block)
        if path is not None:
            _write(path, block)
    return kind(*(np.concatenate(part) for part in zip(*blocks, strict=True)))


def source_hash() -> str:
    """Of all code that results depend on."""
    files = sorted((*SOURCES.glob("kanejax/**/*.py"), *Path(__file__).parent.glob("*.py")))
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()[:12]


def _write(path: Path, block: tuple) -> None:
    """Whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part.npz")
    np.savez(unfinished, *block)
    unfinished.replace(path)
