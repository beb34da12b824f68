"""A task as a problem for CasADi: one step in symbols, bounds and the first guess. Runs with the peers' interpreter."""

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from experiments.benchmarks.optimization_dynamics import Mechanism, forward_dynamics, inverse_dynamics, mechanism


class Stage(NamedTuple):
    """One step in symbols: state, control and parameters; next state, cost and rows that have bounds."""

    x: ca.SX
    w: ca.SX
    p: ca.SX
    after: ca.SX
    cost: ca.SX
    rows: ca.SX


class Bounds(NamedTuple):
    """Of all unknowns and all constraints, the first guess, and the parameters."""

    lbx: np.ndarray
    ubx: np.ndarray
    lbg: np.ndarray
    ubg: np.ndarray
    x0: np.ndarray
    p: np.ndarray


def one_stage(task: dict[str, Any], varied: tuple[str, ...]) -> Stage:
    """A step of the task; what is varied of mass and com are parameters beside the duration."""
    of, free = mechanism(task), task["is_free_in_time"]
    size = len(of.parents)
    driven = _driven(task)
    x, w = ca.SX.sym("x", 2 * size + free), ca.SX.sym("w", size if task["dynamics"] == "inverse" else len(driven))
    duration = x[-1] if free else ca.SX.sym("duration")
    h, parameters = duration / task["steps"], [] if free else [duration]
    for name in varied:
        symbol = ca.SX.sym(name, np.size(task[name]))
        parameters.append(symbol)
        of = of._replace(**_varied(of, name, symbol))
    q, u = x[:size], x[size : 2 * size]
    after, tau, limited = _STEPS[task["dynamics"], task["integrator"]](task, of, q, u, w, h, driven)
    cost = h * ca.sumsqr(tau) if task["cost"] == "torque" else ca.SX(0)
    rows = tau if limited else ca.SX(0, 1)
    return Stage(x, w, ca.vertcat(*parameters), ca.vertcat(*after, *([x[-1]] if free else [])), cost, rows)


def _varied(of: Mechanism, name: str, symbol: ca.SX) -> dict[str, Any]:
    """Masses and centres as symbols."""
    if name == "mass":
        return {"masses": ca.vertsplit(symbol)}
    return {"centers": [symbol[3 * k : 3 * k + 3] - of.anchors[k] for k in range(len(of.parents))]}


def _driven(task: dict[str, Any]) -> list[int]:
    """Joints with a motor."""
    least, greatest = task["limits"]["tau"]
    return [k for k, (a, b) in enumerate(zip(least, greatest, strict=True)) if a != b]


def _inverse(task: dict, of: Mechanism, q: ca.SX, u: ca.SX, w: ca.SX, h: ca.SX, driven: list[int]) -> tuple:
    if task["integrator"] == "euler":
        tau, speed = inverse_dynamics(of, q, u, w), u + h * w
        return (q + h * speed, speed), tau, True
    speed = u + 0.5 * h * w
    tau = inverse_dynamics(of, q + 0.5 * h * (u + 0.25 * h * w), speed, w)
    return (q + h * speed, u + h * w), tau, True


def _forward(task: dict, of: Mechanism, q: ca.SX, u: ca.SX, w: ca.SX, h: ca.SX, driven: list[int]) -> tuple:
    tau = ca.SX.zeros(len(of.parents))
    tau[driven] = w
    if task["integrator"] == "euler":
        speed = u + h * forward_dynamics(of, q, u, tau)
        return (q + h * speed, speed), w, False
    d = h / task["substeps"]
    for _ in range(task["substeps"]):
        at, rates = (q, u), []
        for ahead in (0.5, 0.5, 1.0, None):
            rates.append((at[1], forward_dynamics(of, at[0], at[1], tau)))
            if ahead is not None:
                at = q + ahead * d * rates[-1][0], u + ahead * d * rates[-1][1]
        q, u = (y + d / 6 * (a + 2 * b + 2 * c + e) for y, a, b, c, e in zip((q, u), *rates, strict=True))
    return (q, u), w, False


_STEPS: dict[tuple[str, str], Callable] = {
    ("inverse", "euler"): _inverse,
    ("inverse", "midpoint"): _inverse,
    ("forward", "euler"): _forward,
    ("forward", "rk4"): _forward,
}


def bounds_and_guess(task: dict[str, Any], varied: tuple[str, ...]) -> Bounds:
    """Unknowns are x0, w0, x1, ... xN; constraints are the next state and the rows of each stage."""
    steps, free, driven = task["steps"], task["is_free_in_time"], _driven(task)
    size = len(task["parents"])
    limits = {name: np.array(pair) for name, pair in task["limits"].items()}
    duration = np.array(task["duration"])[:, None][:, : int(free)]
    of_state = np.concatenate((limits["q"], limits["u"], duration), 1)
    inverse = task["dynamics"] == "inverse"
    of_control = np.array([[-np.inf], [np.inf]]) * np.ones((1, size)) if inverse else limits["tau"][:, driven]
    of_rows = limits["tau"] if inverse else np.zeros((2, 0))
    states = np.repeat(of_state[:, None], steps + 1, 1)
    ends = [np.concatenate((task[name], np.zeros(size))) for name in ("start", "goal")]
    states[:, 0, : 2 * size], states[:, -1, : 2 * size] = ends
    controls = np.repeat(of_control[:, None], steps, 1)
    lower, upper = (np.append(np.concatenate((states[i, :-1], controls[i]), 1), states[i, -1]) for i in (0, 1))
    rows = np.repeat(np.concatenate((np.zeros((2, states.shape[2])), of_rows), 1)[:, None], steps, 1).reshape(2, -1)
    share = np.linspace(0.0, 1.0, steps + 1)[:, None]
    line = np.concatenate(((1 - share) * ends[0] + share * ends[1], np.full((steps + 1, int(free)), np.mean(task["duration"]))), 1)
    guess = np.append(np.concatenate((line[:-1], np.zeros((steps, controls.shape[2]))), 1), line[-1])
    numbers = [[] if free else task["duration"][:1], *(np.ravel(task[name]) for name in varied)]
    return Bounds(lower, upper, rows[0], rows[1], guess, np.concatenate(numbers))


def last_cost(task: dict[str, Any], x: Any) -> Any:
    """Of the last state: the duration, if it is what counts."""
    return x[-1] if task["cost"] == "duration" else 0
