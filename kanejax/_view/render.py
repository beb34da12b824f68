"""Films of robots, made without a screen."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from kanejax._model.model import Model
from kanejax._view.camera import AZIMUTH, ELEVATION, camera_around
from kanejax._view.film import GIF, PNG, check_film, frame_rate, write_film
from kanejax._view.motions import Motions, stage_of
from kanejax._view.ray_cast import Floor, picture
from kanejax._view.shape import ViewError
from kanejax._view.stage import Stage, floor_height, grid_spacing, placed_surfaces

_MOST_PICTURES = 100_000


def render(
    robot: str | os.PathLike[str] | Model,
    trajectory: Motions,
    out: str | os.PathLike[str],
    *,
    rows: Sequence[int] | None = None,
    reference: Motions = None,
    size: tuple[int, int] = (960, 540),
    fps: float | None = None,
    seconds: float | None = None,
    start: float = 0.0,
    speed: float = 1.0,
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
    distance: float | None = None,
    ellipsoids: bool = False,
    packages: Sequence[str | os.PathLike[str]] = (),
    strict: bool = False,
    repair: bool = False,
    allow_unphysical: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[str, ...]:
    """Make a film of a moving robot, or a picture of a moment, by casting rays: it needs no screen and no graphics card.

    The same arguments give the same pictures. A file that an interruption leaves half done does not appear.

    Args:
        robot: as in `view`.
        trajectory: as in `view`; None: the reference posture, for a picture.
        out: a path that ends in .mp4, .gif or .png.
        rows: numbers of the trajectories to show side by side.
        reference: a motion that a translucent robot makes.
        size: columns and rows of the picture.
        fps: pictures a second; None: 30, and 25 in a GIF, where 100 / fps is made whole.
        seconds: how long the film is; None: until the end of the motion. After its end the robot stands still.
        start: time of the motion [s] at which the film begins, or that of the picture.
        speed: of the film, over that of the motion.
        azimuth: of the camera, around the vertical from the x axis towards the y axis [degrees].
        elevation: of the camera above the horizon [degrees].
        distance: of the camera from the middle of the motion [m]; None: as near as shows all of it.
        ellipsoids: draw the ellipsoids of all inertias, and shapes translucent.
        packages: as in `view`.
        strict: as in `load`.
        repair: as in `load`.
        allow_unphysical: as in `load`.
        progress: is called with the number of pictures that are done, and of all.

    Returns:
        Sentences on what could not be shown.

    Raises:
        KanejaxError: as `view` does, or no film is like that.
    """
    path = Path(out)
    suffix = path.suffix.lower()
    fps = fps if fps is not None else (25.0 if suffix == GIF else 30.0)
    check_film(path, size, fps)
    if not (speed > 0.0 and np.isfinite(speed)):
        raise ViewError(f"the speed is {speed:g}; it must be greater than zero")
    if trajectory is None and suffix != PNG:
        raise ViewError(f"{path}: a film needs a trajectory; without one, make a picture, a file that ends in {PNG}")
    loading = {"strict": strict, "repair": repair, "allow_unphysical": allow_unphysical}
    stage, notes = stage_of(robot, trajectory, rows=rows, reference=reference, packages=packages, **loading)
    rate = frame_rate(suffix, fps)
    times = [start] if suffix == PNG else film_times(stage, float(rate), start, seconds, speed)
    offsets = stage.offsets()
    points = stage.outline(offsets, ellipsoids=ellipsoids)
    camera = camera_around(points, size[0] / size[1], azimuth=azimuth, elevation=elevation, distance=distance)
    floor = Floor(floor_height(points), grid_spacing(stage.scene.size))

    def draw(t: float) -> np.ndarray:
        return picture(placed_surfaces(stage, t, offsets, ellipsoids=ellipsoids), camera, size, floor)

    write_film(path, times, draw, rate, lambda done: progress(done, len(times)) if progress else None)
    return notes


def film_times(stage: Stage, rate: float, start: float, seconds: float | None, speed: float) -> list[float]:
    """The times of the motion [s] that the pictures of a film show.

    Raises:
        ViewError: there would be none, or too many.
    """
    left = (stage.duration - start) / speed
    if not 0.0 <= start <= stage.duration:
        raise ViewError(f"the film would begin at {start:g} s, but the motion is from 0 to {stage.duration:g} s")
    length = left if seconds is None else seconds
    if not 0.0 <= length <= _MOST_PICTURES / rate:
        raise ViewError(f"a film of {length:g} s is none, or has more than {_MOST_PICTURES} pictures; give seconds= or speed=")
    count = max(1, round(length * rate))
    return [start + speed * k / rate for k in range(count)]
