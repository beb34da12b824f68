"""Timing that survives a drifting machine, and results as JSON and markdown tables.

All competitors of a table run in one process in turns (A B C A B C ...), so that a slow minute slows them all; a ratio is the
median over the turns of the ratio within a turn. The first call, which compiles, is timed apart.
"""

import importlib.metadata
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import jax

RESULTS = Path(__file__).parent / "results"
ROOT = Path(__file__).parents[2]
PACKAGES = ("kanejax", "jax", "jaxlib", "numpy", "equinox", "diffrax", "mujoco", "mujoco-mjx", "pin", "frax", "example-robot-data")
SEED = 0


class Effort(NamedTuple):
    """How often to measure, and how long one measurement takes at least."""

    rounds: int
    seconds: float


def effort(quick: bool) -> Effort:
    """What suits a final figure, or a look."""
    return Effort(4, 0.03) if quick else Effort(15, 0.2)


@dataclass(frozen=True)
class Candidate:
    """A function of no arguments that makes `evaluations` evaluations, and returns what is waited for."""

    name: str
    run: Callable[[], Any]
    evaluations: int = 1


@dataclass(frozen=True)
class Timing:
    """Seconds of the first call, and seconds an evaluation in every round."""

    name: str
    first_call: float
    samples: tuple[float, ...]

    @property
    def median(self) -> float:
        """Seconds an evaluation."""
        return statistics.median(self.samples)

    @property
    def nanoseconds(self) -> float:
        """Nanoseconds an evaluation."""
        return 1e9 * self.median

    @property
    def record(self) -> dict[str, Any]:
        """For the JSON."""
        return {"first_call": self.first_call, "median": self.median, "least": min(self.samples), "samples": self.samples}


def compare(candidates: Sequence[Candidate], level: Effort) -> dict[str, Timing]:
    """Time all candidates in turns."""
    first: dict[str, float] = {}
    calls: dict[str, int] = {}
    for candidate in candidates:
        first[candidate.name] = _seconds(candidate, 1)
        # Once to warm up, then to learn how many calls make a measurement.
        _seconds(candidate, 1)
        calls[candidate.name] = max(1, round(level.seconds / _seconds(candidate, 1)))
    samples: dict[str, list[float]] = {candidate.name: [] for candidate in candidates}
    for turn in range(level.rounds):
        # A different one starts each time, so that no one always follows the same other.
        for k in range(len(candidates)):
            candidate = candidates[(turn + k) % len(candidates)]
            count = calls[candidate.name]
            samples[candidate.name].append(_seconds(candidate, count) / count / candidate.evaluations)
    return {name: Timing(name, first[name], tuple(values)) for name, values in samples.items()}


def ratio(timings: dict[str, Timing], slow: str, fast: str) -> float:
    """How many times longer `slow` takes than `fast`: median over the rounds."""
    pairs = zip(timings[slow].samples, timings[fast].samples, strict=True)
    return statistics.median(a / b for a, b in pairs)


def least_ratio(timings: dict[str, Timing], slow: str, fast: str) -> float:
    """The same of the fastest rounds, which other programs on the machine disturbed least."""
    return min(timings[slow].samples) / min(timings[fast].samples)


def _seconds(candidate: Candidate, count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        jax.block_until_ready(candidate.run())
    return time.perf_counter() - start


@dataclass(frozen=True)
class Table:
    """A table of results."""

    title: str
    headers: tuple[str, ...]
    rows: list[tuple]

    def __str__(self) -> str:
        """Markdown."""
        cells = [self.headers, *(tuple(_cell(value) for value in row) for row in self.rows)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(self.headers))]
        lines = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |" for row in cells]
        lines.insert(1, "| " + " | ".join("-" * width for width in widths) + " |")
        return "\n".join([f"\n### {self.title}\n", *lines])


def _cell(value: Any) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def at_least(value: float, target: float) -> str:
    """The target, and whether it is reached."""
    return f">= {target:g} {'ok' if value >= target else 'MISSED'}"


def at_most(value: float, target: float) -> str:
    """The target, and whether it is kept."""
    return f"<= {target:g} {'ok' if value <= target else 'MISSED'}"


def report(name: str, tables: Sequence[Table], details: Any = None) -> None:
    """Print the tables, and write them to results/NAME.json with all that made them."""
    for table in tables:
        print(table, flush=True)
    record = {
        "benchmark": name,
        "tables": [{"title": table.title, "headers": table.headers, "rows": table.rows} for table in tables],
        "details": details,
        "seed": SEED,
        "versions": versions(),
        "device": device(),
    }
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(record, indent=1) + "\n")


def versions() -> dict[str, str | None]:
    """Versions of everything that is timed."""
    found: dict[str, str | None] = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = getattr(sys.modules.get(package), "__version__", None)
    return found


def device() -> dict[str, Any]:
    """Where it ran, and how busy that machine was."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    cpu = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    load = round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None
    return {"jax": jax.devices()[0].device_kind, "count": jax.device_count(), "cpu": cpu, "cores": os.cpu_count(), "load": load}


def in_subprocess(module: str, *arguments: str, **environment: str) -> Any:
    """Run `python -m experiments.benchmarks.MODULE ARGUMENTS` and read the last line it prints as JSON."""
    command = [sys.executable, "-m", f"experiments.benchmarks.{module}", *arguments]
    done = subprocess.run(command, cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command[1:])} failed:\n{done.stderr[-4000:]}")
    return json.loads(done.stdout.splitlines()[-1])
