"""What `kanejax simulate` writes: a file at the end, or a store piece by piece."""

import hashlib
import json
from pathlib import Path
from typing import Any

from kanejax._cli.terminal import complain, with_options, write_arrays
from kanejax._dataset.attributes import attributes_of
from kanejax._dataset.in_memory import energy_change, simulated_study
from kanejax._dataset.store import zarr_package
from kanejax._dataset.study import Study
from kanejax._dataset.write_study import StudyInterrupted, free_bytes, needed_bytes, write_study
from kanejax._errors import DatasetError
from kanejax._simulate.trajectory import Status

_LARGEST_FILE = 2**33


def write_file(study: Study, out: Path, robot: str, *, progress: bool) -> tuple[dict[str, int], list[str], dict[str, Any]]:
    """Simulate in memory and write an NPZ file."""
    needed = needed_bytes(study)
    if needed > _LARGEST_FILE:
        raise DatasetError(f"{out} would have {size_in_words(needed)}, all in memory before; write a .zarr store, piece by piece")
    try:
        arrays = simulated_study(study, progress=progress)
    except KeyboardInterrupt:
        complain(f"{out} is not written; a .zarr store keeps what is done, and --resume goes on from there", "")
        raise
    median, worst = energy_change(study.model, arrays) if not study.parameters and study.control is None else (None, None)
    details = attributes_of(study, {"robot": robot}) | {"energy_change_median": median, "energy_change_worst": worst}
    write_arrays(out, {**arrays, "details": json.dumps(details)})
    sentences = []
    if worst is not None:
        conservative = not any((abs(leaf) > 0).any() for leaf in (study.model.damping, study.model.coulomb_friction))
        name = "energy drift" if conservative else "energy lost to damping and friction"
        sentences = [f"{name}, relative to the energy that moves: median {median:.1e}, worst {worst:.1e}"]
    return _counted(arrays["status"]), [*sentences, f"{int(arrays['num_steps'].sum())} steps"], details


def write_store(
    study: Study, out: Path, robot: str, *, progress: bool, resume: bool, chunk: int
) -> tuple[dict[str, int], list[str], dict[str, Any]]:
    """Simulate into a store."""
    zarr = zarr_package()
    needed, free = needed_bytes(study), free_bytes(out)
    if not out.exists() and needed > free:
        complain(f"{out} will have {size_in_words(needed)}, but its disk has room for {size_in_words(free)}", "warning: ")
    source = {"robot": Path(robot).name, "robot_sha256": _file_hash(Path(robot))}
    try:
        write_study(study, out, chunk=chunk, resume=resume, source=source, progress=progress)
    except StudyInterrupted as error:
        complain(f"{out}: {with_options(error)}", "")
        raise
    except OSError as error:
        raise OSError(
            error.errno, f"{error.strerror or error}; what was written stays, --resume goes on from it", str(out)
        ) from error
    status = zarr.open_array(str(out / "status"), mode="r")
    counts: dict[str, int] = {}
    # Piece by piece, for any number of them.
    for first in range(0, study.trajectories, 1 << 20):
        for name, count in _counted(status[first : first + (1 << 20)]).items():
            counts[name] = counts.get(name, 0) + count
    return counts, [f"{size_in_words(needed)}"], dict(zarr.open_group(str(out), mode="r").attrs)


def _counted(status: Any) -> dict[str, int]:
    """How many trajectories ended in which way."""
    counts = {each.name: int((status == each).sum()) for each in Status}
    return {name: count for name, count in counts.items() if count}


def _file_hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def size_in_words(size: int) -> str:
    """Bytes, as one reads them."""
    number = float(size)
    for unit in ("B", "kB", "MB", "GB"):
        if number < 1000:
            return f"{number:.3g} {unit}"
        number /= 1000
    return f"{number:.3g} TB"
