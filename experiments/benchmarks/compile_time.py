"""Times of the first call: tracing, lowering, compiling and running once; and of a second start from the persistent cache."""

import json
import math
import sys
import tempfile
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.benchmarks import robots
from experiments.benchmarks.gradients import PARAMETERS, STATES, jitted
from experiments.benchmarks.harness import (
    SEED,
    Candidate,
    Table,
    at_most,
    compare,
    effort,
    in_subprocess,
    least_ratio,
    ratio,
    report,
)

BATCH = 4096
ROBOTS = {
    "iiwa14": robots.iiwa14,
    "talos": robots.talos,
    "tree40": lambda: robots.tree(40),
    "mixed40": lambda: robots.mixed_tree(40),
}
# The tree with ball joints takes minutes to compile: not for a look.
QUICK = ("iiwa14", "talos", "tree40")
CASES = [(function, kind) for kind in ("evaluation", STATES, PARAMETERS) for function in ("inverse", "forward")]
# Seconds for the humanoid; the tree of 40 bodies may take three times as long.
TARGETS = {("inverse", "evaluation"): 3.0, ("forward", "evaluation"): 6.0}
GRADIENT_TARGET, TREE_FACTOR = 8.0, 3.0
SECOND_START_TARGET, RUN_TARGET = 2.0, 6.0


def run(quick: bool) -> None:
    """Time the compiler for every robot and function, second starts, and the run time against the number of joints."""
    rows, details = [], []
    for dtype in ("float32",) if quick else ("float32", "float64"):
        for name in QUICK if quick else ROBOTS:
            with tempfile.TemporaryDirectory() as cache:
                first = in_subprocess("compile_time", name, dtype, **_cached(cache))
                second = in_subprocess("compile_time", name, dtype, **_cached(cache))
            details.append({"robot": name, "dtype": dtype, "first": first, "second": second})
            for (function, kind), start, again in zip(CASES, first, second, strict=True):
                target = TARGETS.get((function, kind), GRADIENT_TARGET) * (1.0 if name == "talos" else TREE_FACTOR)
                verdict = "" if name == "iiwa14" else at_most(start["total"], target)
                seconds = (start["trace"], start["compile"], start["cpu"], start["total"])
                row = (f"{name}, {dtype}: {function}, {kind}", *seconds, verdict)
                rows.append((*row, again["total"], at_most(again["total"], SECOND_START_TARGET)))
    headers = ("", "trace and lower, s", "compile, s", "CPU time, s", "first call, s", "target", "second start, s", "target")
    tables = [Table(f"First calls, batch {BATCH}", headers, rows), _run_times(quick)]
    report("compile_time", tables, details)


def _cached(folder: str) -> dict[str, str]:
    return {
        "JAX_COMPILATION_CACHE_DIR": folder,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }


def _run_times(quick: bool) -> Table:
    """Evaluations of the humanoid and the trees against those of the arm."""
    rows = []
    names = QUICK if quick else tuple(ROBOTS)
    for dtype in ("float32", "float64"):
        with jax.enable_x64(dtype == "float64"):
            for function in ("inverse", "forward"):
                candidates = []
                for name in names:
                    call, arguments = _call(name, function, "evaluation", dtype)
                    candidates.append(Candidate(name, lambda call=call, arguments=arguments: call(*arguments), BATCH))
                timings = compare(candidates, effort(quick))
                arm = timings["iiwa14"].nanoseconds
                rows.append((f"{function}, {dtype}: iiwa14", arm, "", "", ""))
                for name in names[1:]:
                    times, least = ratio(timings, name, "iiwa14"), least_ratio(timings, name, "iiwa14")
                    verdict = at_most(times, RUN_TARGET) if (function, name) == ("inverse", "talos") else ""
                    rows.append((f"{function}, {dtype}: {name}", timings[name].nanoseconds, times, least, verdict))
    return Table(f"Run time an evaluation, batch {BATCH}", ("", "ns", "over iiwa14", "least/least", "target"), rows)


def _call(name: str, function: str, kind: str, dtype: str) -> tuple[Any, tuple]:
    robot = ROBOTS[name]()
    x = robots.states(robot, BATCH, SEED).arrays(dtype)
    call, weighted = jitted(function, kind)
    weights = (jnp.asarray(np.random.default_rng(SEED).normal(size=x.u.shape), dtype),) if weighted else ()
    return call, (robot.model.astype(dtype), *weights, x.q, x.u, x.u_dot if function == "inverse" else x.tau)


def main(name: str, dtype: str) -> list[dict[str, float]]:
    """First calls of everything for one robot, each with JAX's caches in memory cleared before."""
    jax.config.update("jax_enable_x64", dtype == "float64")
    found = []
    for function, kind in CASES:
        call, arguments = _call(name, function, kind, dtype)
        jax.block_until_ready(arguments)
        jax.clear_caches()
        try:
            found.append(_first_call(call, arguments))
        except Exception as error:
            print(f"{name}: {function}, {kind} failed: {type(error).__name__}", file=sys.stderr)
            found.append(dict.fromkeys(("trace", "compile", "total", "cpu"), math.inf))
    return found


def _first_call(call: Any, arguments: tuple) -> dict[str, float]:
    """Seconds of its parts, in all, and of all threads."""
    busy, start = time.process_time(), time.perf_counter()
    lowered = call.lower(*arguments)
    traced = time.perf_counter()
    compiled = lowered.compile()
    made = time.perf_counter()
    jax.block_until_ready(compiled(*arguments))
    total, cpu = time.perf_counter() - start, time.process_time() - busy
    return {"trace": traced - start, "compile": made - traced, "total": total, "cpu": cpu}


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], sys.argv[2])))
