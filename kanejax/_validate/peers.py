"""The quantities that are compared, from this library and from its peers.

Each function returns arrays by quantity: (samples, nv), and (samples, nv, nv) for the mass matrix.
"""

import copy
import importlib
import math
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from kanejax._dynamics.equations_of_motion import bias_force, forward_dynamics, inverse_dynamics, mass_matrix
from kanejax._errors import UnsupportedModelError
from kanejax._model.model import Model
from kanejax._model.tree import Tree
from kanejax._validate.report import QUANTITIES
from kanejax._validate.states import States

# Terms of MuJoCo's smooth dynamics that this library does not model.
_NOT_MODELLED = {
    "body": ("gravcomp",),
    "jnt": ("stiffnesspoly",),
    "dof": ("dampingpoly",),
    "tendon": ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature", "frictionloss"),
    "actuator": ("armature", "damping", "dampingpoly"),
}


def own_terms(model: Model, states: States, dtype: str) -> dict[str, np.ndarray]:
    """This library's numbers in a data type; float64 needs `jax.enable_x64`."""
    found = _terms(model.astype(dtype), *(jnp.asarray(x, dtype) for x in states))
    return {name: np.asarray(found[name], np.float64) for name in QUANTITIES}


@jax.jit
def _terms(model: Model, q: jax.Array, u: jax.Array, u_dot: jax.Array, tau: jax.Array) -> dict[str, jax.Array]:
    """All at many states, in one program, which compiles faster than four."""
    return {
        "inverse dynamics": jax.vmap(inverse_dynamics, (None, 0, 0, 0))(model, q, u, u_dot),
        "forward dynamics": jax.vmap(forward_dynamics, (None, 0, 0, 0))(model, q, u, tau),
        "mass matrix": jax.vmap(mass_matrix, (None, 0))(model, q),
        "bias force": jax.vmap(bias_force, (None, 0, 0))(model, q, u),
    }


def without_constraints(mj_model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy that has nothing but the smooth dynamics which this library models."""
    smooth = copy.copy(mj_model)
    bits = mujoco.mjtDisableBit
    smooth.opt.disableflags |= int(bits.mjDSBL_CONSTRAINT | bits.mjDSBL_ACTUATION | bits.mjDSBL_SENSOR)
    smooth.opt.enableflags = 0
    smooth.opt.density = smooth.opt.viscosity = 0.0
    for owner, terms in _NOT_MODELLED.items():
        for term in terms:
            getattr(smooth, f"{owner}_{term}")[:] = 0
    return smooth


def mujoco_terms(mj_model: mujoco.MjModel, states: States) -> dict[str, np.ndarray]:
    """MuJoCo's qfrc_inverse, qacc, full M and qfrc_bias; `mj_model` must be without constraints."""
    data, expected = mujoco.MjData(mj_model), _empty(*states.u.shape)
    for i, (q, u, u_dot, tau) in enumerate(zip(*states, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:], data.qfrc_applied[:] = q, u, u_dot, tau
        mujoco.mj_inverse(mj_model, data)
        expected["inverse dynamics"][i] = data.qfrc_inverse
        mujoco.mj_forward(mj_model, data)
        expected["forward dynamics"][i], expected["bias force"][i] = data.qacc, data.qfrc_bias
        mujoco.mj_fullM(mj_model, data, expected["mass matrix"][i])
    return expected


def pinocchio_terms(model: Model, urdf: str, states: States) -> dict[str, np.ndarray]:
    """Pinocchio's rnea, aba, crba and nle, from its own reading of the URDF's text.

    Raises:
        UnsupportedModelError: a joint of the model has another type or name in Pinocchio.
        ModuleNotFoundError: `pin` is not installed.
    """
    try:
        pin = importlib.import_module("pinocchio")
    except ModuleNotFoundError as error:
        remedy = "against='pinocchio' needs the package pin: pip install pin"
        raise ModuleNotFoundError(remedy, name="pinocchio") from error
    peer = pin.buildModelFromXML(urdf)
    peer.gravity.linear = np.asarray(model.gravity)
    data, expected = peer.createData(), _empty(*states.u.shape)
    joints = _pinocchio_joints(peer, model.tree)
    order = np.array([joint.idx_v for joint in joints])
    for i in range(len(states.u)):
        q, (u, u_dot, tau) = np.empty(peer.nq), np.empty((3, peer.nv))
        u[order], u_dot[order], tau[order] = states.u[i], states.u_dot[i], states.tau[i]
        for joint, angle in zip(joints, states.q[i], strict=True):
            # Pinocchio describes joints without limits by cosine and sine.
            q[joint.idx_q : joint.idx_q + joint.nq] = angle if joint.nq == 1 else (math.cos(angle), math.sin(angle))
        expected["inverse dynamics"][i] = pin.rnea(peer, data, q, u, u_dot)[order]
        expected["bias force"][i] = pin.nle(peer, data, q, u)[order]
        upper = np.triu(pin.crba(peer, data, q))
        expected["mass matrix"][i] = (upper + np.triu(upper, 1).T)[np.ix_(order, order)]
        expected["forward dynamics"][i] = pin.aba(peer, data, q, u, tau)[order]
    return expected


def _pinocchio_joints(peer: Any, tree: Tree) -> list[Any]:
    """Pinocchio's joints in the order of ours, by name."""
    joints = []
    for name, kind in zip(tree.joint_names, tree.joint_types, strict=True):
        if kind not in ("revolute", "prismatic") or not peer.existJointName(name):
            raise UnsupportedModelError(f"joint {name!r}, {kind}, has another type or name in Pinocchio")
        joints.append(peer.joints[peer.getJointId(name)])
    if peer.nv != tree.nv:
        raise UnsupportedModelError(f"Pinocchio reads {peer.nv} speeds in this URDF, this library {tree.nv}")
    return joints


def _empty(samples: int, nv: int) -> dict[str, np.ndarray]:
    shapes = {name: (samples, nv, nv) if name == "mass matrix" else (samples, nv) for name in QUANTITIES}
    return {name: np.empty(shape) for name, shape in shapes.items()}
