"""Specialized models compute the same, with all parameters as constants."""

import jax
import jax.numpy as jnp
import mujoco
import pytest

import kanejax as kj
from tests.helpers.mechanisms import random_states, random_tree, relative


def everything(model, q, u, other):
    return (
        kj.inverse_dynamics(model, q, u, other),
        kj.forward_dynamics(model, q, u, other),
        kj.mass_matrix(model, q),
        kj.bias_force(model, q, u),
        kj.passive_force(model, q, u),
        jax.grad(lambda q: jnp.sum(kj.forward_dynamics(model, q, u, other)))(q),
    )


@pytest.mark.parametrize(("seed", "kinds"), [(3, ("hinge", "slide")), (5, ("free", "hinge", "ball"))])
def test_it_computes_the_same(seed, kinds):
    mj = mujoco.MjModel.from_xml_string(random_tree(seed, 4, kinds))
    model = kj.from_mujoco(mj)
    states = [jnp.asarray(x) for x in random_states(mj, 3)]
    found, expected = (jax.jit(jax.vmap(everything, (None, 0, 0, 0)))(m, *states) for m in (kj.specialize(model), model))
    for a, b in zip(found, expected, strict=True):
        assert relative(a, b) < 1e-9


def test_it_has_no_leaves_and_keeps_the_data_type():
    model = kj.from_mujoco(mujoco.MjModel.from_xml_string(random_tree(1, 2, ("hinge",)))).astype(jnp.float32)
    frozen = kj.specialize(model)
    assert not jax.tree.leaves(frozen)
    zero = jnp.zeros(2, jnp.float32)
    assert kj.inverse_dynamics(frozen, zero, zero, zero).dtype == jnp.float32


def test_traced_models_are_refused():
    model = kj.from_mujoco(mujoco.MjModel.from_xml_string(random_tree(1, 2, ("hinge",))))
    with pytest.raises(ValueError, match="specialize it outside"):
        jax.jit(lambda m: kj.specialize(m).nq)(model)
