"""Derivatives in many directions at one point: what does not depend on the direction is computed once, and all is right."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj
from kanejax import _batching
from kanejax._dynamics.equations_of_motion import inverse_dynamics_kernel
from kanejax._model.prepared import prepare
from tests.helpers.mechanisms import random_states, random_tree, relative

BATCH = 4 * _batching.VECTOR + 3  # several chunks in two directions or more, the last one padded
# What links have, rows of it; what all share; what speeds have.
LEAVES = ("mass", "gravity", "damping")


@pytest.fixture(scope="module")
def case():
    mj = mujoco.MjModel.from_xml_string(random_tree(3, 2, ("hinge",), chain=True))
    model = kj.from_mujoco(mj)
    return model, *(jnp.asarray(x) for x in random_states(mj, BATCH))


def plain(model, *state):
    """Inverse dynamics by JAX's own rules."""
    return inverse_dynamics_kernel(model.tree, prepare(model), *state)


def shares_the_point(function, *args):
    return "Fan(" in str(jax.make_jaxpr(function)(*args))


def same(found, expected):
    return all(relative(a, b) < 1e-11 for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True))


def of_leaves(dynamics):
    """Of LEAVES and a state, beside the model that has the other leaves: Jacobians are smaller programs."""
    return lambda leaves, model, *state: dynamics(model.replace(**leaves), *state)


def one_by_one(function, *states):
    """For one state after the other, not in a batch."""
    return jax.tree.map(lambda *x: np.stack(x), *(function(*state) for state in zip(*map(np.asarray, states), strict=True)))


@pytest.fixture(scope="module")
def expected(case):
    """Jacobians of each state, by JAX's own rules, with respect to LEAVES and u; and the forces."""
    model, *states = case
    leaves = {name: getattr(model, name) for name in LEAVES}

    def forces(*args):
        found = of_leaves(plain)(*args)
        return found, found

    jacobian = jax.jit(jax.jacfwd(forces, (0, 3), has_aux=True))
    return leaves, *one_by_one(lambda *state: jacobian(leaves, model, *state), *states)


@pytest.mark.parametrize("jacobian", [jax.jacfwd, jax.jacrev])
def test_jacobians_of_each_state(case, expected, jacobian):
    leaves, wanted, _ = expected
    derivative = jax.vmap(jacobian(of_leaves(kj.inverse_dynamics), (0, 3)), (None, None, 0, 0, 0))
    assert shares_the_point(derivative, leaves, *case)
    assert same(jax.jit(derivative)(leaves, *case), wanted)


@pytest.mark.parametrize("jacobian", [jax.jacfwd, jax.jacrev])
def test_jacobians_of_the_batch(case, expected, jacobian):
    leaves, (of_each_leaf, of_u), forces = expected
    model, *states = case[0], *(x[:3] for x in case[1:])

    def squares(*args):
        return jnp.sum(jax.vmap(of_leaves(kj.inverse_dynamics), (None, None, 0, 0, 0))(*args) ** 2, 0)

    derivative = jacobian(squares, (0, 3))
    assert shares_the_point(derivative, leaves, model, *states)

    def chain_rule(slopes):
        return 2.0 * np.einsum("bi,bi...->bi...", forces[:3], slopes[:3])

    wanted = jax.tree.map(lambda slopes: chain_rule(slopes).sum(0), of_each_leaf), np.moveaxis(chain_rule(of_u), 0, 1)
    assert same(jax.jit(derivative)(leaves, model, *states), wanted)


def test_directions_of_directions(case):
    model, *states = case
    hessian = jax.vmap(jax.jacfwd(jax.jacrev(kj.inverse_dynamics, 1), 1), (None, 0, 0, 0))
    assert shares_the_point(hessian, model, *states)
    wanted = jax.jit(jax.jacfwd(jax.jacfwd(lambda *state: plain(model, *state))))
    assert same(jax.jit(lambda *state: hessian(model, *state))(*states), one_by_one(wanted, *states))


