"""Identification by simulation: parameters from two seconds of motion, against mujoco.sysid.

Both have the same data, made by MuJoCo's default integrator with a step of 2 ms, which both use too: known torques or a controller,
noise of 1 mrad on the coordinates, masses (and inertias) up to 30 % off at the start. Both are told the true initial state, and the
peer those of its windows. A problem counts as converged where the error is below 10 %.

The peer runs by the interpreter that KANEJAX_SYSID_PYTHON names, by default this one; it needs mujoco[sysid]==4.0.0 and numpy 2.3.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from scipy.signal import savgol_filter

import kanejax as kj
from experiments.benchmarks.harness import Table, at_least, report
from kanejax._logs.motion import Motion
from kanejax._model.inertia import inertia_parameters
from kanejax._parameters.parameterization import parameterization
from kanejax._parameters.plant import Drives, Plant
from kanejax._parameters.priors import Entropic
from kanejax._parameters.unknowns import Unknown
from kanejax._regression.base_parameters import base_parameters
from kanejax._simulation_fit.simulation_error import fit_simulation
from kanejax._simulation_fit.simulation_fit import SimulationFit

STEP, STEPS, SEEDS = 0.002, 1000, (0, 1, 2)
NOISE, TORQUE_NOISE = 1e-3, 0.05
PRIOR = 0.3
TARGET, CONVERGED = 10.0, 0.1
PEER = Path(__file__).with_name("identification_peer.py")

THREE_LINKS = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="link1"><joint name="joint1" axis="0 0 1"/>
    <inertial pos="0.15 0.02 0.1" mass="3" fullinertia="0.03 0.04 0.03 0.002 -0.001 0.003"/>
    <body name="link2" pos="0.1 0 0.3"><joint name="joint2" axis="0 1 0"/>
      <inertial pos="0.2 0.01 0.03" mass="2" fullinertia="0.01 0.03 0.03 0.001 0.002 -0.001"/>
      <body name="link3" pos="0.4 0 0"><joint name="joint3" axis="0 1 0"/>
        <inertial pos="0.15 -0.01 0.02" mass="1" fullinertia="0.004 0.01 0.01 0.0005 -0.0005 0.0003"/>
      </body></body></body>
</worldbody></mujoco>"""
PANDA = "panda_description/urdf/panda.urdf"


class Problem(NamedTuple):
    """One of the reference problems; `window` is what the peer starts with [s], or None."""

    name: str
    robot: str
    kind: str
    is_controlled: bool
    window: float | None


PROBLEMS = (
    Problem("3 links, masses, single shooting", "three", "mass", False, None),
    Problem("3 links, masses, windows, then single shooting", "three", "mass", False, 0.1),
    Problem("Panda, 7 masses, single shooting", "panda", "mass", False, None),
    Problem("Panda, 7 masses, PD and torque sensor", "panda", "mass", True, None),
    Problem("3 links, all 30 (base parameters)", "three", "inertia", False, None),
    Problem("Panda, all 70 (base parameters), PD and torque sensor", "panda", "inertia", True, None),
)


class Robot(NamedTuple):
    """A mechanism as MJCF and as a model, the middle and the amplitude of its motion, and the gains of its controller."""

    xml: str
    model: kj.Model
    middle: np.ndarray
    amplitude: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray


class Data(NamedTuple):
    """What was measured: `q`, `u` (estimated) and `effort` at `ts`; what the peer takes, and the true states."""

    robot: Robot
    xml: str
    ts: np.ndarray
    goal: np.ndarray
    ctrl: np.ndarray
    sensed: np.ndarray
    q: np.ndarray
    u: np.ndarray
    effort: np.ndarray
    scales: np.ndarray
    states: np.ndarray


class SemiImplicitEuler(diffrax.AbstractSolver):
    """MuJoCo's default: speeds first, then coordinates with the new speeds; for joints of one coordinate, without damping."""

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Any] = diffrax.LocalLinearInterpolation

    def order(self, terms: Any) -> int:
        """Order of convergence."""
        return 1

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> None:
        """Nothing goes from step to step."""

    def step(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any) -> tuple:
        """One step."""
        nv = len(y0) // 2
        change = (t1 - t0) * terms.vf(t0, y0, args)[nv:]
        u = y0[nv:] + change
        y1 = jnp.concatenate((y0[:nv] + (t1 - t0) * u, u))
        return y1, None, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """Right-hand side."""
        return terms.vf(t0, y0, args)


