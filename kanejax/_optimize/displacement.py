"""Coordinates as small vectors: the displacement from reference coordinates, one number a speed, also for quaternions."""

import jax
import jax.numpy as jnp

from kanejax._model.tree import Tree


def displaced(tree: Tree, q: jax.Array, displacement: jax.Array) -> jax.Array:
    """Coordinates (nq,) after turning and moving by a displacement (nv,), as if by constant speeds for a unit of time.

    Quaternions are turned by a rotation vector in the body's axes: q * exp(displacement / 2).
    """
    if tree.nq == tree.nv:
        return q + displacement
    (plain_v, plain_q), turning = tree.plain_speeds, tree.turning_speeds
    moved = q.at[plain_q].add(displacement[plain_v])
    for v, start in zip(*turning, strict=True):
        moved = moved.at[start : start + 4].set(_product(q[start : start + 4], _exponential(displacement[v : v + 3])))
    return moved


def displacement(tree: Tree, reference: jax.Array, q: jax.Array) -> jax.Array:
    """The displacement (nv,) that leads from reference coordinates to others: the inverse of `displaced` up to half a turn."""
    if tree.nq == tree.nv:
        return q - reference
    (plain_v, plain_q), turning = tree.plain_speeds, tree.turning_speeds
    found = jnp.zeros(tree.nv, q.dtype).at[plain_v].set(q[plain_q] - reference[plain_q])
    for v, start in zip(*turning, strict=True):
        back = reference[start : start + 4] * jnp.array([1.0, -1.0, -1.0, -1.0], q.dtype)
        found = found.at[v : v + 3].set(_logarithm(_product(back, q[start : start + 4])))
    return found


def _product(a: jax.Array, b: jax.Array) -> jax.Array:
    """Of quaternions (w, x, y, z)."""
    real = a[0] * b[0] - jnp.sum(a[1:] * b[1:])
    return jnp.concatenate((real[None], a[0] * b[1:] + b[0] * a[1:] + jnp.cross(a[1:], b[1:])))


def _exponential(vector: jax.Array) -> jax.Array:
    """The quaternion of a rotation vector, smooth at zero."""
    squared = 0.25 * jnp.sum(vector * vector)
    small = squared < 1e-6
    half = jnp.sqrt(jnp.where(small, 1.0, squared))
    # sin(h) / h and cos(h) as series: a root has no derivatives at zero.
    ratio = jnp.where(small, 1.0 - squared / 6.0 + squared**2 / 120.0, jnp.sin(half) / half)
    real = jnp.where(small, 1.0 - squared / 2.0 + squared**2 / 24.0, jnp.cos(half))
    return jnp.concatenate((real[None], 0.5 * ratio * vector))


def _logarithm(quaternion: jax.Array) -> jax.Array:
    """The shortest rotation vector of a quaternion of any length, smooth at the identity."""
    quaternion = jnp.where(quaternion[0] < 0, -quaternion, quaternion)
    real, vector = quaternion[0], quaternion[1:]
    squared = jnp.sum(vector * vector)
    small = squared < 1e-8 * real * real
    length = jnp.sqrt(jnp.where(small, 1.0, squared))
    tangent = squared / jnp.where(small, real * real, 1.0)
    near = (1.0 - tangent / 3.0 + tangent**2 / 5.0) / jnp.where(small, real, 1.0)
    return 2.0 * jnp.where(small, near, jnp.arctan2(length, real) / length) * vector
