"""Generalized active forces of springs, dampers and friction, and the rotation vectors that springs need."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._model.prepared import Prepared
from kanejax._model.tree import Tree
from kanejax._recursion.rows import in_order, take
from kanejax._scalar import add, is_known, mul, sub
from kanejax._types import Scalar


def passive_force(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array) -> Scalar:
    """Springs, viscous damping and smoothed Coulomb friction, (nv, *batch), or 0 where it is known that there are none."""
    opposing = add(mul(prepared.damping, u), add(friction_force(prepared, u), spring_force(tree, prepared, q)))
    return sub(0.0, opposing)


def friction_force(prepared: Prepared, u: jax.Array) -> Scalar:
    """Coulomb friction f u / sqrt(u^2 + width^2), which has every derivative at rest; opposes the motion, (nv, *batch)."""
    if is_known(prepared.coulomb_friction):
        return 0.0
    width = prepared.friction_width
    return prepared.coulomb_friction * u * jax.lax.rsqrt(u * u + width * width)


def spring_force(tree: Tree, prepared: Prepared, q: jax.Array) -> Scalar:
    """Stiffness times displacement, as MuJoCo defines it for each joint type; opposes the displacement, (nv, *batch)."""
    if is_known(prepared.stiffness):
        return 0.0
    reference = prepared.spring_reference
    (plain_v, plain_q), (turning_v, turning_q) = tree.plain_speeds, tree.turning_speeds
    away = [take(q, plain_q) - take(reference, plain_q)]
    if len(turning_v):
        away += rotation_between([reference[turning_q + i] for i in range(4)], [q[turning_q + i] for i in range(4)])
    speeds = np.concatenate((plain_v, turning_v, turning_v + 1, turning_v + 2))
    return take(prepared.stiffness, tree.speed_joints) * in_order(away, speeds)


def rotation_between(a: Sequence[jax.Array], b: Sequence[jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Rotation vector from quaternion a to quaternion b, in the axes of b; smooth at zero."""
    w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    x = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    y = a[0] * b[2] + a[1] * b[3] - a[2] * b[0] - a[3] * b[1]
    z = a[0] * b[3] - a[1] * b[2] + a[2] * b[1] - a[3] * b[0]
    # The shorter way round; a quaternion and its negative are the same rotation.
    sign = jnp.where(w < 0, -1.0, 1.0).astype(w.dtype)
    w, squared = w * sign, x * x + y * y + z * z
    # 2 atan(s / w) / s with s the length of the vector part: where s is small, its series in s^2, which has derivatives.
    small = squared < 1e-3 * w * w
    s = jnp.sqrt(jnp.where(small, 1.0, squared))
    t = jnp.where(small, squared / jnp.where(small, w * w, 1.0), 0.0)
    series = 1.0 + t * (-1.0 / 3.0 + t * (1.0 / 5.0 + t * (-1.0 / 7.0 + t * (1.0 / 9.0 - t / 11.0))))
    factor = sign * 2.0 * jnp.where(small, series / jnp.where(small, w, 1.0), jnp.arctan2(s, w) / s)
    return factor * x, factor * y, factor * z
