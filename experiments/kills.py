"""Kill `kanejax identify` and `kanejax optimize` at random times, resume them, and compare their ends with those of unbroken runs.

`python -m experiments.kills` prints and writes what was killed when, and whether all files were the same to the last bit: records,
but for the time that they took, tables, models and arrays.
"""

import argparse
import collections
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

import kanejax as kj

ARM = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.15 0.01 -0.2"/><mass value="2"/>
<inertia ixx="0.05" iyy="0.05" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.05 0 -0.2"/><mass value="{mass}"/>
<inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="tool"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="12" velocity="3"/><dynamics damping="0.1" friction="0.1"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 -0.5"/><axis xyz="0 1 0"/>
<limit lower="-2.5" upper="2.5" effort="5" velocity="3"/><dynamics damping="0.05"/></joint>
<joint name="end" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0 0 -0.4"/></joint></robot>"""
CONFIGURATION = """
[[unknown]]
leaf = "inertia"
[[unknown]]
leaf = "damping"
[[unknown]]
leaf = "friction_width"
of = "shoulder"
[[unknown]]
leaf = "coulomb_friction"
[identify]
stages = ["inverse dynamics", "simulation"]
robust = true
starts = 2
[simulation]
windows = [0.5, "none"]
substeps = 2
"""
INTERVAL = 0.2


class Job(NamedTuple):
    """A command: its arguments, the record that it writes, what its log says of every round, and when it has computed all."""

    name: str
    arguments: list[str]
    record: str
    round: str
    end: str


def write_inputs(folder: Path) -> list[Job]:
    """Make the files that the commands read."""
    (folder / "arm.urdf").write_text(ARM.format(mass=1))
    ts, random = np.arange(0.0, 6.0, 0.01), np.random.default_rng(0)
    rates, phases, sizes = np.array([0.9, 2.3, 3.1, 4.7]), random.uniform(0, 6, (2, 4, 1)), random.normal(size=(2, 4, 1))
    waves = rates[:, None] * ts + phases
    q, u, u_dot = (
        np.sum(sizes * rates[:, None] ** power * wave(waves), 1).T
        for power, wave in ((-1, np.sin), (0, np.cos), (1, lambda x: -np.sin(x)))
    )
    with jax.enable_x64(True):
        true = kj.load(ARM.format(mass=1.6))
        effort = np.asarray(jax.vmap(lambda *state: kj.inverse_dynamics(true, *state))(q, u, u_dot))
    effort, q = effort + 0.05 * random.normal(size=effort.shape), q + 1e-4 * random.normal(size=q.shape)
    header = "time,position_shoulder,position_elbow,effort_shoulder,effort_elbow"
    np.savetxt(folder / "log.csv", np.column_stack((ts, q, effort)), delimiter=",", header=header, comments="")
    (folder / "id.toml").write_text(CONFIGURATION)
    task = subprocess.run([*_command(), "optimize", "--example"], capture_output=True, text=True, check=True).stdout
    for old, new in {"# guesses = 64": "guesses = 24"}.items():
        assert old in task, old
        task = task.replace(old, new)
    (folder / "task.toml").write_text(task)
    return [
        Job("identify", ["arm.urdf", "log.csv", "--config", "id.toml"], "identification.json", ": round ", "simulation: ended"),
        Job("optimize", ["task.toml"], "motion.json", ": iteration ", "optimal after"),
    ]


def _command() -> list[str]:
    return [sys.executable, "-m", "kanejax.cli"]


def start(job: Job, folder: Path, out: str) -> subprocess.Popen:
    """A process of the command, which goes on with what is in the folder."""
    arguments = [job.name, *job.arguments, "--out", out, "--resume", "--checkpoint-interval", str(INTERVAL)]
    return subprocess.Popen([*_command(), *arguments], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def phase(job: Job, folder: Path, before: str, after: str) -> str:
    """Where a killed process was, by what it added to the log."""
    added = after[len(before) :]
    if any(folder.glob(".*.partial")):
        return "writing a file"
    if job.end in added:
        return "writing results"
    return "computing" if job.round in added else "beginning"


def text(path: Path) -> str:
    """Of a file, if there is one."""
    return path.read_text() if path.exists() else ""


def differences(job: Job, one: Path, other: Path) -> list[str]:
    """Names of what two folders differ in, but for times and pictures."""
    records = [json.loads((folder / job.record).read_text()) | {"seconds": 0} for folder in (one, other)]
    found = [job.record] if records[0] != records[1] else []
    if {path.name for path in one.iterdir()} != {path.name for path in other.iterdir()}:
        found.append("names of files")
    for path in one.iterdir():
        twin = other / path.name
        if path.suffix in (".csv", ".urdf", ".xml") and path.read_bytes() != twin.read_bytes():
            found.append(path.name)
        if path.suffix == ".npz":
            with np.load(path) as mine, np.load(twin) as others:
                found += [
                    f"{path.name}: {name}"
                    for name in mine
                    if not np.array_equal(mine[name], others[name], equal_nan=_floats(mine[name]))
                ]
    return found


def _floats(array: np.ndarray) -> bool:
    return np.issubdtype(array.dtype, np.floating)


def killed(job: Job, folder: Path, kills: int, seed: int) -> dict[str, Any]:
    """Kill the command so often, at times spread evenly over that of an unbroken run; begin anew whenever it comes to its end."""
    random, phases, ends, differ = np.random.default_rng(seed), collections.Counter(), 0, []
    _unbroken(job, folder, "first")
    seconds = _unbroken(job, folder, "whole")
    out = folder / f"{job.name}_killed"
    while phases.total() < kills:
        before, process = text(out / "run.log"), start(job, folder, out.name)
        try:
            process.wait(random.uniform(0.0, seconds))
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
            phases[phase(job, out, before, text(out / "run.log"))] += 1
            print(f"{job.name}: {phases.total()} kills, {dict(phases)}; {ends} ends", flush=True)
            continue
        assert process.returncode in (0, 1), process.stderr.read() if process.stderr else ""
        ends += 1
        differ += differences(job, folder / f"{job.name}_whole", out)
        shutil.rmtree(out)
    process = start(job, folder, out.name)
    assert process.wait() in (0, 1), process.stderr.read() if process.stderr else ""
    differ += differences(job, folder / f"{job.name}_whole", out)
    return {"kills": phases.total(), **phases, "ends": ends + 1, "seconds_unbroken": seconds, "different": differ}


def _unbroken(job: Job, folder: Path, name: str) -> float:
    """Run to the end; for how long."""
    begun, process = time.perf_counter(), start(job, folder, f"{job.name}_{name}")
    assert process.wait() in (0, 1), process.stderr.read() if process.stderr else ""
    return time.perf_counter() - begun


def main() -> None:
    """Kill both commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=25, help="of each command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results/kills"))
    options = parser.parse_args()
    shutil.rmtree(options.out, ignore_errors=True)
    options.out.mkdir(parents=True)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(options.out.absolute() / "cache")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    found = {job.name: killed(job, options.out, options.kills, options.seed) for job in write_inputs(options.out)}
    (options.out / "kills.json").write_text(json.dumps({"seed": options.seed, "interval": INTERVAL, **found}, indent=1) + "\n")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
