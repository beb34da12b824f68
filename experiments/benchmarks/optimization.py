"""Optimal motions: the reference problems from a straight line of states and no forces, and from many other guesses.

The peers get the same transcriptions and guesses: CasADi and IPOPT, and Crocoddyl's FDDP where it can be put to a task. They run by
the interpreter that KANEJAX_OPTIMIZATION_PYTHON names; without, costs are compared with those that they found before.
"""

import functools
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

import kanejax as kj
from experiments.benchmarks.harness import ROOT, Candidate, Table, at_least, at_most, compare, effort, report
from experiments.benchmarks.optimization_problems import BATCH, Batch, Problem, batches, exported, problems

STARTS, BEND = 64, 2.0
SAMPLE, QUICK_SAMPLE = 32, 8
# Relative to the reference: for costs, and for durations.
TARGET, TARGET_OF_TIME = 1e-3, 1e-2
# Of batches: times faster than a loop over the peers, and the part of the tasks that converges.
FASTER, CONVERGED = 10.0, 0.95
CHANCES = 3


def run(quick: bool) -> None:
    """Solve each problem from a straight line, and where there is a better optimum from bent lines too."""
    with jax.enable_x64(True):
        peer, details = peer_interpreter(), {}
        ours, against, many = [], [], []
        for problem in problems():
            found, timing = _from_a_line(problem, quick)
            ours.append(_row(problem, found, timing))
            if problem.best is not None and not quick:
                ours.append(_from_many(problem))
            if peer is not None:
                told = details[problem.name] = _by_peers(peer, {"task": exported(problem.task), "repeats": 3 if quick else 7})
                against.append(_beside(problem, found, timing.median, told))
        if peer is not None:
            for each in batches():
                row, details[f"batch, {each.name}"] = batch(each, peer, quick)
                many.append(row)
    tables = [Table("Optimal motions, 50 steps, tolerance 1e-8, float64", HEADERS, ours)]
    if peer is not None:
        tables.append(Table("The same beside CasADi + IPOPT and Crocoddyl's FDDP (one thread or two, the faster)", BESIDE, against))
        sample = QUICK_SAMPLE if quick else SAMPLE
        tables.append(Table(f"{BATCH} tasks at once; the first {sample} of them one after another by the peers", OF_BATCHES, many))
    report("optimization", tables, details)


HEADERS = ("", "cost", "reference", "converged", "iterations", "ms, once compiled", "first call, s", "off in MuJoCo", "target")
BESIDE = (
    *("", "cost", "IPOPT", "FDDP", "FDDP's violation", "iterations", "IPOPT", "FDDP", "ms", "IPOPT", "FDDP"),
    *("times faster than IPOPT", "ms an iteration", "IPOPT", "FDDP", "target for the cost", "target for an iteration"),
)
OF_BATCHES = (
    *("", "ms a task", "converged", "iterations", "from a straight line", "IPOPT", "converged", "iterations"),
    *("same cost", "lower", "higher", "FDDP", "converged", "times faster than IPOPT", "than FDDP", "target", "target"),
    "target for convergence",
)


def _from_a_line(problem: Problem, quick: bool) -> tuple[kj.OptimalMotion, Any]:
    solve = jax.jit(lambda task: kj.optimal_motion(task))
    motion: list[kj.OptimalMotion] = []

    def once() -> kj.OptimalMotion:
        motion[:] = [solve(problem.task)]
        return motion[0]

    timing = compare([Candidate(problem.name, once)], effort(quick))[problem.name]
    return motion[0], timing


def _row(problem: Problem, found: kj.OptimalMotion, timing: Any) -> tuple:
    verdict = at_most(_counted(found), problem.reference * (1.0 + _room(problem)))
    numbers = int(found.iterations), 1e3 * timing.median, timing.first_call
    # At the end, where MuJoCo applies the forces to the same robot.
    off = float(np.abs(kj.replayed_by_mujoco(problem.task.model, found).q[-1]).max())
    return (problem.name, float(found.cost), problem.reference, bool(found.converged), *numbers, off, verdict)


def _beside(problem: Problem, found: kj.OptimalMotion, seconds: float, told: dict) -> tuple:
    """Numbers of the peers beside ours, and the verdicts."""
    cost, iterations = float(found.cost), int(found.iterations)
    good = [each for each in told["ipopt"] if each["converged"]]
    ipopt = min(good or told["ipopt"], key=lambda each: each["seconds"])
    fddp = None if told["crocoddyl"] is None else min(told["crocoddyl"], key=lambda each: each["seconds"])
    each_iteration = [None if one is None else 1e3 * one["seconds"] / one["iterations"] for one in (ipopt, fddp)]
    own = 1e3 * seconds / iterations
    values = [("" if fddp is None else fddp[name]) for name in ("cost", "violation", "iterations")]
    of_cost = at_most(_counted(found), ipopt["cost"] * (1.0 + _room(problem))) if good else "IPOPT fails"
    return (
        *(problem.name, cost, ipopt["cost"], values[0], values[1], iterations, ipopt["iterations"], values[2]),
        *(1e3 * seconds, 1e3 * ipopt["seconds"], "" if fddp is None else 1e3 * fddp["seconds"], ipopt["seconds"] / seconds),
        *(own, each_iteration[0], each_iteration[1] or "", of_cost),
        "" if each_iteration[1] is None else at_most(own, each_iteration[1]),
    )


def _counted(found: kj.OptimalMotion) -> float:
    """The cost, if it is that of a motion."""
    return float(found.cost) if found.converged else float("inf")


