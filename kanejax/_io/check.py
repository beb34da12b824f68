"""Checking the numbers of a model, by name.

A model's constructor checks shapes only, because it must work while JAX traces it. What the loaders return has been
checked; call `check_model` after changing a model by hand, outside of `jax.jit`.
"""

import numpy as np

from kanejax._errors import InvalidInertiaError, InvalidParameterError, UnphysicalInertiaWarning, warn_caller
from kanejax._io.idle_joints import check_joints_move_inertia
from kanejax._io.inertial import defect
from kanejax._model.model import Model, leaf_shapes
from kanejax._model.tree import COORDINATES, WORLD, Tree

# Speed, in rad/s or m/s, over which Coulomb friction builds up in a model from a file or table, which have no such number.
DEFAULT_FRICTION_WIDTH = 0.01
# The square of a length, times a mass, of this size is still a number.
LARGEST_NUMBER = 1e100
_OF_BODIES = ("body_position", "body_quaternion", "mass", "com", "central_inertia")
_OF_COORDINATES = ("spring_reference", "coordinate_reference")
_OF_SPEEDS = ("armature", "damping", "coulomb_friction", "friction_width")


def check_model(model: Model, *, allow_unphysical: bool = False) -> None:
    """Check that every number of a model is one that a mechanism can have.

    Args:
        model: a model without batch axes, and outside of `jax.jit`: its numbers must be known.
        allow_unphysical: only warn of inertias that no rigid body can have, with UnphysicalInertiaWarning.

    Raises:
        ValueError: a leaf has the wrong shape, such as a batch axis.
        InvalidParameterError: a number is not finite or exceeds 1e100, an axis or quaternion is zero, a friction_width is not
            positive, an armature is negative, or a range is empty.
        InvalidInertiaError: a moving body has a negative mass or principal moments that break A + B >= C, or a joint at
            the end of the tree moves no inertia, which makes the mass matrix singular.
    """
    check_numbers(model)
    _check_inertias(model, allow_unphysical)
    check_joints_move_inertia(model)


def check_numbers(model: Model) -> None:
    """Check shapes and everything but the inertias; raises as `check_model` does."""
    model.__check_init__()
    tree = model.tree
    for name in leaf_shapes(tree):
        values = np.asarray(getattr(model, name))
        # Ranges may be infinite.
        bad = np.isnan(values) if name == "joint_range" else ~np.isfinite(values)
        _refuse(tree, name, values, bad, "is not finite")
        if name != "joint_range":
            _refuse(
                tree,
                name,
                values,
                np.abs(values.astype(float)) > LARGEST_NUMBER,
                f"is too large: at most {LARGEST_NUMBER:g} can be computed with",
            )
    axes, axial = np.asarray(model.joint_axis), np.array([COORDINATES[kind] == 1 for kind in tree.joint_types], bool)
    _refuse(tree, "joint_axis", axes, axial & ~axes.any(axis=1), "is zero; give a direction")
    quaternions = np.asarray(model.body_quaternion)
    _refuse(tree, "body_quaternion", quaternions, ~quaternions.any(axis=1), "is zero; no rotation is 1, 0, 0, 0")
    _check_spring_quaternions(model)
    width, armature, ranges = (np.asarray(leaf) for leaf in (model.friction_width, model.armature, model.joint_range))
    _refuse(tree, "friction_width", width, width <= 0, f"is not positive; it is a speed, such as {DEFAULT_FRICTION_WIDTH}")
    _refuse(tree, "armature", armature, armature < 0, "is negative")
    _refuse(tree, "joint_range", ranges, ranges[:, 0] > ranges[:, 1], "is empty: its first number must be the lesser")


def _check_spring_quaternions(model: Model) -> None:
    for joint, (kind, start) in enumerate(zip(model.tree.joint_types, model.tree.q_start, strict=True)):
        end = start + COORDINATES[kind]
        if kind in ("ball", "free") and model.stiffness[joint] and not np.any(model.spring_reference[end - 4 : end]):
            name = model.tree.joint_names[joint]
            raise InvalidParameterError(f"joint {name!r}: the quaternion in spring_reference is zero; no rotation is 1, 0, 0, 0")


def _refuse(tree: Tree, leaf: str, values: np.ndarray, bad: np.ndarray, problem: str) -> None:
    """Raise InvalidParameterError for the first row of a leaf that has a bad element."""
    rows = np.flatnonzero(bad.any(axis=tuple(range(1, bad.ndim))))
    if rows.size:
        row = int(rows[0])
        owner = "" if leaf == "gravity" else _owner(tree, leaf, row) + ": "
        value = values if leaf == "gravity" else values[row]
        raise InvalidParameterError(f"{owner}{leaf} = {' '.join(f'{number:.6g}' for number in np.ravel(value))} {problem}")


def _owner(tree: Tree, leaf: str, row: int) -> str:
    if leaf in _OF_BODIES:
        return f"body {tree.body_names[row]!r}"
    joint = row
    if leaf in _OF_SPEEDS:
        joint = int(tree.speed_joints[row])
    elif leaf in _OF_COORDINATES:
        joint = int(np.searchsorted(tree.q_start, row, side="right")) - 1
    return f"joint {tree.joint_names[joint]!r}"


def _check_inertias(model: Model, allow_unphysical: bool) -> None:
    """Compare masses and principal moments of the bodies that move with what a rigid body can have."""
    mass, inertia = np.asarray(model.mass, float), np.asarray(model.central_inertia, float)
    symmetric = 0.5 * (inertia + inertia.swapaxes(1, 2))
    problems = []
    for body, (name, link) in enumerate(zip(model.tree.body_names, model.tree.body_links, strict=True)):
        problem = None if link == WORLD else defect(float(mass[body]), np.linalg.eigvalsh(symmetric[body]))
        if problem:
            problems.append(f"body {name!r}: {problem}")
    if problems and not allow_unphysical:
        remedy = "Correct it, or pass allow_unphysical=True to keep it"
        raise InvalidInertiaError(f"{'; '.join(problems)}. {remedy}")
    for problem in problems:
        warn_caller(f"{problem}; kept as it is", UnphysicalInertiaWarning)
