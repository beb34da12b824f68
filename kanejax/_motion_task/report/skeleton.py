"""A robot as points and lines between them, as it moves, and what stands in its way."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._kinematics.pose import poses
from kanejax._model.tree import WORLD, Tree
from kanejax._optimize.displacement import displaced
from kanejax._optimize.motion import OptimalMotion
from kanejax._optimize.task import MotionTask

_FRAMES = 121


def animation(task: MotionTask, motion: OptimalMotion, constraints: Sequence[tuple[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """What the page needs to draw the motion, in world axes.

    Args:
        task: what is asked for.
        motion: to be shown.
        constraints: names and options, whose targets and spheres are drawn too.

    Returns:
        "duration"; "frames" (frames, points, 3), first the origins of so many "bodies", then mass centres; "lines" between points;
        "joints", points that are drawn as such; "trace", the point whose path is drawn; the height of the "floor"; "balls" fixed in
        the world, "carried" ones, and "targets".
    """
    tree = task.model.tree
    rotation, origin, com = (np.asarray(each) for each in _poses(task, motion))
    lines = [[parent, body] for body, parent in enumerate(tree.body_parents) if parent != WORLD]
    # Without a body further on, the mass centre says where one points.
    tips = [body for body in range(tree.nbody) if body not in tree.body_parents and float(task.model.mass[body]) > 0]
    points = np.concatenate((origin, com[:, tips]), 1)
    lines += [[body, tree.nbody + i] for i, body in enumerate(tips)]
    ways = np.sum(np.linalg.norm(np.diff(points, axis=0), axis=2), 0)
    return {
        "duration": float(motion.duration),
        "frames": _rounded(points),
        "bodies": tree.nbody,
        "lines": [[a, b] for a, b in lines if np.max(np.linalg.norm(points[:, a] - points[:, b], axis=1)) > 1e-6],
        "joints": np.unique(np.array(tree.joint_bodies, int)).tolist(),
        "trace": int(np.argmax(ways)),
        "floor": float(min(0.0, points[..., 2].min())),
        **_surroundings(tree, rotation, origin, constraints),
    }


def _surroundings(
    tree: Tree, rotation: np.ndarray, origin: np.ndarray, constraints: Sequence[tuple[str, Mapping[str, Any]]]
) -> dict[str, Any]:
    balls, carried, targets = [], [], []
    for name, options in constraints:
        if name == "position":
            targets.append(options["target"])
        if "radius" in options:
            carried.append((options["body"], options.get("center"), options["radius"]))
        if name == "sphere_clearance" and isinstance(options["obstacle"], str):
            carried.append((options["obstacle"], options.get("obstacle_center"), options["obstacle_radius"]))
        elif name == "sphere_clearance":
            balls.append([*options["obstacle"], options["obstacle_radius"]])
    spheres = [_carried(rotation, origin, tree.body(body), center, radius) for body, center, radius in carried]
    return {"balls": balls, "carried": spheres, "targets": targets}


def _poses(task: MotionTask, motion: OptimalMotion) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Rotations, origins and mass centres of all bodies at equal times."""
    model, steps = task.model, task.steps
    place = jnp.linspace(0.0, steps, _FRAMES, dtype=model.dtype)
    k = jnp.minimum(jnp.floor(place).astype(int), steps - 1)
    s = (place - k.astype(model.dtype)) * (motion.duration / steps)

    def at(k: jax.Array, s: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        found = poses(model, displaced(model.tree, motion.q[k], s * (motion.u[k] + 0.5 * s * motion.u_dot[k])))
        return found.rotation, found.origin, found.com

    return jax.jit(jax.vmap(at))(k, s)


def _carried(rotation: np.ndarray, origin: np.ndarray, body: int, center: Any, radius: float) -> dict[str, Any]:
    """A sphere fixed in a body."""
    offset = np.zeros(3) if center is None else np.array(center, float)
    return {"radius": radius, "frames": _rounded(origin[:, body] + rotation[:, body] @ offset)}


def _rounded(points: np.ndarray) -> list:
    """To a tenth of a millimetre."""
    return (np.round(points, 4) + 0.0).tolist()
