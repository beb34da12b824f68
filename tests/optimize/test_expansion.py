"""Derivatives of a stage by the chain rule, and those of the dynamics in it, against differentiating everything."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax import constraints, costs
from kanejax._optimal_control.stages import AbstractStages, StageValues
from kanejax._optimize.optimize import first_path
from kanejax._optimize.transcription import MotionStages

ARM = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="ball" pos="0 0 1"><joint name="ball" type="ball" damping=".3"/>
    <inertial pos=".1 0 -.2" mass="2" diaginertia=".05 .06 .02"/>
    <body name="arm" pos="0 .1 -.5"><joint name="hinge" axis="0 1 0" armature=".02" stiffness="1"/>
      <inertial pos="0 0 -.2" mass="1" diaginertia=".02 .03 .015"/>
      <body name="slide" pos="0 0 -.4"><joint name="slide" type="slide" axis="1 0 0"/>
        <inertial pos="0 .1 0" mass=".5" diaginertia=".002 .003 .004"/></body></body></body>
</worldbody></mujoco>"""


CART_POLE = """<mujoco><worldbody><body><joint name="slide" type="slide" axis="1 0 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
  <body><joint name="hinge" axis="0 -1 0" damping=".2"/><inertial pos="0 0 -.5" mass=".3" diaginertia=".01 .01 .01"/></body>
  </body></worldbody></mujoco>"""


def jointed_by_a_ball():
    """Differentiated, and composed with the midpoint rule; all kinds of limits."""
    model = kj.load(ARM)
    start, goal = np.array([1.0, 0.0, 0.0, 0.0, 0.2, 0.1]), np.array([0.9, 0.1, -0.3, 0.2, 0.5, -0.1])
    terms = (costs.torque(), costs.torque_rate(0.1), costs.energy(), costs.acceleration(0.2), costs.duration(0.3))
    limits = kj.Limits(model, tau=20.0, power=30.0, u_dot=50.0, jerk=1e3)
    clear = constraints.sphere_clearance("slide", 0.05, [0.3, 0.0, 0.2], 0.1)
    return kj.MotionTask(model, start, goal, (0.5, 1.0), terms, limits=limits, constraints=clear, steps=3)


def with_several_evaluations_a_step():
    """In closed form, and chained along the method of Runge and Kutta."""
    model = kj.load(CART_POLE)
    terms = (costs.torque(), costs.energy(), costs.jerk(0.1))
    limits = kj.Limits(model, power=20.0, u_dot=30.0)
    options = {"limits": limits, "steps": 3, "substeps": 2}
    return kj.MotionTask(model, [0.0, 0.0], [1.0, np.pi], (1.0, 3.0), terms, dynamics="forward", **options)


@pytest.mark.parametrize("task", [jointed_by_a_ball, with_several_evaluations_a_step])
def test_expansion_of_a_stage(task):
    asked = task()
    guess = kj.straight_guess(asked)
    stages = MotionStages(asked, guess.q)
    path = first_path(stages, guess)
    rng = np.random.default_rng(1)
    k, nx = jnp.asarray(1), path.x.shape[1]
    v = jnp.concatenate((path.x[1], path.w[1]))
    v = v + jnp.asarray(0.1 * rng.normal(size=len(v)))
    shapes = stages.stage(k, v[:nx], v[nx:])
    weights = StageValues(*(jnp.asarray(rng.normal(size=each.shape)) for each in shapes))
    found = eqx.filter_jit(MotionStages.expansion)(stages, k, v, weights)
    expected = eqx.filter_jit(AbstractStages.expansion)(stages, k, v, weights)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-11 * max(1.0, np.abs(other).max()))
