"""Comparing a robot's dynamics with an independent implementation at random states.

`validate` answers whether this library and MuJoCo (or Pinocchio) agree on a robot, in numbers: the worst relative error of
inverse dynamics, forward dynamics, mass matrix and bias force over random states, in float64 and in float32.
"""

import dataclasses
import importlib.metadata
import os
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from kanejax._errors import UnsupportedModelError
from kanejax._io.check import check_numbers
from kanejax._io.convert import model_from_compiled
from kanejax._io.export import to_mujoco
from kanejax._io.flags import with_flags_applied
from kanejax._io.mujoco import from_mujoco
from kanejax._io.source import compile_source
from kanejax._io.urdf_inertials import to_urdf_inertials
from kanejax._model.model import Model
from kanejax._validate.peers import mujoco_terms, own_terms, pinocchio_terms, without_constraints
from kanejax._validate.report import QUANTITIES, Quantity, ValidationReport, ValidationRow
from kanejax._validate.states import States, sample_states

TOLERANCES: Mapping[str, Mapping[Quantity, float]] = {
    "float64": {"inverse dynamics": 1e-11, "forward dynamics": 1e-9, "mass matrix": 1e-11, "bias force": 1e-11},
    "float32": dict.fromkeys(QUANTITIES, 1e-4),
}
"""Greatest relative error that passes, by data type and quantity."""

# Where a vector is smaller than this share of its kind's median over the states, errors are relative to that share.
_FLOOR = 0.01


