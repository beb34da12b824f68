"""Comparing a robot's dynamics with an independent implementation at random states.

`validate` answers whether this library and MuJoCo (or Pinocchio) agree on a robot, in numbers: the worst relative error of
inverse dynamics, forward dynamics, mass matrix and bias force over random states, in float64 and in float32.
"""

import copy
import dataclasses
import functools
import importlib.metadata
import json
import math
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._dynamics.equations_of_motion import bias_force, forward_dynamics, inverse_dynamics, mass_matrix
from kanejax._model.model import Model
from kanejax._model.tree import COORDINATES, Tree

if TYPE_CHECKING:
    import mujoco
    from rich.table import Table

Quantity = Literal["inverse dynamics", "forward dynamics", "mass matrix", "bias force"]
Precision = Literal["float64", "float32"]
Peer = Literal["mujoco", "pinocchio"]

QUANTITIES: tuple[Quantity, ...] = ("inverse dynamics", "forward dynamics", "mass matrix", "bias force")
TOLERANCES: Mapping[str, Mapping[str, float]] = {
    "float64": {"inverse dynamics": 1e-11, "forward dynamics": 1e-9, "mass matrix": 1e-11, "bias force": 1e-11},
    "float32": dict.fromkeys(QUANTITIES, 1e-4),
}
"""Greatest relative error that passes, by data type and quantity."""

# Share of a quantity's typical size, its median over the states, that errors are relative to where the quantity is smaller.
_FLOOR = 0.01
# Coordinates of joints without a range are drawn from this interval, in rad or m; wider ranges are cut to it.
_WIDTH = {"revolute": math.pi, "prismatic": 1.0}


class States(NamedTuple):
    """Random states, one a row, float64 numbers that float32 can represent.

    Attributes:
        q: generalized coordinates, (samples, nq).
        u: generalized speeds, (samples, nv).
        u_dot: their rates, (samples, nv), the input of inverse dynamics.
        tau: forces at the joints, (samples, nv), the input of forward dynamics.
    """

    q: np.ndarray
    u: np.ndarray
    u_dot: np.ndarray
    tau: np.ndarray


