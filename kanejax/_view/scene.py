"""A robot as it is drawn: shapes fixed in its bodies, ellipsoids where there are none, and where all of it is."""

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from kanejax._io.load import load_report
from kanejax._io.xml_text import file_content, parsed_xml
from kanejax._kinematics.pose import poses
from kanejax._model.model import Model
from kanejax._model.tree import WORLD
from kanejax._view.files import MeshFolders
from kanejax._view.shape import Surface, ellipsoid

# Ellipsoids are orange, as no robot's shapes are likely to be; the blue of a reference goes with it for colour-blind eyes too.
ELLIPSOID_COLOR = (0.90, 0.62, 0.0)
# They may be larger than what they stand for, and are seen through.
ELLIPSOID_OPACITY = 0.55
REFERENCE_COLOR = (0.0, 0.45, 0.70)
BONE_COLOR = (0.35, 0.38, 0.42)
# The smallest semi-axis that is drawn, over the size of the robot.
_THINNEST = 0.002
_MOST_PROBLEMS = 8
# What is farther away [m] is an error, and cannot be drawn in single precision.
_FARTHEST = 1e6


class Fixed(NamedTuple):
    """A surface and the body that it is fixed in, -1 for the world; its vertices are in the body's axes."""

    body: int
    surface: Surface


class Postures(NamedTuple):
    """Where the bodies of several copies of a robot are, in world axes.

    Attributes:
        rotation: from body to world components.
        origin: of the body's frame.
        com: mass centre of the body.
    """

    rotation: Float[np.ndarray, "copies nbody 3 3"]
    origin: Float[np.ndarray, "copies nbody 3"]
    com: Float[np.ndarray, "copies nbody 3"]


@final
@dataclasses.dataclass(frozen=True)
class Scene:
    """What is drawn of a robot.

    Attributes:
        model: the robot.
        shapes: what its file says it looks like.
        ellipsoids: of bodies with mass, the solid ellipsoid of uniform density with its mass and principal moments, unless it is
            larger than the robot, as of bodies whose inertia was made up.
        bare: bodies without a shape that move or have mass: they are drawn as frames, and ellipsoids if they have mass.
        bones: pairs of bodies, one fixed to or hinged on the other, between whose origins a line is drawn.
        size: the length [m] of the robot in its reference posture, from corner to corner.
        notes: in sentences, which shapes could not be read, and how the model differs from its file.
    """

    model: Model
    shapes: tuple[Fixed, ...]
    ellipsoids: tuple[Fixed, ...]
    bare: tuple[int, ...]
    bones: tuple[tuple[int, int], ...]
    size: float
    notes: tuple[str, ...]

    def postures(self, q: Float[np.ndarray, "copies nq"]) -> Postures:
        """Where all bodies are, of several copies of the robot."""
        # The browser's callbacks run in threads of their own, which know nothing of the caller's jax.enable_x64.
        with jax.enable_x64(self.model.dtype == jnp.float64):
            found = _poses(self.model, jnp.asarray(q, self.model.dtype))
        return Postures(*(np.asarray(each, float) for each in (found.rotation, found.origin, found.com)))


_poses = jax.jit(jax.vmap(poses, (None, 0)))