class Controller(eqx.Module):
    """Torques towards a goal that is held from step to step."""

    goal: jax.Array
    stiffness: jax.Array
    damping: jax.Array

    def __call__(self, t: jax.Array, q: jax.Array, u: jax.Array) -> jax.Array:
        """Torques at a time and state."""
        row = jnp.clip(jnp.floor(t / STEP + 1e-3).astype(int), 0, len(self.goal) - 1)
        return self.stiffness * (self.goal[row] - q) - self.damping * u


def run(quick: bool) -> None:
    """Solve every problem for every seed with both, one after the other."""
    with jax.enable_x64(True):
        robots = {"three": three_links(), "panda": panda()}
        peer = peer_interpreter()
        rows, details = [], []
        for problem in PROBLEMS[:4] if quick else PROBLEMS:
            row, detail = _row(problem, robots[problem.robot], peer)
            rows.append(row)
            details.append(detail)
    headers = (
        "",
        "kanejax, s",
        "first call, s",
        "converged",
        "error, %",
        "peer, s",
        "converged",
        "error, %",
        "times faster",
        "least",
        "target",
    )
    title = (
        f"Identification by simulation, {len(SEEDS)} seeds: median time, ratio of each seed's, worst error of those that converged"
    )
    report("identification", [Table(title, headers, rows)], {"problems": details, "peer": peer_versions(peer)})


def _row(problem: Problem, robot: Robot, peer: str | None) -> tuple[tuple, dict]:
    ours, theirs, compiling = [], [], 0.0
    for seed in SEEDS:
        data = measured(problem, robot, seed)
        if not ours:
            compiling = _solved(problem, data)["seconds"]
        # The one in the middle of three, for other programs may be in the way of one.
        ours.append(sorted((_solved(problem, data) for _ in range(3)), key=lambda each: each["seconds"])[1])
        if peer is not None:
            theirs.append(_solved_by_peer(problem, data, peer))
    own, other = _summary(ours), _summary(theirs)
    # Where the peer does not converge, its time says nothing.
    ratios = [b["seconds"] / a["seconds"] for a, b in zip(ours, theirs, strict=False) if b["error"] < CONVERGED]
    faster = statistics.median(ratios) if ratios else ""
    least = min(ratios) if ratios else ""
    verdict = at_least(statistics.median(ratios), TARGET) if ratios else "peer fails" if theirs else "not measured"
    row = (problem.name, own[0], compiling, *own[1:], *other, faster, least, verdict)
    return row, {"problem": problem._asdict(), "kanejax": ours, "peer": theirs, "compile": compiling}


def _summary(results: list[dict]) -> tuple[Any, ...]:
    if not results:
        return "", "", ""
    good = [each["error"] for each in results if each["error"] < CONVERGED]
    return (
        statistics.median(each["seconds"] for each in results),
        f"{len(good)} of {len(results)}",
        100 * max(good) if good else "",
    )


def three_links() -> Robot:
    """An arm of three hinges, the first vertical: 15 base parameters."""
    model = kj.load(THREE_LINKS)
    stiffness, damping = np.array([60.0, 60.0, 20.0]), np.array([6.0, 6.0, 1.5])
    return Robot(kj.to_mjcf(model), model, np.array([0.0, -0.5, 0.8]), np.array([0.8, 0.6, 0.8]), stiffness, damping)


def panda() -> Robot:
    """The Panda of example-robot-data with locked fingers: 7 joints and 43 base parameters."""
    spec = kj.to_mujoco(kj.load_report(kj.robots.example_file(PANDA), strict=False).model)
    for joint in list(spec.joints):
        if "finger" in joint.name:
            spec.delete(joint)
    spec.compiler.fusestatic = True
    model = kj.from_mujoco(spec.compile())
    absent = {name: jnp.zeros_like(getattr(model, name)) for name in ("damping", "coulomb_friction", "armature")}
    model = model.replace(**absent)
    middle = np.array([0.0, -0.5, 0.0, -1.9, 0.0, 1.6, 0.8])
    amplitude = np.array([0.7, 0.6, 0.7, 0.6, 0.8, 0.7, 0.8])
    stiffness = np.array([200.0, 200.0, 200.0, 200.0, 40.0, 40.0, 8.0])
    return Robot(kj.to_mjcf(model), model, middle, amplitude, stiffness, np.array([14.0, 14.0, 14.0, 14.0, 2.0, 2.0, 0.2]))


