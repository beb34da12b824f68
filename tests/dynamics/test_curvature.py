"""Second derivatives of inverse dynamics in closed form, against differentiation and against Pinocchio."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax._optimize.curvature import curved_forward_dynamics, curved_inverse_dynamics
from kanejax._optimize.displacement import displaced

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


# A free base, balls on it and on each other, with springs, and joints of one speed behind them.
BALLS = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="base" pos="0 .2 1"><freejoint name="base"/><inertial pos=".1 0 -.2" mass="2" diaginertia=".05 .06 .02"/>
    <body name="b" pos="0 .1 -.5" euler=".3 -.2 .5"><joint name="b" type="ball" stiffness="3" frictionloss=".5"/>
      <inertial pos="0 .1 -.2" mass="1" diaginertia=".02 .03 .015"/>
      <body name="c" pos="0 0 -.4"><joint name="c" axis="1 0 0" damping=".1"/>
        <inertial pos="0 .1 0" mass=".5" diaginertia=".002 .003 .004"/>
        <body name="d" pos="0 .1 .2"><joint name="d" type="ball" pos=".02 0 .1" armature=".01"/>
          <inertial pos="0 .1 .1" mass=".3" diaginertia=".002 .003 .004"/></body></body></body>
    <body name="e" pos="0 .3 -.5"><joint name="e" type="slide" axis="0 1 .5"/>
      <inertial pos="0 .1 -.2" mass="1" diaginertia=".02 .03 .015"/></body></body>
</worldbody></mujoco>"""


def state(model, count, dtype):
    """Coordinates, speeds, rates or forces, and weights."""
    rng = np.random.default_rng(2)
    q = rng.normal(size=(count, model.nq))
    for start in model.tree.turning_speeds[1]:
        q[:, start : start + 4] /= np.linalg.norm(q[:, start : start + 4], axis=1, keepdims=True)
    return [jnp.asarray(each, dtype) for each in (q, *rng.normal(size=(3, count, model.nv)))]


@functools.partial(jax.jit, static_argnums=0)
def weighted(curved, model, states):
    """Of a batch, with fixed weights."""
    return jax.vmap(lambda q, u, last, weights: curved(model, q, u, last, lambda _: weights))(*states)


