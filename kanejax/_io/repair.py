"""Compiling a spec with the inertias that its file states, also those that MuJoCo's compiler refuses.

MuJoCo 4.0.0 refuses every moving body of mass or principal moment below 1e-15 that has no massive body welded to it,
every full inertia with an eigenvalue below 1e-14, and every violation of the triangle inequality, however small; a
negative mass it silently raises to zero. Some of those are sound models: massless links between the axes of a
spherical joint, thin rods, rounded decimals. So a body that MuJoCo would refuse is compiled with a placeholder that
has the same inertial frame, and the true numbers are written into the compiled model afterwards; the frame has to
stay, as MuJoCo precomputes shortcuts from it. What cannot be true of a rigid body is refused here, by name, unless the
caller asks for repair or takes it as it is.
"""

import dataclasses

import mujoco
import numpy as np

from kanejax._errors import InvalidInertiaError, UnphysicalInertiaWarning, UnsupportedModelError, warn_caller
from kanejax._io.assets import bodies_and_motion, compiled, takes_inertia_from_geoms
from kanejax._io.bounds import balanced_body, bounded_bodies, stated_numbers
from kanejax._io.check import LARGEST_NUMBER
from kanejax._io.deficient import deficient_bodies, is_regular, strengthened
from kanejax._io.inertial import (
    REPAIR_MASS,
    Inertial,
    defect,
    described_moments,
    nearest_physical_moments,
)

# What MuJoCo's compiler asks for: mjMINVAL of a jointed body, mjEPS of the eigenvalues of a full inertia.
_SMALLEST_JOINTED, _SMALLEST_FULL_INERTIA = 1e-15, 1e-14
# Smallest mass and second moment of a placeholder: any that MuJoCo accepts would do.
_PLACEHOLDER_MASS, _PLACEHOLDER_MOMENT = 1e-3, 1e-9
_REMEDY = "correct the file, or load with repair=True to change it or allow_unphysical=True to keep it"


@dataclasses.dataclass(frozen=True)
class CompiledInertias:
    """A compiled model, the bodies that MuJoCo would have refused, and sentences on what was ignored or changed."""

    mj_model: mujoco.MjModel
    inertials: dict[int, Inertial]
    ignored: list[str]
    repaired: list[str]


@dataclasses.dataclass(frozen=True)
class _Stated:
    """What a spec says of a body: mass, principal moments, their axes, whether MuJoCo compiles that or balances it first."""

    mass: float
    moments: np.ndarray
    axes: np.ndarray | None
    accepted: bool
    balanced: bool


def compile_with_stated_inertias(spec: mujoco.MjSpec, origin: str, *, repair: bool, allow_unphysical: bool) -> CompiledInertias:
    """Compile `spec`, which is edited, with every stated inertia that can be kept; `origin` names the file in errors.

    Raises InvalidInertiaError for a moving body whose numbers no rigid body can have, or that leaves the mass matrix
    singular. With `repair` the numbers of all bodies are changed by the least that helps; with `allow_unphysical` they
    are kept with an UnphysicalInertiaWarning as long as the mass matrix stays regular.
    """
    substituted: dict[int, tuple[_Stated, float, np.ndarray]] = {}
    refused: list[str] = []
    ignored: list[str] = []
    repaired: list[str] = []
    bodies = bodies_and_motion(spec)
    written = stated_numbers(bodies)
    for index, (body, moves) in enumerate(bodies):
        if index == 0 or takes_inertia_from_geoms(body):
            continue
        label = f"body {body.name!r}" if body.name else f"body number {index}"
        stated = _stated(body, f"{origin}: {label}")
        problem = defect(stated.mass, stated.moments)
        if stated.balanced:
            repaired.append(balanced_body(label))
        if problem and repair:
            stated = _repaired(stated)
            repaired.append(f"{label}: {problem}; changed to {_described(stated.mass, stated.moments)}")
        elif problem and not moves:
            ignored.append(f"{label}: {problem}; it is welded to the world, so its inertia does not matter")
        elif problem and not allow_unphysical:
            refused.append(f"{label}: {problem}")
        elif problem:
            warn_caller(f"{origin}: {label}: {problem}; kept as it is", UnphysicalInertiaWarning)
        if not stated.accepted:
            substituted[index] = (stated, *_substitute(body, stated))
    if refused:
        raise InvalidInertiaError(f"{origin}: {'; '.join(refused)}. Either {_REMEDY}")
    if substituted:
        _check_nothing_derived(spec, origin)
    mj_model, warned = compiled(spec, origin)
    for index, (stated, placeholder_mass, placeholder_moments) in substituted.items():
        # The compiled placeholder differs from the one written only by a scale that the file asks for, if by any.
        mj_model.body_mass[index] = stated.mass * (mj_model.body_mass[index] / placeholder_mass)
        mj_model.body_inertia[index] = stated.moments * (mj_model.body_inertia[index] / placeholder_moments)
    repaired += bounded_bodies(mj_model, bodies, written)
    changed = _complete(mj_model, origin, repair, repaired) if any(bodies[index][1] for index in substituted) else []
    if substituted and is_regular(mj_model):
        mujoco.mj_setConst(mj_model, mujoco.MjData(mj_model))
    inertials = {index: inertial_of(mj_model, index) for index in sorted({*substituted, *changed})}
    return CompiledInertias(mj_model, inertials, warned + ignored, repaired)


