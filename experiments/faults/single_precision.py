"""Single against double precision: energies, momenta, poses, partial velocities and a second of motion, for nine robots."""

import importlib.metadata
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.progress import track

import kanejax as kj
from experiments.thesis import record

ROBOTS = {
    "ur10": ("example-robot-data", "ur_description/urdf/ur10_robot.urdf"),
    "panda": ("example-robot-data", "panda_description/urdf/panda.urdf"),
    "kinova": ("example-robot-data", "kinova_description/robots/kinova.urdf"),
    "xarm7": ("example-robot-data", "xarm_description/urdf/xarm7.urdf"),
    "z1": ("example-robot-data", "z1_description/urdf/z1.urdf"),
    "go2": ("example-robot-data", "go2_description/urdf/go2.urdf"),
    "anymal c": ("example-robot-data", "anymal_c_simple_description/urdf/anymal.urdf"),
    "g1, 29 joints": ("example-robot-data", "g1_description/urdf/g1_29dof_rev_1_0.urdf"),
    "talos, reduced": ("example-robot-data", "talos_data/robots/talos_reduced.urdf"),
}
QUANTITIES: dict[str, Callable[..., Any]] = {
    "kinetic energy": kj.kinetic_energy,
    "potential energy": lambda model, q, u: kj.potential_energy(model, q),
    "linear momentum": lambda model, q, u: kj.momentum(model, q, u).linear,
    "angular momentum": lambda model, q, u: kj.momentum(model, q, u).angular,
    "body rotations": lambda model, q, u: kj.poses(model, q).rotation,
    "body positions": lambda model, q, u: kj.poses(model, q).origin,
    "partial angular velocities": lambda model, q, u: kj.partial_velocities(model, q).angular,
    "partial velocities": lambda model, q, u: kj.partial_velocities(model, q).linear,
}
# Tolerances relative and absolute: the defaults of float32 and of float64, and a motion to compare with.
TOLERANCES = {
    "float32, 1e-4": ("float32", 1e-4, 1e-6),
    "float32, 1e-6": ("float32", 1e-6, 1e-8),
    "float64, 1e-6": ("float64", 1e-6, 1e-8),
}
REFERENCE = ("float64", 1e-10, 1e-12)
STATES, MOVING = 256, 32
TS = np.array([0.0, 1.0])


def run(directory: Path, robots: tuple[str, ...] = tuple(ROBOTS)) -> dict:
    """Medians and largest errors of each robot."""
    numbers: dict[str, Any] = {"states": STATES, "trajectories": MOVING, "robots": {}}
    for name in track(robots, description="single precision", transient=True):
        model = load(name)
        q, u = states(model)
        numbers["robots"][name] = {"nv": model.nv, **errors(model, q, u), "motion": motions(model, q[:MOVING], u[:MOVING])}
        jax.clear_caches()
        record.write(directory, "single_precision", numbers)
    (directory / "single_precision.md").write_text(markdown(numbers))
    return numbers


