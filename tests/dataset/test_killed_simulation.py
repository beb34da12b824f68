"""Simulations that are killed go on, with any number of processes, and end with the bits of one that was left alone."""

import os
import random
import signal
import socket
import subprocess
import sys
import time

import pytest

from tests.dataset.test_write_study import ARM, files

STUDY = """trajectories = 2048
duration = 0.5
times = 21
[parameters]
density = { distribution = "log-normal", sigma = 0.2 }
[forces]
distribution = "normal"
std = 2.0
period = 0.1
"""
CHUNK, CHUNKS = 32, 64


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("killed")
    (path / "arm.xml").write_text(ARM)
    (path / "study.toml").write_text(STUDY)
    return path


def started(folder, out, *more):
    command = "simulate", "arm.xml", "--study", "study.toml", "--out", out, "--chunk", CHUNK, *more
    program = "from kanejax.cli import main; main()"
    cache = {"JAX_COMPILATION_CACHE_DIR": str(folder / "cache"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    return subprocess.Popen(
        [sys.executable, "-c", program, *map(str, command)],
        cwd=folder,
        env=os.environ | cache,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def done(path):
    """Chunks that are there."""
    folder = path / "status" / "c"
    return sum(name.isdecimal() for name in os.listdir(folder)) if folder.is_dir() else 0


def wait_for(condition, process, seconds=120.0):
    end = time.monotonic() + seconds
    while not condition() and process.poll() is None:
        assert time.monotonic() < end
        time.sleep(0.001)


@pytest.fixture(scope="module")
def whole(folder):
    process = started(folder, "whole.zarr")
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 0, output
    assert "2048 SUCCESSFUL" in output
    return folder / "whole.zarr"


def test_killed_again_and_again(folder, whole):
    path, kills, chance = folder / "killed.zarr", 0, random.Random(0)
    while done(path) < CHUNKS:
        process, before = started(folder, path.name, "--resume"), done(path)
        # At the first of some chunks, and somewhere in the writing of the next.
        goal = min(before + chance.randint(1, CHUNKS // 4), CHUNKS)
        wait_for(lambda goal=goal: done(path) >= goal, process)
        time.sleep(chance.uniform(0.0, 0.01))
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            kills += 1
        process.communicate(timeout=60)
        assert process.returncode in (0, -signal.SIGKILL)
        assert done(path) > before
    process = started(folder, path.name, "--resume")
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0, output
    assert kills >= 3
    assert files(path) == files(whole)


def test_one_of_two_processes_is_killed(folder, whole):
    path = folder / "two.zarr"
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    several = ("--coordinator", f"localhost:{port}", "--processes", 2)
    first, second = (started(folder, path.name, *several, "--process", i) for i in range(2))
    try:
        wait_for(lambda: any((path / "status" / "c" / str(chunk)).exists() for chunk in range(1, CHUNKS, 2)), second)
        second.kill()
        # It does its share, and then waits for the other.
        wait_for(lambda: all((path / "status" / "c" / str(chunk)).exists() for chunk in range(0, CHUNKS, 2)), first)
        assert done(path) < CHUNKS
    finally:
        for process in (first, second):
            process.kill()
            process.communicate(timeout=60)
    process = started(folder, path.name, "--resume")
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 0, output
    assert files(path) == files(whole)
