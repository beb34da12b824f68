"""Every fault in one trajectory of a batch: what it reports, when it ended, and whether its neighbours noticed."""

import time
from pathlib import Path
from typing import Any

import diffrax
import jax
import numpy as np
from rich.progress import track

import kanejax as kj
from experiments.faults.cases import FAULTS, Case, disturbed, healthy, stacked
from experiments.thesis import record

TS = np.linspace(0.0, 1.0, 5)
WAYS: dict[str, dict[str, Any]] = {
    "adaptive": {},
    "equal steps": {"dt0": 0.01},
    "implicit": {"solver": diffrax.Kvaerno5(), "max_steps": 1000},
    "implicit, equal steps": {"solver": kj.BetaScheme(1.0), "dt0": 0.01},
}
DTYPES = ("float64", "float32")


def run(directory: Path, ways: tuple[str, ...] = tuple(WAYS)) -> dict:
    """Status, end and steps of each fault, by way and precision; and how many healthy neighbours lost their bits."""
    numbers: dict[str, Any] = {"faults": {name: {} for name in FAULTS}, "ways": {}}
    for way, dtype in track([(way, dtype) for way in ways for dtype in DTYPES], description="faults", transient=True):
        begin = time.perf_counter()
        found, without, faulty = outcome(dtype, WAYS[way])
        moved = sum(not identical(found, without, i) for i in np.flatnonzero(~faulty))
        healthy_ones = {kj.Status(int(status)).name for status in without.status}
        numbers["ways"][f"{way}, {dtype}"] = {
            "neighbours": int(np.sum(~faulty)),
            "neighbours_with_other_bits": moved,
            "statuses_without_faults": sorted(healthy_ones),
            "seconds": round(time.perf_counter() - begin, 1),
        }
        for name, i in zip(FAULTS, np.flatnonzero(faulty), strict=True):
            numbers["faults"][name][f"{way}, {dtype}"] = {
                "status": kj.Status(int(found.status[i])).name,
                "t_end": float(found.t_end[i]),
                "steps": int(found.stats["num_steps"][i]),
                "finite_where_reached": bool(np.isfinite(found.q[i][np.asarray(found.reached[i])]).all()),
            }
        record.write(directory, "trouble", numbers)
    (directory / "trouble.md").write_text(markdown(numbers, ways))
    # diffrax's implicit Runge-Kutta methods decide for a whole batch when to evaluate a Jacobian or a stage again.
    explicit = [way for name, way in numbers["ways"].items() if not name.startswith("implicit,")]
    record.require(not any(way["neighbours_with_other_bits"] for way in explicit), "healthy neighbours keep all their bits")
    return numbers


def outcome(dtype: str, options: dict[str, Any]) -> tuple[kj.Trajectory, kj.Trajectory, np.ndarray]:
    """The batch in which every other trajectory has a fault, the same without, and which have one."""
    bad, good, faulty = batches(dtype)
    return simulated(bad, options), simulated(good, options), faulty


def batches(dtype: str) -> tuple[Case, Case, np.ndarray]:
    """Trajectories of which every other has a fault, the same without faults, and which have one."""
    bad, good = [], []
    for seed, fault in enumerate(FAULTS.values()):
        case, neighbour = healthy(2 * seed), healthy(2 * seed + 1)
        bad += [fault(case), neighbour]
        good += [case, neighbour]
    return stacked(bad, dtype), stacked(good, dtype), np.arange(len(bad)) % 2 == 0


def simulated(case: Case, options: dict[str, Any]) -> kj.Trajectory:
    """The batch by `simulate_batch`, with room for a third of it at a time."""
    how = {"control": (disturbed, case.control), "control_axis": 0, "batch_size": 32, "threads": 2}
    return kj.simulate_batch(case.model, case.q, case.u, TS, **how, **options)


def identical(a: kj.Trajectory, b: kj.Trajectory, i: int) -> bool:
    """Whether all numbers of a trajectory are the same to the last bit."""
    return all(np.array_equal(x[i], y[i], equal_nan=True) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))


def markdown(numbers: dict, ways: tuple[str, ...]) -> str:
    """The table of docs/numerics.md: status and end, once where both precisions agree."""
    lines = [f"| fault | {' | '.join(ways)} |", "| --- |" + " --- |" * len(ways)]
    for name, found in numbers["faults"].items():
        cells = []
        for way in ways:
            double, single = (text(found[f"{way}, {dtype}"]) for dtype in DTYPES)
            cells.append(double if double == single else f"{double}; float32: {single}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def text(of: dict[str, Any]) -> str:
    """One cell: the status, and the time where it ended too soon."""
    status = of["status"].lower().replace("_", " ")
    return status if of["status"] == "SUCCESSFUL" else f"{status} at {of['t_end']:.2g}"