def load(name: str) -> kj.Model:
    """A robot whose numbers single precision has too, so that what differs is arithmetic; without the file's friction and springs.

    Those make some of them so stiff that an explicit method takes thousands of steps.
    """
    package, path = ROBOTS[name]
    file = next(file for file in importlib.metadata.files(package) or () if str(file).endswith(path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", (kj.IgnoredFeatureWarning, kj.RepairedModelWarning))
        model = kj.load(Path(str(file.locate())), strict=False, repair=True)
    model = model.replace(**{name: 0.0 * getattr(model, name) for name in ("damping", "coulomb_friction", "stiffness")})
    return model.astype("float32").astype("float64")


def states(model: kj.Model) -> tuple[np.ndarray, np.ndarray]:
    """Random coordinates within half of the joints' ranges or a radian, and speeds of half a radian a second."""
    rng = np.random.default_rng(record.SEED)
    q, u = rng.uniform(-1, 1, (STATES, model.nq)), 0.5 * rng.normal(size=(STATES, model.nv))
    for kind, start, limits in zip(model.tree.joint_types, model.tree.q_start, np.asarray(model.joint_range), strict=True):
        if kind in ("revolute", "prismatic") and np.isfinite(limits).all():
            q[:, start] = limits.mean() + 0.25 * np.ptp(limits) * q[:, start]
        if kind in ("ball", "free"):
            turn = slice(start + 3, start + 7) if kind == "free" else slice(start, start + 4)
            q[:, turn] /= np.linalg.norm(q[:, turn], axis=1, keepdims=True)
    return tuple(x.astype(np.float32).astype(np.float64) for x in (q, u))  # type: ignore[return-value]


def errors(model: kj.Model, q: np.ndarray, u: np.ndarray) -> dict[str, list[float]]:
    """Median and largest error of each quantity, relative to its largest component at that state."""

    def all_of(model: kj.Model, q: Any, u: Any) -> dict[str, Any]:
        return {name: quantity(model, q, u) for name, quantity in QUANTITIES.items()}

    evaluate = jax.jit(jax.vmap(all_of, (None, 0, 0)))
    single, double = (evaluate(model.astype(x), q.astype(x), u.astype(x)) for x in ("float32", "float64"))
    found = {}
    for name, exact in double.items():
        exact, rough = (np.asarray(x, np.float64).reshape(STATES, -1) for x in (exact, single[name]))
        found[name] = summary(np.max(abs(rough - exact), 1) / np.maximum(np.max(abs(exact), 1), 1e-30))
    return found


def motions(model: kj.Model, q: np.ndarray, u: np.ndarray) -> dict[str, Any]:
    """Median and largest error of the coordinates after a second, [rad] or [m]."""
    exact, ended = moved(model, q, u, *REFERENCE)
    found: dict[str, Any] = {"ended": {"reference": ended}, "distance": summary(np.max(abs(exact - q), 1))}
    for name, how in TOLERANCES.items():
        rough, found["ended"][name] = moved(model, q, u, *how)
        found[name] = summary(np.max(abs(rough - exact), 1))
    return found


def moved(model: kj.Model, q: np.ndarray, u: np.ndarray, dtype: str, rtol: float, atol: float) -> tuple[np.ndarray, int]:
    """Coordinates after a second of a motion that friction ends, and how many reached it."""
    model, q, u = model.astype(dtype), q.astype(dtype), u.astype(dtype)
    tolerances = {"rtol": jnp.asarray(rtol, dtype), "atol": jnp.asarray(atol, dtype)}
    friction = 2.0 * jax.jit(jax.vmap(lambda q: jnp.diagonal(kj.mass_matrix(model, q))))(q)
    control = (_held, (jax.tree.map(lambda x: jnp.broadcast_to(x, (len(q), *x.shape)), model), friction))
    found = kj.simulate_batch(model, q, u, TS, control=control, control_axis=0, threads=1, batch_size=32, **tolerances)
    return np.asarray(found.q_end, np.float64), int(np.sum(found.ok))


def _held(t: jax.Array, q: jax.Array, u: jax.Array, how: tuple[kj.Model, jax.Array]) -> jax.Array:
    """Gravity is held, and friction ends the motion."""
    model, friction = how
    return -kj.gravity_force(model, q) - friction * u


def summary(values: np.ndarray) -> list[float]:
    """Median and largest."""
    return [float(np.median(values)), float(np.max(values))]


def markdown(numbers: dict) -> str:
    """The tables of docs/numerics.md."""
    lines = [f"| robot | {' | '.join(QUANTITIES)} |", "| --- |" + " --- |" * len(QUANTITIES)]
    for name, of in numbers["robots"].items():
        lines.append(f"| {name} | {' | '.join(text(of[column]) for column in QUANTITIES)} |")
    lines += ["", f"| robot | moved by | {' | '.join(TOLERANCES)} |", "| --- |" + " --- |" * (1 + len(TOLERANCES))]
    for name, of in numbers["robots"].items():
        moved_by = " / ".join(f"{x:.2g}" for x in of["motion"]["distance"])
        lines.append(f"| {name} | {moved_by} | {' | '.join(text(of['motion'][column]) for column in TOLERANCES)} |")
    return "\n".join(lines) + "\n"


def text(values: list[float]) -> str:
    """Median and largest."""
    return " / ".join(f"{x:.0e}" for x in values)
