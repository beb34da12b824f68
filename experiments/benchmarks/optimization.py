"""Optimal motions: the reference problems from a straight line of states and no forces, and from many other guesses.

Swing-ups hold the force during each of 50 steps and take four steps of Runge and Kutta's method in it; the Panda takes steps of the
semi-implicit method of Euler: so costs can be compared with those of CasADi and IPOPT (3.14.19) on the same transcription, which
come from another machine. Costs are h times the sum of the squared forces.
"""

import functools
import time
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import kanejax as kj
from experiments.benchmarks.harness import Candidate, Table, at_most, compare, effort, report
from experiments.benchmarks.identification import panda

STARTS, BEND = 64, 2.0
# Relative to the reference.
TARGET = 1e-3
PENDULUM = """<mujoco><worldbody><body><joint name="hinge" axis="0 1 0" damping=".1"/>
  <inertial pos="0 0 -1" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody></mujoco>"""
CART_POLE = """<mujoco><worldbody><body><joint name="slide" type="slide" axis="1 0 0" range="-2 2" limited="true"/>
  <inertial pos="0 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/>
  <body><joint name="hinge" axis="0 -1 0"/><inertial pos="0 0 -.5" mass=".3" diaginertia="1e-9 1e-9 1e-9"/></body>
  </body></worldbody></mujoco>"""
START, GOAL = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785), (1.2, 0.4, -0.6, -1.4, 0.5, 2.2, -0.5)


class Problem(NamedTuple):
    """A task, the cost that CasADi and IPOPT find from the same guess, and the best cost known, if others found them."""

    name: str
    task: kj.MotionTask
    reference: float | None
    best: float | None


def problems() -> list[Problem]:
    """The reference problems."""
    swing = {"dynamics": "forward", "substeps": 4}
    pendulum, cart, arm = kj.load(PENDULUM), kj.load(CART_POLE), panda().model
    limits = kj.Limits(arm, u=np.array([2.175] * 4 + [2.61] * 3), tau=np.array([87.0] * 4 + [12.0] * 3))
    reach = functools.partial(kj.MotionTask, arm, np.array(START), np.array(GOAL), limits=limits)
    upright = kj.MotionTask(
        pendulum, [0.0], [np.pi], 4.0, kj.costs.torque(), limits=kj.Limits(pendulum, q=10.0, u=20.0, tau=5.0), **swing
    )
    aside = kj.MotionTask(
        cart, [0.0, 0.0], [1.0, np.pi], 2.0, kj.costs.torque(), limits=kj.Limits(cart, tau=20.0, passive=("hinge",)), **swing
    )
    return [
        Problem("pendulum", upright, 41.142, 29.409),
        Problem("cart-pole", aside, 59.130, 58.339),
        Problem("Panda, 1 s", reach(duration=1.0, costs=kj.costs.torque(), integrator="euler"), 903.698, None),
        Problem(
            "Panda, 1 s, forward dynamics",
            reach(duration=1.0, costs=kj.costs.torque(), dynamics="forward", integrator="euler"),
            903.698,
            None,
        ),
        Problem("Panda, least time", reach(duration=(0.2, 3.0), costs=kj.costs.duration()), None, None),
    ]


def run(quick: bool) -> None:
    """Solve each problem from a straight line, and where there is a better optimum from bent lines too."""
    with jax.enable_x64(True):
        rows = []
        for problem in problems():
            rows.append(_from_a_line(problem, quick))
            if problem.best is not None and not quick:
                rows.append(_from_many(problem))
    headers = ("", "cost", "CasADi + IPOPT", "converged", "iterations", "ms, once compiled", "first call, s", "target")
    report("optimization", [Table("Optimal motions, 50 steps, tolerance 1e-8, float64", headers, rows)], {})


def _from_a_line(problem: Problem, quick: bool) -> tuple:
    solve = jax.jit(lambda task: kj.optimal_motion(task))
    motion: list[kj.OptimalMotion] = []

    def once() -> kj.OptimalMotion:
        motion[:] = [solve(problem.task)]
        return motion[0]

    timing = compare([Candidate(problem.name, once)], effort(quick))[problem.name]
    (found,) = motion
    verdict = "" if problem.reference is None else at_most(float(found.cost), problem.reference * (1.0 + TARGET))
    numbers = int(found.iterations), 1e3 * timing.median, timing.first_call
    return (problem.name, float(found.cost), problem.reference or "", bool(found.converged), *numbers, verdict)


def _from_many(problem: Problem) -> tuple:
    assert problem.best is not None
    guesses = bent(problem.task)
    solve = jax.jit(jax.vmap(lambda guess: kj.optimal_motion(problem.task, guess)))
    first, found = _timed(lambda: solve(guesses))
    seconds, _ = _timed(lambda: solve(guesses))
    ended = np.asarray(found.converged)
    cost = float(np.asarray(found.cost)[ended].min())
    name, converged = f"{problem.name}, best of {STARTS} guesses by vmap", f"{ended.sum()} of {STARTS}"
    numbers = int(found.iterations.max()), 1e3 * seconds, first
    return (name, cost, problem.best, converged, *numbers, at_most(cost, problem.best * (1.0 + TARGET)))


def bent(task: kj.MotionTask) -> kj.Guess:
    """Straight lines with three waves of random height on all coordinates and speeds."""
    line = kj.straight_guess(task)
    heights = BEND * np.random.default_rng(0).normal(size=(STARTS, 3, 2, task.model.nv))
    waves = np.sin(np.pi * np.outer(np.arange(1, 4), np.linspace(0.0, 1.0, task.steps + 1)))
    bends = jnp.asarray(np.einsum("swpv,wn->spnv", heights, waves))
    many = jax.tree.map(lambda x: jnp.broadcast_to(x[None], (STARTS, *x.shape)), line)
    return kj.Guess(many.q + bends[:, 0], many.u + bends[:, 1], many.u_dot, many.tau, many.duration)


def _timed(function: Callable[[], kj.OptimalMotion]) -> tuple[float, kj.OptimalMotion]:
    begin = time.perf_counter()
    found = jax.block_until_ready(function())
    return time.perf_counter() - begin, found