@pytest.mark.parametrize("batch", ["one state", "states"])
def test_reverse_mode_over_directions_that_share_a_tangent(case, batch):
    """The gradient of a shared tangent is the sum over the directions, that of the others is each one's own."""
    model, q, u, u_dot = case[0], *(x[: _batching.VECTOR + 3] for x in case[1:])
    rng = np.random.default_rng(1)
    directions, shared = jnp.asarray(rng.normal(size=(5, 2))), jnp.asarray(rng.normal(size=2))

    def loss(dynamics):
        def one(q, u, u_dot, directions, shared):
            def change(direction):
                return jax.jvp(lambda q, u: dynamics(model, q, u, u_dot), (q, u), (direction, shared))[1]

            return jnp.sum(jnp.sin(jax.vmap(change)(directions)))

        if batch == "one state":
            return lambda *x: one(q[0], u[0], u_dot[0], *x)
        return lambda *x: jnp.sum(jax.vmap(one, (0, 0, 0, None, None))(q, u, u_dot, *x))

    def gradients(dynamics):
        return jax.grad(loss(dynamics), (0, 1))

    def twice(dynamics):
        """The gradient of a gradient is one in directions that the loss shares."""
        return lambda *x: (gradients(dynamics)(*x), jax.jacrev(gradients(dynamics), (0, 1))(*x))

    derivative = gradients if batch == "states" else twice
    found, expected = (jax.jit(derivative(f))(directions, shared) for f in (kj.inverse_dynamics, plain))
    assert same(found, expected)


@pytest.mark.parametrize("batch", ["one state", "states"])
def test_transposed_directions_that_share_a_tangent(case, batch):
    """Of a function that is linear in them, without a derivative of its own."""
    model, *states = case[0], *(x[:3] for x in case[1:])
    rng = np.random.default_rng(1)
    directions, shared = jnp.asarray(rng.normal(size=(5, 2))), jnp.asarray(rng.normal(size=2))

    def changes(dynamics):
        def one(q, u, u_dot, directions, shared):
            def change(direction):
                return jax.jvp(lambda q, u: dynamics(model, q, u, u_dot), (q, u), (direction, shared))[1]

            return jax.vmap(change)(directions)

        if batch == "one state":
            return lambda *x: one(*(state[0] for state in states), *x)
        return lambda *x: jax.vmap(one, (0, 0, 0, None, None))(*states, *x)

    cotangents = jnp.asarray(rng.normal(size=(5, 2) if batch == "one state" else (3, 5, 2)))
    pull_back = jax.linear_transpose(changes(kj.inverse_dynamics), directions, shared)
    expected = jax.jit(lambda *x: jax.vjp(changes(plain), *x)[1](cotangents))(directions, shared)
    assert same(jax.jit(pull_back)(cotangents), expected)


def test_forward_dynamics(case):
    model, *states = case
    derivatives = [jax.vmap(j(lambda *x: kj.forward_dynamics(model, *x), (0, 1, 2))) for j in (jax.jacfwd, jax.jacrev)]
    forward, reverse = (jax.jit(d)(*states) for d in derivatives)
    assert same(forward, reverse)
    inverse = jnp.linalg.inv(jax.jit(jax.vmap(kj.mass_matrix, (None, 0)))(model, states[0]))
    assert relative(forward[2], inverse) < 1e-10


def test_more_directions_than_a_chunk_has_room_for(case):
    model, q, u, u_dot = case
    directions = jnp.asarray(np.random.default_rng(2).normal(size=(_batching.CHUNK + 1, 2)))

    def changes(q, u, u_dot):
        return jax.vmap(lambda d: jax.jvp(lambda q: kj.inverse_dynamics(model, q, u, u_dot), (q,), (d,))[1])(directions)

    found = jax.jit(jax.vmap(changes))(q[:3], u[:3], u_dot[:3])
    by_jacobian = one_by_one(jax.jit(jax.jacfwd(lambda *state: plain(model, *state))), q[:3], u[:3], u_dot[:3])
    assert relative(found, jnp.einsum("bij,dj->bdi", by_jacobian, directions)) < 1e-12
    assert not shares_the_point(changes, q[0], u[0], u_dot[0])