@final
@dataclasses.dataclass(frozen=True)
class ValidationRow:
    """Agreement in one quantity, in one data type, with one peer.

    Attributes:
        against: "mujoco" or "pinocchio".
        dtype: "float64" or "float32", of this library's side; the peer computes in float64.
        quantity: one of `QUANTITIES`.
        error: the worst relative error over all states, infinite where a result is not finite; see `validate`.
        median: the median of the states' relative errors.
        tolerance: the greatest error that passes.
        state: number of the worst state.
        condition_number: of the mass matrix in the worst state.
    """

    against: Peer
    dtype: Precision
    quantity: Quantity
    error: float
    median: float
    tolerance: float
    state: int
    condition_number: float

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance."""
        return self.error <= self.tolerance


@final
@dataclasses.dataclass(frozen=True)
class ValidationReport:
    """What `validate` found: `print` it, or read `passed` and `rows`.

    Attributes:
        robot: the file's path, or what else was validated.
        nbody: number of bodies, the world not counted.
        nq: number of generalized coordinates.
        nv: number of generalized speeds.
        samples: number of random states.
        seed: of the random numbers.
        rows: the errors.
        notes: what was left out on both sides before comparing, and what differs from the file.
        versions: of the packages compared.
    """

    robot: str
    nbody: int
    nq: int
    nv: int
    samples: int
    seed: int
    rows: tuple[ValidationRow, ...]
    notes: tuple[str, ...]
    versions: Mapping[str, str]

    @property
    def passed(self) -> bool:
        """Whether every error is within its tolerance."""
        return all(row.passed for row in self.rows)

    def worst(self, dtype: Precision, quantity: Quantity) -> float:
        """The greatest error of a quantity among all peers; NaN where it was not compared."""
        return max((row.error for row in self.rows if (row.dtype, row.quantity) == (dtype, quantity)), default=math.nan)

    def table(self) -> "Table":
        """A table for `rich.print`."""
        from rich.table import Table

        title = f"{self.robot}: {self.nbody} bodies, {self.nv} speeds, {self.samples} random states"
        table = Table(title=title, title_justify="left", caption="\n".join(self.notes), caption_justify="left")
        for heading in ("against", "type", "quantity"):
            table.add_column(heading)
        for heading in ("worst error", "median", "tolerance", "cond(M) there", ""):
            table.add_column(heading, justify="right")
        for row in self.rows:
            numbers = (row.error, row.median, row.tolerance, row.condition_number)
            verdict = "[green]ok" if row.passed else "[bold red]OVER"
            table.add_row(row.against, row.dtype, row.quantity, *(f"{number:.1e}" for number in numbers), verdict)
        return table

    def to_json(self) -> str:
        """The report as JSON; an infinite error is the string "Infinity"."""
        return json.dumps(_strict_numbers({"passed": self.passed, **dataclasses.asdict(self)}), indent=1)

    def __str__(self) -> str:
        """The table as text."""
        from rich.console import Console

        console = Console(width=110, no_color=True, highlight=False)
        with console.capture() as capture:
            console.print(self.table())
        return capture.get()


def validate(
    robot: "str | os.PathLike | mujoco.MjModel | mujoco.MjSpec | Model",
    *,
    samples: int = 1000,
    seed: int = 0,
    against: Peer | Sequence[Peer] = "mujoco",
    dtypes: Sequence[Precision] = ("float64", "float32"),
    tolerances: Mapping[str, Mapping[str, float]] = TOLERANCES,
    strict: bool = True,
    repair: bool = False,
    allow_unphysical: bool = False,
) -> ValidationReport:
    """Compare the dynamics of a robot with MuJoCo's at random states.

    Per state, the error of a quantity is the largest absolute difference among its elements over the largest magnitude
    among the peer's elements: the mass matrix is compared with its own largest element, a vector of forces with its own
    largest force. Where all of a vector happens to be small (a pendulum near its rest), rounding errors are large beside it
    in any arithmetic; so what a vector is compared with is at least one hundredth of its kind's median over all states, forces
    being compared with those of inverse dynamics. A row reports the worst state, and the condition number of
    the mass matrix there: rounding numbers of relative size e at the input moves accelerations by up to that number times e,
    whatever the algorithm, and e is 6e-8 in float32.

    States: coordinates uniform over the joint's range, or [-pi, pi] rad and [-1, 1] m where there is none or it is wider,
    quaternions uniform over the rotations; speeds and accelerations standard normal; forces normal, with each joint's
    standard deviation of inverse dynamics. All are rounded to float32, so that both data types see the same ones; the parameters are
    the robot's, which a float32 model rounds.

    Both sides leave out contacts, constraints, limits and actuators, and friction: MuJoCo treats friction loss as a
    constraint, so `coulomb_friction` is set to zero here. Features that `strict=False` ignores are left out of
    MuJoCo's side too. Pinocchio reads the URDF itself, and has neither dampers nor springs.

    Float64 is compared whether or not `jax_enable_x64` is set, and the setting stays as it is.

    Args:
        robot: path of a URDF or MJCF, XML text, an MjSpec, a compiled MjModel, or a Model, which `to_mujoco` converts.
        samples: number of states.
        seed: of the random numbers.
        against: "mujoco", "pinocchio" (of URDFs, with the package `pin` installed), or both.
        dtypes: data types of this library's side.
        tolerances: greatest errors that pass, like `TOLERANCES`.
        strict: as of `load`.
        repair: as of `load`; Pinocchio gets the repaired inertias.
        allow_unphysical: as of `load`.

    Returns:
        The report.

    Raises:
        ValueError: fewer than one sample, a robot without joints, or an unknown peer or data type.
        TypeError: `robot` is none of the above.
        ModelFileError: as of `load`, as are UnsupportedModelError and InvalidInertiaError.
        ModuleNotFoundError: `pin` is not installed.
    """
    peers = (against,) if isinstance(against, str) else tuple(against)
    _check_options(samples, peers, dtypes)
    with jax.enable_x64(True):
        loaded = _loaded(robot, strict=strict, repair=repair, allow_unphysical=allow_unphysical)
        if not loaded.model.nv:
            raise ValueError(f"{loaded.name} has no joints, so there are no dynamics to compare")
        smooth = without_constraints(loaded.mj_model)
        states = sample_states(loaded.model, smooth, samples, seed)
        rows = []
        for peer in peers:
            if peer == "mujoco":
                model, expected = _with(loaded.model, coulomb_friction=0.0), mujoco_terms(smooth, states)
            else:
                model = _with(loaded.model, coulomb_friction=0.0, damping=0.0, stiffness=0.0, armature=0.0)
                expected = pinocchio_terms(loaded, states)
            scales = _scales(expected)
            for dtype in dtypes:
                found = terms(model, states, dtype)
                rows += [_row(peer, dtype, name, found, expected, scales, tolerances[dtype][name]) for name in QUANTITIES]
    tree = loaded.model.tree
    versions = {package: importlib.metadata.version(package) for package in ("jax", "mujoco", *(["pin"] if "pinocchio" in peers else []))}
    return ValidationReport(
        loaded.name, tree.nbody, tree.nq, tree.nv, samples, seed, tuple(rows), _notes(loaded), versions
    )


@dataclasses.dataclass(frozen=True)
class _Loaded:
    """A robot as this library and MuJoCo have it, and where it comes from."""

    name: str
    model: Model
    mj_model: "mujoco.MjModel"
    source: Any = None
    ignored: tuple[str, ...] = ()
    repaired: tuple[str, ...] = ()


def _loaded(robot: Any, *, strict: bool, repair: bool, allow_unphysical: bool) -> _Loaded:
    import mujoco

    from kanejax._io.export import to_mujoco
    from kanejax._io.flags import with_flags_applied
    from kanejax._io.load import load_report
    from kanejax._io.mujoco import from_mujoco
    from kanejax._io.source import compile_source

    if isinstance(robot, Model):
        model = robot.astype(jnp.float64)
        return _Loaded("Model", model, to_mujoco(model).compile())
    if isinstance(robot, mujoco.MjModel):
        return _Loaded("MjModel", from_mujoco(robot, strict=strict, allow_unphysical=allow_unphysical), with_flags_applied(robot))
    if not isinstance(robot, (str, os.PathLike, mujoco.MjSpec)):
        kinds = "a path, XML text, an MjSpec, an MjModel or a Model"
        raise TypeError(f"validate takes {kinds}, got {type(robot).__name__}")
    options = {"strict": strict, "repair": repair, "allow_unphysical": allow_unphysical}
    report = load_report(robot, **options)
    compiled = compile_source(robot, **options)
    return _Loaded(report.origin, report.model, compiled.mj_model, robot, report.ignored, report.repaired)


def _check_options(samples: int, peers: Sequence[str], dtypes: Sequence[str]) -> None:
    if samples < 1:
        raise ValueError(f"samples is {samples}; give at least 1")
    for name, values, valid in (("against", peers, ("mujoco", "pinocchio")), ("dtypes", dtypes, tuple(TOLERANCES))):
        unknown = [value for value in values if value not in valid]
        if unknown or not values:
            raise ValueError(f"{name} is {', '.join(map(repr, unknown)) or 'empty'}; choose from {', '.join(map(repr, valid))}")


def _notes(loaded: _Loaded) -> tuple[str, ...]:
    notes = []
    if np.any(loaded.model.coulomb_friction):
        notes.append("friction left out on both sides: it is a constraint in MuJoCo")
    notes += [f"left out on both sides: {sentence}" for sentence in loaded.ignored]
    return (*notes, *(f"repaired: {sentence}" for sentence in loaded.repaired))


def _with(model: Model, **values: float) -> Model:
    """The model with leaves filled with one value each."""
    return dataclasses.replace(model, **{name: jnp.full_like(getattr(model, name), value) for name, value in values.items()})


# States.


def sample_states(model: Model, mj_model: "mujoco.MjModel", samples: int, seed: int) -> States:
    """Draw random states of `model`; `mj_model` says how large its joint forces are. See `validate`."""
    random = np.random.default_rng(seed)
    q = _rounded(sample_coordinates(model, samples, random))
    u, u_dot, tau = (_rounded(random.normal(size=(samples, model.nv))) for _ in range(3))
    forces = mujoco_terms(mj_model, States(q, u, u_dot, tau))["inverse dynamics"]
    return States(q, u, u_dot, _rounded(tau * np.sqrt(np.mean(forces**2, axis=0))))


def sample_coordinates(model: Model, samples: int, random: np.random.Generator) -> np.ndarray:
    """Draw generalized coordinates (samples, nq) within the joints' ranges, quaternions uniform over the rotations."""
    q = np.empty((samples, model.nq))
    ranges = np.asarray(model.joint_range, float)
    for kind, start, limits in zip(model.tree.joint_types, model.tree.q_start, ranges, strict=True):
        if kind in _WIDTH:
            q[:, start] = random.uniform(*_interval(limits, _WIDTH[kind]), size=samples)
            continue
        if kind == "free":
            q[:, start : start + 3] = random.uniform(-1.0, 1.0, size=(samples, 3))
        turn = random.normal(size=(samples, 4))
        end = start + COORDINATES[kind]
        q[:, end - 4 : end] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    return q


