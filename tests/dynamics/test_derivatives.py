"""Gradients: right against finite differences in the tangent space, and finite wherever a user can stand."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj
from tests.helpers.mechanisms import random_states, random_tree, relative


@pytest.fixture(scope="module")
def case():
    """A floating base with a ball joint and hinges on it: every kind of coordinate."""
    xml = """<mujoco><worldbody><body name="base"><freejoint/><inertial pos=".1 0 .05" mass="2" diaginertia=".2 .3 .25"/>
      <body name="arm" pos=".3 0 .1"><joint type="ball" stiffness="2" damping=".1" armature=".05"/>
        <inertial pos="0 .1 .2" mass="1" diaginertia=".1 .1 .05"/>
        <body name="hand" pos="0 0 .4"><joint type="hinge" axis="1 .2 0" stiffness="1" springref=".2" frictionloss=".3"/>
          <joint type="slide" axis="0 0 1" damping=".2"/><inertial pos="0 0 .1" mass=".5" diaginertia=".02 .03 .04"/></body></body>
      </body></worldbody></mujoco>"""
    mj = mujoco.MjModel.from_xml_string(xml)
    return mj, kj.from_mujoco(mj)


def everything(model, q, u, tau):
    """A sum, of which no number is finite that is not in all parts."""
    return (
        jnp.sum(kj.forward_dynamics(model, q, u, tau))
        + jnp.sum(kj.inverse_dynamics(model, q, u, tau))
        + jnp.sum(kj.mass_matrix(model, q))
        + kj.kinetic_energy(model, q, u)
        + kj.potential_energy(model, q)
    )


def singular_parts(model, q, u, tau):
    """What divides or takes roots, and where springs turn: the rest of `everything` are products and sums of rotations."""
    return jnp.sum(kj.forward_dynamics(model, q, u, tau)) + kj.potential_energy(model, q)


value_and_gradients = jax.jit(jax.value_and_grad(everything, (0, 1, 2, 3)))


def at_rest(model):
    """Zero speeds, zero displacements and identity quaternions, with springs at their references and friction at rest."""
    still = jnp.zeros(model.nv, model.dtype)
    return jnp.asarray(model.coordinate_reference), still, still


def test_tangent_gradient_is_the_derivative_along_the_speeds(case):
    mj, model = case
    (q,), (u,), (tau,) = random_states(mj, 1)
    _, (_, of_q, *_) = value_and_gradients(model, q, u, tau)
    found = kj.tangent_gradient(model, jnp.asarray(q), of_q)
    assert found.shape == (model.nv,)
    expected, step = np.zeros(model.nv), 1e-5
    for i, direction in enumerate(np.eye(model.nv)):
        for sign in (1, -1):
            moved = q.copy()
            mujoco.mj_integratePos(mj, moved, direction, sign * step)
            expected[i] += sign * float(value_and_gradients(model, moved, u, tau)[0]) / (2 * step)
    assert relative(found, expected) < 1e-6


def test_gradients_with_respect_to_every_leaf(case):
    mj, model = case
    (q,), (u,), (tau,) = random_states(mj, 1)
    loss, (gradient, *_) = value_and_gradients(model, q, u, tau)
    rng = np.random.default_rng(1)
    for name in (f for f in vars(model) if f != "tree" and f != "joint_range"):
        leaf = getattr(model, name)
        direction = rng.normal(size=leaf.shape)
        step = 1e-6
        moved = (model.replace(**{name: leaf + sign * step * direction}) for sign in (1, -1))
        ahead, behind = (float(value_and_gradients(each, q, u, tau)[0]) for each in moved)
        slope = np.vdot(getattr(gradient, name), direction)
        # The differences are good to about 1e-16 / 1e-6 of the loss itself.
        assert slope == pytest.approx((ahead - behind) / (2 * step), rel=1e-5, abs=1e-7 * abs(float(loss))), name


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_gradients_are_finite_at_rest_and_at_the_identity(case, dtype):
    model = case[1].astype(dtype)
    if dtype == "float64":
        gradients = value_and_gradients(model, *at_rest(model))
    else:
        gradients = jax.jit(jax.grad(singular_parts, (0, 1, 2, 3)))(model, *at_rest(model))
    for leaf in jax.tree.leaves(gradients):
        assert leaf.dtype == dtype
        assert bool(jnp.isfinite(leaf).all())


def test_second_derivatives_are_finite_at_rest(case):
    """The sum of each row of the Hessian, of which none is finite that has a number which is not."""
    _, model = case
    rest, still, _ = at_rest(model)
    gradient = jax.grad(lambda q: jnp.sum(kj.forward_dynamics(model, q, still, still)))
    rows = jax.jit(lambda q: jax.jvp(gradient, (q,), (jnp.ones_like(q),))[1])(rest)
    assert bool(jnp.isfinite(rows).all())


def test_length_of_a_quaternion_does_not_matter():
    mj = mujoco.MjModel.from_xml_string(random_tree(3, 2, ("ball",)))
    model = kj.from_mujoco(mj).replace(stiffness=jnp.zeros(2))
    (q,), (u,), (tau,) = (jnp.asarray(x) for x in random_states(mj, 1))
    assert relative(kj.forward_dynamics(model, 3.0 * q, u, tau), kj.forward_dynamics(model, q, u, tau)) < 1e-12
