"""Loading an input, and judging what comes of it."""

import functools
import inspect
import os
import resource
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import kanejax as kj
from experiments.fuzz import seeds
from experiments.fuzz.cases import Case
from kanejax._dataset.study_file import read_study
from kanejax._identify.configuration import read_configuration
from kanejax._logs.log import Log
from kanejax._model.model import Model, leaf_shapes
from kanejax._motion_task.task_file import read_task
from kanejax._view.scene import Scene, scene_of
from kanejax._view.track_files import read_tracks
from kanejax._view.tracks import Track

# Beside the folder of each input, where no loader may look.
SECRETS = {
    "secret.xml": b'<mujoco><option gravity="0 0 -77"/><worldbody/></mujoco>',
    "secret.obj": b"v 77777 0 0\nv 77778 0 0\nv 77777 1 0\nf 1 2 3\n",
}
# Meshes are drawn at a tenth of their size.
_FORBIDDEN_GRAVITY, _FORBIDDEN_SIZE = -77.0, 7777.7
_MUCH_MEMORY, _MUCH_TIME = 700, 10.0
# Messages that say that MuJoCo, and not we, found out.
_TOO_LATE = ("allocat", "unknown exception", "bad_alloc")
_LARGEST_SQUARED = 1e60


class Verdict(NamedTuple):
    """What became of an input: "loaded" or the name of an error; what is wrong with that, if anything; and the cost [s, MB]."""

    outcome: str
    finding: str
    seconds: float
    megabytes: float


def judged(case: Case, folder: Path) -> Verdict:
    """Write an input below `folder`, which is empty, load it there, and see whether that went as it may."""
    inside, work = folder / "in", folder / "work"
    _written(case, inside)
    for name, data in SECRETS.items():
        (folder / name).write_bytes(data)
    work.mkdir()
    os.chdir(work)
    memory, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
    finding = ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            loaded = _LOADERS.get(case.kind, _robot)(case, inside / case.main)
        outcome = "loaded"
        finding = nonsense(loaded, case)
    except kj.KanejaxError as error:
        outcome = type(error).__name__
        finding = next((f"MuJoCo ran out of memory: {error}"[:300] for word in _TOO_LATE if word in str(error)), "")
        if not str(error) or "\n" in str(error) or len(str(error)) > 20_000:
            finding = f"not a message of one line: {str(error)[:300]!r}"
    except Exception as error:
        outcome = type(error).__name__
        documented = (ValueError, TypeError) if case.kind == "DH table" else (OSError,) if "TOML" in case.kind else ()
        finding = "" if isinstance(error, documented) else f"{outcome}: {str(error)[:300]}"
    seconds = time.perf_counter() - start
    megabytes = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) / 1024
    known = (inside, work, *(folder / name for name in SECRETS))
    left = [str(path) for path in (*work.iterdir(), *folder.iterdir()) if path not in known]
    left += [name for name, data in SECRETS.items() if (folder / name).read_bytes() != data]
    if left:
        finding = finding or f"wrote {left}"
    if megabytes > _MUCH_MEMORY or seconds > _MUCH_TIME:
        finding = finding or f"took {seconds:.1f} s and {megabytes:.0f} MB"
    return Verdict(outcome, finding, seconds, megabytes)


