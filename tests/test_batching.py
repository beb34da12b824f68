"""The batching primitive: every order of vmap, grad and jit gives what a plain loop over states gives."""

import functools
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


# What links have, rows of it; what all share; what speeds have.
LEAVES = ("mass", "gravity", "damping")


@pytest.fixture(scope="module")
def case():
    mj = mujoco.MjModel.from_xml_string(random_tree(4, 2, ("hinge",), chain=True))
    return kj.from_mujoco(mj), *(jnp.asarray(x) for x in random_states(mj, BATCH))


def plain(model, q, u, u_dot):
    """Inverse dynamics without the primitive: JAX's own rules for everything."""
    from kanejax._dynamics.equations_of_motion import inverse_dynamics_kernel

    return inverse_dynamics_kernel(model.tree, prepare(model), q, u, u_dot)


def over_states(function):
    return jax.jit(jax.vmap(function, (None, 0, 0, 0)))


def one_by_one(function, model, *states):
    """Results of a plain loop over states."""
    return jax.tree.map(lambda *x: np.stack(x), *(function(model, *state) for state in zip(*map(np.asarray, states), strict=True)))


def loss(dynamics):
    """Its value, and the forces that it is made from."""

    def value(*args):
        forces = dynamics(*args)
        return jnp.sum(jnp.sin(forces)), forces

    return value


plain_gradients = jax.jit(jax.grad(loss(plain), (0, 1, 2, 3), has_aux=True))


@pytest.fixture(scope="module")
def expected(case):
    """For each member of the batch: the gradients of the loss, of which those of a sum are the sums; and the forces."""
    return one_by_one(plain_gradients, *case)


def test_vmap(case, expected):
    assert relative(over_states(kj.inverse_dynamics)(*case), expected[1]) < 1e-13


def test_vmap_over_models(case):
    model, q, u, u_dot = case
    count = 5
    masses = model.mass[None] * jnp.linspace(0.5, 2.0, count)[:, None]
    models = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *x.shape)), model)
    models = eqx.tree_at(lambda m: m.mass, models, masses)
    found = jax.jit(jax.vmap(kj.inverse_dynamics))(models, q[:count], u[:count], u_dot[:count])
    for i in range(count):
        expected = plain_gradients(model.replace(mass=masses[i]), q[i], u[i], u_dot[i])[1]
        assert relative(found[i], expected) < 1e-13


def test_vmap_of_vmap(case):
    model, q, u, u_dot = case
    nested = jax.vmap(jax.vmap(kj.inverse_dynamics, (None, 0, None, 0)), (None, None, 0, None))
    found = jax.jit(nested)(model, q[:5], u[:7], u_dot[:5])
    assert found.shape == (7, 5, model.nv)
    for i, j in np.ndindex(7, 5):
        assert relative(found[i, j], plain_gradients(model, q[j], u[i], u_dot[j])[1]) < 1e-13


@pytest.mark.parametrize("which", [(1, 2, 3), (0,)])
def test_gradient_of_a_sum_over_the_batch(case, which, expected):
    found = jax.jit(jax.grad(lambda *args: jnp.sum(jax.vmap(loss(kj.inverse_dynamics), (None, 0, 0, 0))(*args)[0]), which))(*case)
    shared, *of_states = expected[0]
    wanted = [(jax.tree.map(lambda x: x.sum(0), shared), *of_states)[i] for i in which]
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        assert relative(a, b) < 1e-11


@pytest.mark.parametrize("which", [(1, 2, 3), (0,)])
def test_gradient_for_each_member_of_the_batch(case, which, expected):
    found, _ = over_states(jax.grad(loss(kj.inverse_dynamics), which, has_aux=True))(*case)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves([expected[0][i] for i in which]), strict=True):
        assert relative(a, b) < 1e-11


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


def of_leaves(function):
    """The same, of LEAVES alone and of the state, beside the model that has the others: in a smaller program."""
    return lambda leaves, model, *state: function(model.replace(**leaves), *state)


def some(model):
    return {name: getattr(model, name) for name in LEAVES}


def test_gradient_of_a_gradient_over_the_batch(case):
    """A penalty on per-state gradients, differentiated with respect to what the models share."""
    model = case[0]

    def penalty(dynamics):
        slope = jax.grad(lambda q, m, u, a: jnp.sum(dynamics(m, q, u, a)))
        return of_leaves(lambda m, q, u, a: jnp.sum(slope(q, m, u, a) ** 2))

    batched = jax.vmap(penalty(kj.inverse_dynamics), (None, None, 0, 0, 0))
    found = jax.jit(jax.grad(lambda *args: jnp.sum(batched(*args))))(some(model), *case)
    each = one_by_one(functools.partial(jax.jit(jax.grad(penalty(plain))), some(model)), *case)
    for name in LEAVES:
        assert relative(found[name], each[name].sum(0)) < 1e-10


def test_gradients_of_sums_for_several_models(case):
    """The batch within is summed over, the one outside is not."""
    model, *states = case
    models = jax.tree.map(lambda x: x[None] * jnp.reshape(jnp.array([1.0, 0.8, 1.3]), (3,) + (1,) * x.ndim), model)
    batched = of_leaves(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))
    slopes = jax.grad(lambda *args: jnp.sum(jnp.sin(batched(*args))), (0, 2))
    found = jax.jit(jax.vmap(slopes, (0, 0, None, None, None)))(some(models), models, *states)
    for i in range(3):
        (shared, of_q, *_), _ = one_by_one(plain_gradients, jax.tree.map(lambda x, i=i: x[i], models), *states)
        assert relative(found[1][i], of_q) < 1e-11
        for name in LEAVES:
            assert relative(found[0][name][i], getattr(shared, name).sum(0)) < 1e-11


@pytest.fixture(scope="module")
def two_devices():
    """Relative errors of all cases with two devices."""
    done = subprocess.run([sys.executable, "-m", "tests.helpers.two_devices"], capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.parametrize("how", ["checked", "unchecked", "auto", "explicit"])
def test_two_devices_compute_what_one_does(two_devices, how):
    errors = two_devices[how]
    assert errors
    assert {case: error for case, error in errors.items() if not error < 1e-12} == {}


def test_without_jit(case, expected):
    model, *state = case
    assert relative(kj.inverse_dynamics(model, *(x[0] for x in state)), expected[1][0]) < 1e-13


def test_float32_follows_the_inputs(case, expected):
    model, *state = case
    found = over_states(kj.inverse_dynamics)(model.astype(jnp.float32), *(x.astype(jnp.float32) for x in state))
    assert found.dtype == jnp.float32
    assert relative(found, expected[1]) < 1e-4


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

    of = jax.jit(jax.value_and_grad(loss))
    step = 1e-6 * jnp.asarray(np.random.default_rng(0).normal(size=q.shape))
    along = float((of(q + step)[0] - of(q - step)[0]) / 2)
    assert float(jnp.vdot(of(q)[1], step)) == pytest.approx(along, rel=1e-6)
