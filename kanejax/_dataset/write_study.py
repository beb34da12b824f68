"""Simulation of a study into a data set, on all cores and in any number of processes."""

import os
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from kanejax._dataset.attributes import attributes_of, layout_of
from kanejax._dataset.chunks import run_chunks
from kanejax._dataset.store import Store, check, create
from kanejax._dataset.study import Study
from kanejax._errors import DatasetError
from kanejax._simulate.checks import check_positive

# Several of them are in memory at the same time.
_LARGEST_CHUNK, _MOST_CHUNKS = 2**31, 2**27


class StudyInterrupted(KeyboardInterrupt):
    """`write_study` was interrupted; what was written stays, and `resume=True` goes on from there."""


def write_study(
    study: Study,
    path: str | os.PathLike[str],
    *,
    chunk: int = 1024,
    resume: bool = False,
    source: Mapping[str, Any] | None = None,
    batch_size: int = 128,
    threads: int | None = None,
    progress: bool = False,
) -> Path:
    """Simulate a study and write its trajectories to a Zarr store, in memory that does not grow with their number.

    Chunks of trajectories are written whole or not at all. After an interruption of any kind - Ctrl-C, a killed process, a full
    disk - the same call with `resume=True` simulates what is missing, and the store ends with the same bits as without it. Among
    several processes of `jax.distributed` each makes this call, simulates its share of the chunks, and waits for the others; a
    store can be gone on with by another number of processes.

    Args:
        study: what to simulate.
        path: of the store, a folder; xarray opens it with `xarray.open_zarr`.
        chunk: trajectories in one file of each array.
        resume: go on with a store of the same study, or begin it if there is none.
        source: where the model is from, kept in the attributes of the store: such as {"robot": "arm.urdf"}.
        batch_size: trajectories that a thread simulates side by side, see `simulate_batch`; a multiple of 32.
        threads: how many run side by side, by default one for each core.
        progress: show a progress bar.

    Returns:
        The path.

    Raises:
        DatasetError: there is something at the path, or, with `resume`, another study, or what is no data set; or a chunk is larger
            than 2 GiB.
        ValueError: an option has no meaning.
        OSError: the store cannot be written.
        StudyInterrupted: on Ctrl-C.
    """
    check_positive(chunk=chunk, batch_size=batch_size, threads=threads)
    if batch_size % 32:
        raise ValueError(
            f"batch_size is {batch_size}; it must be a multiple of 32, so that all lanes compute with the same instructions"
        )
    path, chunk = Path(path), min(int(chunk), study.trajectories)
    _check_sizes(study, chunk)
    # Programs of other sizes give numbers that differ by rounding errors.
    attributes = {**attributes_of(study, dict(source or {})), "chunk": chunk, "batch_size": int(batch_size)}
    store = _opened(path, study, chunk, attributes, resume=resume)
    mine = np.flatnonzero(~store.done())
    mine = mine[mine % jax.process_count() == jax.process_index()]
    try:
        run_chunks(study, store, mine, batch_size=int(batch_size), threads=threads, progress=progress)
    except KeyboardInterrupt as error:
        left = int(np.sum(~store.done()))
        raise StudyInterrupted(f"{left} of {store.chunks} chunks are missing; go on with resume=True") from error
    while jax.process_count() > 1 and not store.done().all():
        # Whoever leaves first takes the others' connection away. If one of them died, JAX ends this process too.
        time.sleep(0.2)
    return path


def _check_sizes(study: Study, chunk: int) -> None:
    """Refuse chunks that memory does not hold, and more of them than a folder."""
    size = needed_bytes(study) // study.trajectories * chunk
    if size > _LARGEST_CHUNK:
        raise DatasetError(f"a chunk of {chunk} trajectories has {size / 1e9:.3g} GB; give a smaller chunk, or fewer times")
    if study.trajectories // chunk > _MOST_CHUNKS:
        raise DatasetError(f"{study.trajectories} trajectories make {study.trajectories // chunk:.3g} chunks; give a larger chunk")


def needed_bytes(study: Study) -> int:
    """About how large the data set will be [bytes]."""
    return sum(int(np.prod(array.shape)) * np.dtype(array.dtype).itemsize for array in layout_of(study).values())


def free_bytes(path: str | os.PathLike[str]) -> int:
    """Room [bytes] on the disk where a store will be, or is."""
    return shutil.disk_usage(Path(path).absolute().parent).free


def _opened(path: Path, study: Study, chunk: int, attributes: dict[str, Any], *, resume: bool) -> Store:
    """The store, made by the first process if it is not there."""
    layout = layout_of(study)
    first, exists = jax.process_index() == 0, os.path.lexists(path)
    _together("kanejax: is there a store")
    if exists and not resume:
        raise DatasetError(f"{path} is there already; go on with it with resume=True, or give another path")
    if not exists and first:
        create(path, layout, chunk, attributes)
    _together("kanejax: there is a store")
    check(path, layout, chunk, attributes)
    return Store(path, layout, chunk)


def _together(what: str) -> None:
    """Wait for the other processes."""
    if jax.process_count() > 1:
        from jax.experimental.multihost_utils import sync_global_devices

        sync_global_devices(what)
