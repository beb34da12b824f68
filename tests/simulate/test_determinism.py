"""The same bits from run to run, as docs/numerics.md promises."""

import functools
import json
import subprocess
import sys

import jax
import numpy as np
import pytest

import kanejax as kj
from tests.helpers.result_hashes import COUNT, TS, hash_of, results, states


def run(model, count=COUNT, order=slice(None), **how):
    q, u = states(count)
    return kj.simulate_batch(model, q[order], u[order], TS, **how)


def test_a_second_call_has_the_same_bits(pendulum):
    assert results(pendulum) == results(pendulum)
    simulated = jax.jit(jax.vmap(lambda q, u: kj.simulate(pendulum, q, u, TS)))
    assert hash_of(simulated(*states())) == hash_of(simulated(*states()))


def test_another_process_with_two_devices_has_the_same_bits(pendulum):
    command = [sys.executable, "-m", "tests.helpers.result_hashes", "2"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    assert json.loads(done.stdout.splitlines()[-1]) == results(pendulum)


@pytest.mark.parametrize("options", [{}, {"dt0": 0.02}, {"joint_limits": True}], ids=["adaptive", "equal", "limited"])
def test_bits_depend_on_neither_threads_nor_place_nor_size_from_16_on(pendulum, options):
    """Sizes are multiples of 16: with others a few trajectories run in code for what is left over."""
    whole = run(pendulum, batch_size=32, threads=1, **options)
    for how in ({"batch_size": 16, "threads": 1}, {"batch_size": 16, "threads": 2}):
        assert hash_of(run(pendulum, **how, **options)) == hash_of(whole)
    turned = run(pendulum, order=slice(None, None, -1), batch_size=32, threads=1, **options)
    assert hash_of(jax.tree.map(lambda x: np.asarray(x)[::-1], turned)) == hash_of(whole)


def test_an_event_of_one_leaves_the_others_their_bits(pendulum):
    q, u = np.tile([0.1, 0.2], (16, 1)), np.linspace(-0.1, 0.1, 32).reshape(16, 2)
    q[1, 0], u[1, 1] = -0.3, 5.0  # takes more steps than it may
    swung = u.copy()
    swung[0, 0] = 4.0  # comes to the end of its range
    one = jax.jit(jax.vmap(lambda q, u: kj.simulate(pendulum, q, u, TS, joint_limits=True, max_steps=17)))
    many = functools.partial(kj.simulate_batch, pendulum, ts=TS, joint_limits=True, max_steps=17, batch_size=16, threads=1)
    for simulated, first in ((one, 2), (many, 1)):
        calm, disturbed = simulated(q, u), simulated(q, swung)
        assert calm.status.tolist() == [kj.Status.SUCCESSFUL, kj.Status.MAX_STEPS, *[kj.Status.SUCCESSFUL] * 14]
        assert disturbed.status.tolist() == [kj.Status.EVENT, *calm.status.tolist()[1:]]
        assert hash_of(jax.tree.map(lambda x, first=first: np.asarray(x)[first:], disturbed)) == hash_of(
            jax.tree.map(lambda x, first=first: np.asarray(x)[first:], calm)
        )


def test_a_small_batch_differs_by_rounding(pendulum):
    model = pendulum.astype("float32")
    q, u = (x.astype(np.float32) for x in states())
    whole = kj.simulate_batch(model, q, u, TS, batch_size=32, threads=1, dt0=0.02)
    few = kj.simulate_batch(model, q[:6], u[:6], TS, batch_size=3, threads=1, dt0=0.02)
    np.testing.assert_allclose(few.q, whole.q[:6], rtol=0, atol=1e3 * np.finfo(np.float32).eps)
