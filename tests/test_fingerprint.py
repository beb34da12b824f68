"""Fingerprints: the same in every process for the same inputs, others for others."""

import dataclasses
import functools
import json
import os
import pathlib
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax._fingerprint import fingerprint_of

PENDULUM = """<mujoco><worldbody><body name="link"><joint name="hinge" axis="0 1 0"/>
<inertial pos="0.2 0.02 0.01" mass="2" fullinertia="0.01 0.05 0.05 0.001 0.002 -0.001"/></body></worldbody></mujoco>"""
FACTOR = np.array([2.0])


@dataclasses.dataclass(frozen=True)
class Gains:
    stiffness: float
    of: tuple[str, ...]


class Controller:
    def __init__(self, gain):
        self.gain = gain

    def force(self, t, q, u):
        return -self.gain * q


def controller(gain):
    def force(t, q, u):
        return FACTOR * gain * q + helped(u)

    return force


def helped(u):
    return 0.1 * u


def inputs():
    """One of each kind of value that a computation may depend on."""
    model = kj.load(PENDULUM)
    task = kj.MotionTask(model, [0.0], [1.0], 1.0, (kj.costs.torque(), kj.Cost(lambda model, now: jnp.sum(now.u**2), name="speed")))
    return {
        "model": model,
        "plant": kj.Plant(model, kj.Drives.ideal(model)),
        "unknown": kj.Unknown("damping", bounds=(0.0, 1.0)),
        "parameterization": kj.parameterization(kj.Plant(model, kj.Drives.ideal(model)), ["inertia", "damping"]),
        "task": task,
        "closure": controller(3.0),
        "jitted": jax.jit(controller(4.0)),
        "partial": functools.partial(np.add, 1.0),
        "method": Controller(2.0).force,
        "record": Gains(1.0, ("a", "b")),
        "key": jax.random.key(0),
        "set": {"a", "b", "c"},
        "mapping": {"b": None, "a": (1, 2.0, "3", b"4", pathlib.Path("5"))},
    }


def fingerprints():
    return {name: fingerprint_of(value) for name, value in inputs().items()}


def test_fingerprints_are_the_same_in_every_process():
    here = fingerprints()
    assert len(set(here.values())) == len(here)
    assert fingerprints() == here
    # Among themselves: here functions are wrapped, to check their types.
    program = "import json; from tests.test_fingerprint import fingerprints; print(json.dumps(fingerprints()))"
    environments = (os.environ | {"JAX_ENABLE_X64": "1", "PYTHONHASHSEED": seed} for seed in ("1", "7"))
    command = [sys.executable, "-c", program]
    processes = [subprocess.Popen(command, env=each, stdout=subprocess.PIPE, text=True) for each in environments]
    one, other = (json.loads(process.communicate(timeout=300)[0]) for process in processes)
    assert one == other
    assert one.keys() == here.keys()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (1, 1.0),
        (1, True),
        (0.0, -0.0),
        ("1", 1),
        ((1, 2), [1, 2]),
        ([[1], 2], [1, [2]]),
        (np.zeros(2), np.zeros((2, 1))),
        (np.zeros(2), np.zeros(2, np.float32)),
        (np.zeros(2), np.array([0.0, -0.0])),
        ({"a": 1}, {"a": 2}),
        (controller(3.0), controller(3.5)),
        (Controller(2.0).force, Controller(3.0).force),
        (lambda x: x + 1, lambda x: x + 2),
        (lambda x, k=1: x + k, lambda x, k=2: x + k),
        (Gains(1.0, ("a",)), Gains(1.0, ("b",))),
        (jax.random.key(0), jax.random.key(1)),
        (kj.costs.torque(), kj.costs.torque(2.0)),
        (kj.Unknown("damping"), kj.Unknown("damping", bounds=(0.0, 1.0))),
    ],
)
def test_other_inputs_have_other_fingerprints(one, other):
    assert fingerprint_of(one) == fingerprint_of(one)
    assert fingerprint_of(one) != fingerprint_of(other)
    assert fingerprint_of([one, one]) != fingerprint_of([one, other])


def test_what_functions_refer_to_counts(monkeypatch):
    before = fingerprint_of(controller(3.0))
    monkeypatch.setitem(globals(), "FACTOR", np.array([2.5]))
    after = fingerprint_of(controller(3.0))
    monkeypatch.setitem(globals(), "helped", lambda u: 0.2 * u)
    assert len({before, after, fingerprint_of(controller(3.0))}) == 3


def test_values_that_refer_to_themselves_have_one():
    ring: list = [1]
    ring.append(ring)
    other: list = [2]
    other.append(other)
    assert fingerprint_of(ring) != fingerprint_of(other)


def test_what_a_traced_function_left_behind_is_no_obstacle():
    left = []
    jax.jit(lambda x: left.append(x) or x)(jnp.ones(3))
    assert fingerprint_of(left) == fingerprint_of(left) != fingerprint_of([])