def _room(problem: Problem) -> float:
    return TARGET_OF_TIME if problem.task.is_free_in_time else TARGET


def batch(each: Batch, peer: str, quick: bool) -> tuple[tuple, dict]:
    """All of many tasks on all cores, and a sample of them one after another by the peers."""
    count = QUICK_SAMPLE if quick else SAMPLE
    told = _by_peers(peer, {"tasks": [exported(task) for task in each.rows(count)]})
    rows = each.arrays, np.zeros((len(each.arrays[0]), 2, 3, each.rows(1)[0].model.nv))

    def task(row: tuple) -> tuple[kj.MotionTask, kj.Guess]:
        arrays, heights = row
        asked = each.task(*arrays)
        return asked, kj.bent_guess(asked, heights)

    kj.optimize_batch(task, jax.tree.map(lambda x: x[:1], rows))
    seconds, (found, at_once) = _timed(lambda: _with_second_chances(task, rows))
    own: dict[str, Any] = {"seconds": [seconds / len(found.cost)]}
    own |= {name: np.asarray(getattr(found, name)).tolist() for name in ("cost", "converged", "iterations")}
    sample = {name: values[:count] for name, values in own.items()}
    ours, ipopt, fddp = _means(own), _means(told["ipopt"]), _of_fddp(told)
    ratios = [other / ours[0] if other else "" for other in (ipopt[0], fddp[0])]
    verdicts = [at_least(ratio, FASTER) if ratio else "" for ratio in ratios]
    enough = at_least(float(np.mean(own["converged"])), CONVERGED)
    row = each.name, *ours, at_once, *ipopt, *_compared(sample, told["ipopt"]), *fddp, *ratios, *verdicts, enough
    return row, {"kanejax": own, **told}


def _with_second_chances(task: Callable, rows: tuple) -> tuple[kj.OptimalMotion, int]:
    """Searches that do not converge from a straight line start again from bent ones; and how many did from it."""
    found, (arrays, none), rng = kj.optimize_batch(task, rows), rows, np.random.default_rng(1)
    at_once = int(np.sum(found.converged))
    for _ in range(CHANCES):
        failed = np.flatnonzero(~np.asarray(found.converged))
        if len(failed) == 0:
            break
        heights = BEND * rng.normal(size=none[failed].shape)
        again = kj.optimize_batch(task, (tuple(x[failed] for x in arrays), heights))
        for whole, part in zip(jax.tree.leaves(found), jax.tree.leaves(again), strict=True):
            whole[failed] = part
    return found, at_once


def _means(solved: dict[str, Any]) -> tuple[Any, ...]:
    converged = f"{sum(solved['converged'])} of {len(solved['converged'])}"
    return 1e3 * float(np.mean(solved["seconds"])), converged, float(np.mean(solved["iterations"]))


def _compared(own: dict[str, Any], other: dict[str, Any]) -> tuple[int, int, int]:
    """Of the tasks on which both converge, on how many the cost is the same, lower and higher."""
    both = np.array(own["converged"]) & np.array(other["converged"])
    excess = (np.array(own["cost"]) / np.array(other["cost"]) - 1.0)[both]
    return int(np.sum(np.abs(excess) <= TARGET)), int(np.sum(excess < -TARGET)), int(np.sum(excess > TARGET))


def _of_fddp(told: dict[str, Any]) -> tuple[Any, Any]:
    if told["crocoddyl"] is None:
        return "", ""
    names = ("seconds", "converged", "iterations")
    return _means({name: [one[name] for one in told["crocoddyl"]] for name in names})[:2]


def _from_many(problem: Problem) -> tuple:
    assert problem.best is not None
    heights = BEND * np.random.default_rng(0).normal(size=(STARTS, 2, 3, problem.task.model.nv))
    solve = functools.partial(kj.optimize_batch, lambda row: (problem.task, kj.bent_guess(problem.task, row)))
    first, found = _timed(lambda: solve(heights))
    seconds, _ = _timed(lambda: solve(heights))
    ended = np.asarray(found.converged)
    cost = float(np.asarray(found.cost)[ended].min())
    name, converged = f"{problem.name}, best of {STARTS} guesses", f"{ended.sum()} of {STARTS}"
    numbers = int(found.iterations.max()), 1e3 * seconds, first
    return (name, cost, problem.best, converged, *numbers, "", at_most(cost, problem.best * (1.0 + TARGET)))


def _timed[T](function: Callable[[], T]) -> tuple[float, T]:
    begin = time.perf_counter()
    found = jax.block_until_ready(function())
    return time.perf_counter() - begin, found


def peer_interpreter() -> str | None:
    """The interpreter that has the peers, or None with a word about it."""
    python = os.environ.get("KANEJAX_OPTIMIZATION_PYTHON")
    if python is None:
        print("the peers are not measured: set KANEJAX_OPTIMIZATION_PYTHON to a python with casadi, crocoddyl and pin")
        return None
    done = subprocess.run([python, "-c", "import casadi, crocoddyl, pinocchio"], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"KANEJAX_OPTIMIZATION_PYTHON is {python}, which has not all of the peers:\n{done.stderr[-2000:]}")
    return python


def _by_peers(python: str, asked: dict) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "asked.json"
        path.write_text(json.dumps(asked))
        command = [str(Path(python).absolute()), "-m", "experiments.benchmarks.optimization_peers", str(path)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"the peers failed:\n{done.stderr[-4000:]}")
    return json.loads(done.stdout.splitlines()[-1])
