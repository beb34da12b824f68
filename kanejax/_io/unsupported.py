"""The features of a compiled MuJoCo model that the library does not model, each as a sentence that names them.

`refused_features` lists what enters MuJoCo's mass matrix, bias force or passive force, or constrains the coordinates:
a model that has any would give other numbers here. `unmodelled_features` lists what never enters those terms: forces
from outside (contacts, actuators), limits, and things that only look or measure.

Modelled, hence in neither list: gravity, hinge, slide, ball and free joints, armature, linear damping, linear
stiffness, friction loss of joints. Joint limits are in neither list because a simulation can treat them as events.
"""

import mujoco
import numpy as np


def refused_features(mj_model: mujoco.MjModel) -> list[str]:
    """List the features that change the equations of motion and are not modelled, one sentence each."""
    return [
        *_refused_options(mj_model),
        *_refused_bodies(mj_model),
        *_refused_joints(mj_model),
        *_refused_constraints(mj_model),
        *_refused_actuators(mj_model),
    ]


def unmodelled_features(mj_model: mujoco.MjModel) -> list[str]:
    """List the features that are ignored because they are no part of the smooth dynamics, one sentence each."""
    colliding = (mj_model.geom_contype != 0) | (mj_model.geom_conaffinity != 0)
    counted = (
        (int(colliding.sum()), "contacts, with their friction and adhesion, are not modelled ({} geoms can collide)"),
        (mj_model.npair, "contact pairs are not modelled ({})"),
        (mj_model.nactuator, "actuators are not modelled ({}): give their generalized forces as tau"),
        (int(mj_model.jnt_actfrclimited.sum()), "tau is not clamped to actuator force ranges ({} joints have one)"),
        (int(mj_model.tendon_limited.sum()), "tendon length limits are not enforced ({})"),
        (int((mj_model.eq_active0 == 0).sum()), "equality constraints that start inactive stay inactive ({})"),
        (len(_mocap_bodies(mj_model, moving=False)), "mocap bodies stay where the model puts them ({})"),
        (mj_model.nsensor, "sensors are not computed ({})"),
        (_limited_ball_joints(mj_model), "ranges of ball joints are not read ({})"),
        (mj_model.nkey, "keyframes are not read ({})"),
        (mj_model.nskin, "skins are not read ({})"),
    )
    return [text.format(count) for count, text in counted if count]


def _limited_ball_joints(mj_model: mujoco.MjModel) -> int:
    return int(np.sum((mj_model.jnt_type == mujoco.mjtJoint.mjJNT_BALL) & (mj_model.jnt_limited != 0)))


def _refused_options(mj_model: mujoco.MjModel) -> list[str]:
    features = []
    if mj_model.opt.density or mj_model.opt.viscosity:
        features.append(
            f"fluid forces (option density={mj_model.opt.density:g}, viscosity={mj_model.opt.viscosity:g}, "
            f"wind={_numbers(mj_model.opt.wind)}) are not modelled: set density and viscosity to 0"
        )
    # A flag that switches off a modelled term matters only where the model has that term.
    bits = mujoco.mjtDisableBit
    switches = (
        (bits.mjDSBL_GRAVITY, "gravity", "option gravity", mj_model.opt.gravity),
        (bits.mjDSBL_SPRING, "spring", "the joints' stiffness", mj_model.jnt_stiffness),
        (bits.mjDSBL_DAMPER, "damper", "the joints' damping", mj_model.dof_damping),
        (bits.mjDSBL_FRICTIONLOSS, "frictionloss", "the joints' frictionloss", mj_model.dof_frictionloss),
        (bits.mjDSBL_CONSTRAINT, "constraint", "the joints' frictionloss", mj_model.dof_frictionloss),
    )
    for bit, flag, quantity, values in switches:
        if mj_model.opt.disableflags & bit and np.any(values):
            features.append(f"option flag {flag}='disable' is not modelled: set {quantity} to 0 instead")
    return features


