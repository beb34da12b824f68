"""Gradient of a loss through 100 steps of simulation with respect to every leaf of the model, against the simulation alone."""

import time

import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj
from experiments.benchmarks import robots
from experiments.benchmarks.harness import SEED, Candidate, Table, at_most, compare, effort, least_ratio, ratio, report

BATCH, STEPS, DURATION = 256, 100, 0.2
TARGET, COMPILE_TARGET = 5.0, 20.0


def run(quick: bool) -> None:
    """Time 256 trajectories of 100 fixed steps in both data types."""
    if not hasattr(kj, "simulate"):
        print("kanejax.simulate does not exist: not measured")
        return
    rows, details = [], []
    for dtype in ("float64",) if quick else ("float32", "float64"):
        with jax.enable_x64(dtype == "float64"):
            row, detail = _row(dtype, quick)
        rows.append(row)
        details.append(detail)
    parts = ("", "forward, ms", "compile, s", "gradient, ms", "compile, s", "target")
    headers = (*parts, "gradient over forward", "least/least", "target")
    report("simulation_gradient", [Table(f"{BATCH} trajectories of {STEPS} steps, iiwa14, Tsit5", headers, rows)], details)


def _row(dtype: str, quick: bool) -> tuple[tuple, dict]:
    robot = robots.iiwa14()
    x = robots.states(robot, BATCH, SEED).arrays(dtype)
    model = robot.model.astype(dtype)
    ts = jnp.array([0.0, DURATION], dtype)

    def loss(model: kj.Model, q: jax.Array, u: jax.Array) -> jax.Array:
        def one(q: jax.Array, u: jax.Array) -> jax.Array:
            end = kj.simulate(model, q, u, ts, dt0=DURATION / STEPS, max_steps=STEPS + 1)
            return jnp.sum(end.q[-1] ** 2) + jnp.sum(end.u[-1] ** 2)

        return jnp.mean(jax.vmap(one)(q, u))

    compiled, seconds = {}, {}
    for name, function in (("forward", loss), ("gradient", jax.grad(loss))):
        jax.clear_caches()
        start = time.perf_counter()
        compiled[name] = jax.jit(function).lower(model, x.q, x.u).compile()
        seconds[name] = time.perf_counter() - start
    if dtype == "float64":
        verify(compiled, model, x)
    candidates = [Candidate(name, lambda call=call: call(model, x.q, x.u)) for name, call in compiled.items()]
    timings = compare(candidates, effort(quick))
    times = ratio(timings, "gradient", "forward")
    row = (dtype, 1e3 * timings["forward"].median, seconds["forward"], 1e3 * timings["gradient"].median, seconds["gradient"])
    row += (at_most(seconds["gradient"], COMPILE_TARGET), times, least_ratio(timings, "gradient", "forward"))
    row += (at_most(times, TARGET),)
    return row, {"dtype": dtype, "compile": seconds, "timings": {name: timing.record for name, timing in timings.items()}}


def verify(compiled: dict, model: kj.Model, x: robots.States) -> None:
    """Compare the gradient along a random direction with a difference quotient.

    Raises:
        AssertionError: they differ.
    """
    gradient = compiled["gradient"](model, x.q, x.u)
    rng = np.random.default_rng(SEED)
    along = jax.tree.map(lambda leaf: jnp.where(jnp.isfinite(leaf), leaf, 0.0) * rng.normal(size=leaf.shape), model)
    step = 1e-6

    def at(sign: float) -> float:
        return float(compiled["forward"](jax.tree.map(lambda leaf, d: leaf + sign * step * d, model, along), x.q, x.u))

    slope = sum(float(jnp.vdot(g, d)) for g, d in zip(jax.tree.leaves(gradient), jax.tree.leaves(along), strict=True))
    quotient = (at(1.0) - at(-1.0)) / (2 * step)
    assert abs(slope - quotient) <= 1e-5 * abs(quotient), f"gradient along a direction {slope}, difference quotient {quotient}"
