"""From what users have, to a stage: a robot with motions that were read or computed."""

import os
from collections.abc import Mapping, Sequence
from typing import Any

from kanejax._logs.log import Log
from kanejax._model.model import Model
from kanejax._view.scene import Scene, scene_of
from kanejax._view.shape import ViewError
from kanejax._view.stage import Stage
from kanejax._view.track_files import log_tracks, read_tracks
from kanejax._view.tracks import Track, tracks_of

# Robots beside one another; a browser does not show more at a speed that is of use.
_MOST_COPIES = 64
# A path, a trajectory, a log, arrays by name, or several of them: `view` says which.
Motions = Any


def stage_of(
    robot: str | os.PathLike[str] | Model,
    trajectory: Motions,
    *,
    rows: Sequence[int] | None,
    reference: Motions,
    **loading: Any,
) -> tuple[Stage, tuple[str, ...]]:
    """What `view` and `render` show, and in sentences what they do not."""
    scene = scene_of(robot, **loading)
    tracks, notes = motions_of(trajectory, scene, rows)
    ghosts, more = motions_of(reference, scene, None)
    if len(ghosts) > 1:
        raise ViewError(f"the reference has {len(ghosts)} motions; give one")
    if ghosts and not tracks:
        raise ViewError(
            "there is a reference, but no trajectory that it belongs to; give the trajectory, or show the reference as one"
        )
    if len(tracks) > _MOST_COPIES:
        raise ViewError(f"{len(tracks)} trajectories are asked for; at most {_MOST_COPIES} are shown side by side, choose rows")
    return Stage(scene, tuple(tracks), ghosts[0] if ghosts else None), (*scene.notes, *notes, *more)


def motions_of(source: Motions, scene: Scene, rows: Sequence[int] | None) -> tuple[list[Track], list[str]]:
    """The motions of anything that `view` takes, and in sentences what of them is not shown."""
    model = scene.model
    if source is None:
        return [], []
    if isinstance(source, str | os.PathLike):
        return read_tracks(source, model, rows)
    if isinstance(source, Log):
        return log_tracks(source, model, rows)
    if isinstance(source, Mapping):
        return tracks_of(source, model, rows, "trajectory"), []
    if hasattr(source, "ts") and hasattr(source, "q"):
        arrays = {name: getattr(source, name) for name in ("ts", "q", "u", "tau") if hasattr(source, name)}
        return tracks_of(arrays, model, rows, type(source).__name__), []
    if isinstance(source, Sequence):
        found = [motions_of(each, scene, rows) for each in source]
        return [track for tracks, _ in found for track in tracks], [note for _, notes in found for note in notes]
    raise ViewError(f"cannot show a {type(source).__name__}; give a trajectory, a log, a path, or a mapping with ts and q")