def _refused_bodies(mj_model: mujoco.MjModel) -> list[str]:
    compensated = np.flatnonzero(mj_model.body_gravcomp)
    with_plugin = np.flatnonzero(mj_model.body_plugin >= 0)
    mocap = _mocap_bodies(mj_model, moving=True)
    features = []
    if compensated.size:
        features.append(f"gravity compensation (gravcomp) of {_named(mj_model, 'body', compensated)} is not modelled")
    if with_plugin.size:
        features.append(f"the passive force plugin of {_named(mj_model, 'body', with_plugin)} is not modelled")
    if mocap:
        features.append(f"{_named(mj_model, 'body', mocap)} is a mocap body that carries moving bodies")
    if mj_model.nflex:
        features.append(f"{mj_model.nflex} flex: deformable bodies are not modelled")
    return features


def _refused_joints(mj_model: mujoco.MjModel) -> list[str]:
    stiffening = _rows_with_values(mj_model.jnt_stiffnesspoly)
    yielding = _rows_with_values(mj_model.jnt_springyield)
    nonlinear = _rows_with_values(mj_model.dof_dampingpoly)
    damped = np.unique(mj_model.dof_jntid[nonlinear])
    features = []
    if stiffening.size:
        features.append(f"polynomial stiffness of {_named(mj_model, 'joint', stiffening)} is not modelled")
    if damped.size:
        features.append(f"polynomial damping of {_named(mj_model, 'joint', damped)} is not modelled")
    if yielding.size:
        features.append(f"plastic springs (springyield) of {_named(mj_model, 'joint', yielding)} are not modelled")
    return features


def _refused_constraints(mj_model: mujoco.MjModel) -> list[str]:
    disabled = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_EQUALITY
    active = np.flatnonzero(mj_model.eq_active0) if not mj_model.opt.disableflags & disabled else np.empty(0, int)
    features = []
    if active.size:
        kinds = sorted({mujoco.mjtEq(mj_model.eq_type[index]).name.removeprefix("mjEQ_").lower() for index in active})
        names = _named(mj_model, "equality", active, kind="")
        features.append(f"equality constraints ({', '.join(kinds)}) {names} are not modelled")
    properties = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature", "frictionloss", "springyield")
    for name in properties:
        affected = _rows_with_values(getattr(mj_model, f"tendon_{name}"))
        if affected.size:
            features.append(f"{name} of {_named(mj_model, 'tendon', affected)} is not modelled")
    return features


def _refused_actuators(mj_model: mujoco.MjModel) -> list[str]:
    features = []
    for name in ("armature", "damping", "dampingpoly"):
        affected = _rows_with_values(getattr(mj_model, f"actuator_{name}"))
        if affected.size:
            remedy = "" if name == "dampingpoly" else f": give the joint its {name} instead"
            features.append(f"{name} of {_named(mj_model, 'actuator', affected)} is not modelled{remedy}")
    return features


def _mocap_bodies(mj_model: mujoco.MjModel, *, moving: bool) -> list[int]:
    """Return the mocap bodies that do (`moving`) or do not carry bodies with joints."""
    carriers = set()
    for body in range(1, mj_model.nbody):
        if mj_model.body_jntnum[body]:
            carriers.add(int(mj_model.body_rootid[body]))
    return [int(body) for body in np.flatnonzero(mj_model.body_mocapid >= 0) if (int(body) in carriers) == moving]


def _rows_with_values(values: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.any(values, axis=tuple(range(1, values.ndim))))


def _named(mj_model: mujoco.MjModel, accessor: str, indices: np.ndarray | list[int], kind: str | None = None) -> str:
    """Return for instance "body 'a', 'b'"; unnamed elements go by number, and a long list is cut."""
    names = [getattr(mj_model, accessor)(int(index)).name or f"number {int(index)}" for index in indices]
    listed = ", ".join(repr(name) for name in names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    return f"{accessor if kind is None else kind} {listed}".strip()


def _numbers(values: np.ndarray) -> str:
    return "'" + " ".join(f"{value:g}" for value in values) + "'"
