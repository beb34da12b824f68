"""Motions from files: what `simulate` and `optimize` write, data sets, and logs."""

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kanejax._dataset.store import link_free, zarr_package
from kanejax._errors import DatasetError, LogError
from kanejax._logs.columns import Columns
from kanejax._logs.log import Log
from kanejax._logs.read_log import read_log
from kanejax._logs.tables import promises_too_much, text_table
from kanejax._model.model import Model
from kanejax._model.tree import COORDINATES, SPEEDS
from kanejax._view.scene import reference_coordinates
from kanejax._view.shape import ViewError
from kanejax._view.tracks import Track, tracks_of

# Our names of arrays, and those of data sets.
_NAMES = {"ts": ("ts", "time"), "q": ("q",), "u": ("u",), "tau": ("tau",), "tau_ts": ("force_time",)}
_TEXT = (".csv", ".tsv", ".txt", ".dat", ".log")
_LOGS = (*_TEXT, ".parquet", ".pq", ".mcap")
# A packed file may unpack to this many bytes, or else to this many times its size; of a data set so much is read at most.
_MOST_BYTES, _MOST_TIMES = 2**28, 100


def read_tracks(path: str | os.PathLike[str], model: Model, rows: Sequence[int] | None) -> tuple[list[Track], list[str]]:
    """The motions of a file, and in sentences what of it is not shown.

    Raises:
        KanejaxError: the file is missing or malformed, or does not fit the model.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if not file.exists():
        raise ViewError(f"{file}: there is no such file; give the path of a trajectory or a log")
    if suffix == ".zarr":
        return _store_tracks(file, model, rows)
    if suffix == ".npz":
        return _npz_tracks(file, model, rows)
    if suffix in _LOGS:
        return log_tracks(_log(file, model), model, rows)
    raise ViewError(f"{file}: motions are read from .npz, .zarr, {', '.join(_LOGS)}; it ends in none of them")


def log_tracks(log: Log, model: Model, rows: Sequence[int] | None) -> tuple[list[Track], list[str]]:
    """The runs of a log, all if `rows` is None; joints that it does not have stay where they are at first."""
    tree = model.tree
    joints = [tree.joint(name) for name in log.joints]
    for joint in joints:
        if tree.joint_types[joint] not in ("revolute", "prismatic"):
            raise ViewError(f"joint {tree.joint_names[joint]!r} has several coordinates; a log has one number a joint")
    at_q, at_v = ([starts[joint] for joint in joints] for starts in (tree.q_start, tree.v_start))
    wanted = range(len(log.runs)) if rows is None else rows
    found = []
    for row in wanted:
        if not 0 <= row < len(log.runs):
            raise ViewError(f"there is no run {row} in the log; the {len(log.runs)} are numbered from 0")
        run = log.runs[row]
        q = np.tile(reference_coordinates(model), (len(run), 1))
        u, tau = (np.full((len(run), model.nv), np.nan) for _ in range(2))
        q[:, at_q], tau[:, at_v] = run.q, run.effort
        if run.u is not None:
            u[:, at_v] = run.u
        known = {"u": run.u is not None, "tau": bool(np.isfinite(run.effort).any())}
        arrays = {"ts": run.ts, "q": q} | {key: array for key, array in (("u", u), ("tau", tau)) if known[key]}
        found += tracks_of(arrays, model, None, run.name)
    resting = [name for name in tree.joint_names if name not in log.joints]
    return found, [f"not in the log, and shown at rest: {', '.join(resting)}"] if resting else []


def _log(file: Path, model: Model) -> Log:
    tree = model.tree
    joints = [name for name, kind in zip(tree.joint_names, tree.joint_types, strict=True) if kind in ("revolute", "prismatic")]
    if file.suffix.lower() not in _TEXT:
        return read_log(file, joints)
    names = text_table(file, None, None).names or ()
    there = [joint for joint in joints if f"position_{joint}" in names]
    if not there:
        columns = ", ".join(f"position_{joint}" for joint in joints)[:300]
        raise LogError(f"{file} has none of the columns {columns}; kanejax.read_log reads others, and view takes what it returns")
    speeds, forces = (all(f"{what}_{joint}" in names for joint in there) for what in ("velocity", "effort"))
    # A log needs something that was measured of the actuators; to be seen, a robot does not.
    columns = Columns(velocity="velocity_{joint}" if speeds else None, effort="effort_{joint}" if forces else "position_{joint}")
    log = read_log(file, there, columns=columns)
    if forces:
        return log
    nothing, (run,) = np.zeros_like(log.runs[0].q), log.runs
    return Log(log.joints, type(run)(run.name, run.ts, run.q, nothing * np.nan, u=run.u, weight=nothing))


def _npz_tracks(file: Path, model: Model, rows: Sequence[int] | None) -> tuple[list[Track], list[str]]:
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            entries = {entry.filename: entry.file_size for entry in archive.zip.infolist()}
            wanted = {key: name for key, names in _NAMES.items() for name in names if name in archive.files}
            names = [*wanted.values(), *(name for name in ("joint_names",) if name in archive.files)]
            unpacked = sum(entries.get(f"{name}.npy", 0) for name in names)
            if unpacked > max(_MOST_BYTES, _MOST_TIMES * file.stat().st_size):
                raise ViewError(f"{file}: it unpacks to {unpacked} bytes, {_MOST_TIMES} times its size; write it anew")
            for name in names:
                if promises_too_much(archive, name):
                    raise ViewError(f"{file}: the array {name!r} says that it is larger than it is; write the file anew")
            arrays = {key: archive[name] for key, name in wanted.items()}
            joints = archive["joint_names"].tolist() if "joint_names" in names else None
            keys = sorted(archive.files)
    except OSError as error:
        raise ViewError(f"{file}: cannot be read ({error.strerror or error})") from error
    except ViewError:
        raise
    except Exception as error:
        # What is wrong with an archive of somebody else may raise anything.
        raise ViewError(f"{file}: not an NPZ file of a motion: {' '.join(str(error).split())[:200]}") from error
    if "q" not in arrays:
        raise ViewError(f"{file} has no array 'q'; it has {', '.join(keys)[:300] or 'nothing'}")
    arrays, notes = _of_all_joints(arrays, joints, model, file)
    return tracks_of(arrays, model, rows, str(file)), notes


def _store_tracks(path: Path, model: Model, rows: Sequence[int] | None) -> tuple[list[Track], list[str]]:
    """Only these trajectories of a data set: it may have millions."""
    zarr = zarr_package()
    if not path.is_dir():
        raise DatasetError(f"{path} is no folder, so it is no data set")
    try:
        group = zarr.open_group(link_free(path), mode="r")
        found = {key: group[name] for key, names in _NAMES.items() for name in names if name in group}
        joints = None if "q" not in found else found["q"].attrs.get("joints")
        arrays = {key: _stored(array, key, rows or (0,), path) for key, array in found.items()}
    except (DatasetError, ViewError):
        raise
    except Exception as error:
        # Metadata of somebody else may raise anything.
        raise DatasetError(f"{path} is no data set of motions: {' '.join(str(error).split())[:200]}") from error
    arrays, notes = _of_all_joints(arrays, joints, model, path)
    tracks = tracks_of(arrays, model, range(len(rows or (0,))), str(path))
    return [
        dataclasses.replace(track, name=f"{path}, trajectory {row}") for track, row in zip(tracks, rows or (0,), strict=True)
    ], notes


def _stored(array: Any, key: str, rows: Sequence[int], path: Path) -> np.ndarray:
    """An array of a data set, or its rows."""
    shape, batched = tuple(array.shape), array.ndim == 3
    size = int(np.prod(shape[1:] if batched else shape, dtype=float)) * (len(rows) if batched else 1) * array.dtype.itemsize
    chunk = int(np.prod(array.chunks, dtype=float)) * array.dtype.itemsize
    if size > _MOST_BYTES or chunk > 2**31:
        raise DatasetError(f"{path}: {key} of {len(rows)} trajectories takes {max(size, chunk)} bytes; ask for fewer")
    for row in rows if batched else ():
        if not 0 <= row < shape[0]:
            raise ViewError(f"{path}: there is no trajectory {row}; the {shape[0]} are numbered from 0 to {shape[0] - 1}")
    return np.stack([np.asarray(array[row]) for row in rows]) if batched else np.asarray(array[:])


def _of_all_joints(
    arrays: dict[str, np.ndarray], joints: Any, model: Model, origin: Path
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Arrays for the whole robot from those of some of its joints, as of an optimization that held others still."""
    tree = model.tree
    if not isinstance(joints, list) or tuple(joints) == tree.joint_names:
        return arrays, []
    if not set(joints) <= set(tree.joint_names):
        of_file, of_robot = (", ".join(map(str, names))[:300] for names in (joints, tree.joint_names))
        raise ViewError(f"{origin} is of a robot with the joints {of_file}, but this one has {of_robot}")
    numbers = [tree.joint(name) for name in joints]
    found = dict(arrays)
    rest = {"q": reference_coordinates(model), "u": np.zeros(model.nv), "tau": np.full(model.nv, np.nan)}
    for key in rest.keys() & arrays.keys():
        sizes, starts = (COORDINATES, tree.q_start) if key == "q" else (SPEEDS, tree.v_start)
        columns = [starts[joint] + k for joint in numbers for k in range(sizes[tree.joint_types[joint]])]
        given = arrays[key]
        if given.ndim and given.shape[-1] == len(columns) and given.dtype.kind in "fiu":
            found[key] = np.tile(rest[key], (*given.shape[:-1], 1))
            found[key][..., columns] = given
    resting = [name for name in tree.joint_names if name not in joints]
    return found, [f"not in {origin}, and shown at rest: {', '.join(resting)}"]
