"""Finding joints that move no inertia, which leave the mass matrix singular, from the numbers of a model alone.

Only what holds in every pose is looked for: an inner joint's share of the mass matrix depends on the pose.
"""

from typing import NamedTuple

import numpy as np

from kanejax._errors import InvalidInertiaError
from kanejax._model.model import Model
from kanejax._model.tree import SPEEDS, WORLD

# A joint moves something if its mass matrix has no smaller diagonal element, and, scaled to unit diagonal, eigenvalue.
_SMALLEST_DIAGONAL, _SMALLEST_EIGENVALUE = 1e-16, 1e-12


class _Body(NamedTuple):
    """Where a body is while no joint is displaced, in world axes, and its inertial numbers."""

    rotation: np.ndarray
    position: np.ndarray
    mass: float
    com: np.ndarray
    central_inertia: np.ndarray


def check_joints_move_inertia(model: Model) -> None:
    """Raise InvalidInertiaError for a joint at the end of the tree with a singular mass matrix, or that carries nothing."""
    tree = model.tree
    placed = _placed_bodies(model)
    armature, anchors, axes = (np.asarray(leaf, float) for leaf in (model.armature, model.joint_anchor, model.joint_axis))
    for joint, (kind, body, start) in enumerate(zip(tree.joint_types, tree.joint_bodies, tree.v_start, strict=True)):
        rotor = armature[start : start + SPEEDS[kind]]
        carried = [placed[index] for index in np.flatnonzero(tree.body_moved_by[:, start])]
        if joint in tree.link_parents:
            singular = not rotor.all() and not any(other.mass or other.central_inertia.any() for other in carried)
        else:
            rotation, position = placed[body][:2]
            point = position if kind == "free" else position + rotation @ anchors[joint]
            motion = _motion(kind, rotation, axes[joint])
            singular = _is_singular(motion.T @ _inertia_about(carried, point) @ motion + np.diag(rotor))
        if singular:
            raise InvalidInertiaError(
                f"body {tree.body_names[body]!r}: joint {tree.joint_names[joint]!r} moves no inertia, so the mass matrix is "
                "singular; give the body a mass and an inertia, or the joint an armature"
            )


def _placed_bodies(model: Model) -> list[_Body]:
    positions, quaternions = np.asarray(model.body_position, float), np.asarray(model.body_quaternion, float)
    masses, coms, inertias = (np.asarray(leaf, float) for leaf in (model.mass, model.com, model.central_inertia))
    placed: list[_Body] = []
    for body, parent in enumerate(model.tree.body_parents):
        rotation, position = _rotation_matrix(quaternions[body]), positions[body]
        if parent != WORLD:
            rotation, position = placed[parent].rotation @ rotation, placed[parent].position + placed[parent].rotation @ position
        placed.append(_Body(rotation, position, float(masses[body]), coms[body], inertias[body]))
    return placed


def _rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    cross = _cross(quaternion[1:])
    return np.eye(3) + 2 * (quaternion[0] * cross + cross @ cross) / (quaternion @ quaternion)


def _cross(vector: np.ndarray) -> np.ndarray:
    """The matrix whose product with another vector is the cross product."""
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def _inertia_about(bodies: list[_Body], point: np.ndarray) -> np.ndarray:
    """6x6 inertia of `bodies` about `point` in world axes, for an angular velocity and the velocity of the point."""
    total = np.zeros((6, 6))
    for body in bodies:
        offset = body.mass * _cross(body.position + body.rotation @ body.com - point)
        central = body.rotation @ body.central_inertia @ body.rotation.T
        rotary = central - (offset @ offset / body.mass if body.mass else 0.0)
        total += np.block([[rotary, offset], [-offset, body.mass * np.eye(3)]])
    return total


def _motion(kind: str, rotation: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Columns of angular velocity and velocity that the speeds of a joint cause, in world axes."""
    if kind == "free":
        return np.block([[np.zeros((3, 3)), rotation], [np.eye(3), np.zeros((3, 3))]])
    if kind == "ball":
        return np.vstack([rotation, np.zeros((3, 3))])
    direction = rotation @ axis / np.linalg.norm(axis)
    return np.concatenate([direction, np.zeros(3)] if kind == "revolute" else [np.zeros(3), direction])[:, None]


def _is_singular(mass_matrix: np.ndarray) -> bool:
    diagonal = np.diag(mass_matrix)
    if diagonal.min() < _SMALLEST_DIAGONAL:
        return True
    scale = 1 / np.sqrt(diagonal)
    return bool(np.linalg.eigvalsh(mass_matrix * np.outer(scale, scale))[0] < _SMALLEST_EIGENVALUE)
