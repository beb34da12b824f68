"""Second derivatives of inverse dynamics in closed form, against differentiation and against Pinocchio."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax._optimize.curvature import curved_forward_dynamics, curved_inverse_dynamics

# A tree with both kinds of joints, none along an axis of its frame, and forces of its joints.
TREE = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="a" pos="0 .2 1"><joint name="a" axis=".3 1 .2" armature=".1" damping=".2"/>
    <inertial pos=".1 0 -.2" mass="2" diaginertia=".05 .06 .02"/>
    <body name="b" pos="0 .1 -.5"><joint name="b" type="slide" axis="0 1 .5" stiffness="3" frictionloss=".5"/>
      <inertial pos="0 .1 -.2" mass="1" diaginertia=".02 .03 .015"/>
      <body name="c" pos="0 0 -.4"><joint name="c" axis="1 0 0" frictionloss=".1"/>
        <inertial pos="0 .1 0" mass=".5" diaginertia=".002 .003 .004"/></body></body>
    <body name="d" pos="0 .3 -.5"><joint name="d" axis="0 1 .5"/>
      <inertial pos="0 .1 -.2" mass="1" diaginertia=".02 .03 .015"/></body></body>
  <body name="e" pos="0 .3 -.5"><joint name="e" type="slide" axis="1 1 .5"/>
    <inertial pos="0 .1 -.2" mass="1" diaginertia=".02 .03 .015"/></body>
</worldbody></mujoco>"""


def state(model, count, dtype):
    rng = np.random.default_rng(2)
    return [jnp.asarray(rng.normal(size=(count, model.nv)), dtype) for _ in range(4)]


@pytest.mark.parametrize(
    ("curved", "dynamics"),
    [(curved_inverse_dynamics, kj.inverse_dynamics), (curved_forward_dynamics, kj.forward_dynamics)],
    ids=["inverse", "forward"],
)
def test_against_differences_of_the_jacobian(curved, dynamics):
    """Of the second order in their step; and float32 against float64."""
    model = kj.load(TREE)
    states = state(model, 3, jnp.float64)

    @jax.jit
    @jax.vmap
    def slopes(x):
        return jax.jacobian(lambda x: dynamics(model, *jnp.split(x, 3)))(x)

    def found(model, states):
        return jax.jit(jax.vmap(lambda q, u, last, weights: curved(model, q, u, last, lambda _: weights)))(*states)

    values = found(model, states)
    x, weights = jnp.concatenate(states[:3], 1), states[3]
    np.testing.assert_allclose(values.jacobian, slopes(x), rtol=0, atol=1e-12 * np.abs(values.jacobian).max())
    step = 1e-5
    ways = step * jnp.eye(x.shape[1])
    ahead, behind = (jnp.stack([slopes(x + sign * way[None]) for way in ways], 1) for sign in (1, -1))
    expected = jnp.einsum("nr,nirj->nij", weights, (ahead - behind) / (2 * step))
    np.testing.assert_allclose(values.curvature, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    single = found(model.astype(jnp.float32), [each.astype(jnp.float32) for each in states])
    for one, other in zip(single, values, strict=True):
        assert one.dtype == jnp.float32
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-5 * np.abs(other).max())


URDF = """<robot name="r"><link name="base"/>""" + "".join(
    f"""<joint name="j{i}" type="{kind}"><parent link="{"base" if i == 0 else f"l{i - 1}"}"/><child link="l{i}"/>
    <origin xyz=".1 {0.2 * i} .3" rpy="{i} .4 -.7"/><axis xyz="0 {i % 2} {1 - i % 2}"/>
    <limit effort="1" velocity="1" lower="-3" upper="3"/></joint>
    <link name="l{i}"><inertial><mass value="{1 + i}"/><origin xyz=".1 0 {0.1 * i}"/>
    <inertia ixx=".1" iyy=".12" izz=".09" ixy=".01" ixz="0" iyz=".02"/></inertial></link>"""
    for i, kind in enumerate(["revolute", "prismatic", "revolute", "revolute"])
)


def test_against_pinocchio():
    """Differences of its derivatives."""
    pin = pytest.importorskip("pinocchio")
    model, peer = kj.load(f"{URDF}</robot>"), pin.buildModelFromXML(f"{URDF}</robot>")
    work = peer.createData()
    rng = np.random.default_rng(3)
    q, u, a, weights = rng.normal(size=(4, model.nv))

    def slopes(x):
        q, u, a = np.split(x, 3)
        by_q, by_u, by_a = (each.copy() for each in pin.computeRNEADerivatives(peer, work, q, u, a))
        return np.hstack((by_q, by_u, np.triu(by_a) + np.triu(by_a, 1).T))

    there = [jnp.asarray(each) for each in (q, u, a, weights)]
    found = curved_inverse_dynamics(model, *there[:3], weigh=lambda _: there[3])
    x, step = np.concatenate((q, u, a)), 1e-5
    np.testing.assert_allclose(found.jacobian, slopes(x), rtol=0, atol=1e-11)
    expected = [weights @ (slopes(x + way) - slopes(x - way)) / (2 * step) for way in step * np.eye(len(x))]
    np.testing.assert_allclose(found.curvature, expected, rtol=0, atol=1e-7)