def _interval(limits: np.ndarray, width: float) -> tuple[float, float]:
    """The part of a joint's range within `width` of zero, or of the range's nearer end where zero is far away."""
    low, high = (float(limit) for limit in limits)
    center = min(max(0.0, low), high)
    return max(low, center - width), min(high, center + width)


def _rounded(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32).astype(np.float64)


# The quantities, from this library and from its peers: arrays (samples, nv), and (samples, nv, nv) for the mass matrix.


def terms(model: Model, states: States, dtype: Precision) -> dict[Quantity, np.ndarray]:
    """This library's numbers, in a data type; `jax.enable_x64` must be set for float64."""
    q, u, u_dot, tau = (jnp.asarray(x, dtype) for x in states)
    inputs = {"inverse dynamics": (q, u, u_dot), "forward dynamics": (q, u, tau), "mass matrix": (q,), "bias force": (q, u)}
    model = model.astype(dtype)
    return {name: np.asarray(_batched(name)(model, *inputs[name]), np.float64) for name in QUANTITIES}


@functools.cache
def _batched(quantity: Quantity) -> Any:
    function, arguments = {
        "inverse dynamics": (inverse_dynamics, 3),
        "forward dynamics": (forward_dynamics, 3),
        "mass matrix": (mass_matrix, 1),
        "bias force": (bias_force, 2),
    }[quantity]
    return jax.jit(jax.vmap(function, in_axes=(None, *(0,) * arguments)))


