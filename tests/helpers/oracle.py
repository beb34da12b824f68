"""What MuJoCo says of a state."""

from typing import NamedTuple

import mujoco
import numpy as np


class Answer(NamedTuple):
    inverse: np.ndarray
    forward: np.ndarray
    mass_matrix: np.ndarray
    bias: np.ndarray
    passive: np.ndarray
    com: np.ndarray
    rotation: np.ndarray
    jacobian_com: np.ndarray
    jacobian_rotation: np.ndarray
    kinetic: float
    potential: float
    momentum: np.ndarray
    angular_momentum: np.ndarray


def ask(mj: mujoco.MjModel, q, u, u_dot, tau, wrench=None) -> Answer:
    """MuJoCo's results at one state; `wrench` is (nbody, 6): force, then torque, at the mass centres."""
    data = mujoco.MjData(mj)
    data.qpos, data.qvel, data.qfrc_applied = q, u, tau
    if wrench is not None:
        data.xfrc_applied[1:] = wrench
    mujoco.mj_forward(mj, data)
    forward, passive, bias = data.qacc.copy(), data.qfrc_passive.copy(), data.qfrc_bias.copy()
    full = np.zeros((mj.nv, mj.nv))
    mujoco.mj_fullM(mj, data, full)
    mujoco.mj_subtreeVel(mj, data)
    positions, rotations = [], []
    for body in range(1, mj.nbody):
        position, rotation = np.zeros((3, mj.nv)), np.zeros((3, mj.nv))
        mujoco.mj_jacBodyCom(mj, data, position, rotation, body)
        positions.append(position.T)
        rotations.append(rotation.T)
    total = mj.body_subtreemass[0]
    answer = Answer(
        np.zeros(mj.nv), forward, full, bias, passive, data.xipos[1:].copy(), data.xmat[1:].reshape(-1, 3, 3).copy(),
        np.array(positions), np.array(rotations), float(data.energy[1]), float(data.energy[0]),
        data.subtree_linvel[0] * total, data.subtree_angmom[0].copy(),
    )  # fmt: skip
    data.xfrc_applied[:], data.qfrc_applied[:], data.qacc = 0, 0, u_dot
    mujoco.mj_inverse(mj, data)
    return answer._replace(inverse=data.qfrc_inverse.copy())
