"""Drives: friction laws written by hand, derivatives at rest, and what they say of mistakes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers.mechanisms import random_tree, relative

import kanejax as kj
from kanejax._parameters.plant import Drives, Plant, drive_force, motor_signal, signal

RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def plant() -> Plant:
    model = kj.load(random_tree(3, 3, ("hinge", "slide"), chain=True))
    nv = model.nv
    model = model.replace(coulomb_friction=RNG.uniform(0, 1, nv), friction_width=RNG.uniform(0.05, 0.2, nv))
    drives = Drives.ideal(model).replace(
        gain=RNG.uniform(0.5, 2.0, nv) * np.where(np.arange(nv) % 2, 1.0, -1.0),
        offset=RNG.normal(size=nv),
        stribeck_friction=RNG.uniform(0, 2, nv),
        stribeck_speed=RNG.uniform(0.1, 0.5, nv),
        load_friction=RNG.uniform(0, 0.3, nv),
    )
    return Plant(model, drives)


def state(model: kj.Model, scale: float = 1.0):
    rng = np.random.default_rng(1)
    return tuple(jnp.asarray(scale * rng.normal(size=size), model.dtype) for size in (model.nq, model.nv, model.nv))


def by_hand(plant: Plant, q, u, u_dot) -> np.ndarray:
    """The law in numpy, with the load from a model that has neither rotors nor springs, dampers and friction."""
    model, drives, nothing = plant.model, plant.drives, jnp.zeros(plant.model.nv)
    bare = model.replace(armature=nothing, damping=nothing, coulomb_friction=nothing, stiffness=jnp.zeros(model.njoint))
    load = np.asarray(kj.inverse_dynamics(bare, q, u, u_dot))
    stribeck, speed, width = (np.asarray(x) for x in (drives.stribeck_friction, drives.stribeck_speed, model.friction_width))
    u_ = np.asarray(u)
    friction = stribeck * np.exp(-((u_ / speed) ** 2)) + np.asarray(drives.load_friction) * np.abs(load)
    total = np.asarray(kj.inverse_dynamics(model, q, u, u_dot)) + friction * u_ / np.sqrt(u_**2 + width**2)
    return total + np.asarray(drives.offset)


def test_ideal_drives_measure_forces_at_the_joints(plant):
    ideal = Plant(plant.model, Drives.ideal(plant.model))
    q, u, u_dot = state(plant.model)
    np.testing.assert_allclose(signal(ideal, q, u, u_dot), kj.inverse_dynamics(plant.model, q, u, u_dot), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("scale", [0.0, 0.05, 1.0, 30.0])
def test_forces_and_signals_follow_the_law(plant, scale):
    q, u, u_dot = state(plant.model)
    u = scale * u
    expected = by_hand(plant, q, u, u_dot)
    assert relative(drive_force(plant, q, u, u_dot), expected) < 1e-12
    assert relative(signal(plant, q, u, u_dot), expected / np.asarray(plant.drives.gain)) < 1e-12
    single = jax.tree.map(lambda x: x.astype(jnp.float32), plant)
    result = jax.jit(signal)(single, *(x.astype(jnp.float32) for x in (q, u, u_dot)))
    assert result.dtype == jnp.float32
    assert relative(result, expected / np.asarray(plant.drives.gain)) < 1e-4


def test_inertia_parameters_take_the_place_of_the_models(plant):
    q, u, u_dot = state(plant.model)
    other = plant.model.replace(mass=2.0 * plant.model.mass, com=plant.model.com + 0.1)
    expected = by_hand(Plant(other, plant.drives), q, u, u_dot)
    assert relative(drive_force(plant, q, u, u_dot, kj.inertia_parameters(other)), expected) < 1e-12


def test_signals_from_forces(plant):
    q, u, u_dot = state(plant.model)
    force = kj.inverse_dynamics(plant.model, q, u, u_dot)
    load = force + kj.passive_force(plant.model, q, u) - plant.model.armature * u_dot
    result = motor_signal(plant.drives, plant.model.friction_width, force, load, u)
    assert relative(result, signal(plant, q, u, u_dot)) < 1e-12


def test_states_in_a_batch(plant):
    states = [jnp.stack([x, 0.5 * x, 0.1 + x]) for x in state(plant.model)]
    batch = jax.jit(jax.vmap(lambda *x: signal(plant, *x)))(*states)
    for row in range(3):
        assert relative(batch[row], signal(plant, *(x[row] for x in states))) < 1e-12


def test_derivatives_agree_with_differences(plant):
    q, u, u_dot = state(plant.model)
    direction = jax.tree.map(lambda x: jnp.asarray(np.random.default_rng(x.size).normal(size=x.shape)), plant)
    slope = jax.jvp(lambda p: signal(p, q, u, u_dot), (plant,), (direction,))[1]
    step = 1e-6
    ahead, behind = (jax.tree.map(lambda x, d, s=s: x + s * d, plant, direction) for s in (step, -step))
    difference = (signal(ahead, q, u, u_dot) - signal(behind, q, u, u_dot)) / (2 * step)
    assert relative(slope, difference) < 1e-7


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_derivatives_are_finite_at_rest_without_load(plant, dtype):
    weightless = Plant(plant.model.replace(gravity=jnp.zeros(3)), plant.drives)
    weightless = jax.tree.map(lambda x: x.astype(dtype), weightless)
    q = state(weightless.model)[0]
    rest = jnp.zeros(weightless.model.nv, dtype)
    size = jax.grad(lambda *args: jnp.sum(jnp.cos(signal(*args))), argnums=(0, 1, 2, 3))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(jax.jit(size)(weightless, q, rest, rest)))
    # At rest the friction of the gears is as steep as its width says.
    slope = np.diag(jax.jacfwd(lambda u: drive_force(weightless, q, u, rest))(rest))
    viscous = weightless.model.damping + weightless.model.coulomb_friction / weightless.model.friction_width
    assert relative(slope, viscous + weightless.drives.stribeck_friction / weightless.model.friction_width) < 1e-4


def test_drives_replace_converts_and_checks(plant):
    changed = plant.drives.replace(gain=2, delay=np.float32(0.25))
    np.testing.assert_array_equal(changed.gain, np.full(plant.model.nv, 2.0))
    assert (changed.gain.dtype, changed.delay.shape, float(changed.delay)) == (jnp.float64, (), 0.25)
    with pytest.raises(kj.UnknownNameError, match="no leaf of drives is named 'gains'; the names are: 'gain', 'offset', 'stri"):
        plant.drives.replace(gains=1.0)
    with pytest.raises(ValueError, match=rf"drives\.offset has shape \(2,\), but needs \({plant.model.nv},\)"):
        plant.drives.replace(offset=[1.0, 2.0])


def test_plants_check_their_drives(plant):
    other = kj.load(random_tree(0, 5, ("hinge",)))
    with pytest.raises(ValueError, match=rf"drives\.gain has shape \({plant.model.nv},\), but this model needs \(5,\)"):
        Plant(other, plant.drives)
    with pytest.raises(ValueError, match=r"drives\.gain has dtype float64, but the model has float32"):
        Plant(other.astype(jnp.float32), Drives.ideal(other))
