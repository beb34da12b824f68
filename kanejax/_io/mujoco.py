"""From MuJoCo's objects to a Model."""

import mujoco

from kanejax._errors import IgnoredFeatureWarning, UnsupportedModelError, warn_caller
from kanejax._io.check import check_model
from kanejax._io.convert import model_from_compiled
from kanejax._io.flags import with_flags_applied
from kanejax._io.load import load
from kanejax._io.unsupported import refused_features
from kanejax._model.model import Model


def from_mujoco(mj: mujoco.MjModel | mujoco.MjSpec, *, strict: bool = True, allow_unphysical: bool = False) -> Model:
    """Convert a compiled MuJoCo model or a spec, so that qpos and qvel of MuJoCo are q and u here.

    Leaves are float64 if `jax_enable_x64` is set, otherwise float32. Bodies and joints keep their names; unnamed ones are
    called "body3" or "joint5" after their numbers in MuJoCo, where the world is body 0. Friction loss becomes Coulomb
    friction with a friction_width of 0.01 rad/s or m/s. A spec is compiled without fusing static bodies, so it may have
    more bodies than its own `compile()` gives.

    Args:
        mj: the model or spec; it is not changed.
        strict: refuse features that change the equations of motion and are not modelled; otherwise warn of them.
        allow_unphysical: keep inertias that no rigid body can have, with an UnphysicalInertiaWarning.

    Returns:
        The model.

    Raises:
        UnsupportedModelError: a feature that changes the equations of motion is not modelled, and `strict` is set.
        InvalidInertiaError: a moving body has an inertia that no rigid body can have, or a joint moves no inertia.
        InvalidParameterError: a number is not finite.
    """
    if isinstance(mj, mujoco.MjSpec):
        return load(mj, strict=strict, allow_unphysical=allow_unphysical)
    if not isinstance(mj, mujoco.MjModel):
        raise TypeError(f"from_mujoco takes an MjModel or an MjSpec, got {type(mj).__name__}; use load for paths and XML")
    applied = with_flags_applied(mj)
    refused = refused_features(applied)
    if refused and strict:
        raise UnsupportedModelError(f"MjModel: {'; '.join(refused)}. Remove it, or pass strict=False to ignore it")
    if refused:
        warn_caller(f"MjModel: ignored, though it changes the dynamics: {'; '.join(refused)}", IgnoredFeatureWarning)
    model = model_from_compiled(applied)
    check_model(model, allow_unphysical=allow_unphysical)
    return model
