"""Feedback along an optimal motion, in diffrax and in MuJoCo, for robots that are not as they are said to be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax import costs


@pytest.fixture(scope="module")
def case():
    """A planar arm that has to stand up, where it would fall without feedback: the program of the guide's first motion."""
    arm = kj.load(
        """<mujoco><worldbody>
      <body name="upper"><joint name="shoulder" axis="0 1 0"/><inertial pos="0 0 .25" mass="2" diaginertia=".05 .05 .01"/>
        <body name="fore" pos="0 0 .5"><joint name="elbow" axis="0 1 0"/>
          <inertial pos="0 0 .2" mass="1" diaginertia=".02 .02 .005"/><body name="tool" pos="0 0 .4"/></body></body>
      </worldbody></mujoco>"""
    )
    task = kj.MotionTask(arm, [2.0, -1.0], [0.3, 0.2], 1.0, costs.torque(), limits=kj.Limits(arm, u=np.inf, tau=40.0), steps=20)
    return arm, kj.optimize(task)


def test_both_simulators_agree(case):
    arm, motion = case
    ours, theirs = kj.replayed(arm, motion), kj.replayed_by_mujoco(arm, motion)
    assert np.abs(ours.q - theirs.q).max() < 1e-6 * max(1.0, np.abs(ours.q).max())
    assert np.abs(ours.q[0]).max() == np.abs(theirs.u[0]).max() == 0.0


def test_a_pole_swung_up_on_a_cart_stands_in_mujoco_too():
    """The cart-pole of Kelly (2017); CasADi and IPOPT find the same cost from the straight guess."""
    cart = kj.load(
        """<mujoco><worldbody><body><joint name="slide" type="slide" axis="1 0 0" range="-2 2" limited="true"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/>
      <body><joint name="hinge" axis="0 -1 0"/><inertial pos="0 0 -.5" mass=".3" diaginertia="1e-9 1e-9 1e-9"/></body>
      </body></worldbody></mujoco>"""
    )
    limits = kj.Limits(cart, tau=20.0, passive=("hinge",))
    options = {"limits": limits, "dynamics": "forward", "substeps": 4}
    motion = kj.optimize(kj.MotionTask(cart, [0.0, 0.0], [1.0, np.pi], 2.0, costs.torque(), **options))
    assert float(motion.cost) == pytest.approx(59.130, abs=1e-3)
    assert np.abs(motion.q[-1] - np.array([1.0, np.pi])).max() < 1e-6
    for off in (kj.replayed(cart, motion), kj.replayed_by_mujoco(cart, motion)):
        assert np.abs(off.q[-1]).max() < 1e-5
        assert np.abs(off.u[-1]).max() < 1e-4


def test_feedback_holds_a_motion_that_is_lost_without_it(case):
    arm, motion = case
    wrong = arm.replace(mass=1.1 * arm.mass, com=0.9 * arm.com, central_inertia=1.1 * arm.central_inertia)
    lost = kj.replayed(wrong, motion)
    control = kj.tracking(arm, motion)
    held = kj.replayed(wrong, motion, control)
    assert np.abs(lost.q).max() > 0.3
    assert np.abs(held.q).max() < 0.02
    assert np.abs(held.q).max() < 0.05 * np.abs(lost.q).max()
    theirs = kj.replayed_by_mujoco(wrong, motion, control)
    assert np.abs(theirs.q - held.q).max() < 5e-3


def test_on_the_motion_the_forces_are_its_own(case):
    arm, motion = case
    control = kj.tracking(arm, motion)
    forces = jax.jit(lambda t, q, u: control(t, q, u))
    for k in (0, 7, 19):
        np.testing.assert_allclose(forces(motion.ts[k], motion.q[k], motion.u[k]), motion.tau[k], atol=1e-9)
    smaller = kj.tracking(arm, motion, tau_error=jnp.array([0.01, 0.01]))
    assert np.abs(smaller.gains).max() < 0.2 * np.abs(control.gains).max()
