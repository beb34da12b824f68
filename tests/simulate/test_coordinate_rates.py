import functools
from xml.etree import ElementTree

import diffrax
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import kanejax as kj

SPINNING = """
<mujoco><option gravity="0 0 0"/><worldbody><body name="top"><freejoint name="float"/>
  <inertial pos="0 0 0" mass="1" diaginertia="0.3 0.3 0.5"/></body></worldbody></mujoco>"""


def state(model, seed=0):
    rng = np.random.default_rng(seed)
    q = np.array(model.spring_reference) + 0.1 * rng.normal(size=model.nq)
    return q, rng.normal(size=model.nv)


def test_coordinate_rates_are_those_of_mujoco(floating, floating_xml):
    mj_model = mujoco.MjModel.from_xml_string(floating_xml)
    q, u = state(floating)
    mujoco.mj_normalizeQuat(mj_model, q)
    ahead, behind, h = q.copy(), q.copy(), 1e-5
    mujoco.mj_integratePos(mj_model, ahead, u, h)
    mujoco.mj_integratePos(mj_model, behind, u, -h)
    np.testing.assert_allclose(kj.coordinate_rates(floating, jnp.asarray(q), jnp.asarray(u)), (ahead - behind) / (2 * h), atol=1e-9)


@pytest.fixture(scope="module")
def carrying(floating_xml):
    """A floating base that carries a ball joint, and no other kind."""
    root = ElementTree.fromstring(floating_xml)
    for arm in root.iterfind(".//body[@name='arm']"):
        arm.remove(arm[-1])
    return kj.load(ElementTree.tostring(root, encoding="unicode"))


@jax.jit
@functools.partial(jax.value_and_grad, argnums=(0, 1, 2), has_aux=True)
def loss(model, q, u):
    """Of a motion, its gradient and the motion: one program."""
    trajectory = kj.simulate(model, q, u, np.linspace(0, 0.3, 3), dt0=0.03)
    return jnp.sum(jnp.sin(trajectory.q)) + jnp.sum(trajectory.u**2), trajectory


def test_a_quaternion_of_another_length_moves_alike(carrying):
    q, u = state(carrying)
    longer = q.copy()
    longer[3:7] *= 3.0
    a, b = (loss(carrying, start, u)[0][1] for start in (q, longer))
    np.testing.assert_allclose(a.q, b.q, atol=1e-14)


def test_a_symmetric_top_keeps_its_axis_and_its_length():
    # In the body's axes, the angular velocity turns about the axis of symmetry at w_z (C - A) / A.
    model = kj.load(SPINNING)
    w, ts = np.array([1.0, 0.0, 2.0]), np.linspace(0, 200, 5)
    trajectory = kj.simulate(model, np.array([0, 0, 0, 1.0, 0, 0, 0]), np.array([0, 0, 0, *w]), ts, dt0=0.02)
    np.testing.assert_allclose(np.linalg.norm(trajectory.q[:, 3:], axis=1), 1, atol=1e-14)
    angle = w[2] * (0.5 - 0.3) / 0.3 * ts
    np.testing.assert_allclose(trajectory.u[:, 3:], np.stack((np.cos(angle), np.sin(angle), 2 + 0 * ts), 1), atol=1e-6)
    momentum = np.array([0.3, 0.3, 0.5])

    def turned(q, u):
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, np.array(q[3:]))
        return matrix.reshape(3, 3) @ (momentum * u[3:])

    np.testing.assert_allclose(turned(trajectory.q[-1], trajectory.u[-1]), momentum * w, atol=1e-6)


def test_the_explicit_euler_method_does_not_overflow():
    # Its steps lengthen the quaternion by a factor of 1 + (h w)^2 / 8, which would be more than 1e400 in all.
    model = kj.load(SPINNING)
    u0 = np.array([0, 0, 0, 0, 0, 40.0])
    trajectory = kj.simulate(model, np.array([0, 0, 0, 1.0, 0, 0, 0]), u0, np.array([0.0, 500.0]), dt0=0.01, solver=diffrax.Euler())
    assert trajectory.status == kj.Status.SUCCESSFUL
    np.testing.assert_allclose(np.linalg.norm(trajectory.q[-1, 3:]), 1, atol=1e-14)


def test_gradients_through_quaternions_agree_with_finite_differences_and_are_finite_at_rest(carrying):
    q, u = state(carrying, 1)
    _, dq, du = loss(carrying, q, u)[1]
    rng = np.random.default_rng(2)
    a, b, h = rng.normal(size=q.shape), rng.normal(size=u.shape), 1e-6
    ahead, behind = (loss(carrying, q + s * a, u + s * b)[0][0] for s in (h, -h))
    np.testing.assert_allclose(dq @ a + du @ b, (ahead - behind) / (2 * h), rtol=1e-7)

    changes = {name: jnp.full_like(getattr(carrying, name), 0.2) for name in ("stiffness", "coulomb_friction", "armature")}
    weightless = type(carrying)(**{**vars(carrying), **changes, "gravity": jnp.zeros(3)})
    rest = np.array([0, 0, 0, 1.0, 0, 0, 0, 1, 0, 0, 0])
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(loss(weightless, rest, np.zeros(9))[1]))
