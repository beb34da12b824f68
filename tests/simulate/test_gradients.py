from typing import Any

import diffrax
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


@pytest.mark.parametrize("options", [{"dt0": 0.02}, {"rtol": 1e-11, "atol": 1e-12}], ids=["equal", "adaptive"])
def test_every_leaf_agrees_with_finite_differences(pendulum, options):
    def loss(inputs):
        model, q, u = inputs
        trajectory = kj.simulate(model, q, u, TS, **options)
        return jnp.sum(jnp.sin(trajectory.q)) + jnp.sum(trajectory.u**2)

    inputs = (lossy(pendulum), jnp.asarray(Q0), jnp.asarray(U0))
    loss = jax.jit(loss)
    gradient, change, h = jax.grad(loss)(inputs), direction(inputs), 1e-5
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(gradient))
    found = sum(jnp.vdot(a, b) for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(change), strict=True))
    expected = (loss(along(inputs, change, h)) - loss(along(inputs, change, -h))) / (2 * h)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_forward_mode_agrees_with_finite_differences(pendulum):
    change, h = jnp.array([0.3, -0.7]), 1e-5
    choices: list[dict[str, Any]] = [{"dt0": 0.01}, {"rtol": 1e-11, "atol": 1e-12, "adjoint": diffrax.ForwardMode()}]
    for options in choices:

        def end(mass):
            model = type(pendulum)(**{**vars(pendulum), "mass": mass})
            return jnp.sum(kj.simulate(model, Q0, U0, TS, **options).q_end)  # noqa: B023

        found = jax.jvp(end, (pendulum.mass,), (change,))[1]
        expected = (end(pendulum.mass + h * change) - end(pendulum.mass - h * change)) / (2 * h)
        np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_times_that_were_not_reached_have_no_gradient(pendulum):
    ts = np.linspace(0, 1, 9)

    def loss(q):
        trajectory = kj.simulate(pendulum, q, U0, ts, events=lambda t, q, u: q[0] - 0.2, rtol=1e-10, atol=1e-12)
        return jnp.sum(jnp.where(trajectory.reached[:, None], trajectory.q, 0.0))

    q0, h = jnp.asarray(Q0), 1e-5
    assert np.isnan(kj.simulate(pendulum, q0, U0, ts, events=lambda t, q, u: q[0] - 0.2).q[-1]).all()
    expected = [(loss(q0 + h * e) - loss(q0 - h * e)) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(jax.grad(loss)(q0), expected, rtol=1e-6)


def test_an_implicit_step_has_gradients(pendulum):
    def end(q):
        return jnp.sum(kj.simulate(pendulum, q, U0, TS, solver=kj.BetaScheme(0.5), dt0=0.1, rtol=1e-12, atol=1e-13).q_end)

    gradient, h = jax.grad(end)(jnp.asarray(Q0)), 1e-5
    expected = [(end(Q0 + h * e) - end(Q0 - h * e)) / (2 * h) for e in np.eye(2)]
    np.testing.assert_allclose(gradient, expected, rtol=1e-7)
