"""MuJoCo's option flags that switch off a modelled term, carried out on the numbers of the term."""

import copy

import mujoco


def with_flags_applied(mj_model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a model with the same smooth dynamics whose flags switch off no gravity, spring, damper or friction loss.

    Where such a flag is set, a copy is returned with the flag cleared and the numbers it switches off set to zero.
    """
    bits = mujoco.mjtDisableBit
    zeroed_by = (
        (bits.mjDSBL_GRAVITY, lambda model: model.opt.gravity),
        (bits.mjDSBL_SPRING, lambda model: model.jnt_stiffness),
        (bits.mjDSBL_SPRING, lambda model: model.jnt_stiffnesspoly),
        (bits.mjDSBL_DAMPER, lambda model: model.dof_damping),
        (bits.mjDSBL_DAMPER, lambda model: model.dof_dampingpoly),
        (bits.mjDSBL_FRICTIONLOSS, lambda model: model.dof_frictionloss),
        (bits.mjDSBL_CONSTRAINT, lambda model: model.dof_frictionloss),
    )
    flags = mj_model.opt.disableflags
    if not any(flags & bit for bit, _ in zeroed_by):
        return mj_model
    applied = copy.copy(mj_model)
    for bit, term in zeroed_by:
        if flags & bit:
            term(applied)[:] = 0
    # The flag for all constraints stays: it also switches off equality constraints.
    for bit in (bits.mjDSBL_GRAVITY, bits.mjDSBL_SPRING, bits.mjDSBL_DAMPER, bits.mjDSBL_FRICTIONLOSS):
        applied.opt.disableflags &= ~int(bit)
    return applied
