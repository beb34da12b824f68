"""Derivatives of optima against differences of optima."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax import costs

ARM = """<mujoco><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping=".1"/><inertial pos="0 0 -.25" mass="2" diaginertia=".05 .05 .01"/>
    <body name="fore" pos="0 0 -.5"><joint name="elbow" axis="0 1 0" damping=".05"/>
      <inertial pos="0 0 -.2" mass="1" diaginertia=".02 .02 .005"/></body></body></worldbody></mujoco>"""


def optimum(arm, x):
    """An optimum on limits of speeds and forces, as a function of numbers of all kinds."""
    mass, length, goal, torque, weight, most = x[0], x[1], x[2:4], x[4], x[5], x[6]
    model = arm.replace(mass=arm.mass.at[1].set(mass), body_position=arm.body_position.at[1, 2].set(-length))
    limits = kj.Limits(model, u=most, tau=jnp.stack((torque, torque)))
    terms = (costs.torque(), costs.duration(weight))
    return kj.optimal_motion(kj.MotionTask(model, [-1.0, 0.5], goal, (0.3, 3.0), terms, limits=limits, steps=12), tolerance=1e-11)


def summary(motion):
    return jnp.concatenate((motion.cost[None], motion.duration[None], motion.q[6], motion.u[3], motion.tau[4]))


def test_all_of_an_optimum_by_all_of_a_task_in_both_modes():
    arm = kj.load(ARM)
    weights = jnp.asarray(np.random.default_rng(0).normal(size=8))

    def summary_and_ends(x):
        motion = optimum(arm, x)
        return summary(motion), (motion.converged, jnp.max(jnp.abs(motion.tau)), jnp.max(jnp.abs(motion.u)))

    @jax.jit
    def derived(x):
        found, push, ends = jax.linearize(summary_and_ends, x, has_aux=True)
        (gradient,) = jax.linear_transpose(push, x)(weights)
        return *ends, found, jax.vmap(push)(jnp.eye(len(x))).T, gradient

    x = jnp.array([1.0, 0.5, 0.8, -0.6, 1.5, 40.0, 3.0])
    converged, force, speed, _, forward, reverse = derived(x)
    assert bool(converged)
    assert float(force) == pytest.approx(1.5, abs=1e-7)
    assert float(speed) == pytest.approx(3.0, abs=1e-7)
    step = 1e-4
    expected = np.stack([(derived(x + step * e)[3] - derived(x - step * e)[3]) / (2 * step) for e in jnp.eye(len(x))], 1)
    scale = np.abs(expected).max(1, keepdims=True)
    assert np.abs((forward - expected) / scale).max() < 1e-6
    assert np.abs(reverse - weights @ forward).max() < 1e-9 * np.abs(reverse).max()
