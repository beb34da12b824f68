"""Several copies of a robot side by side, each with its motion and perhaps a reference: what is drawn at a time."""

import dataclasses
from typing import final

import numpy as np
from jaxtyping import Float

from kanejax._model.tree import WORLD
from kanejax._view.scene import BONE_COLOR, REFERENCE_COLOR, Fixed, Postures, Scene, outline, reference_coordinates, visible
from kanejax._view.shape import Surface, cylinder, ellipsoid
from kanejax._view.tracks import Track

GHOST_OPACITY, SEE_THROUGH = 0.35, 0.5
# Thickness of bones, and of the axes of frames, over the size of the robot.
THIN = 0.006
_SAMPLES = 24


@final
@dataclasses.dataclass(frozen=True)
class Stage:
    """Copies of a robot, each moved off so that they stand on a grid.

    Attributes:
        scene: the robot.
        tracks: a motion for each copy; none for one copy at rest.
        reference: a motion that a translucent copy of each makes.
    """

    scene: Scene
    tracks: tuple[Track, ...] = ()
    reference: Track | None = None

    @property
    def copies(self) -> int:
        """How many robots there are."""
        return max(len(self.tracks), 1)

    @property
    def duration(self) -> float:
        """Of the longest motion [s]."""
        return max((each.duration for each in self.tracks), default=0.0)

    def coordinates(self, t: float) -> Float[np.ndarray, "copies nq"]:
        """Of all copies at a time."""
        model = self.scene.model
        return np.array([each.at(model, t) for each in self.tracks] or [reference_coordinates(model)])

    def ghost_coordinates(self, t: float) -> Float[np.ndarray, "copies nq"]:
        """Of the ghosts, all the same, at a time."""
        assert self.reference is not None
        return np.tile(self.reference.at(self.scene.model, t), (self.copies, 1))

    def offsets(self) -> Float[np.ndarray, "copies 3"]:
        """How far the copies are moved off: rows along y, about as many as columns along x, the first in front."""
        if self.copies == 1:
            return np.zeros((1, 3))
        reach = np.ptp(self.outline(np.zeros((self.copies, 3))), axis=0)
        step = 1.1 * np.maximum(reach, 0.2 * self.scene.size)
        columns = int(np.ceil(np.sqrt(self.copies)))
        numbers = np.arange(self.copies)
        return np.stack((-(numbers // columns) * step[0], (numbers % columns) * step[1], np.zeros(self.copies)), 1)

    def outline(self, offsets: Float[np.ndarray, "copies 3"], *, ellipsoids: bool = False) -> Float[np.ndarray, "n 3"]:
        """Points around all that is drawn of the copies in all of their motion."""
        times = np.linspace(0.0, self.duration, _SAMPLES if self.tracks else 1)
        q = [self.coordinates(t) for t in times]
        q += [self.ghost_coordinates(t) for t in times] if self.reference is not None else []
        placed = (moved_off(self.scene.postures(each), offsets) for each in q)
        return np.concatenate([outline(self.scene, each, ellipsoids=ellipsoids) for each in placed])


def moved_off(placed: Postures, offsets: Float[np.ndarray, "copies 3"]) -> Postures:
    """The same postures elsewhere."""
    return placed._replace(origin=placed.origin + offsets[:, None], com=placed.com + offsets[:, None])


def placed_surfaces(
    stage: Stage, t: float, offsets: Float[np.ndarray, "copies 3"], *, shapes: bool = True, ellipsoids: bool = False
) -> list[Surface]:
    """All surfaces in world axes at a time, ghosts of the reference among them."""
    scene = stage.scene
    fixed = visible(scene, shapes=shapes, ellipsoids=ellipsoids)
    if ellipsoids:
        # Either may hide the other.
        fixed = tuple(Fixed(body, each._replace(opacity=min(each.opacity, SEE_THROUGH))) for body, each in fixed)
    placed = moved_off(scene.postures(stage.coordinates(t)), offsets)
    found = _placed(fixed, placed, offsets)
    if shapes:
        found += [each for copy in range(stage.copies) for each in (*_bones(scene, placed, copy), *_frames(scene, placed, copy))]
    if stage.reference is not None:
        ghosts = tuple(each for each in fixed if each.body != WORLD)
        at = _placed(ghosts, moved_off(scene.postures(stage.ghost_coordinates(t)), offsets), offsets)
        found += [each._replace(color=REFERENCE_COLOR, opacity=GHOST_OPACITY) for each in at]
    return found


def _placed(fixed: tuple[Fixed, ...], placed: Postures, offsets: Float[np.ndarray, "copies 3"]) -> list[Surface]:
    found = []
    for copy, offset in enumerate(offsets):
        for body, each in fixed:
            rotation, origin = (np.eye(3), offset) if body == WORLD else (placed.rotation[copy, body], placed.origin[copy, body])
            found.append(each.moved(rotation, origin))
    return found


def _bones(scene: Scene, placed: Postures, copy: int) -> list[Surface]:
    found = []
    for parent, body in scene.bones:
        start, end = placed.origin[copy, parent], placed.origin[copy, body]
        length = float(np.linalg.norm(end - start))
        if length > 1e-6 * scene.size:
            rod = cylinder(THIN * scene.size, length, color=BONE_COLOR)
            found.append(rod.moved(_axes_along((end - start) / length), 0.5 * (start + end)))
    return found


def _frames(scene: Scene, placed: Postures, copy: int) -> list[Surface]:
    """Axes of the bodies without shapes: x red, y green, z blue, and a ball at the origin."""
    found = []
    length = 8.0 * THIN * scene.size
    for body in scene.bare:
        rotation, origin = placed.rotation[copy, body], placed.origin[copy, body]
        for axis, color in enumerate(((0.84, 0.20, 0.18), (0.20, 0.63, 0.17), (0.12, 0.35, 0.85))):
            rod = cylinder(0.5 * THIN * scene.size, length, color=color)
            direction = rotation[:, axis]
            found.append(rod.moved(_axes_along(direction), origin + 0.5 * length * direction))
        found.append(ellipsoid(np.full(3, 1.4 * THIN * scene.size), color=BONE_COLOR).moved(np.eye(3), origin))
    return found


def _axes_along(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """A rotation whose z axis is this unit vector."""
    least = np.eye(3)[int(np.argmin(np.abs(direction)))]
    x = np.cross(least, direction)
    x /= np.linalg.norm(x)
    return np.stack((x, np.cross(direction, x), direction), 1)


def grid_spacing(size: float) -> float:
    """Between lines on the floor [m]: 1, 2 or 5 of some power of ten, about a sixth of the robot's size."""
    power = 10.0 ** np.floor(np.log10(size / 6.0))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= size / 6.0))


def floor_height(points: Float[np.ndarray, "n 3"]) -> float:
    """Where the floor is [m]: at zero, or below all of these points."""
    return float(min(0.0, points[:, 2].min()))
