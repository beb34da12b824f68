"""Inverse and forward dynamics of the 7-joint arm over a batch, all leaves traced, against the peers.

Run as `python -m experiments.benchmarks.evaluation inverse|forward float32|float64 BATCH` it prints JSON of one comparison: so frax
is also timed with the XLA flags that it recommends.
"""

import json
import sys
from typing import Any

import jax
import numpy as np

import kanejax as kj
from experiments.benchmarks import peers, robots
from experiments.benchmarks.harness import (
    SEED,
    Candidate,
    Table,
    Timing,
    at_least,
    compare,
    effort,
    in_subprocess,
    least_ratio,
    ratio,
    report,
)

FUNCTIONS = {"inverse": kj.inverse_dynamics, "forward": kj.forward_dynamics}
# Name of the peer: the least ratio of its time to that of (all traced, specialized) kanejax, by function and data type.
TARGETS: dict[tuple[str, str, str], tuple[float | None, float | None]] = {
    ("inverse", "float64", "Pinocchio"): (3, 5),
    ("inverse", "float32", "Pinocchio"): (6, 10),
    ("inverse", "float32", "MJX"): (50, None),
    ("inverse", "float32", "frax"): (50, None),
    ("forward", "float64", "Pinocchio"): (4, 6),
    ("forward", "float32", "Pinocchio"): (7, 10),
    ("forward", "float32", "MJX"): (150, None),
    ("forward", "float32", "frax"): (40, None),
}
FRAX_FLAGS = "--xla_cpu_multi_thread_eigen=false --xla_cpu_scheduler_type=CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED"
TWO_DEVICES = "--xla_force_host_platform_device_count=2"
TOLERANCE = {"float32": 2e-4, "float64": 1e-9}


def run(quick: bool) -> None:
    """Time everything, and print the ratios."""
    tables, details = [], []
    for batch in (4096,) if quick else (4096, 65536):
        for dtype in ("float32", "float64"):
            for function in FUNCTIONS:
                with jax.enable_x64(dtype == "float64"):
                    timings = measure(function, dtype, batch, quick)
                # Other processes at other times: only the ratios within each are used.
                arguments = (function, dtype, str(batch), *(["--quick"] if quick else []))
                others = {"two devices": in_subprocess("sharded", *arguments, XLA_FLAGS=TWO_DEVICES)}
                if dtype == "float32":
                    others["with frax's flags"] = in_subprocess("evaluation", *arguments, XLA_FLAGS=FRAX_FLAGS)
                tables.append(_table(function, dtype, batch, timings, others))
                records = {name: timing.record for name, timing in timings.items()}
                details.append({"function": function, "dtype": dtype, "batch": batch, "others": others, "timings": records})
    report("evaluation", tables, details)


def measure(function: str, dtype: str, batch: int, quick: bool) -> dict[str, Timing]:
    """Time kanejax and the peers on the same states, once they agree."""
    robot = robots.iiwa14()
    at = robots.states(robot, batch, SEED)
    ours = kanejax_candidates(function, robot, at, dtype)
    reference = np.asarray(ours[0].run(), float)
    rivals = [peers.pinocchio(robot, at), peers.mujoco_batch(robot, at)]
    if dtype == "float32":
        rivals += [peers.mjx(robot, at, dtype), peers.mjx(robot, at, dtype, limits=True), peers.frax(at, dtype)]
    candidates = list(ours)
    for rival in rivals:
        call = getattr(rival, function)
        if call is not None:
            peers.verify(rival.name, call(), reference, TOLERANCE[dtype])
            candidates.append(Candidate(rival.name, call, batch))
    for own in ours[1:]:
        peers.verify(own.name, own.run(), reference, TOLERANCE[dtype])
    return compare(candidates, effort(quick))


def kanejax_candidates(function: str, robot: robots.Robot, at: robots.States, dtype: str) -> list[Candidate]:
    """The public function under vmap, the model an argument; and specialized, where that exists."""
    x = at.arrays(dtype)
    model = robot.model.astype(dtype)
    batch, last = len(at.q), x.u_dot if function == "inverse" else x.tau
    traced = jax.jit(jax.vmap(FUNCTIONS[function], (None, 0, 0, 0)))
    found = [Candidate("kanejax", lambda: traced(model, x.q, x.u, last), batch)]
    if hasattr(kj, "specialize"):
        frozen = kj.specialize(model)
        special = jax.jit(jax.vmap(lambda *state: FUNCTIONS[function](frozen, *state)))
        found.append(Candidate("kanejax specialized", lambda: special(x.q, x.u, last), batch))
    return found


def _table(function: str, dtype: str, batch: int, timings: dict[str, Timing], others: dict[str, Any]) -> Table:
    special = "kanejax specialized" in timings
    rows = []
    for name, timing in timings.items():
        targets = [value for key, value in TARGETS.items() if key[:2] == (function, dtype) and name.startswith(key[2])]
        traced_target, special_target = targets[0] if targets else (None, None)
        row: tuple = (name, timing.nanoseconds, ratio(timings, name, "kanejax"), least_ratio(timings, name, "kanejax"))
        row += (at_least(row[2], traced_target) if traced_target else "",)
        over = ratio(timings, name, "kanejax specialized") if special else ""
        row += (over, at_least(over, special_target) if special_target and special else "")
        rows.append(row)
    for label, other in others.items():
        for name, nanoseconds in other["nanoseconds"].items():
            over = (other["over_kanejax"][name], other["least_over_kanejax"][name])
            rows.append((f"{label}: {name}", nanoseconds, *over, "", other["over_specialized"].get(name, ""), ""))
    headers = ("", "ns an evaluation", "over kanejax", "least/least", "target", "over specialized", "target")
    return Table(f"{function} dynamics, iiwa14, batch {batch}, {dtype}", headers, rows)


def ratios(timings: dict[str, Timing]) -> dict[str, dict[str, float]]:
    """For another process: times, and ratios to kanejax."""
    special = "kanejax specialized"
    return {
        "nanoseconds": {name: timing.nanoseconds for name, timing in timings.items()},
        "over_kanejax": {name: ratio(timings, name, "kanejax") for name in timings},
        "least_over_kanejax": {name: least_ratio(timings, name, "kanejax") for name in timings},
        "over_specialized": {name: ratio(timings, name, special) for name in timings} if special in timings else {},
    }


if __name__ == "__main__":
    with jax.enable_x64(sys.argv[2] == "float64"):
        found = measure(sys.argv[1], sys.argv[2], int(sys.argv[3]), "--quick" in sys.argv)
    print(json.dumps(ratios(found)))
