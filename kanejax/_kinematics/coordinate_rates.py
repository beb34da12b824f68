"""Kinematical equations: rates of the coordinates from the speeds, and the length of quaternions.

The rate of a quaternion is q * (0, w) / 2, linear in it, and forces do not depend on its length. So a quaternion of any length
stands for the same motion, and normalising what is saved gives the trajectory that normalising after every step would give.
Only overflow would end this, of the explicit Euler method within some 1e4 steps: while integrating, `restoring_rate` keeps the
length near one. It is zero at length one, and it acts along the quaternion, so it changes no rotation and no derivative of one.
"""

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._evaluate import check_state, evaluate
from kanejax._model.model import Model
from kanejax._model.prepared import Prepared
from kanejax._model.specialized import Specialized
from kanejax._model.tree import Tree
from kanejax._recursion.rows import in_order, take
from kanejax._scalar import plus
from kanejax._types import Coordinates, Quaternion, Scalar, Speeds


def coordinate_rates(model: Model | Specialized, q: Coordinates, u: Speeds) -> Coordinates:
    """Rates of the generalized coordinates, which the kinematical equations give from the speeds.

    Revolute and prismatic joints: the speed. Free joints: the velocity in world axes, and the rate of the quaternion
    (w, x, y, z), q * (0, w) / 2 with the angular velocity w in the body's axes. Ball joints: the latter.

    Args:
        model: the mechanism.
        q: generalized coordinates.
        u: generalized speeds.

    Returns:
        q_dot, [rad/s] and [m/s], quaternions [1/s].

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(model, q=q, u=u)
    return evaluate(_coordinate_rates, model, q, u)


def tangent_gradient(model: Model | Specialized, q: Coordinates, gradient: Coordinates) -> Speeds:
    """Gradient with respect to infinitesimal motions, from the one with respect to coordinates.

    `jax.grad` with respect to q gives one number a coordinate, of which a quaternion has one more than there are directions to
    move in. Here: the derivative along each generalized speed, which is what descent and Newton's method on the
    configuration need. It is the transpose of `coordinate_rates` applied to `gradient`.

    Args:
        model: the mechanism.
        q: generalized coordinates.
        gradient: with respect to q, such as `jax.grad` returns.

    Returns:
        The derivative for each generalized speed, (nv,).

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(model, q=q)
    _, pull_back = jax.vjp(lambda u: coordinate_rates(model, q, u), jnp.zeros(model.nv, q.dtype))
    return pull_back(gradient)[0]


def kinematical_rates(tree: Tree, q: jax.Array, u: jax.Array, restore: bool = False) -> jax.Array:
    """Rates of the coordinates (nq, *batch); with `restore`, quaternions are led back to length one."""
    if tree.nq == tree.nv:
        return u
    (plain_v, plain_q), (v, start) = tree.plain_speeds, tree.turning_speeds
    quaternion, w = (q[start], q[start + 1], q[start + 2], q[start + 3]), (u[v], u[v + 1], u[v + 2])
    rates = quaternion_rate(quaternion, w)
    if restore:
        rates = plus(rates, restoring_rate(quaternion, w))
    rows = [take(u, plain_v), *rates]
    return in_order(rows, np.concatenate((plain_q, start, start + 1, start + 2, start + 3)))


def quaternion_rate(quaternion: Quaternion, w: tuple[Scalar, Scalar, Scalar]) -> Quaternion:
    """Rate of (w, x, y, z) for an angular velocity in the turned axes."""
    a, b, c, d = (0.5 * x for x in quaternion)
    x, y, z = w
    return (-b * x - c * y - d * z, a * x + c * z - d * y, a * y + d * x - b * z, a * z + b * y - c * x)


def restoring_rate(quaternion: Quaternion, w: tuple[Scalar, Scalar, Scalar]) -> Quaternion:
    """Rate that leads the length back to one, at most as fast as the quaternion turns, so that it never limits the step."""
    squared = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    length = quaternion[0] ** 2 + quaternion[1] ** 2 + quaternion[2] ** 2 + quaternion[3] ** 2
    speed = squared * jax.lax.rsqrt(1.0 + squared)
    factor = 0.25 * speed * (1.0 - length)
    a, b, c, d = (factor * x for x in quaternion)
    return a, b, c, d


def unit_quaternions(tree: Tree, q: jax.Array) -> jax.Array:
    """The coordinates (..., nq) with every quaternion divided by its length."""
    for start in tree.turning_speeds[1]:
        quaternion = q[..., start : start + 4]
        length = jnp.sqrt(jnp.sum(quaternion * quaternion, -1, keepdims=True))
        q = q.at[..., start : start + 4].set(quaternion / length)
    return q


def _coordinate_rates(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array) -> jax.Array:
    return kinematical_rates(tree, q, u)
