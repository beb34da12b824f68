"""Many trajectories of a falling arm with adaptive Tsit5, per dynamics evaluation, against MuJoCo's threads in C."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import mujoco
import numpy as np

import kanejax as kj
from experiments.benchmarks import peers, robots
from experiments.benchmarks.harness import SEED, Candidate, Table, at_least, compare, effort, least_ratio, ratio, report

TARGET = 8.0
# Tsit5 evaluates its seventh stage as the first of the next step.
STAGES = 6
STEP, STEPS = 0.002, 50


def run(quick: bool) -> None:
    """Time 4096 trajectories of a second in both data types."""
    if not hasattr(kj, "simulate"):
        print("kanejax.simulate does not exist: not measured")
        return
    # Many times `batch_size`, or what its last trajectories leave empty counts.
    batch = 2048 if quick else 4096
    rows, details = [], []
    for dtype in ("float32", "float64"):
        with jax.enable_x64(dtype == "float64"):
            robot = robots.iiwa14()
            at = robots.states(robot, batch, SEED)
            call, specialized, lockstep = ours(robot, at, dtype)
            trajectory = call()
            taken = np.asarray(trajectory.stats["num_steps"])
            for found in (trajectory, specialized()):
                verify(robot, at, found, 5e-2 if dtype == "float32" else 5e-4)
            useful = STAGES * int(taken.sum())
            candidates = [Candidate(*row, useful) for row in (("kanejax", call), ("specialized", specialized), ("vmap", lockstep))]
            timings = compare([*candidates, Candidate("MuJoCo", theirs(robot, at), STEPS * batch)], effort(quick))
        own = timings["kanejax"]
        row = (dtype, useful / batch, STAGES * int(taken.max()), own.median * useful)
        row += (own.nanoseconds, ratio(timings, "vmap", "kanejax"))
        times = ratio(timings, "MuJoCo", "kanejax")
        row += (timings["MuJoCo"].nanoseconds, times, least_ratio(timings, "MuJoCo", "kanejax"), at_least(times, TARGET))
        row += (timings["specialized"].nanoseconds, ratio(timings, "MuJoCo", "specialized"))
        rows.append(row)
        details.append({"dtype": dtype, "batch": batch, "timings": {name: timing.record for name, timing in timings.items()}})
    headers = (
        "",
        "evaluations a trajectory",
        "of the longest",
        "seconds",
        "ns an evaluation",
        "vmap of simulate, times",
        f"MuJoCo C, {peers.THREADS} threads, Euler",
        "times",
        "least/least",
        "target",
        "specialized",
        "times",
    )
    report("simulate", [Table(f"{batch} trajectories of 1 s, iiwa14, adaptive Tsit5", headers, rows)], details)


def ours(robot: robots.Robot, at: robots.States, dtype: str) -> tuple[Callable, Callable, Callable]:
    """`simulate_batch`, also of the specialized model, and `jax.vmap` of `simulate`, where all wait for the longest."""
    model = robot.model.astype(dtype)
    frozen = kj.specialize(model)
    x = at.arrays(dtype)
    ts = np.array([0.0, 1.0], dtype)
    lockstep = jax.jit(jax.vmap(lambda model, q, u: kj.simulate(model, q, u, ts), (None, 0, 0)))
    batches = (functools.partial(kj.simulate_batch, m, x.q, x.u, ts) for m in (model, frozen))
    return *batches, lambda: lockstep(model, x.q, x.u)


def theirs(robot: robots.Robot, at: robots.States) -> Callable:
    """Steps of MuJoCo from the same states."""
    from mujoco.batch import Batch

    model = peers.bare_mujoco(robot)
    model.opt.timestep = STEP
    batch = Batch(model, len(at.q), peers.THREADS)
    positions, speeds = batch.bind("qpos"), batch.bind("qvel")

    def call() -> np.ndarray:
        positions[:], speeds[:] = at.q, at.u
        batch.step(nstep=STEPS)
        return positions

    return call


def verify(robot: robots.Robot, at: robots.States, trajectory: Any, tolerance: float) -> None:
    """Compare the ends of a few trajectories with MuJoCo's, integrated finely.

    The arm's free fall is chaotic, and a few trajectories amplify the solver's tolerance a thousandfold: the median counts.

    Raises:
        AssertionError: the ends differ.
    """
    model = peers.bare_mujoco(robot)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 5e-4
    data = mujoco.MjData(model)
    differences = []
    for i in range(15):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = at.q[i], at.u[i]
        mujoco.mj_step(model, data, 2000)
        differences.append(np.max(np.abs(data.qpos - np.asarray(trajectory.q[i, -1], float))))
    difference = float(np.median(differences))
    assert difference <= tolerance, f"ends of trajectories differ from MuJoCo's by {difference:.1e} rad, more than {tolerance:.0e}"
