"""Processes that are killed at random times and started again until the end.

Their program takes a folder, goes on from the checkpoint in it, prints a line for every state that it keeps, and writes its result.
"""

import os
import pathlib
import signal
import subprocess
import sys
import time
from typing import NamedTuple

import jax
import numpy as np

from kanejax._checkpoint import Checkpoint

CHECKPOINT, RESULT = "unfinished.npz", "result.npz"


class Process(NamedTuple):
    """One process: how many states it kept, whether it was killed while it wrote them, and whether it came to its end."""

    states: int
    was_writing: bool
    ended: bool


def run(program: str, folder: pathlib.Path, states: int | None = None, delay: float = 0.0) -> Process:
    """Run a program to its end, or kill it so many seconds after so many states."""
    folder.mkdir(exist_ok=True)
    environment = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": str(jax.config.jax_compilation_cache_dir),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "0",
        "JAX_ENABLE_X64": "1",
    }
    count = 0
    with subprocess.Popen([sys.executable, "-m", program, folder], env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        while (states is None or count < states) and process.stdout.readline():
            count += 1
        if states is not None:
            time.sleep(delay)
            process.send_signal(signal.SIGKILL)
            count += len(process.stdout.readlines())
    # With few states left it may end before it is killed.
    assert process.returncode in ((0,) if states is None else (0, -signal.SIGKILL))
    return Process(count, any(folder.glob(".*.partial")), process.returncode == 0)


def run_with_kills(program: str, folder: pathlib.Path, kills: int, states: int, seed: int) -> list[Process]:
    """Kill so many processes, all along the states that one alone keeps, and the fourth while it begins; then let one end."""
    random, processes = np.random.default_rng(seed), []
    for left in range(kills, 0, -1):
        remaining = states - sum(process.states for process in processes)
        most = max(2 * (remaining - 12) // (left + 1), 1)
        begins = left == kills - 3
        after = 0 if begins else int(random.integers(1, most + 1))
        processes.append(run(program, folder, after, random.uniform(0, 2.0 if begins else 0.03)))
        if processes[-1].ended:
            assert len(processes) > kills // 2
            return processes
    return [*processes, run(program, folder)]


def tell_of_states() -> None:
    """Print a line for every state that is kept from now on."""
    keep = Checkpoint.keep

    def told(self: Checkpoint, state: object) -> None:
        keep(self, state)
        print("kept", flush=True)

    Checkpoint.keep = told


def result(folder: pathlib.Path) -> dict[str, np.ndarray]:
    """What the program wrote at its end."""
    with np.load(folder / RESULT) as archive:
        return {name: archive[name] for name in archive.files}
