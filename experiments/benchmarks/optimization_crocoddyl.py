"""Crocoddyl's FDDP on a motion of a fixed duration: limits and the goal as penalties, steps of the semi-implicit method of Euler.

Its actions are in C++, where all joints have motors and no damping; other tasks are not for it. Runs with the peers' interpreter.
"""

import statistics
import time
from typing import Any

import crocoddyl
import numpy as np

from experiments.benchmarks.optimization_dynamics import mechanism, pinocchio_model

# Weights of the goal and of the limits, raised one after another, for a static motion of size one; their effect ends below them.
WEIGHTS = ((1e2, 1e1, 30), (1e3, 1e2, 60), (1e4, 1e3, 300))
TOLERANCE = 1e-5


def is_possible(task: dict[str, Any]) -> bool:
    """Whether the task can be put to it."""
    driven = all(a != b for a, b in zip(*task["limits"]["tau"], strict=True))
    return driven and not task["is_free_in_time"] and not np.any(task["damping"])


def solved(task: dict[str, Any], repeats: int, threads: int = 1) -> dict[str, Any]:
    """A task from the straight line and the forces that hold the arm there, which serve it better than none."""
    steps, size = task["steps"], len(task["parents"])
    share = np.linspace(0.0, 1.0, steps + 1)[:, None]
    line = (1 - share) * np.array(task["start"]) + share * np.array(task["goal"])
    states = [np.concatenate((row, np.zeros(size))) for row in line]
    forces = list(_problem(task, 1.0, 1.0).quasiStatic(states[:-1]))
    scale = task["duration"][0] / steps * float(np.sum(np.square(forces)))
    problems = [(_problem(task, scale * goal, scale * limit), most) for goal, limit, most in WEIGHTS]
    seconds = []
    for _ in range(repeats):
        xs, us, iterations = states, forces, 0
        start = time.perf_counter()
        for problem, most in problems:
            problem.nthreads = threads
            solver = crocoddyl.SolverFDDP(problem)
            solver.th_stop = TOLERANCE
            done = solver.solve(xs, us, most, False)
            xs, us, iterations = list(solver.xs), list(solver.us), iterations + solver.iter
        seconds.append(time.perf_counter() - start)
    return {"seconds": statistics.median(seconds), "iterations": iterations, "converged": bool(done), **_told(task, solver)}


def _told(task: dict[str, Any], solver: Any) -> dict[str, float]:
    states, torques, size = np.array(solver.xs), np.array(solver.us), len(task["parents"])
    limits = {name: np.array(pair) for name, pair in task["limits"].items()}
    beyond = [np.abs(states[-1] - np.concatenate((task["goal"], np.zeros(size))))]
    for name, values in (("q", states[:, :size]), ("u", states[:, size:]), ("tau", torques)):
        beyond += [limits[name][0] - values, values - limits[name][1]]
    h = task["duration"][0] / task["steps"]
    return {"cost": float(h * np.sum(torques**2)), "violation": float(max(np.max(each) for each in beyond))}


def _problem(task: dict[str, Any], of_goal: float, of_limits: float) -> Any:
    state = crocoddyl.StateMultibody(pinocchio_model(mechanism(task)))
    actuation, size = crocoddyl.ActuationModelFull(state), len(task["parents"])
    h = task["duration"][0] / task["steps"]
    limits = {name: np.array(pair) for name, pair in task["limits"].items()}
    ends = [np.concatenate((task[name], np.zeros(size))) for name in ("start", "goal")]
    of_state, of_torque = np.concatenate((limits["q"], limits["u"]), 1), limits["tau"]
    control = crocoddyl.ResidualModelControl(state, size)
    at_zero = crocoddyl.ResidualModelState(state, np.zeros(2 * size), size)
    within = [crocoddyl.ActivationModelQuadraticBarrier(crocoddyl.ActivationBounds(*each)) for each in (of_state, of_torque)]
    costs, last = crocoddyl.CostModelSum(state, size), crocoddyl.CostModelSum(state, size)
    # Its costs are halves of squares.
    costs.addCost("torque", crocoddyl.CostModelResidual(state, control), 2.0)
    costs.addCost("state", crocoddyl.CostModelResidual(state, within[0], at_zero), of_limits)
    costs.addCost("force", crocoddyl.CostModelResidual(state, within[1], control), of_limits)
    last.addCost("goal", crocoddyl.CostModelResidual(state, crocoddyl.ResidualModelState(state, ends[1], size)), of_goal)
    running = _euler(state, actuation, costs, h)
    return crocoddyl.ShootingProblem(ends[0], [running] * task["steps"], _euler(state, actuation, last, 0.0))


def _euler(state: Any, actuation: Any, costs: Any, h: float) -> Any:
    dynamics = crocoddyl.DifferentialActionModelFreeFwdDynamics(state, actuation, costs)
    dynamics.armature = np.zeros(state.nv)
    return crocoddyl.IntegratedActionModelEuler(dynamics, h)