@pytest.mark.parametrize(
    ("tree", "curved", "dynamics"),
    [
        (TREE, curved_inverse_dynamics, kj.inverse_dynamics),
        (TREE, curved_forward_dynamics, kj.forward_dynamics),
        (BALLS, curved_inverse_dynamics, kj.inverse_dynamics),
    ],
    ids=["inverse", "forward", "balls"],
)
def test_against_differences_of_the_jacobian(tree, curved, dynamics):
    """Of the second order in their step."""
    model = kj.load(tree)
    states = state(model, 2, jnp.float64)
    nv = model.nv

    @jax.jit
    @jax.vmap
    def slopes(q, x):
        def of(x):
            return dynamics(model, displaced(model.tree, q, x[:nv]), x[nv : 2 * nv], x[2 * nv :])

        return jax.jacfwd(of)(x)

    values = weighted(curved, model, states)
    q, weights = states[0], states[3]
    x = jnp.concatenate((jnp.zeros_like(states[1]), *states[1:3]), 1)
    np.testing.assert_allclose(values.jacobian, slopes(q, x), rtol=0, atol=1e-12 * np.abs(values.jacobian).max())
    step = 1e-5
    ways = step * jnp.eye(x.shape[1])
    ahead, behind = (jnp.stack([slopes(q, x + sign * way[None]) for way in ways], 1) for sign in (1, -1))
    expected = jnp.einsum("nr,nirj->nij", weights, (ahead - behind) / (2 * step))
    np.testing.assert_allclose(values.curvature, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("tree", [TREE, BALLS], ids=["hinges and slides", "balls"])
def test_in_single_precision(tree):
    model = kj.load(tree)

    states = state(model, 2, jnp.float64)
    single = weighted(curved_inverse_dynamics, model.astype(jnp.float32), [each.astype(jnp.float32) for each in states])
    for one, other in zip(single, weighted(curved_inverse_dynamics, model, states), strict=True):
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


ON_A_BALL = """<mujoco><compiler angle="radian"/><worldbody><body name="a" pos="0 .2 1"><joint name="a" type="ball"/>
  <inertial pos=".1 0 -.2" mass="2" diaginertia=".05 .06 .02"/>
  <body name="b" pos="0 .1 -.5"><joint name="b" axis="0 0 1"/><inertial pos="0 .1 -.2" mass="1" diaginertia=".02 .03 .015"/>
  </body></body></worldbody></mujoco>"""


def test_a_ball_against_pinocchio():
    """Turning about one axis of a ball and then about another is the mean of both orders."""
    pin = pytest.importorskip("pinocchio")
    model, peer = kj.load(ON_A_BALL), pin.Model()
    ball = peer.addJoint(0, pin.JointModelSpherical(), pin.SE3(np.eye(3), np.array([0.0, 0.2, 1.0])), "a")
    peer.appendBodyToJoint(ball, pin.Inertia(2.0, np.array([0.1, 0, -0.2]), np.diag([0.05, 0.06, 0.02])), pin.SE3.Identity())
    hinge = peer.addJoint(ball, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([0.0, 0.1, -0.5])), "b")
    peer.appendBodyToJoint(hinge, pin.Inertia(1.0, np.array([0, 0.1, -0.2]), np.diag([0.02, 0.03, 0.015])), pin.SE3.Identity())
    q, u, a, weights = (np.asarray(each[0]) for each in state(model, 1, jnp.float64))
    theirs, work, nv = np.array([*q[1:4], q[0], q[4]]), peer.createData(), model.nv

    def slopes(x):
        moved, u, a = np.split(x, 3)
        found = pin.computeRNEADerivatives(peer, work, pin.integrate(peer, theirs, moved), u, a)
        by_q, by_u, by_a = (each.copy() for each in found)
        return np.hstack((by_q, by_u, np.triu(by_a) + np.triu(by_a, 1).T))

    there = [jnp.asarray(each) for each in (q, u, a, weights)]
    found = curved_inverse_dynamics(model, *there[:3], weigh=lambda _: there[3])
    x, step = np.concatenate((np.zeros(nv), u, a)), 1e-5
    np.testing.assert_allclose(found.jacobian, slopes(x), rtol=0, atol=1e-12 * np.abs(slopes(x)).max())
    one_order = np.array([weights @ (slopes(x + way) - slopes(x - way)) / (2 * step) for way in step * np.eye(len(x))])
    expected = 0.5 * (one_order + one_order.T)
    assert np.abs(one_order - expected).max() > 0.1
    np.testing.assert_allclose(found.curvature, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_at_the_identity_and_at_rest_in_both_modes():
    """Derivatives are finite there, also those of the second derivatives; of a ball on a spring, which pulls from elsewhere too."""
    model = kj.load(ON_A_BALL.replace('type="ball"', 'type="ball" stiffness="3"'))
    q, still, weights = jnp.array([1.0, 0.0, 0.0, 0.0, 0.0]), jnp.zeros(model.nv), jnp.arange(1.0, 5.0)

    @jax.jit
    def derived(model, q, u):
        def of(model, q, u):
            return curved_inverse_dynamics(model, q, u, u, lambda _: weights)

        mixed, pull_back = jax.vjp(of, model, q, u)
        direction = jax.tree.map(jnp.ones_like, (model, q, u))
        moved = jax.jvp(of, (model, q, u), direction)[1]
        slopes = pull_back(jax.tree.map(jnp.ones_like, mixed))
        return mixed, moved, slopes, direction

    found, moved, slopes, direction = derived(model, q, still)
    forwards = sum(float(jnp.sum(each)) for each in moved)
    backwards = sum(float(jnp.sum(a * b)) for a, b in zip(jax.tree.leaves(slopes), jax.tree.leaves(direction), strict=True))
    assert np.isfinite(forwards)
    assert backwards == pytest.approx(forwards, rel=1e-10)
    assert all(bool(jnp.all(jnp.isfinite(each))) for each in jax.tree.leaves((found, slopes)))
    loose = derived(model.replace(stiffness=0.0 * model.stiffness), q, still)[0]
    np.testing.assert_allclose(np.diag((found.jacobian - loose.jacobian)[:3, :3]), 3.0, rtol=1e-12)
