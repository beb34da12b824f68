"""A robot whose joints are partly held still: a smaller model, in which they are not joints any more."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._errors import UnsupportedModelError
from kanejax._io.rotation import quaternion_of
from kanejax._kinematics.pose import poses
from kanejax._model.model import Model
from kanejax._model.tree import COORDINATES, SPEEDS, Tree


def with_locked_joints(model: Model, positions: Mapping[str, Any]) -> Model:
    """The model with joints welded where their coordinates say; inertia of rotors, friction and springs of these joints vanish.

    Args:
        model: of the whole robot.
        positions: coordinates [rad], [m] by joint: a number, four of a ball and seven of a free joint.

    Returns:
        A model with the same bodies and fewer joints.

    Raises:
        UnknownNameError: there is no such joint.
        UnsupportedModelError: another joint moves the same body, and is not locked too; or no joint would be left.
        ValueError: a joint has another number of coordinates.
    """
    tree = model.tree
    locked = [tree.joint(name) for name in positions]
    bodies = {tree.joint_bodies[joint] for joint in locked}
    kept = [joint for joint in range(tree.njoint) if joint not in locked]
    for joint in kept:
        if (body := tree.joint_bodies[joint]) in bodies:
            name = tree.joint_names[joint]
            raise UnsupportedModelError(f"joint {name!r} moves body {tree.body_names[body]!r} too; lock all of its joints, or none")
    if locked and not kept:
        raise UnsupportedModelError("all joints are locked, so nothing moves")
    q = np.array(model.coordinate_reference)
    for joint, value in zip(locked, positions.values(), strict=True):
        count = COORDINATES[tree.joint_types[joint]]
        if np.size(value) != count:
            raise ValueError(f"joint {tree.joint_names[joint]!r} has {count} coordinates, not {np.size(value)}")
        q[tree.q_start[joint] : tree.q_start[joint] + count] = value
    position, quaternion = _placed(model, q, sorted(bodies))
    fewer = Tree(
        tree.body_names,
        tree.body_parents,
        tuple(tree.joint_names[joint] for joint in kept),
        tuple(tree.joint_types[joint] for joint in kept),
        tuple(tree.joint_bodies[joint] for joint in kept),
    )
    rows = {
        "joint": kept,
        "speed": _numbers(tree.v_start, SPEEDS, tree, kept),
        "coordinate": _numbers(tree.q_start, COORDINATES, tree, kept),
    }
    leaves = {leaf: getattr(model, leaf)[np.array(rows[of], int)] for of, names in _LEAVES.items() for leaf in names}
    same = {leaf: getattr(model, leaf) for leaf in ("gravity", "mass", "com", "central_inertia")}
    return Model(tree=fewer, body_position=position, body_quaternion=quaternion, **same, **leaves)


_LEAVES = {
    "joint": ("joint_axis", "joint_anchor", "stiffness", "joint_range"),
    "speed": ("armature", "damping", "coulomb_friction", "friction_width"),
    "coordinate": ("spring_reference", "coordinate_reference"),
}


def _placed(model: Model, q: np.ndarray, bodies: list[int]) -> tuple[jax.Array, jax.Array]:
    """Positions and quaternions of all bodies in their parents, those of some as they are at coordinates."""
    position, quaternion = np.array(model.body_position), np.array(model.body_quaternion)
    found = poses(model, jnp.asarray(q, model.dtype))
    rotation = np.concatenate((np.asarray(found.rotation), np.eye(3)[None]))
    origin = np.concatenate((np.asarray(found.origin), np.zeros((1, 3))))
    for body in bodies:
        # The world is the last row.
        parent = model.tree.body_parents[body]
        position[body] = rotation[parent].T @ (origin[body] - origin[parent])
        quaternion[body] = quaternion_of(rotation[parent].T @ rotation[body])
    return jnp.asarray(position), jnp.asarray(quaternion)


def _numbers(starts: tuple[int, ...], sizes: Mapping[str, int], tree: Tree, joints: list[int]) -> list[int]:
    return [starts[joint] + i for joint in joints for i in range(sizes[tree.joint_types[joint]])]
