"""Batches over two processes with two devices each: what a cluster computes is what one device computes."""

import json
import os
import socket
import subprocess
import sys

import numpy as np
import pytest

import kanejax as kj


def test_two_processes_compute_what_one_device_does():
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "tests.helpers.two_processes", str(port)]
    started = [
        subprocess.Popen([*command, str(i)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ)
        for i in range(2)
    ]
    try:
        outputs = [process.communicate(timeout=500) for process in started]
    finally:
        for process in started:
            process.kill()
    for process, (_, complaints) in zip(started, outputs, strict=True):
        assert process.returncode == 0, complaints[-4000:]
    errors = json.loads(outputs[0][0].splitlines()[-1])
    assert set(errors) == {
        "simulation",
        "gradient of simulations",
        "gradient of inverse dynamics",
        "normal equations",
        "optimal costs",
    }
    for case, error in errors.items():
        assert error < 1e-10, case


def test_a_batch_is_placed_in_equal_parts():
    mesh = kj.batch_mesh()
    batch = kj.shard_batch({"q": np.arange(6.0).reshape(3, 2), "u": np.zeros((3, 1))}, mesh)
    assert batch["q"].sharding.mesh == mesh
    np.testing.assert_array_equal(batch["q"], np.arange(6.0).reshape(3, 2))
    assert kj.replicate(kj.robots.three_revolute_arm(), mesh).mass.sharding.is_fully_replicated


@pytest.mark.parametrize("batch", [{"q": np.zeros((3, 2)), "u": np.zeros((2, 2))}, {"q": np.zeros(())}, {}])
def test_batches_without_one_leading_axis_are_refused(batch):
    with pytest.raises(ValueError, match="needs one leading axis"):
        kj.shard_batch(batch, kj.batch_mesh())