def reference(robot: Robot, ts: np.ndarray) -> np.ndarray:
    """Goals: sums of sines of frequencies that differ from joint to joint, from rest."""
    nv = robot.model.nv
    ramp = (1.0 - np.exp(-((ts / 0.15) ** 2)))[:, None]
    frequency = 0.5 + 0.1 * np.arange(nv)
    phase = 0.7 * np.arange(nv)
    fast = 0.2 * np.sin(2 * np.pi * 2.3 * frequency * ts[:, None] + 2.0 * phase)
    return robot.middle + robot.amplitude * ramp * (np.sin(2 * np.pi * frequency * ts[:, None] + phase) + fast)


def measured(problem: Problem, robot: Robot, seed: int) -> Data:
    """Motion by MuJoCo, with noise."""
    rng = np.random.default_rng(seed)
    ts = STEP * np.arange(STEPS + 1)
    goal = reference(robot, ts)
    xml = with_motors(robot, problem.is_controlled)
    mj = mujoco.MjModel.from_xml_string(xml)
    ahead = np.zeros_like(goal) if problem.is_controlled else feedforward(robot, ts)
    speeds = np.gradient(goal, STEP, axis=0)
    data = mujoco.MjData(mj)
    data.qpos[:] = goal[0]
    rows, states, ctrl = [], [], []
    for k in range(STEPS):
        states.append((data.qpos.copy(), data.qvel.copy()))
        # Torques are those of a controller too, but known as they were.
        held = ahead[k] + robot.stiffness * (goal[k] - data.qpos) + robot.damping * (speeds[k] - data.qvel)
        ctrl.append(goal[k] if problem.is_controlled else held)
        data.ctrl[:] = ctrl[-1]
        mujoco.mj_step(mj, data)
        rows.append(data.sensordata.copy())
    ctrl = np.array([*ctrl, ctrl[-1]])
    exact, nv = np.array(rows), robot.model.nv
    sizes = np.concatenate((np.full(nv, NOISE), np.full(exact.shape[1] - nv, TORQUE_NOISE)))
    sensed = exact + sizes * rng.normal(size=exact.shape)
    q = sensed[:, :nv]
    u = savgol_filter(q, 21, 3, deriv=1, delta=STEP, axis=0)
    u[0] = 0.0
    effort = sensed[:, nv:] if problem.is_controlled else ctrl[:-1]
    scales = 1.0 + rng.uniform(-0.3, 0.3, nv)
    return Data(robot, xml, ts, goal, ctrl, sensed, q, u, effort, scales, np.array(states))


def feedforward(robot: Robot, ts: np.ndarray) -> np.ndarray:
    """Torques that would keep the robot near its reference."""
    q = reference(robot, ts)
    u = np.gradient(q, STEP, axis=0)
    u_dot = np.gradient(u, STEP, axis=0)
    return np.asarray(jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))(robot.model, *map(jnp.asarray, (q, u, u_dot))))


