"""Specialized models compute the same, with all parameters as constants."""

import functools

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj
from tests.helpers import components
from tests.helpers.mechanisms import random_states, random_tree, relative

# Leaves that one test or the other keeps.
LEAVES = ("mass", "com", "central_inertia", "joint_axis", "body_position", "gravity", "armature", "stiffness")


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
    mj = mujoco.MjModel.from_xml_string(random_tree(seed, 3, kinds))
    model = kj.from_mujoco(mj)
    states = [jnp.asarray(x) for x in random_states(mj, 3)]
    found = jax.jit(jax.vmap(everything, (None, 0, 0, 0)))(kj.specialize(model), *states)
    expected = one_by_one(jax.jit(functools.partial(everything, model)), states)
    for a, b in zip(found, expected, strict=True):
        assert relative(a, b) < 1e-9


def one_by_one(function, states):
    """What `jax.vmap` over states gives, from a program for one state, which compiles in half the time."""
    return jax.tree.map(lambda *x: np.stack(x), *(function(*state) for state in zip(*states, strict=True)))


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


def combination(results):
    """Of all components, with unequal weights: its gradient is wrong if that of any of them is."""
    return sum(jnp.sum(jnp.cos(jnp.arange(x.size)) * x.ravel()) for x in jax.tree.leaves(results))


def with_gradients(function, model, values, states):
    """Results of one state after the other, and gradients of their combination with respect to `values` and to the state.

    In forward mode, one component after the other, by one program for them all. `values` are leaves of the model, by name.
    """

    @jax.jit
    def along(direction, *state):
        def results(leaves, *state):
            found = function(model.replace(**leaves), *state)
            return combination(found), found

        return jax.jvp(results, (values, *state), direction, has_aux=True)[1:]

    def of_one(*state):
        point = (values, *state)
        nowhere = jax.tree.map(jnp.zeros_like, point)
        return along(nowhere, *state)[1], components.gradient(lambda direction: along(direction, *state)[0], point)

    return one_by_one(of_one, states)


def some_leaves(model):
    return {name: getattr(model, name) for name in LEAVES}


def partly(model, keep):
    """The model, specialized when the leaves that are kept had other values; and their values."""
    values = {name: getattr(model, name) for name in keep}
    return kj.specialize(model.replace(**{name: 0.9 * value - 0.05 for name, value in values.items()}), keep), values


def equations(model, q, u, other):
    return kj.inverse_dynamics(model, q, u, other), kj.forward_dynamics(model, q, u, other)


@pytest.fixture(scope="module")
def dynamics():
    model, states = shuffled(8)
    return model, states, *with_gradients(equations, model, some_leaves(model), states)


@pytest.mark.parametrize("keep", [("mass", "com", "central_inertia"), ("joint_axis",), ("gravity", "armature", "stiffness")])
def test_kept_leaves_are_parameters(dynamics, keep):
    model, states, expected, (slopes, *_) = dynamics
    some, values = partly(model, keep)

    def loss(values, *states):
        found = equations(some.replace(**values), *states)
        return combination(found), found

    def sum_of_losses(values, *states):
        losses, found = jax.vmap(loss, (None, 0, 0, 0))(values, *states)
        return jnp.sum(losses), found

    if keep == ("joint_axis",):  # A batch takes twice as long to compile.
        rows, found = one_by_one(jax.jit(functools.partial(jax.grad(loss, has_aux=True), values)), states)
        gradients = jax.tree.map(lambda x: x.sum(0), rows)
    else:
        gradients, found = jax.jit(jax.grad(sum_of_losses, has_aux=True))(values, *states)
    for a, b in zip(found, expected, strict=True):
        assert relative(a, b) < 1e-9
    for name, gradient in gradients.items():
        assert relative(gradient, slopes[name].sum(0)) < 1e-9, name


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


@pytest.fixture(scope="module")
def kinematics():
    model, states = shuffled(5, ("free", "hinge", "ball"))
    assert set(model.tree.joint_types) == {"free", "revolute", "ball"}
    return model, states, *with_gradients(quantities, model, some_leaves(model), states)


def same_gradients(found, expected, keep):
    """Gradients and results of those quantities, but with respect to the leaves that are kept."""
    results, (slopes, *of_state) = expected
    wanted = ({name: slopes[name] for name in keep}, *of_state), results
    for (path, a), b in zip(jax.tree.leaves_with_path(found), jax.tree.leaves(wanted), strict=True):
        assert relative(a, b) < 1e-12, path


@pytest.mark.parametrize("keep", [("mass", "com", "stiffness"), ("body_position", "gravity")], ids=str)
def test_kinematics_energies_and_wrenches_with_kept_leaves(kinematics, keep):
    model, states, *expected = kinematics
    results, gradients = with_gradients(quantities, *partly(model, keep), states)
    same_gradients((gradients, results), expected, keep)


def test_kinematics_energies_and_wrenches_of_a_batch(kinematics):
    model, states, *expected = kinematics
    frozen = kj.specialize(model)

    def combined(*state):
        found = quantities(frozen, *state)
        return combination(found), found

    gradients, found = jax.jit(jax.vmap(jax.grad(combined, (0, 1, 2), has_aux=True)))(*states)
    same_gradients((({}, *gradients), found), expected, ())


def test_kept_leaves_can_be_batched():
    model, (q, u, other) = shuffled(9)
    some, masses = kj.specialize(model, ["mass"]), model.mass[None, :] * jnp.array([[1.0], [2.0], [0.5]])
    found = jax.jit(jax.vmap(lambda mass, *x: kj.forward_dynamics(some.replace(mass=mass), *x)))(masses, q, u, other)
    plain = jax.jit(lambda mass, *x: kj.forward_dynamics(model.replace(mass=mass), *x))
    assert relative(found, one_by_one(plain, (masses, q, u, other))) < 1e-9


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
