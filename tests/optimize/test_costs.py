"""The terms of the library, each at a moment, against their formulas; in both data types and with two derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kanejax as kj
from kanejax import constraints, costs

ARM = """<mujoco><worldbody>
  <body name="upper"><joint axis="0 1 0"/><inertial pos="0 0 -.25" mass="2" diaginertia=".05 .05 .01"/>
    <body name="fore" pos="0 0 -.5"><joint axis="0 1 0"/><inertial pos="0 0 -.2" mass="1" diaginertia=".02 .02 .005"/></body>
  </body></worldbody></mujoco>"""
Q, U, U_DOT, TAU = np.array([[0.3, 0.8], [0.5, -1.0], [2.0, 3.0], [-1.5, 0.7]])
RATE, JERK = np.array([4.0, -2.0]), np.array([1.0, 5.0])
POINT = np.array([0.0, 0.0, -0.4])


def place(q):
    """Of a point 0.4 m below the elbow."""
    return np.array([-0.5 * np.sin(q[0]) - 0.4 * np.sin(q.sum()), 0.0, -0.5 * np.cos(q[0]) - 0.4 * np.cos(q.sum())])


def at(dtype):
    return kj.Moment(jnp.asarray(0.25, dtype), *(jnp.asarray(each, dtype) for each in (Q, U, U_DOT, TAU, RATE, JERK)))


def value_of(term, dtype):
    """As a task has it, with gradients of both orders finite."""
    model = kj.load(ARM).astype(dtype)
    if isinstance(term, kj.Cost):
        (term,) = kj.MotionTask(model, Q, Q, 1.0, term).costs
    else:
        (term,) = kj.MotionTask(model, Q, Q, 1.0, costs.torque(), constraints=term).constraints

    def value(q):
        return jnp.asarray(term.function(model, at(dtype)._replace(q=q)))

    q = jnp.asarray(Q, dtype)
    found = value(q)
    assert found.dtype == dtype
    assert np.isfinite(jax.jit(jax.hessian(lambda q: jnp.sum(value(q))))(q)).all()
    return np.asarray(found)


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
@pytest.mark.parametrize(
    ("term", "expected"),
    [
        (costs.torque(np.array([1.0, 2.0])), TAU[0] ** 2 + 2 * TAU[1] ** 2),
        (costs.torque_rate(), np.sum(RATE**2)),
        (costs.speed(3), 3 * np.sum(U**2)),
        (costs.acceleration(), np.sum(U_DOT**2)),
        (costs.jerk(), np.sum(JERK**2)),
        (costs.duration(), 0.25),
        (costs.energy(width=0.1), np.sum(np.sqrt((TAU * U) ** 2 + 0.01) - 0.1)),
        (costs.tracking(np.array([[0.0, 0.0], [1.0, 2.0], [0.0, 0.0]]), 1.0, np.array([1.0, 2.0])), 0.2**2 + 2 * 0.2**2),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_costs(term, expected, dtype):
    assert float(value_of(term, dtype)) == pytest.approx(expected, rel=1e-12 if dtype == jnp.float64 else 1e-5)


def test_manipulability_is_the_area_of_the_velocities():
    """In the plane; the third row of the Jacobian is zero, so a joint that moves the point out of it is added."""
    model = kj.load(ARM.replace('<body name="upper">', '<body name="upper"><joint axis="0 0 1"/>'))
    moment = kj.Moment(jnp.asarray(0.0), jnp.array([0.0, *Q]), jnp.zeros(3))
    found = costs.manipulability("fore", POINT).function(model, moment)
    step = 1e-6
    places = [kj.poses(model, moment.q + step * e) for e in np.eye(3)], [kj.poses(model, moment.q - step * e) for e in np.eye(3)]
    ahead, behind = ([np.asarray(p.origin[1] + p.rotation[1] @ POINT) for p in side] for side in places)
    jacobian = (np.array(ahead) - np.array(behind)).T / (2 * step)
    assert float(found) == pytest.approx(-np.log(abs(np.linalg.det(jacobian))), rel=1e-8)


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
@pytest.mark.parametrize(
    ("term", "expected", "lower"),
    [
        (constraints.position("fore", [0.1, 0.0, 0.2], POINT, tolerance=0.01), place(Q), np.array([0.09, -0.01, 0.19])),
        (constraints.direction("fore", [0.0, 0.0, 2.0], angle=0.5), np.cos(Q.sum()), np.cos(0.5)),
        (
            constraints.sphere_clearance("fore", 0.1, [0.2, 0.0, 0.1], 0.3, center=POINT),
            np.sum((place(Q) - [0.2, 0.0, 0.1]) ** 2),
            0.16,
        ),
        (constraints.sphere_clearance("fore", 0.1, "upper", 0.2, center=POINT), np.sum(place(Q) ** 2), 0.09),
        (constraints.plane_clearance("fore", 0.1, [0.0, 0.0, 5.0], -2.0, center=POINT), place(Q)[2], -1.9),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_constraints(term, expected, lower, dtype):
    tolerance = 1e-12 if dtype == jnp.float64 else 1e-6
    np.testing.assert_allclose(value_of(term, dtype).squeeze(), expected, rtol=10 * tolerance, atol=tolerance)
    np.testing.assert_allclose(term.lower, lower, atol=1e-12)
