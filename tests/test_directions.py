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

BATCH = _batching.VECTOR + 3  # two chunks in so many directions, the last one padded


@pytest.fixture(scope="module")
def case():
    mj = mujoco.MjModel.from_xml_string(random_tree(3, 2, ("hinge", "slide"), chain=True))
    model = kj.from_mujoco(mj)
    return model, *(jnp.asarray(x) for x in random_states(mj, BATCH))


def plain(model, *state):
    """Inverse dynamics by JAX's own rules."""
    return inverse_dynamics_kernel(model.tree, prepare(model), *state)


def shares_the_point(function, *args):
    return "Fan(" in str(jax.make_jaxpr(function)(*args))


def same(found, expected):
    return all(relative(a, b) < 1e-11 for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True))


@pytest.mark.parametrize("jacobian", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("order", ["jacobian of each state", "jacobian of the batch"])
def test_jacobians(case, jacobian, order):
    def each(dynamics):
        return jax.vmap(jacobian(dynamics, (0, 2)), (None, 0, 0, 0))

    def whole(dynamics):
        return jacobian(lambda model, *state: jnp.sum(jax.vmap(dynamics, (None, 0, 0, 0))(model, *state) ** 2, 0), (0, 2))

    derivative = each if order == "jacobian of each state" else whole
    case = case if order == "jacobian of each state" else (case[0], *(x[:3] for x in case[1:]))
    assert shares_the_point(derivative(kj.inverse_dynamics), *case)
    assert same(jax.jit(derivative(kj.inverse_dynamics))(*case), jax.jit(derivative(plain))(*case))


def test_directions_of_directions(case):
    model, *state = case
    hessian = [jax.jit(jax.vmap(jax.jacfwd(jax.jacrev(f, 1), 1), (None, 0, 0, 0))) for f in (kj.inverse_dynamics, plain)]
    assert shares_the_point(hessian[0], *case)
    assert same(*(h(model, *state) for h in hessian))


@pytest.mark.parametrize("batch", ["one state", "states"])
def test_reverse_mode_over_directions_that_share_a_tangent(case, batch):
    """The gradient of a shared tangent is the sum over the directions, that of the others is each one's own."""
    model, q, u, u_dot = case
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

    found, expected = (jax.jit(jax.grad(loss(f), (0, 1)))(directions, shared) for f in (kj.inverse_dynamics, plain))
    assert same(found, expected)
    if batch == "states":
        return
    # The gradient of a gradient is one in directions that the loss shares.
    twice = [jax.jit(jax.jacrev(jax.grad(loss(f), (0, 1)), (0, 1)))(directions, shared) for f in (kj.inverse_dynamics, plain)]
    assert same(*twice)


def test_forward_dynamics(case):
    model, q, u, tau = case
    derivatives = [jax.vmap(j(kj.forward_dynamics, (1, 2, 3)), (None, 0, 0, 0)) for j in (jax.jacfwd, jax.jacrev)]
    forward, reverse = (jax.jit(d)(model, q, u, tau) for d in derivatives)
    assert same(forward, reverse)
    inverse = jax.vmap(lambda q: jnp.linalg.inv(kj.mass_matrix(model, q)))(q)
    assert relative(forward[2], inverse) < 1e-10


def test_more_directions_than_a_chunk_has_room_for(case):
    model, q, u, u_dot = case
    directions = jnp.asarray(np.random.default_rng(2).normal(size=(_batching.CHUNK + 1, 2)))

    def changes(q, u, u_dot):
        return jax.vmap(lambda d: jax.jvp(lambda q: kj.inverse_dynamics(model, q, u, u_dot), (q,), (d,))[1])(directions)

    found = jax.jit(jax.vmap(changes))(q[:3], u[:3], u_dot[:3])
    by_jacobian = jax.jit(jax.vmap(jax.jacfwd(kj.inverse_dynamics, 1), (None, 0, 0, 0)))(model, q[:3], u[:3], u_dot[:3])
    assert relative(found, jnp.einsum("bij,dj->bdi", by_jacobian, directions)) < 1e-12
    assert not shares_the_point(changes, q[0], u[0], u_dot[0])
