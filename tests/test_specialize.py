"""Specialized models compute the same, with all parameters as constants."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
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
    for function in (kj.inverse_dynamics, kj.forward_dynamics):
        assert function(frozen, zero, zero, zero).dtype == jnp.float32


def shuffled(seed, kinds=("hinge", "slide", "ball")):
    mj = mujoco.MjModel.from_xml_string(random_tree(seed, 3, kinds))
    return kj.from_mujoco(mj), [jnp.asarray(x) for x in random_states(mj, 3)]


@pytest.mark.parametrize("keep", [("mass", "com", "central_inertia"), ("joint_axis",), ("gravity", "armature", "stiffness")])
def test_kept_leaves_are_parameters(keep):
    model, states = shuffled(8)
    some = kj.specialize(model, keep)
    rng = np.random.default_rng(0)
    values = {name: getattr(model, name) * (1 + 0.1 * rng.uniform(size=np.shape(getattr(model, name)))) for name in keep}

    def loss(change, values):
        functions = (kj.inverse_dynamics, kj.forward_dynamics)
        return sum(jnp.sum(jax.vmap(function, (None, 0, 0, 0))(change(**values), *states)) for function in functions)

    found = jax.jit(jax.value_and_grad(lambda values: loss(some.replace, values)))(values)
    expected = jax.jit(jax.value_and_grad(lambda values: loss(model.replace, values)))(values)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert relative(a, b) < 1e-9


def quantities(model, q, u, other):
    """What is computed body by body."""
    force = jnp.reshape(jnp.sin(jnp.arange(6.0 * model.nbody)), (2, model.nbody, 3))
    return {
        "poses": kj.poses(model, q),
        "partial velocities": kj.partial_velocities(model, q),
        "rates": kj.partial_velocity_rates(model, q, u),
        "kinetic energy": kj.kinetic_energy(model, q, u),
        "potential energy": kj.potential_energy(model, q),
        "momentum": kj.momentum(model, q, u),
        "mass centre": kj.center_of_mass(model, q),
        "external force": kj.external_force(model, q, *force),
        "reactions": kj.joint_reactions(model, q, u, other),
    }


@pytest.mark.parametrize("keep", [(), ("mass", "com", "stiffness"), ("body_position", "gravity")], ids=str)
def test_kinematics_energies_and_wrenches(keep):
    model, states = shuffled(8, ("free", "hinge", "ball"))
    some = kj.specialize(model, keep)
    values = {name: getattr(model, name) + 0.1 for name in keep}

    def with_gradients(change):
        def combined(values, *state):
            found = quantities(change(**values), *state)
            # A combination of all components with unequal weights: its gradient is wrong if that of any of them is.
            return sum(jnp.sum(jnp.cos(jnp.arange(x.size)) * x.ravel()) for x in jax.tree.leaves(found)), found

        return jax.jit(jax.vmap(jax.grad(combined, (0, 1, 2), has_aux=True), (None, 0, 0, 0)))(values, *states)

    found, expected = with_gradients(some.replace), with_gradients(model.replace)
    for (path, a), b in zip(jax.tree.leaves_with_path(found), jax.tree.leaves(expected), strict=True):
        assert relative(a, b) < 1e-12, path


def test_kept_leaves_can_be_batched():
    model, (q, u, other) = shuffled(9)
    some, masses = kj.specialize(model, ["mass"]), model.mass[None, :] * jnp.array([[1.0], [2.0], [0.5]])
    found = jax.vmap(lambda mass, *x: kj.forward_dynamics(some.replace(mass=mass), *x))(masses, q, u, other)
    expected = jax.vmap(lambda mass, *x: kj.forward_dynamics(model.replace(mass=mass), *x))(masses, q, u, other)
    assert relative(found, expected) < 1e-9


def test_changing_a_kept_leaf_does_not_compile_again():
    model, (q, u, other) = shuffled(9)
    some, traced = kj.specialize(model, ["mass"]), []

    @jax.jit
    def call(some, *x):
        traced.append(1)
        return kj.inverse_dynamics(some, *x)

    first = call(some, q[0], u[0], other[0])
    assert not np.allclose(call(some.replace(mass=2 * model.mass), q[0], u[0], other[0]), first)
    assert len(traced) == 1


def test_unknown_leaves_are_named():
    model, _ = shuffled(1)
    with pytest.raises(kj.UnknownNameError, match=r"no leaf of a model is named 'weight'; the names are: 'gravity'"):
        kj.specialize(model, ["weight"])
    with pytest.raises(kj.UnknownNameError, match=r"no kept leaf is named 'com'; the names are: 'mass'"):
        kj.specialize(model, ["mass"]).replace(com=model.com)


def test_traced_models_are_refused():
    model = kj.from_mujoco(mujoco.MjModel.from_xml_string(random_tree(1, 2, ("hinge",))))
    with pytest.raises(ValueError, match="specialize it outside"):
        jax.jit(lambda m: kj.specialize(m).nq)(model)
