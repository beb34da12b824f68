"""The batching primitive: every order of vmap, grad and jit gives what a plain loop over states gives."""

import json
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj
from kanejax import _batching
from kanejax._model.prepared import prepare
from tests.helpers.mechanisms import random_states, random_tree, relative

BATCH = 2 * _batching.CHUNK + 37  # three chunks, the last one padded


@pytest.fixture(scope="module")
def case():
    mj = mujoco.MjModel.from_xml_string(random_tree(4, 2, ("hinge", "slide"), chain=True))
    return kj.from_mujoco(mj), *(jnp.asarray(x) for x in random_states(mj, BATCH))


def plain(model, q, u, u_dot):
    """Inverse dynamics without the primitive: JAX's own rules for everything."""
    from kanejax._dynamics.equations_of_motion import inverse_dynamics_kernel

    return inverse_dynamics_kernel(model.tree, prepare(model), q, u, u_dot)


def over_states(function):
    return jax.jit(jax.vmap(function, (None, 0, 0, 0)))


def test_vmap(case):
    assert relative(over_states(kj.inverse_dynamics)(*case), over_states(plain)(*case)) < 1e-13


def test_vmap_over_models(case):
    model, q, u, u_dot = case
    count = 5
    masses = model.mass[None] * jnp.linspace(0.5, 2.0, count)[:, None]
    models = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)), model)
    models = eqx.tree_at(lambda m: m.mass, models, masses)
    found = jax.jit(jax.vmap(kj.inverse_dynamics))(models, q[:count], u[:count], u_dot[:count])
    for i in range(count):
        expected = kj.inverse_dynamics(model.replace(mass=masses[i]), q[i], u[i], u_dot[i])
        assert relative(found[i], expected) < 1e-13


def test_vmap_of_vmap(case):
    model, q, u, u_dot = case
    nested = jax.vmap(jax.vmap(kj.inverse_dynamics, (None, 0, None, 0)), (None, None, 0, None))
    found = jax.jit(nested)(model, q[:5], u[:7], u_dot[:5])
    expected = over_states(plain)(model, jnp.tile(q[:5], (7, 1)), jnp.repeat(u[:7], 5, axis=0), jnp.tile(u_dot[:5], (7, 1)))
    assert relative(found.reshape(35, -1), expected) < 1e-13


def loss(dynamics):
    return lambda *args: jnp.sum(jnp.sin(dynamics(*args)))


@pytest.fixture(scope="module")
def expected_gradients(case):
    """For each member of the batch; those of a sum are the sums of these."""
    return over_states(jax.grad(loss(plain), (0, 1, 2, 3)))(*case)


@pytest.mark.parametrize("which", [(1, 2, 3), (0,)])
def test_gradient_of_a_sum_over_the_batch(case, which, expected_gradients):
    found = jax.jit(jax.grad(loss(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0))), which))(*case)
    shared, *of_states = expected_gradients
    expected = [(jax.tree.map(lambda x: np.asarray(x).sum(0), shared), *of_states)[i] for i in which]
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert relative(a, b) < 1e-11


@pytest.mark.parametrize("which", [(1, 2, 3), (0,)])
def test_gradient_for_each_member_of_the_batch(case, which, expected_gradients):
    found = over_states(jax.grad(loss(kj.inverse_dynamics), which))(*case)
    expected = [expected_gradients[i] for i in which]
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert relative(a, b) < 1e-11


def test_forward_and_reverse_mode_agree(case):
    for dynamics in (kj.inverse_dynamics, kj.forward_dynamics):
        forward = over_states(jax.jacfwd(dynamics, (1, 2, 3)))(*case)
        reverse = over_states(jax.jacrev(dynamics, (1, 2, 3)))(*case)
        for a, b in zip(forward, reverse, strict=True):
            assert relative(a, b) < 1e-10


