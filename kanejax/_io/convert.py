"""From the numbers of a compiled MuJoCo model to a Model."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from kanejax._io.check import DEFAULT_FRICTION_WIDTH
from kanejax._io.repair import inertial_of
from kanejax._model.model import Model
from kanejax._model.tree import COORDINATES, JointType, Tree

# MuJoCo's numbers of the joint types.
_JOINT_TYPES: tuple[JointType, ...] = ("free", "ball", "prismatic", "revolute")


def model_from_compiled(mj_model: mujoco.MjModel) -> Model:
    """Read the numbers of a compiled model; nothing is checked and no option flag is carried out."""
    tree = _tree(mj_model)
    inertials = [inertial_of(mj_model, body) for body in range(1, mj_model.nbody)]
    # MuJoCo puts the mass centre of a body without mass anywhere, such as at its place in the parent.
    coms = [inertial.com if inertial.mass else np.zeros(3) for inertial in inertials]
    dtype = jax.dtypes.canonicalize_dtype(float)

    def leaf(values: object, *shape: int) -> jax.Array:
        return jnp.asarray(np.asarray(values, float).reshape(shape), dtype)

    nbody, njoint, nq, nv = tree.nbody, tree.njoint, tree.nq, tree.nv
    return Model(
        tree=tree,
        gravity=leaf(mj_model.opt.gravity, 3),
        body_position=leaf(mj_model.body_pos[1:], nbody, 3),
        body_quaternion=leaf(mj_model.body_quat[1:], nbody, 4),
        joint_axis=leaf(mj_model.jnt_axis, njoint, 3),
        joint_anchor=leaf(mj_model.jnt_pos, njoint, 3),
        mass=leaf(mj_model.body_mass[1:], nbody),
        com=leaf(coms, nbody, 3),
        central_inertia=leaf([inertial.central_inertia for inertial in inertials], nbody, 3, 3),
        armature=leaf(mj_model.dof_armature, nv),
        damping=leaf(_linear_part(mj_model.dof_damping), nv),
        stiffness=leaf(_linear_part(mj_model.jnt_stiffness), njoint),
        spring_reference=leaf(mj_model.qpos_spring, nq),
        coordinate_reference=leaf(mj_model.qpos0, nq),
        coulomb_friction=leaf(mj_model.dof_frictionloss, nv),
        friction_width=leaf(np.full(nv, DEFAULT_FRICTION_WIDTH), nv),
        joint_range=leaf(_joint_range(mj_model, tree), njoint, 2),
    )


def _tree(mj_model: mujoco.MjModel) -> Tree:
    return Tree(
        body_names=_unique_names("body", [mj_model.body(body).name for body in range(1, mj_model.nbody)], first=1),
        # MuJoCo's body 0 is the world, which is -1 here.
        body_parents=tuple(int(parent) - 1 for parent in mj_model.body_parentid[1:]),
        joint_names=_unique_names("joint", [mj_model.joint(joint).name for joint in range(mj_model.njnt)], first=0),
        joint_types=tuple(_JOINT_TYPES[kind] for kind in mj_model.jnt_type),
        joint_bodies=tuple(int(body) - 1 for body in mj_model.jnt_bodyid),
    )


def _unique_names(label: str, names: list[str], first: int) -> tuple[str, ...]:
    """Name what has no name by its number in MuJoCo, `first` being that of the first: "body3", or "body3_2" if taken."""
    used = set(names)
    unique = []
    for number, given in enumerate(names, start=first):
        name, attempt = given or f"{label}{number}", 1
        while not given and name in used:
            attempt += 1
            name = f"{label}{number}_{attempt}"
        used.add(name)
        unique.append(name)
    return tuple(unique)


def _joint_range(mj_model: mujoco.MjModel, tree: Tree) -> np.ndarray:
    """Range of each joint, infinite where it is not limited and for joints whose coordinates have no order."""
    axial = np.array([COORDINATES[kind] == 1 for kind in tree.joint_types], bool)
    limited = np.asarray(mj_model.jnt_limited, bool) & axial
    return np.where(limited[:, None], mj_model.jnt_range, [-np.inf, np.inf])


def _linear_part(coefficients: np.ndarray) -> np.ndarray:
    """The linear coefficient, where a version of MuJoCo keeps it in one array with those of a polynomial."""
    return coefficients if coefficients.ndim == 1 else coefficients[:, 0]
