"""Reverse-mode gradients and Jacobians of inverse and forward dynamics, as multiples of an evaluation in the same run."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj
from experiments.benchmarks import robots
from experiments.benchmarks.harness import SEED, Candidate, Table, at_most, compare, effort, least_ratio, ratio, report

FUNCTIONS = {"inverse": kj.inverse_dynamics, "forward": kj.forward_dynamics}
STATES, PARAMETERS = "gradient to the states", "gradient to all parameters, summed"
JACOBIAN, PINOCCHIO = "Jacobian to the states", "Pinocchio's analytical derivatives, float64, one thread"
# Pinocchio has its derivatives one state a call: Python's share in that is some 1000 of its nanoseconds.
CALLS = 256


def run(quick: bool) -> None:
    """Time evaluations and gradients of both functions."""
    tables, details = [], []
    for batch in (4096,) if quick else (4096, 65536):
        rows: list[tuple] = []
        for dtype in ("float32", "float64"):
            for function in FUNCTIONS:
                with jax.enable_x64(dtype == "float64"):
                    timings = compare(candidates(function, dtype, batch), effort(quick))
                for name, target in ((STATES, 3), (PARAMETERS, 6), (JACOBIAN, None), (PINOCCHIO, None)):
                    times = ratio(timings, name, "evaluation")
                    verdict = at_most(times, target) if function == "inverse" and target else ""
                    least = least_ratio(timings, name, "evaluation")
                    nanoseconds = (timings[name].nanoseconds, timings["evaluation"].nanoseconds)
                    rows.append((f"{function}, {dtype}: {name}", *nanoseconds, times, least, verdict))
                records = {name: timing.record for name, timing in timings.items()}
                details.append({"function": function, "dtype": dtype, "batch": batch, "timings": records})
        headers = ("", "ns", "ns an evaluation", "times", "least/least", "target")
        tables.append(Table(f"Gradients and Jacobians, iiwa14, batch {batch}", headers, rows))
    report("gradients", tables, details)


def candidates(function: str, dtype: str, batch: int) -> list[Candidate]:
    """The evaluation, both gradients of a weighted sum of its results, the weights random and traced, and Jacobians."""
    robot = robots.iiwa14()
    at = robots.states(robot, batch, SEED)
    x = at.arrays(dtype)
    model = robot.model.astype(dtype)
    last = x.u_dot if function == "inverse" else x.tau
    weights = jnp.asarray(np.random.default_rng(SEED).normal(size=x.u.shape), dtype)
    call = FUNCTIONS[function]
    evaluate = jax.jit(jax.vmap(call, (None, 0, 0, 0)))
    to_states, to_parameters = jax.jit(gradient_to_states(call)), jax.jit(gradient_to_parameters(call))
    jacobian = jax.jit(jax.vmap(jax.jacrev(call, (1, 2, 3)), (None, 0, 0, 0)))
    peer = pinocchio_derivatives(robot, function, at)
    for found, expected in zip(jacobian(model, x.q[:4], x.u[:4], last[:4]), peer(4), strict=True):
        atol = (1e-3 if dtype == "float32" else 1e-9) * np.abs(expected).max()
        np.testing.assert_allclose(found[3], expected, rtol=0, atol=atol)
    return [
        Candidate("evaluation", lambda: evaluate(model, x.q, x.u, last), batch),
        Candidate(STATES, lambda: to_states(model, weights, x.q, x.u, last), batch),
        Candidate(PARAMETERS, lambda: to_parameters(model, weights, x.q, x.u, last), batch),
        Candidate(JACOBIAN, lambda: jacobian(model, x.q, x.u, last), batch),
        Candidate(PINOCCHIO, lambda: peer(CALLS), CALLS),
    ]


def pinocchio_derivatives(robot: robots.Robot, function: str, at: robots.States) -> Callable[[int], tuple[np.ndarray, ...]]:
    """Function that goes through so many states, and returns the last one's derivatives: by coordinates, speeds, and the rest."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(robot.source))
    model.armature = np.zeros(model.nv)
    data = model.createData()
    derivatives = pin.computeRNEADerivatives if function == "inverse" else pin.computeABADerivatives
    last = at.u_dot if function == "inverse" else at.tau

    def through(count: int) -> tuple[np.ndarray, ...]:
        found: tuple[np.ndarray, ...] = ()
        for state in zip(at.q[:count], at.u[:count], last[:count], strict=True):
            found = derivatives(model, data, *state)
        return found

    return through


def gradient_to_states(call: Callable) -> Callable:
    """Of (model, weights, q, u, last): the gradients with respect to each state of the batch."""

    def weighted(model: kj.Model, weights: jax.Array, *state: jax.Array) -> jax.Array:
        return jnp.vdot(weights, call(model, *state))

    return jax.vmap(jax.grad(weighted, (2, 3, 4)), (None, 0, 0, 0, 0))


def gradient_to_parameters(call: Callable) -> Callable:
    """Of the same arguments: a model of gradients, summed over the batch."""

    def total(model: kj.Model, weights: jax.Array, *state: jax.Array) -> jax.Array:
        return jnp.vdot(weights, jax.vmap(call, (None, 0, 0, 0))(model, *state))

    return jax.grad(total)


def jitted(function: str, kind: str) -> tuple[Callable, bool]:
    """A fresh jitted function, and whether it takes weights after the model: for timing the compiler."""
    call: Any = FUNCTIONS[function]
    if kind == "evaluation":
        return jax.jit(jax.vmap(call, (None, 0, 0, 0))), False
    return jax.jit({STATES: gradient_to_states, PARAMETERS: gradient_to_parameters}[kind](call)), True