def without_constraints(mj_model: "mujoco.MjModel") -> "mujoco.MjModel":
    """A copy that has nothing but the smooth dynamics which this library models."""
    import mujoco

    smooth = copy.copy(mj_model)
    bits = mujoco.mjtDisableBit
    smooth.opt.disableflags |= int(bits.mjDSBL_CONSTRAINT | bits.mjDSBL_ACTUATION | bits.mjDSBL_SENSOR)
    smooth.opt.enableflags = 0
    smooth.opt.density = smooth.opt.viscosity = 0.0
    for owner, terms_left_out in (
        ("body", ("gravcomp",)),
        ("jnt", ("stiffnesspoly",)),
        ("dof", ("dampingpoly",)),
        ("tendon", ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature", "frictionloss")),
        ("actuator", ("armature", "damping", "dampingpoly")),
    ):
        for term in terms_left_out:
            getattr(smooth, f"{owner}_{term}")[:] = 0
    return smooth


def mujoco_terms(mj_model: "mujoco.MjModel", states: States) -> dict[Quantity, np.ndarray]:
    """MuJoCo's qfrc_inverse, qacc, full M and qfrc_bias."""
    import mujoco

    data = mujoco.MjData(mj_model)
    samples, nv = states.u.shape
    expected: dict[Quantity, np.ndarray] = {name: np.empty((samples, nv)) for name in QUANTITIES}
    expected["mass matrix"] = np.empty((samples, nv, nv))
    for i, (q, u, u_dot, tau) in enumerate(zip(*states, strict=True)):
        data.qpos[:], data.qvel[:], data.qacc[:], data.qfrc_applied[:] = q, u, u_dot, tau
        mujoco.mj_inverse(mj_model, data)
        expected["inverse dynamics"][i] = data.qfrc_inverse
        mujoco.mj_forward(mj_model, data)
        expected["forward dynamics"][i], expected["bias force"][i] = data.qacc, data.qfrc_bias
        mujoco.mj_fullM(mj_model, data, expected["mass matrix"][i])
    return expected


def pinocchio_terms(loaded: _Loaded, states: States) -> dict[Quantity, np.ndarray]:
    """Pinocchio's rnea, aba, crba and nle, from its own reading of the URDF."""
    import pinocchio as pin

    model = pin.buildModelFromXML(_urdf_text(loaded))
    model.gravity.linear = np.asarray(loaded.model.gravity)
    data = model.createData()
    tree = loaded.model.tree
    order, coordinates = _pinocchio_order(model, tree)
    samples, nv = states.u.shape
    expected: dict[Quantity, np.ndarray] = {name: np.empty((samples, nv)) for name in QUANTITIES}
    expected["mass matrix"] = np.empty((samples, nv, nv))
    for i in range(samples):
        q = coordinates(states.q[i])
        u, u_dot, tau = np.empty((3, nv))
        u[order], u_dot[order], tau[order] = states.u[i], states.u_dot[i], states.tau[i]
        expected["inverse dynamics"][i] = pin.rnea(model, data, q, u, u_dot)[order]
        expected["bias force"][i] = pin.nle(model, data, q, u)[order]
        upper = np.triu(pin.crba(model, data, q))
        expected["mass matrix"][i] = (upper + np.triu(upper, 1).T)[np.ix_(order, order)]
        expected["forward dynamics"][i] = pin.aba(model, data, q, u, tau)[order]
    return expected


def _urdf_text(loaded: _Loaded) -> str:
    """The URDF, with the inertias of the model where those of the file were repaired."""
    from kanejax._io.urdf_inertials import to_urdf_inertials

    if not isinstance(loaded.source, (str, os.PathLike)):
        raise ValueError(f"against='pinocchio' needs a URDF, got {loaded.name}")
    text = str(loaded.source)
    if not text.lstrip().startswith("<"):
        with open(loaded.source, encoding="utf-8-sig") as file:
            text = file.read()
    if "<robot" not in text:
        raise ValueError(f"against='pinocchio' needs a URDF, and {loaded.name} is none")
    return to_urdf_inertials(loaded.model, loaded.source) if loaded.repaired else text


def _pinocchio_order(model: Any, tree: Tree) -> tuple[np.ndarray, Any]:
    """Pinocchio's index of each generalized speed, and its coordinates as a function of ours: (cos, sin) for continuous joints."""
    joints = []
    for name, kind in zip(tree.joint_names, tree.joint_types, strict=True):
        if kind not in _WIDTH or not model.existJointName(name):
            raise ValueError(f"joint {name!r} cannot be compared with Pinocchio: it is {kind}, or has another name there")
        joints.append(model.joints[model.getJointId(name)])
    if model.nv != tree.nv:
        raise ValueError(f"Pinocchio has {model.nv} speeds, this model {tree.nv}")

    def coordinates(q: np.ndarray) -> np.ndarray:
        converted = np.empty(model.nq)
        for joint, value in zip(joints, q, strict=True):
            converted[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (math.cos(value), math.sin(value))
        return converted

    return np.array([joint.idx_v for joint in joints]), coordinates


# Errors.


def _scales(expected: Mapping[Quantity, np.ndarray]) -> dict[Quantity, np.ndarray]:
    """What the differences of each quantity are relative to, (samples,); see `validate`."""
    largest = {name: _largest(values) for name, values in expected.items()}
    typical = {name: float(np.median(values)) for name, values in largest.items()}
    typical["bias force"] = typical["inverse dynamics"]
    return {name: np.maximum(values, _FLOOR * typical[name]) for name, values in largest.items()}


def _largest(values: np.ndarray) -> np.ndarray:
    return np.abs(values).reshape(len(values), -1).max(axis=1)


def _row(
    peer: Peer,
    dtype: Precision,
    quantity: Quantity,
    found: Mapping[Quantity, np.ndarray],
    expected: Mapping[Quantity, np.ndarray],
    scales: Mapping[Quantity, np.ndarray],
    tolerance: float,
) -> ValidationRow:
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = _largest(found[quantity] - expected[quantity]) / scales[quantity]
    errors = np.where(np.isfinite(errors), errors, np.inf)
    worst = int(np.argmax(errors))
    condition = float(np.linalg.cond(expected["mass matrix"][worst]))
    return ValidationRow(peer, dtype, quantity, float(errors[worst]), float(np.median(errors)), tolerance, worst, condition)


def _strict_numbers(value: Any) -> Any:
    """Replace what JSON has no number for by strings."""
    if isinstance(value, float) and not math.isfinite(value):
        return {math.inf: "Infinity", -math.inf: "-Infinity"}.get(value, "NaN")
    if isinstance(value, Mapping):
        return {key: _strict_numbers(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strict_numbers(item) for item in value]
    return value
