"""Which bits depend on what: calls, processes, the size of batches, the place in one, threads, and the number of devices."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.progress import track

import kanejax as kj
from experiments.faults.cases import MECHANISM
from experiments.thesis import record

COUNT = 256
SIZES = (256, 128, 100, 64, 48, 32, 31, 16, 8, 7, 4, 3, 1)
TS = np.linspace(0.0, 1.0, 5)
OPTIONS: dict[str, dict[str, Any]] = {"adaptive": {}, "equal steps": {"dt0": 0.01}}
PROCESSES = {
    "once more": "",
    "one thread of XLA": "--xla_cpu_multi_thread_eigen=false",
    "two devices": "--xla_force_host_platform_device_count=2",
    "four devices": "--xla_force_host_platform_device_count=4",
}


def run(directory: Path) -> dict:
    """Shares of identical trajectories, and the largest differences."""
    numbers: dict[str, Any] = {"trajectories": COUNT, "sizes": {}}
    for dtype, way in track([(d, w) for d in ("float64", "float32") for w in OPTIONS], description="determinism", transient=True):
        whole = moved(dtype, way, range(COUNT), batch_size=32, threads=1)
        of = {}
        for size in SIZES:
            of[str(size)] = difference(moved(dtype, way, range(min(COUNT, 8 * size)), batch_size=size, threads=1), whole)
        of["two threads"] = difference(moved(dtype, way, range(COUNT), batch_size=32, threads=2), whole)
        turned = moved(dtype, way, range(COUNT - 1, -1, -1), batch_size=32, threads=1)
        of["in reverse order"] = difference(jax.tree.map(lambda x: x[::-1], turned), whole)
        numbers["sizes"][f"{way}, {dtype}"] = of
        record.write(directory, "determinism", numbers)
    here = in_process("")
    numbers["processes"] = {name: in_process(flags) == here for name, flags in PROCESSES.items()}
    record.write(directory, "determinism", numbers)
    (directory / "determinism.md").write_text(markdown(numbers))
    return numbers


def moved(dtype: str, way: str, rows: Any, **how: Any) -> kj.Trajectory:
    """Some of the trajectories, which are the same in every call."""
    rng, rows = np.random.default_rng(record.SEED), np.array(rows)
    model = kj.load(MECHANISM).astype(dtype)
    q, u = rng.normal(size=(COUNT, model.nq)).astype(dtype), rng.normal(size=(COUNT, model.nv)).astype(dtype)
    return kj.simulate_batch(model, q[rows], u[rows], TS, **how, **OPTIONS[way])


def difference(found: kj.Trajectory, whole: kj.Trajectory) -> dict[str, float]:
    """Share of trajectories that have all bits of those of the whole, and the largest difference of coordinates."""
    count = len(found.q)
    same = (found.q == whole.q[:count]).all((1, 2)) & (found.u == whole.u[:count]).all((1, 2))
    return {"identical": float(np.mean(same)), "largest": float(np.max(abs(found.q - whole.q[:count])))}


def in_process(flags: str) -> dict[str, str]:
    """Hashes of results, from a process of its own."""
    environment = os.environ | {"XLA_FLAGS": flags}
    command = [sys.executable, "-m", "experiments.faults.determinism"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=600, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def hashes() -> dict[str, str]:
    """Of the results of each precision and way."""
    found = {}
    for dtype in ("float64", "float32"):
        for way in OPTIONS:
            trajectory = moved(dtype, way, range(64), batch_size=32, threads=2)
            found[f"{way}, {dtype}"] = hashlib.sha256(trajectory.q.tobytes() + trajectory.u.tobytes()).hexdigest()
    return found


def markdown(numbers: dict) -> str:
    """The table of docs/numerics.md."""
    lines = [f"| batch_size | {' | '.join(numbers['sizes'])} |", "| --- |" + " --- |" * len(numbers["sizes"])]
    for row in (*map(str, SIZES), "two threads", "in reverse order"):
        lines.append(f"| {row} | {' | '.join(text(of[row]) for of in numbers['sizes'].values())} |")
    return "\n".join(lines) + "\n"


def text(of: dict[str, float]) -> str:
    """One cell."""
    return "same bits" if of["identical"] == 1 else f"{of['identical']:.0%}, {of['largest']:.0e}"


if __name__ == "__main__":
    print(json.dumps(hashes()))
