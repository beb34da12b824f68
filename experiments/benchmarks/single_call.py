"""One jitted call on one state, float64, against what JAX takes to call anything at all."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

import kanejax as kj
from experiments.benchmarks import peers, robots
from experiments.benchmarks.harness import SEED, Candidate, Table, at_least, at_most, compare, effort, least_ratio, ratio, report

FLOOR_TARGET, FRAX_TARGET = 1.5, 2.0


def run(quick: bool) -> None:
    """Time calls with the model as an argument, and with the model closed over."""
    with jax.enable_x64(True):
        functions = {"inverse": kj.inverse_dynamics, "forward": kj.forward_dynamics}
        tables = [_table(name, function, quick) for name, function in functions.items()]
    report("single_call", tables)


def _table(function: str, call: Callable, quick: bool) -> Table:
    robot = robots.iiwa14()
    at = robots.states(robot, 1, SEED)
    x = at.arrays("float64")
    state = (x.q[0], x.u[0], x.u_dot[0] if function == "inverse" else x.tau[0])
    model = robot.model
    with_model, states_only = jax.jit(call), jax.jit(lambda *state: call(model, *state))
    # All arguments are returned, or all are taken and one result is made of the last.
    same_model, same_states = jax.jit(lambda *x: x), jax.jit(lambda *x: x)
    touch_model = jax.jit(lambda model, q, u, last: 2.0 * last, keep_unused=True)
    touch_states = jax.jit(lambda q, u, last: 2.0 * last, keep_unused=True)
    rival = _frax_call(function, state)
    peers.verify("frax", rival.run(), with_model(model, *state), 1e-6)
    groups = {
        "model and states": [
            Candidate("model and states: kanejax", lambda: with_model(model, *state)),
            Candidate("model and states: identity", lambda: same_model(model, *state)),
            Candidate("model and states: 2 x", lambda: touch_model(model, *state)),
        ],
        "states": [
            Candidate("states: kanejax", lambda: states_only(*state)),
            Candidate("states: identity", lambda: same_states(*state)),
            Candidate("states: 2 x", lambda: touch_states(*state)),
        ],
    }
    if hasattr(kj, "specialize"):
        frozen = kj.specialize(model)
        special = jax.jit(lambda *state: call(frozen, *state))
        groups["states"].append(Candidate("states: kanejax specialized", lambda: special(*state)))
    timings = compare([*groups["model and states"], *groups["states"], rival], effort(quick))
    rows = []
    for group, members in groups.items():
        for member in members:
            name = member.name
            over = [ratio(timings, name, f"{group}: {floor}") for floor in ("identity", "2 x")]
            least = least_ratio(timings, name, f"{group}: identity")
            verdict = at_most(over[0], FLOOR_TARGET) if "kanejax" in name else ""
            rows.append((name, 1e6 * timings[name].median, *over, least, verdict, ratio(timings, rival.name, name)))
    faster = at_least(ratio(timings, rival.name, "model and states: kanejax"), FRAX_TARGET)
    rows.append((rival.name, 1e6 * timings[rival.name].median, "", "", "", faster, 1.0))
    headers = ("", "microseconds", "over identity", "over 2 x", "least over identity", "target", "frax over it")
    return Table(f"One call, {function} dynamics, iiwa14, float64", headers, rows)


def _frax_call(function: str, state: tuple) -> Candidate:
    robot = peers.frax_iiwa()
    gravity = jnp.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
    if function == "inverse":
        call = jax.jit(lambda q, u, u_dot: robot.rnea(q, u, u_dot, gravity, None))
    else:
        call = jax.jit(lambda q, u, tau: robot.forward_dynamics(q, u, tau, None))
    return Candidate("frax", lambda: call(*state))