def nonsense(loaded: Any, case: Case) -> str:
    """What no sound model or log has; empty if all is well."""
    if isinstance(loaded, Log):
        arrays = [array for run in loaded.runs for array in (run.ts, run.q, run.effort)]
        return "" if all(np.all(np.isfinite(array)) for array in arrays) else "a log with numbers that are not finite"
    if isinstance(loaded, Scene):
        corners = [each.surface.vertices for each in (*loaded.shapes, *loaded.ellipsoids)]
        if not all(np.all(np.isfinite(each)) for each in corners):
            return "a surface with numbers that are not finite"
        if any(np.any(np.isclose(np.linalg.norm(each, axis=1), _FORBIDDEN_SIZE, rtol=1e-3)) for each in corners):
            return "a mesh outside of the folder was read"
        return ""
    if case.kind == "seen motion":
        sound = all(np.all(np.isfinite(track.ts)) and np.all(np.diff(track.ts) > 0) for track in loaded)
        return "" if sound and all(np.all(np.isfinite(track.q)) for track in loaded) else "a motion that cannot be shown"
    if case.kind == "data set":
        return "" if loaded == seeds.data_set() else "went on with a store that is not that of the study"
    if not isinstance(loaded, Model):
        return ""
    tree = loaded.tree
    for name, shape in leaf_shapes(tree).items():
        leaf = np.asarray(getattr(loaded, name))
        if leaf.shape != shape or np.any(np.isnan(leaf)) or (name != "joint_range" and not np.all(np.isfinite(leaf))):
            return f"{name} = {leaf!r}"[:300]
    if not case.options.get("allow_unphysical") and np.any(np.asarray(loaded.mass)[np.array(tree.body_links, int) >= 0] < 0):
        return "a negative mass"
    if loaded.gravity[2] == _FORBIDDEN_GRAVITY:
        return "a file outside of the folder was read"
    moderate = all(
        np.abs(np.nan_to_num(np.asarray(leaf), posinf=0, neginf=0)).max(initial=0) < _LARGEST_SQUARED
        for leaf in jax.tree.leaves(loaded)
    )
    if tree in _known_trees() and moderate and "allow_unphysical" in case.options and not case.options["allow_unphysical"]:
        q, u = np.array(loaded.coordinate_reference), np.linspace(-1, 1, tree.nv)
        if not np.all(np.isfinite(_inverse_dynamics(loaded, q, u, u[::-1]))):
            return "inverse dynamics is not finite"
    return ""


def _written(case: Case, folder: Path) -> None:
    folder.mkdir()
    for name, data in case.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    for name, target in case.links.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).symlink_to(target)


def _robot(case: Case, path: Path) -> Model:
    options = dict(case.options)
    source = path.read_bytes().decode("utf-8", "surrogateescape") if options.pop("as_text", False) else path
    # Text that is no XML is taken for a path.
    if isinstance(source, str) and not source.lstrip().startswith("<"):
        source = f"<{source}"
    return kj.load_report(source, **options).model


def _dh(case: Case, _: Path) -> Model:
    options = dict(case.options)
    rows = [_row(row) if isinstance(row, dict) and "mass" in row else row for row in options.pop("rows")]
    # Without the type checks of the tests, which would come before those of `from_dh`.
    return inspect.unwrap(kj.from_dh)(rows, **options)


def _row(fields: dict[str, Any]) -> kj.DHLink:
    row = kj.DHLink(1.0)
    for name, value in fields.items():
        object.__setattr__(row, name, value)
    return row


def _log(case: Case, path: Path) -> Log:
    return kj.read_log(path, seeds.JOINTS, **case.options)


def _configuration(_: Case, path: Path) -> Any:
    return read_configuration(path)


def _task(_: Case, path: Path) -> Any:
    return read_task(path, lambda robot: kj.load_report(robot))


def _study(_: Case, path: Path) -> Any:
    file = read_study(path)
    values = {"trajectories": 4, "duration": 0.1, "times": 3, "seed": 0, **file.values}
    ts = np.linspace(0.0, values["duration"], values["times"])
    study = file.study(kj.load(path.with_name("arm.xml")), ts, values["trajectories"], values["seed"], {})
    return study.rows(values["trajectories"] - 1, 1)


def _data_set(_: Case, path: Path) -> dict[str, bytes]:
    """Go on with it; what is accepted must end as the whole one."""
    kj.write_study(seeds.study(), path, chunk=2, threads=1, resume=True)
    return {name: (path / name).read_bytes() for name in seeds.data_set()}


def _seen_robot(case: Case, path: Path) -> Scene:
    return scene_of(path, **case.options)


def _seen_motion(_: Case, path: Path) -> list[Track]:
    return read_tracks(path, kj.load(seeds.PENDULUM), None)[0]


_LOADERS = {
    "DH table": _dh,
    **dict.fromkeys(("CSV log", "NPZ log", "Parquet log", "MCAP log"), _log),
    "identify TOML": _configuration,
    "task TOML": _task,
    "study TOML": _study,
    "data set": _data_set,
    "seen robot": _seen_robot,
    "seen motion": _seen_motion,
}


@functools.cache
def _known_trees() -> frozenset:
    """Of the seeds, so that few programs are compiled."""
    return frozenset(kj.load_report(text, strict=False, repair=True).model.tree for text in (seeds.URDF, seeds.PENDULUM))


@functools.cache
def _compiled() -> Any:
    return jax.jit(kj.inverse_dynamics)


def _inverse_dynamics(model: Model, q: np.ndarray, u: np.ndarray, u_dot: np.ndarray) -> np.ndarray:
    return np.asarray(_compiled()(model, q, u, u_dot))
