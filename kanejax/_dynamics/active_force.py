"""Generalized active forces of springs, dampers and friction, and the rotation vectors that springs need."""

import jax
import jax.numpy as jnp

from kanejax._model.prepared import Prepared
from kanejax._model.tree import COORDINATES, Tree
from kanejax._scalar import barrier


def passive_force(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array) -> jax.Array:
    """Springs, viscous damping and smoothed Coulomb friction, (nv, *batch).

    Friction is -f u / sqrt(u^2 + width^2), which has every derivative at rest.
    """
    width = prepared.friction_width
    friction = prepared.coulomb_friction * u * jax.lax.rsqrt(u * u + width * width)
    return -prepared.damping * u - friction - spring_force(tree, prepared, q)


def spring_force(tree: Tree, prepared: Prepared, q: jax.Array) -> jax.Array:
    """Stiffness times displacement, as MuJoCo defines it for each joint type; opposes the displacement, (nv, *batch)."""
    stiffness, reference = prepared.stiffness, prepared.spring_reference
    if all(COORDINATES[kind] == 1 for kind in tree.joint_types):
        return stiffness * (q - reference)
    rows = []
    for joint, (kind, start) in enumerate(zip(tree.joint_types, tree.q_start, strict=True)):
        k = stiffness[joint]
        if kind in ("revolute", "prismatic"):
            rows.append(k * (q[start] - reference[start]))
            continue
        if kind == "free":
            rows += [k * (q[start + i] - reference[start + i]) for i in range(3)]
            start += 3
        turn = rotation_between([reference[start + i] for i in range(4)], [q[start + i] for i in range(4)])
        rows += [k * x for x in turn]
    batch = jnp.broadcast_shapes(q.shape[1:], *(row.shape for row in rows))
    return jnp.stack(barrier([jnp.broadcast_to(row, batch) for row in rows]))


def rotation_between(a: list[jax.Array], b: list[jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
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