def test_second_derivatives(case):
    model, *state = case
    q, u, tau = (x[0] for x in state)

    def energy_rate(q):
        return jnp.sum(kj.forward_dynamics(model, q, u, tau) ** 2)

    expected = np.zeros((model.nq, model.nq))
    step = 1e-5
    gradient = jax.jit(jax.grad(energy_rate))
    for i, direction in enumerate(np.eye(model.nq)):
        expected[i] = (gradient(q + step * direction) - gradient(q - step * direction)) / (2 * step)
    assert relative(jax.jit(jax.hessian(energy_rate))(q), expected) < 1e-6
    assert relative(jax.jit(jax.jacrev(jax.grad(energy_rate)))(q), expected) < 1e-6
    batched = jax.jit(jax.vmap(jax.hessian(lambda q, u: jnp.sum(kj.inverse_dynamics(model, q, u, u))), (0, 0)))(state[0], state[1])
    assert batched.shape == (BATCH, model.nq, model.nq)
    assert np.isfinite(batched).all()


def test_gradient_of_a_gradient_over_the_batch(case):
    """A penalty on per-state gradients, differentiated with respect to the shared model."""

    def penalty(dynamics):
        slope = jax.grad(lambda q, m, u, a: jnp.sum(dynamics(m, q, u, a)))
        return lambda m, q, u, a: jnp.sum(jax.vmap(slope, (0, None, 0, 0))(q, m, u, a) ** 2)

    found = jax.jit(jax.grad(penalty(kj.inverse_dynamics)))(*case)
    expected = jax.jit(jax.grad(penalty(plain)))(*case)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert relative(a, b) < 1e-10


def test_gradients_of_sums_for_several_models(case):
    """The batch within is summed over, the one outside is not."""
    model, *states = case
    models = jax.tree.map(lambda x: x[None] * jnp.reshape(jnp.array([1.0, 0.8, 1.3]), (3,) + (1,) * x.ndim), model)

    def slopes(dynamics):
        loss = jax.grad(lambda *args: jnp.sum(jnp.sin(jax.vmap(dynamics, (None, 0, 0, 0))(*args))), (0, 1))
        return jax.jit(jax.vmap(loss, (0, None, None, None)))(models, *states)

    for a, b in zip(jax.tree.leaves(slopes(kj.inverse_dynamics)), jax.tree.leaves(slopes(plain)), strict=True):
        assert relative(a, b) < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("how", ["checked", "unchecked", "auto", "explicit"])
def test_two_devices_compute_what_one_does(how):
    program = [sys.executable, "-m", "tests.helpers.two_devices", how]
    done = subprocess.run(program, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    errors = json.loads(done.stdout)
    assert len(errors) >= 3
    assert {case: error for case, error in errors.items() if not error < 1e-12} == {}


def test_without_jit(case):
    model, *state = case
    assert relative(kj.inverse_dynamics(model, *(x[0] for x in state)), plain(model, *(x[0] for x in state))) < 1e-13


def test_float32_follows_the_inputs(case):
    model, *state = case
    found = over_states(kj.inverse_dynamics)(model.astype(jnp.float32), *(x.astype(jnp.float32) for x in state))
    assert found.dtype == jnp.float32
    assert relative(found, over_states(plain)(*case)) < 1e-4


def test_changing_a_leaf_compiles_nothing(case):
    model, *state = case
    count = 0

    @jax.jit
    def dynamics(model, q, u, u_dot):
        nonlocal count
        count += 1
        return kj.inverse_dynamics(model, q, u, u_dot)

    first = dynamics(model, *(x[0] for x in state))
    second = dynamics(model.replace(mass=model.mass * 2.0), *(x[0] for x in state))
    assert count == 1
    assert not np.allclose(first, second)


def test_reverse_mode_over_gradients_of_each_state(case):
    """The regressor of each state is a gradient; its gradient in turn is one more transposition."""
    model, (q, u, u_dot) = case[0], (x[:3] for x in case[1:])

    def loss(q):
        return jnp.sum(jnp.sin(jax.vmap(kj.regressor, (None, 0, 0, 0))(model, q, u, u_dot)))

    step = 1e-6 * jnp.asarray(np.random.default_rng(0).normal(size=q.shape))
    along = float((loss(q + step) - loss(q - step)) / 2)
    assert float(jnp.vdot(jax.jit(jax.grad(loss))(q), step)) == pytest.approx(along, rel=1e-6)