def validate(
    robot: str | os.PathLike[str] | mujoco.MjModel | mujoco.MjSpec | Model,
    *,
    samples: int = 1000,
    seed: int = 0,
    against: str | Sequence[str] = "mujoco",
    dtypes: str | Sequence[str] = ("float64", "float32"),
    tolerances: Mapping[str, Mapping[Quantity, float]] = TOLERANCES,
    strict: bool = True,
    repair: bool = False,
    allow_unphysical: bool = False,
) -> ValidationReport:
    """Compare the dynamics of a robot with MuJoCo's at random states.

    Per state, the error of a quantity is the largest absolute difference among its elements over the largest magnitude
    among the peer's elements: the mass matrix is compared with its own largest element, a vector of forces with its own
    largest force. Where all of a vector happens to be small (a pendulum near its rest), rounding errors are large beside it
    in any arithmetic; so what a vector is compared with is at least one hundredth of its kind's median over all states,
    forces being compared with those of inverse dynamics. A row reports the worst state, and the condition number of the
    mass matrix there: rounding the mass matrix, by a relative 1.1e-16 in float64 and 6e-8 in float32, moves accelerations
    by up to that times the condition number, whatever the algorithm.

    States: coordinates uniform over the joint's range, or [-pi, pi] rad and [-1, 1] m where there is none or it is wider,
    quaternions uniform over the rotations; speeds and accelerations standard normal; forces normal, for each joint as large as
    those of inverse dynamics (root mean square). All are rounded to float32, so that both data types see the same
    ones; the parameters are the robot's, which a float32 model rounds.

    Both sides leave out contacts, constraints, limits and actuators, and friction: MuJoCo treats friction loss as a
    constraint, so `coulomb_friction` is set to zero here. Features that `strict=False` ignores are left out of
    MuJoCo's side too. Pinocchio reads the URDF itself, and applies neither damping nor springs.

    Float64 is compared whether or not `jax_enable_x64` is set, and the setting stays as it is.

    Args:
        robot: path of a URDF or MJCF, XML text, an MjSpec, a compiled MjModel, or a Model, which `to_mujoco` converts.
        samples: number of states.
        seed: of the random numbers.
        against: "mujoco", "pinocchio" (of URDFs, with the package `pin` installed), or both.
        dtypes: of this library's side: "float64", "float32", or both.
        tolerances: greatest errors that pass, by data type and quantity; in float64 1e-11, and 1e-9 for forward dynamics, in
            float32 1e-4.
        strict: as of `load`.
        repair: as of `load`; Pinocchio gets the repaired inertias.
        allow_unphysical: as of `load`.

    Returns:
        The report.

    Raises:
        ValueError: fewer than one sample, or an unknown peer or data type.
        TypeError: `robot` is none of the above.
        UnsupportedModelError: the robot has no joints, Pinocchio cannot read it, or as of `load`.
        ModelFileError: as of `load`, as is InvalidInertiaError.
        ModuleNotFoundError: `pin` is not installed.
    """
    against = (against,) if isinstance(against, str) else tuple(against)
    dtypes = (dtypes,) if isinstance(dtypes, str) else tuple(dtypes)
    _check_options(samples, against, dtypes)
    with jax.enable_x64(True):
        loaded = _loaded(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
        states = _states(loaded, samples, seed)
        rows = [row for peer in against for row in _compared(loaded, peer, states, dtypes, tolerances)]
    return _report(loaded, samples, seed, rows)


@dataclasses.dataclass(frozen=True)
class _Robot:
    """A robot as this library and MuJoCo have it, and where it comes from."""

    name: str
    model: Model
    mj_model: mujoco.MjModel
    source: Any = None
    ignored: tuple[str, ...] = ()
    repaired: tuple[str, ...] = ()


def _loaded(robot: Any, *, strict: bool, repair: bool, allow_unphysical: bool) -> _Robot:
    if isinstance(robot, Model):
        model = robot.astype(jnp.float64)
        return _Robot("Model", model, to_mujoco(model).compile())
    if isinstance(robot, mujoco.MjModel):
        return _Robot("MjModel", from_mujoco(robot, strict=strict, allow_unphysical=allow_unphysical), with_flags_applied(robot))
    if not isinstance(robot, (str, os.PathLike, mujoco.MjSpec)):
        raise TypeError(f"validate takes a path, XML text, an MjSpec, an MjModel or a Model, got {type(robot).__name__}")
    compiled = compile_source(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
    model = model_from_compiled(compiled.mj_model)
    check_numbers(model)
    return _Robot(compiled.origin, model, compiled.mj_model, robot, compiled.refused, compiled.repaired)


def _states(robot: _Robot, samples: int, seed: int) -> States:
    """Random states, with forces as large as those of MuJoCo's inverse dynamics."""
    if not robot.model.nv:
        raise UnsupportedModelError(f"{robot.name}: it has no joints, so there are no dynamics to compare")
    return sample_states(robot.model, samples, seed, lambda states: _expected(robot, "mujoco", states)["inverse dynamics"])


def _expected(robot: _Robot, peer: str, states: States) -> dict[str, np.ndarray]:
    """The peer's numbers."""
    if peer == "pinocchio":
        return pinocchio_terms(robot.model, _urdf(robot), states)
    return mujoco_terms(without_constraints(robot.mj_model), states)


def _compared(
    robot: _Robot, peer: str, states: States, dtypes: Sequence[str], tolerances: Mapping[str, Mapping[Quantity, float]]
) -> list[ValidationRow]:
    """Rows of one peer, with what it does not apply left out of this library's side."""
    left_out = ("coulomb_friction",) if peer == "mujoco" else ("coulomb_friction", "damping", "stiffness", "armature")
    model = robot.model.replace(**{name: jnp.zeros_like(getattr(robot.model, name)) for name in left_out})
    expected = _expected(robot, peer, states)
    scales, rows = _scales(expected), []
    for dtype in dtypes:
        found = own_terms(model, states, dtype)
        rows += [_row(peer, dtype, name, found, expected, scales, tolerances[dtype][name]) for name in QUANTITIES]
    return rows


def _urdf(robot: _Robot) -> str:
    """The URDF's text, with the inertias of the model where those of the file were repaired."""
    text = ""
    if isinstance(robot.source, str) and robot.source.lstrip().startswith("<"):
        text = robot.source
    elif isinstance(robot.source, (str, os.PathLike)):
        with open(robot.source, encoding="utf-8-sig") as file:
            text = file.read()
    if "<robot" not in text:
        raise UnsupportedModelError(f"{robot.name}: against='pinocchio' needs a URDF")
    return to_urdf_inertials(robot.model, robot.source) if robot.repaired else text


def _check_options(samples: int, against: Sequence[str], dtypes: Sequence[str]) -> None:
    if samples < 1:
        raise ValueError(f"samples is {samples}; give at least 1")
    for name, values, valid in (("against", against, ("mujoco", "pinocchio")), ("dtypes", dtypes, tuple(TOLERANCES))):
        unknown = [value for value in values if value not in valid]
        if unknown or not values:
            given = ", ".join(map(repr, unknown)) or "empty"
            raise ValueError(f"{name} is {given}; choose from {', '.join(map(repr, valid))}")


def _report(robot: _Robot, samples: int, seed: int, rows: list[ValidationRow]) -> ValidationReport:
    packages = ("jax", "mujoco", "pin") if any(row.against == "pinocchio" for row in rows) else ("jax", "mujoco")
    versions = {package: importlib.metadata.version(package) for package in packages}
    tree = robot.model.tree
    return ValidationReport(robot.name, tree.nbody, tree.nq, tree.nv, samples, seed, tuple(rows), _notes(robot), versions)


def _notes(robot: _Robot) -> tuple[str, ...]:
    notes = []
    if np.any(robot.model.coulomb_friction):
        notes.append("friction is left out on both sides: in MuJoCo it is a constraint")
    notes += [f"left out on both sides: {sentence}" for sentence in robot.ignored]
    return (*notes, *(f"repaired: {sentence}" for sentence in robot.repaired))


def _scales(expected: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What the differences of each quantity are relative to in each state, (samples,); see `validate`."""
    largest = {name: _largest(values) for name, values in expected.items()}
    typical = {name: float(np.median(values)) for name, values in largest.items()}
    typical["bias force"] = typical["inverse dynamics"]
    return {name: np.maximum(values, _FLOOR * typical[name]) for name, values in largest.items()}


def _largest(values: np.ndarray) -> np.ndarray:
    return np.abs(values).reshape(len(values), -1).max(axis=1)


def _row(
    peer: str,
    dtype: str,
    quantity: Quantity,
    found: Mapping[str, np.ndarray],
    expected: Mapping[str, np.ndarray],
    scales: Mapping[str, np.ndarray],
    tolerance: float,
) -> ValidationRow:
    """The states' errors, of which the worst counts; one that is not finite is infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = _largest(found[quantity] - expected[quantity]) / scales[quantity]
    errors = np.where(np.isfinite(errors), errors, np.inf)
    worst = int(np.argmax(errors))
    condition = float(np.linalg.cond(expected["mass matrix"][worst]))
    return ValidationRow(peer, dtype, quantity, float(errors[worst]), float(np.median(errors)), tolerance, worst, condition)