def inertial_of(mj_model: mujoco.MjModel, body: int) -> Inertial:
    """Return the inertial numbers of a compiled body in body axes."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, mj_model.body_iquat[body])
    axes = rotation.reshape(3, 3)
    # Numbers that are too large for this are refused later, by name.
    with np.errstate(over="ignore", invalid="ignore"):
        central_inertia = axes @ np.diag(mj_model.body_inertia[body]) @ axes.T
    return Inertial(float(mj_model.body_mass[body]), mj_model.body_ipos[body].copy(), central_inertia)


def _stated(body: mujoco.MjsBody, label: str) -> _Stated:
    """Read a body's inertial; `axes` is None where the spec's inertial orientation already holds the principal axes."""
    mass, full = float(body.mass), np.array(body.fullinertia)
    if not np.all(np.abs([mass, *body.inertia, *full[1:]]) <= LARGEST_NUMBER):
        inertia = " ".join(f"{number:.6g}" for number in (body.inertia if np.isnan(full[0]) else full))
        raise InvalidInertiaError(
            f"{label}: mass {mass:.6g} kg or inertia {inertia} kg m^2 is not finite, or too large; correct the file"
        )
    axes, moments = None, np.array(body.inertia)
    smallest, rounding = (_SMALLEST_JOINTED if body.joints else 0.0), 0.0
    if not np.isnan(full[0]):
        moments, axes = np.linalg.eigh(full[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]])
        # MuJoCo's eigenvalues may differ from these by rounding.
        rounding = 1e-12 * np.abs(moments).max()
        smallest = _SMALLEST_FULL_INERTIA + rounding
    # The file itself can ask MuJoCo for these changes; what it asks for is what it states.
    compiler = body.compiler
    accepted = moments.min() >= smallest and mass >= (_SMALLEST_JOINTED if body.joints else 0.0)
    mass, moments = max(mass, compiler.boundmass or mass), np.maximum(moments, compiler.boundinertia or -np.inf)
    margin = moments.sum() / 2 - moments.max()
    balanced = bool(margin < 0 and compiler.balanceinertia)
    if balanced:
        moments, margin = np.full(3, moments.mean()), 0.0
    return _Stated(mass, moments, axes, bool(accepted and margin >= rounding), balanced)


def _repaired(stated: _Stated) -> _Stated:
    mass = stated.mass if stated.mass >= 0 else REPAIR_MASS
    return dataclasses.replace(stated, mass=mass, moments=nearest_physical_moments(stated.moments), accepted=False)


def _substitute(body: mujoco.MjsBody, stated: _Stated) -> tuple[float, np.ndarray]:
    """Give a body a mass and moments that MuJoCo compiles, with its own principal axes, and return them."""
    mass, moments = max(stated.mass, _PLACEHOLDER_MASS), nearest_physical_moments(stated.moments, _PLACEHOLDER_MOMENT)
    if np.isnan(body.ipos[0]):
        body.ipos, body.iquat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    if stated.axes is not None:
        axes = stated.axes if np.linalg.det(stated.axes) > 0 else -stated.axes
        principal, rotated = np.zeros(4), np.zeros(4)
        mujoco.mju_mat2Quat(principal, axes.ravel())
        mujoco.mju_mulQuat(rotated, np.array(body.iquat) / np.linalg.norm(body.iquat), principal)
        body.iquat, body.fullinertia = rotated, [np.nan, 0, 0, 0, 0, 0]
    body.mass, body.inertia, body.explicitinertial = mass, moments, True
    # For a body that it finds simple, MuJoCo would use the mass matrix of the placeholder.
    body.simple = 0
    return mass, moments


def _check_nothing_derived(spec: mujoco.MjSpec, origin: str) -> None:
    """Refuse numbers that MuJoCo would compute from the placeholders."""
    if spec.compiler.settotalmass > 0:
        raise UnsupportedModelError(f"{origin}: settotalmass needs inertias that MuJoCo compiles; remove it from the file")
    for joint in spec.joints:
        if np.all(np.array(joint.springdamper) > 0):
            raise UnsupportedModelError(
                f"{origin}: springdamper of joint {joint.name!r} needs inertias that MuJoCo compiles; "
                "write stiffness and damping instead"
            )


def _complete(mj_model: mujoco.MjModel, origin: str, repair: bool, repaired: list[str]) -> list[int]:
    """Make the mass matrix regular by changing bodies of `mj_model`, whose ids are returned, or raise."""
    deficient, complete = deficient_bodies(mj_model)
    names = [f"{mj_model.body(body).name or f'number {body}'!r}" for body in deficient]
    if deficient and not repair:
        numbers = _described(mj_model.body_mass[deficient[0]], mj_model.body_inertia[deficient[0]])
        raise InvalidInertiaError(
            f"{origin}: body {', '.join(names)}: a joint moves too little inertia, so the mass matrix is singular "
            f"({names[0]}: {numbers}); "
            "write an inertia in the file, or load with repair=True for a small one"
        )
    if not complete:
        raise InvalidInertiaError(
            f"{origin}: more than {len(deficient)} bodies need an inertia, too many to repair; write them in the file, first that "
            f"of body {names[0]}"
        )
    for body, name in zip(deficient, names, strict=True):
        before = _described(mj_model.body_mass[body], mj_model.body_inertia[body])
        strengthened(mj_model, body)
        after = _described(mj_model.body_mass[body], mj_model.body_inertia[body])
        repaired.append(f"body {name}: {before} leave the mass matrix singular; changed to {after}")
    return deficient


def _described(mass: float, moments: np.ndarray) -> str:
    return f"mass {mass:.6g} kg, principal moments {described_moments(moments)} kg m^2"
