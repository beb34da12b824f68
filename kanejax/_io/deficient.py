"""Finding moving bodies with too little inertia: those that leave the mass matrix singular at general positions.

A massless link is no fault as long as massive bodies further out, or armature, give every joint something to move:
three hinges joined by massless links make a good ankle. So the test is on the mass matrix, at random positions, since
it may well be singular at special ones (gimbal lock).
"""

import copy

import mujoco
import numpy as np

from kanejax._errors import InvalidInertiaError
from kanejax._io.inertial import REPAIR_MASS, REPAIR_RADIUS

# Smallest eigenvalue of the mass matrix scaled to unit diagonal that counts as regular, and smallest diagonal element.
_SMALLEST_EIGENVALUE, _SMALLEST_DIAGONAL = 1e-12, 1e-14
_POSITIONS = 3
# How many passes are made, times the number of speeds.
_PASSES_OF_ALL_SPEEDS = 3_000


def deficient_bodies(mj_model: mujoco.MjModel) -> tuple[list[int], bool]:
    """Return the bodies that need inertia for a regular mass matrix, and whether these are all; none where it is regular.

    In a large model with many of them the search ends early.
    """
    trial = copy.copy(mj_model)
    deficient: list[int] = []
    passes = max(_PASSES_OF_ALL_SPEEDS // max(mj_model.nv, 1), 3)
    # Each pass strengthens at least one more body, so the passes end.
    while (dof := _idle_dof(trial)) is not None:
        if not passes:
            return sorted(deficient), False
        passes -= 1
        bodies = [body for body in _massless_outwards(trial) if body not in deficient] or [_weakest(trial, dof)]
        for body in bodies:
            strengthened(trial, body)
        if set(bodies) <= set(deficient):
            break
        deficient += [body for body in bodies if body not in deficient]
    return sorted(deficient), True


def strengthened(mj_model: mujoco.MjModel, body: int) -> None:
    """Give a body of `mj_model`, in place, the repair mass if it has none, and the repair inertia on top of its own."""
    if mj_model.body_mass[body] <= 0:
        mj_model.body_mass[body] = REPAIR_MASS
    mj_model.body_inertia[body] += mj_model.body_mass[body] * REPAIR_RADIUS**2


def is_regular(mj_model: mujoco.MjModel) -> bool:
    """Return whether the mass matrix is regular at the reference position."""
    return mj_model.nv == 0 or _null_direction(_mass_matrix(mj_model, mj_model.qpos0)) is None


def _massless_outwards(mj_model: mujoco.MjModel) -> list[int]:
    """Return the bodies with joints that carry no mass and no inertia at all from there to the tips of the tree."""
    content = mj_model.body_mass + np.abs(mj_model.body_inertia).sum(axis=1)
    for body in range(mj_model.nbody - 1, 0, -1):
        content[mj_model.body_parentid[body]] += content[body]
    return [body for body in range(1, mj_model.nbody) if mj_model.body_jntnum[body] and content[body] == 0]


def _idle_dof(mj_model: mujoco.MjModel) -> np.ndarray | None:
    """Return a direction in joint space that moves no mass at any of a few random positions, or None."""
    if mj_model.nv == 0:
        return None
    random = np.random.default_rng(0)
    direction = None
    for _ in range(_POSITIONS):
        qpos = mj_model.qpos0.copy()
        mujoco.mj_integratePos(mj_model, qpos, random.uniform(-1, 1, mj_model.nv), 1.0)
        direction = _null_direction(_mass_matrix(mj_model, qpos))
        if direction is None:
            return None
    return direction


def _mass_matrix(mj_model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    mj_data = mujoco.MjData(mj_model)
    mj_data.qpos[:] = qpos
    mujoco.mj_kinematics(mj_model, mj_data)
    mujoco.mj_comPos(mj_model, mj_data)
    mujoco.mj_crb(mj_model, mj_data)
    mass_matrix = np.zeros((mj_model.nv, mj_model.nv))
    mujoco.mj_fullM(mj_model, mj_data, mass_matrix)
    if not np.all(np.isfinite(mass_matrix)):
        raise InvalidInertiaError("the mass matrix is not finite: a mass, an inertia or a position is too large; correct the file")
    return mass_matrix


def _null_direction(mass_matrix: np.ndarray) -> np.ndarray | None:
    """Return joint speeds, of norm 1, to which a mass matrix gives no kinetic energy or a negative one, or None."""
    diagonal = np.diag(mass_matrix)
    if diagonal.min() < _SMALLEST_DIAGONAL:
        return np.eye(len(diagonal))[np.argmin(diagonal)]
    scale = 1 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(mass_matrix * np.outer(scale, scale))
    return vectors[:, 0] if values[0] < _SMALLEST_EIGENVALUE else None


def _weakest(mj_model: mujoco.MjModel, direction: np.ndarray) -> int:
    """Return the body with the least inertia, the outermost of equals, whose joints take part in a direction."""
    taking_part = np.flatnonzero(np.abs(direction) > 0.3 * np.abs(direction).max())
    content = np.zeros(mj_model.nbody)
    np.add.at(content, mj_model.body_weldid, mj_model.body_inertia.sum(axis=1))
    bodies = sorted({int(mj_model.dof_bodyid[dof]) for dof in taking_part}, reverse=True)
    return min(bodies, key=lambda body: content[body])
