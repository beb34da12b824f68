"""Energy, momentum and the length of the quaternion over 100,000 steps, for every solver that `simulate` takes."""

import math
import time
from pathlib import Path
from typing import Any

import diffrax
import jax
import numpy as np
from rich.progress import track

import kanejax as kj
from experiments.thesis import record

# A tumbling body with a sprung arm of two links: quaternion, springs, and motions of about a second. Nothing acts on it.
BODY = """
<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody>
  <body name="body"><freejoint name="float"/>
    <inertial pos="0.02 0.01 -0.03" mass="2" diaginertia="0.03 0.02 0.04"/>
    <body name="arm" pos="0.2 0 0"><joint name="shoulder" axis="0 1 0" stiffness="0.5"/>
      <inertial pos="0.1 0.02 0" mass="0.7" diaginertia="0.004 0.006 0.005"/>
      <body name="hand" pos="0.25 0 0"><joint name="elbow" axis="0 0.6 0.8" stiffness="0.2"/>
        <inertial pos="0.1 0 0.01" mass="0.5" diaginertia="0.001 0.002 0.002"/></body></body></body>
</worldbody></mujoco>"""
QUATERNION = slice(3, 7)
STATES, STEP, STEPS, SAVED = 4, 1e-3, 100_000, 100
SOLVERS: dict[str, dict[str, Any]] = {
    "Euler": {"solver": diffrax.Euler()},
    "Heun": {"solver": diffrax.Heun()},
    "Midpoint": {"solver": diffrax.Midpoint()},
    "Ralston": {"solver": diffrax.Ralston()},
    "Bosh3": {"solver": diffrax.Bosh3()},
    "Tsit5": {"solver": diffrax.Tsit5()},
    "Dopri5": {"solver": diffrax.Dopri5()},
    "Dopri8": {"solver": diffrax.Dopri8()},
    "BetaScheme(0.5)": {"solver": kj.BetaScheme(0.5)},
    "BetaScheme(1)": {"solver": kj.BetaScheme(1.0)},
    "BetaScheme(1, three_point)": {"solver": kj.BetaScheme(1.0, three_point=True)},
    "ImplicitEuler": {"solver": diffrax.ImplicitEuler()},
    "Kvaerno3": {"solver": diffrax.Kvaerno3()},
    "Kvaerno4": {"solver": diffrax.Kvaerno4()},
    "Kvaerno5": {"solver": diffrax.Kvaerno5()},
}
# For implicit steps, so that what is left of an equation does not hide the drift. Closer to rounding errors root finders fail.
TIGHT = {"rtol": 1e-10, "atol": 1e-12}
ADAPTIVE: dict[str, dict[str, Any]] = {
    "Tsit5, default tolerances": {},
    "Tsit5, rtol 1e-9, atol 1e-11": {"rtol": 1e-9, "atol": 1e-11},
    "Dopri8, rtol 1e-9, atol 1e-11": {"solver": diffrax.Dopri8(), "rtol": 1e-9, "atol": 1e-11},
}


def run(directory: Path, steps: int = STEPS) -> dict:
    """Drifts of each solver in both precisions; the record is written after each, for they take long."""
    numbers: dict[str, Any] = {"steps": steps, "step": STEP, "states": STATES}
    cases = [(name, options | {"dt0": STEP}) for name, options in SOLVERS.items()] + list(ADAPTIVE.items())
    for name, options in track(cases, description="energy drift", transient=True):
        numbers[name] = {}
        for dtype in ("float64", "float32"):
            if dtype == "float32" and "rtol" in options:
                continue
            tolerances = TIGHT if isinstance(options.get("solver"), kj.BetaScheme) and dtype == "float64" else {}
            begin = time.perf_counter()
            numbers[name][dtype] = drift(dtype, options | tolerances, steps)
            numbers[name][dtype]["seconds"] = round(time.perf_counter() - begin, 1)
        record.write(directory, "energy_drift", numbers)
    (directory / "energy_drift.md").write_text(markdown(numbers))
    return numbers


def drift(dtype: str, options: dict, steps: int) -> dict[str, Any]:
    """Largest changes over all saved times and states, and where the worst ended."""
    model, reference = kj.load(BODY).astype(dtype), kj.load(BODY)
    q0, u0 = states(dtype)
    ts = np.linspace(0.0, steps * STEP, SAVED + 1)
    options = options if "dt0" in options else options | {"max_steps": 1_000_000}
    found = jax.jit(jax.vmap(lambda q, u: kj.simulate(model, q, u, ts, **options)))(q0, u0)
    q, u = (np.asarray(x, np.float64) for x in (found.q, found.u))
    energy, linear, angular = jax.jit(jax.vmap(jax.vmap(lambda q, u: conserved(reference, q, u))))(q, u)
    length = abs(np.linalg.norm(np.asarray(found.q_end, np.float64)[:, QUATERNION], axis=-1) - 1)
    finite = np.isfinite(q).all((1, 2))
    return {
        "status": sorted({kj.Status(int(status)).name for status in found.status}),
        "t_end": float(np.min(found.t_end)),
        "steps": int(np.max(found.stats["num_steps"])),
        "energy": number(abs(energy / energy[:, :1] - 1), finite),
        "energy_at_the_end": number(abs(energy[:, -1:] / energy[:, :1] - 1), finite),
        "linear_momentum": number(relative(linear), finite),
        "angular_momentum": number(relative(angular), finite),
        "unit_length": number(length, finite),
    }


def states(dtype: str) -> tuple[np.ndarray, np.ndarray]:
    """Initial states, with speeds of about 1 rad/s and 1 m/s."""
    rng = np.random.default_rng(record.SEED)
    q, u = rng.normal(size=(STATES, 9)), rng.normal(size=(STATES, 8))
    q[:, QUATERNION] /= np.linalg.norm(q[:, QUATERNION], axis=1, keepdims=True)
    return q.astype(dtype), u.astype(dtype)


def conserved(model: kj.Model, q: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Energy, and linear and angular momentum, in double precision."""
    momentum = kj.momentum(model, q, u)
    return kj.kinetic_energy(model, q, u) + kj.potential_energy(model, q), momentum.linear, momentum.angular


def relative(vectors: jax.Array) -> np.ndarray:
    """Changes of vectors over time, relative to their first lengths."""
    vectors = np.asarray(vectors)
    return np.linalg.norm(vectors - vectors[:, :1], axis=-1) / np.linalg.norm(vectors[:, :1], axis=-1)


def number(values: Any, finite: np.ndarray) -> float | None:
    """The largest, or None where not all trajectories are finite or the number overflows."""
    largest = float(np.max(values)) if finite.all() else math.inf
    return largest if math.isfinite(largest) else None


def markdown(numbers: dict) -> str:
    """The table of docs/numerics.md."""
    keys = ("energy", "angular_momentum", "linear_momentum")
    lines = [
        "| solver | steps | energy f64 | f32 | angular momentum f64 | f32 | linear momentum f64 | f32 |",
        "| --- |" + " --- |" * 7,
    ]
    for name in (*SOLVERS, *ADAPTIVE):
        of = numbers[name]
        cells = [text(of.get(dtype), key) for key in keys for dtype in ("float64", "float32")]
        lines.append(f"| {name} | {of['float64']['steps']} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def text(of: dict | None, key: str) -> str:
    """One cell: a number, or how it failed."""
    if of is None:
        return ""
    return f"{of[key]:.0e}" if of[key] is not None else f"{'/'.join(of['status'])} at {of['t_end']:.0f} s"
