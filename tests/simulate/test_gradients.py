from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj

Q0, U0, TS = np.array([0.3, -0.8]), np.array([0.5, 1.0]), np.array([0.0, 0.2, 0.4])


def lossy(model):
    """The model with springs, dampers and friction."""
    changes = {name: jnp.full_like(getattr(model, name), 0.2) for name in ("damping", "stiffness", "coulomb_friction", "armature")}
    return type(model)(**{**vars(model), **changes, "friction_width": jnp.full_like(model.friction_width, 0.3)})


def direction(tree, seed=0):
    """A random direction, zero where a leaf is infinite, such as joint ranges."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), jnp.asarray(rng.normal(size=x.shape)), 0.0), tree)


def along(tree, change, h):
    return jax.tree.map(lambda x, d: jnp.where(d == 0, x, x + h * d), tree, change)


class Gain(eqx.Module):
    gain: jax.Array

    def __call__(self, t, q, u):
        return -self.gain * u + jnp.sin(t)


@pytest.mark.parametrize("options", [{"dt0": 0.02}, {"rtol": 1e-11, "atol": 1e-12}], ids=["equal", "adaptive"])
def test_every_leaf_agrees_with_finite_differences(pendulum, options):
    @jax.jit
    @jax.value_and_grad
    def loss(inputs):
        model, q, u, control = inputs
        trajectory = kj.simulate(model, q, u, TS, control=control, **options)
        return jnp.sum(jnp.sin(trajectory.q)) + jnp.sum(trajectory.u**2)

    inputs = (lossy(pendulum), jnp.asarray(Q0), jnp.asarray(U0), Gain(jnp.array([0.3, 0.2])))
    gradient, change, h = loss(inputs)[1], direction(inputs), 1e-5
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(gradient))
    found = sum(np.vdot(a, b) for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(change), strict=True))
    expected = (loss(along(inputs, change, h))[0] - loss(along(inputs, change, -h))[0]) / (2 * h)
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    *state, control = inputs
    ahead, behind = ([loss((*state, Gain(control.gain + s * e)))[0] for e in np.eye(2)] for s in (h, -h))
    np.testing.assert_allclose(gradient[3].gain, (np.array(ahead) - np.array(behind)) / (2 * h), rtol=1e-7)


def test_forward_mode_agrees_with_finite_differences(pendulum):
    change, h = jnp.array([0.3, -0.7]), 1e-5
    choices: list[dict[str, Any]] = [{"dt0": 0.01}, {"rtol": 1e-11, "atol": 1e-12, "adjoint": diffrax.ForwardMode()}]
    for options in choices:

        def end(mass):
            model = type(pendulum)(**{**vars(pendulum), "mass": mass})
            return jnp.sum(kj.simulate(model, Q0, U0, TS, **options).q_end)  # noqa: B023

        both = jax.jit(lambda mass: jax.jvp(end, (mass,), (change,)))
        found = both(pendulum.mass)[1]
        expected = (both(pendulum.mass + h * change)[0] - both(pendulum.mass - h * change)[0]) / (2 * h)
        np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_an_implicit_step_has_gradients(pendulum):
    @jax.jit
    @jax.value_and_grad
    def end(q):
        return jnp.sum(kj.simulate(pendulum, q, U0, TS, solver=kj.BetaScheme(0.5), dt0=0.1, rtol=1e-12, atol=1e-13).q_end)

    gradient, h = end(jnp.asarray(Q0))[1], 1e-5
    expected = [(end(Q0 + h * e)[0] - end(Q0 - h * e)[0]) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(gradient, expected, rtol=1e-7)