def with_motors(robot: Robot, is_controlled: bool) -> str:
    """MJCF with a motor and sensors at each joint, and without contacts and limits."""
    spec = mujoco.MjSpec.from_string(robot.xml)
    spec.option.timestep = STEP
    flags = mujoco.mjtDisableBit
    spec.option.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_CONSTRAINT
    names = robot.model.tree.joint_names
    for joint, stiffness, damping in zip(names, robot.stiffness, robot.damping, strict=True):
        motor = spec.add_actuator(name=f"motor_{joint}", target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        if is_controlled:
            motor.gainprm[0] = stiffness
            motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            motor.biasprm[1:3] = -stiffness, -damping
    kinds = [("q", mujoco.mjtSensor.mjSENS_JOINTPOS), ("torque", mujoco.mjtSensor.mjSENS_JOINTACTFRC)]
    for name, kind in kinds if is_controlled else kinds[:1]:
        for joint in names:
            spec.add_sensor(name=f"{name}_{joint}", type=kind, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=joint)
    spec.compile()
    return spec.to_xml()


def _solved(problem: Problem, data: Data) -> dict:
    robot = data.robot
    factors = jnp.asarray(data.scales)
    wrong = robot.model.replace(mass=robot.model.mass * factors)
    if problem.kind == "inertia":
        wrong = wrong.replace(central_inertia=robot.model.central_inertia * factors[:, None, None])
    # Of inertias motion tells combinations only; the prior holds the rest near to the start, as the peer's bounds do.
    unknown = Unknown("mass") if problem.kind == "mass" else Unknown("inertia", prior=Entropic(PRIOR))
    sought = parameterization(Plant(wrong, Drives.ideal(wrong)), [unknown])
    count = len(data.q)
    q, u = data.q.copy(), data.u.copy()
    q[0], u[0] = data.states[0]
    motion = Motion(data.ts[:count], q, u, np.zeros_like(u), data.effort)
    options: dict[str, Any] = {"initial_state": "given", "solver": SemiImplicitEuler(), "interpolation": "hold"}
    options["sigma"] = {"q": NOISE}
    if problem.is_controlled:
        options["control"] = Controller(*map(jnp.asarray, (data.goal, robot.stiffness, robot.damping)))
        options["sigma"]["effort"] = TORQUE_NOISE
    start = time.perf_counter()
    fit: SimulationFit = fit_simulation(sought, [motion], **options)
    seconds = time.perf_counter() - start
    parameters = np.asarray(sought.assemble(fit.phi)[1])
    told = {"converged": fit.converged, "message": fit.message, "iterations": fit.iterations, "cost": fit.cost}
    return {"seconds": seconds, "error": _error(problem, robot, parameters), **told}


def _solved_by_peer(problem: Problem, data: Data, peer: str) -> dict:
    mj = mujoco.MjModel.from_xml_string(data.xml)
    names = [mj.sensor(i).name for i in range(mj.nsensor)]
    noise = np.where([name.startswith("q_") for name in names], NOISE, TORQUE_NOISE)
    # It divides residuals by the size of what was measured; with these weights, by the noise instead.
    weights = np.linalg.norm(data.sensed, axis=0) / np.sqrt(2) / noise / np.sqrt(len(data.sensed))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "problem.npz"
        np.savez(
            path,
            **{name: getattr(data, name) for name in ("xml", "ts", "ctrl", "sensed", "states", "scales")},
            bodies=data.robot.model.tree.body_names,
            kind=problem.kind,
            sensors=names,
            weights=weights,
            windows=[0] if problem.window is None else [round(problem.window / STEP), 0],
        )
        done = subprocess.run([peer, str(PEER), str(path)], capture_output=True, text=True, check=False)
    if done.returncode:
        return {"seconds": float("nan"), "error": float("inf"), "message": done.stderr[-2000:]}
    found = json.loads(done.stdout.splitlines()[-1])
    if "failure" in found:
        return {"seconds": found["seconds"], "error": float("inf"), "message": found["failure"]}
    return {"seconds": found["seconds"], "error": _error(problem, data.robot, _inertia_of(data.robot, found))}


def _inertia_of(robot: Robot, found: dict) -> np.ndarray:
    """Inertia parameters of what the peer found."""
    inertia = []
    for axes, moments in zip(found["body_iquat"], found["body_inertia"], strict=True):
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, np.array(axes))
        rotation = rotation.reshape(3, 3)
        inertia.append(rotation @ np.diag(moments) @ rotation.T)
    return np.asarray(
        inertia_parameters(robot.model.replace(mass=found["body_mass"], com=found["body_ipos"], central_inertia=np.array(inertia)))
    )


def _error(problem: Problem, robot: Robot, found: np.ndarray) -> float:
    """Largest relative error of a mass, or that of all base parameters together.

    The centre of the Panda's first link is on its vertical joint, so that no motion tells its mass: it does not count.
    """
    true = np.asarray(inertia_parameters(robot.model))
    if problem.kind == "mass":
        return float(np.max(np.abs(found[:, 0] / true[:, 0] - 1.0)[robot.model.nbody == 7 :]))
    base = base_parameters(robot.model)
    expected = base.matrix @ true.ravel()
    return float(np.linalg.norm(base.matrix @ found.ravel() - expected) / np.linalg.norm(expected))


def peer_interpreter() -> str | None:
    """The interpreter that has the peer, or None with a word about it."""
    python = os.environ.get("KANEJAX_SYSID_PYTHON", sys.executable)
    probe = "import numpy; from mujoco import sysid; sysid.optimize; assert numpy.__version__ < '2.5', numpy.__version__"
    done = subprocess.run([python, "-c", probe], capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.splitlines() or ["?"])[-1]
        print(f"mujoco.sysid is not measured: {last}; set KANEJAX_SYSID_PYTHON to a python with mujoco[sysid]==4.0.0 and numpy 2.3")
        return None
    return python


def peer_versions(python: str | None) -> Any:
    """Versions of the peer."""
    if python is None:
        return None
    program = "import json, mujoco, numpy, scipy; print(json.dumps({m.__name__: m.__version__ for m in (mujoco, numpy, scipy)}))"
    return json.loads(subprocess.run([python, "-c", program], capture_output=True, text=True, check=True).stdout)