def scene_of(
    robot: str | os.PathLike[str] | Model,
    *,
    packages: Sequence[str | os.PathLike[str]] = (),
    strict: bool = False,
    repair: bool = False,
    allow_unphysical: bool = False,
) -> Scene:
    """Load a robot with its shapes.

    Args:
        robot: a path or XML text, or a model, which has no shapes.
        packages: folders with packages of ROS, for package:// in names of meshes, beyond those above the robot's file.
        strict: as in `load`, and so are the others.
        repair: as in `load`.
        allow_unphysical: as in `load`.

    Raises:
        KanejaxError: the robot cannot be loaded; shapes that cannot be read do not matter.
    """
    if isinstance(robot, Model):
        return _scene(robot, [], ())
    report = load_report(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
    found, problems = _shapes(robot, report.model, tuple(Path(folder) for folder in packages))
    shapes = [each for each in found if np.all(np.abs(each.surface.vertices) < _FARTHEST)]
    if len(shapes) < len(found):
        problems.append(f"{len(found) - len(shapes)} with numbers that are not finite, or beyond {_FARTHEST:g} m")
    return _scene(report.model, shapes, (*report.ignored, *report.repaired, *_not_drawn(problems, report.origin)))


def _not_drawn(problems: list[str], origin: str) -> list[str]:
    """One sentence for all shapes that cannot be drawn, each reason told once."""
    if not problems:
        return []
    places: dict[str, list[str]] = {}
    for problem in problems:
        place, _, reason = problem.partition(": ")
        places.setdefault(reason, []).append(place)
    told = [f"{_first(names, ', ')}: {reason}" if reason else _first(names, ", ") for reason, names in places.items()]
    return [f"{origin}: {len(problems)} shapes are not drawn: {_first(told, '; ')}"]


def _first(words: list[str], mark: str) -> str:
    """Some of them, and how many more there are."""
    more = len(words) - _MOST_PROBLEMS
    return mark.join(words[:_MOST_PROBLEMS]) + (f"{mark}and {more} more" if more > 0 else "")


def reference_coordinates(model: Model) -> Float[np.ndarray, " nq"]:
    """The posture that the robot's file describes, brought into the ranges of its joints."""
    q = np.array(model.coordinate_reference, float)
    ranges = np.asarray(model.joint_range, float)
    for joint, (kind, start) in enumerate(zip(model.tree.joint_types, model.tree.q_start, strict=True)):
        if kind in ("revolute", "prismatic"):
            q[start] = np.clip(q[start], *ranges[joint])
    return q


def semi_axes(mass: float, moments: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Semi-axes of the solid ellipsoid of uniform density with this mass and these principal moments.

    Its moments are m (b^2 + c^2) / 5 and so on. Where moments break A + B >= C there is none: what would be the square of a
    negative length becomes zero.
    """
    squares = 2.5 / mass * (np.sum(moments) - 2.0 * moments)
    return np.sqrt(np.maximum(squares, 0.0))


def _shapes(robot: str | os.PathLike[str], model: Model, packages: tuple[Path, ...]) -> tuple[list[Fixed], list[str]]:
    # Only here, as it needs MuJoCo.
    from kanejax._view.mjcf_shapes import mjcf_shapes
    from kanejax._view.urdf_shapes import urdf_shapes

    text = isinstance(robot, str) and robot.lstrip().startswith("<")
    path, origin = (None, "XML text") if text else (Path(robot), str(robot))
    root = parsed_xml(str(robot).lstrip() if path is None else file_content(path), origin)
    if root.tag == "robot":
        named, problems = urdf_shapes(root, MeshFolders(path, packages))
        numbers = {name: number for number, name in enumerate(model.tree.body_names)}
        # A link called "world" is the world.
        return [Fixed(numbers.get(name, WORLD), each) for name, each in named], problems
    if path is None:
        return [], ["shapes of MJCF text are not drawn; write it to a file"]
    found, problems = mjcf_shapes(root, path, origin)
    # MuJoCo counts the world as body 0.
    return [Fixed(body - 1, each) for body, each in found], problems


def _scene(model: Model, shapes: list[Fixed], notes: tuple[str, ...]) -> Scene:
    tree = model.tree
    mass = np.asarray(model.mass, float)
    drawn_bodies = {each.body for each in shapes}
    moved = set(tree.joint_bodies)
    bare = tuple(body for body in range(tree.nbody) if body not in drawn_bodies and (mass[body] > 0 or body in moved))
    found = Scene(model, tuple(shapes), (), bare, (), 1.0, notes)
    placed = found.postures(reference_coordinates(model)[None])
    axes = [_principal(*each) for each in zip(mass, np.asarray(model.central_inertia, float), strict=True)]
    size = float(np.linalg.norm(np.ptp(outline(found, placed), axis=0)))
    size = size or 2.0 * max((float(lengths.max()) for lengths, _ in axes), default=0.0) or 1.0
    ellipsoids, huge = [], []
    for body, (lengths, rotation) in enumerate(axes):
        if mass[body] > 0 and lengths.max() <= size:
            drawn = ellipsoid(np.maximum(lengths, _THINNEST * size), color=ELLIPSOID_COLOR, opacity=ELLIPSOID_OPACITY)
            ellipsoids.append(Fixed(body, drawn.moved(rotation, np.asarray(model.com[body], float))))
        elif mass[body] > 0:
            huge.append(f"{tree.body_names[body]!r} ({lengths.max():.3g} m)")
    if huge:
        listed = ", ".join(huge[:_MOST_PROBLEMS]) + ", ..." * (len(huge) > _MOST_PROBLEMS)
        notes = (*notes, f"inertias of too large a radius for the robot, whose ellipsoids are not drawn: {listed}")
    bones = tuple(
        (parent, body)
        for body, parent in enumerate(tree.body_parents)
        if parent != WORLD and (body not in drawn_bodies or parent not in drawn_bodies) and _leads_on(body, tree.body_parents, mass)
    )
    return dataclasses.replace(found, ellipsoids=tuple(ellipsoids), bones=bones, size=size, notes=notes)


def _principal(mass: float, inertia: Float[np.ndarray, "3 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Semi-axes of a body's ellipsoid, and the rotation to them; zeros without mass."""
    moments, axes = np.linalg.eigh(0.5 * (inertia + inertia.T))
    # Right-handed, or the triangles would be inside out.
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return semi_axes(mass, moments) if mass > 0 else np.zeros(3), axes


def _leads_on(body: int, parents: tuple[int, ...], mass: np.ndarray) -> bool:
    """Whether a body, or one that hangs on it, has mass."""
    carried = {body}
    for child in range(body + 1, len(parents)):
        if parents[child] in carried:
            carried.add(child)
    return bool(np.any(mass[list(carried)] > 0))


def visible(scene: Scene, *, shapes: bool = True, ellipsoids: bool = False) -> tuple[Fixed, ...]:
    """The surfaces that are shown: shapes and what stands in for them, and ellipsoids of all bodies, or of none but those."""
    bare = set(scene.bare)
    ours = scene.shapes if shapes else ()
    return (*ours, *(each for each in scene.ellipsoids if ellipsoids or (shapes and each.body in bare)))


def outline(scene: Scene, placed: Postures, *, ellipsoids: bool = False) -> Float[np.ndarray, "n 3"]:
    """Points in world axes around all that is drawn: corners of boxes around the surfaces, origins, and the world's origin."""
    points = [np.zeros((1, 3)), placed.origin.reshape(-1, 3)]
    for body, each in visible(scene, ellipsoids=ellipsoids):
        low, high = each.vertices.min(0), each.vertices.max(0)
        corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), -1).reshape(-1, 3)
        if body != WORLD:
            corners = np.einsum("cij,kj->cki", placed.rotation[:, body], corners) + placed.origin[:, None, body]
        points.append(corners.reshape(-1, 3))
    return np.concatenate(points)
