"""Generalized inertia forces, accumulated tip to base in the links' own axes.

Kane's -F*_r = sum_k (v_r^k . m a^k + w_r^k . (I alpha + w x I w)), Nie (3.46). The partial velocities of link k are those of
its parent plus the joint's own, so the sum over k is taken once from tip to base and projected joint by joint.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from kanejax._model.links import LinkParameters
from kanejax._model.tree import Tree
from kanejax._recursion.joints import Joint
from kanejax._recursion.rows import Link, ball_coupling, join_speeds, joint_features, split_parameters, split_speeds
from kanejax._recursion.sweeps import base_to_tip, tip_to_base
from kanejax._scalar import (
    ZERO,
    add,
    apply,
    apply_transposed,
    barrier,
    cross,
    dot,
    full,
    is_known,
    plus,
    scale,
    sub,
)
from kanejax._types import Matrix, Scalar, Vector


class LinkInputs(NamedTuple):
    """What a sweep reads of one link: parameters, joint features, and components of speeds and forces."""

    links: Link
    features: tuple[Scalar, ...]
    speeds: tuple[Scalar, ...]
    rates: tuple[Scalar, ...]


class Motion(NamedTuple):
    """Motion of a link's origin in the link's axes; the acceleration contains minus gravity."""

    w: Vector
    alpha: Vector
    a: Vector


def inertia_force(
    tree: Tree,
    links: LinkParameters,
    gravity: jax.Array | tuple[float, ...],
    q: jax.Array,
    u: jax.Array,
    u_dot: jax.Array,
) -> jax.Array:
    """Minus the generalized inertia and gravity forces, (nv, *batch): M(q) u_dot + bias(q, u), without armature.

    `q` is relative to the coordinate references, `gravity` is (3, *batch).
    """
    if not tree.njoint:
        return u
    features = joint_features(tree, q)
    parts = split_parameters(tree, links)
    rates = split_speeds(tree, sub(u_dot, ball_coupling(tree, u)))
    inputs = [LinkInputs(*rows) for rows in zip(parts, features, split_speeds(tree, u), rates, strict=True)]
    root = Motion(ZERO, ZERO, minus_gravity(gravity, q))
    wrenches = base_to_tip(tree, _link_wrench, root, inputs, q)
    outward = list(zip(parts, features, wrenches, strict=True))
    return join_speeds(tree, tip_to_base(tree, _project, (ZERO, ZERO), outward, q), q)


def minus_gravity(gravity: jax.Array | tuple[float, ...], like: jax.Array) -> Vector:
    """Acceleration of a world that free fall is at rest in; known numbers stay known."""
    parts = (gravity[0], gravity[1], gravity[2])
    return tuple(-g if is_known(g) else jnp.broadcast_to(-g, like.shape[1:]) for g in parts)  # type: ignore[return-value]


def _link_wrench(joint: Joint, parent: Motion, link: LinkInputs) -> tuple[Motion, tuple[Vector, Vector]]:
    """Motion of a link from its parent's, and the force and moment about its origin that this motion takes."""
    rotation, position = joint.place(*link.links.placement, link.features)
    w, alpha, a = parent
    # Acceleration of the joint, Nie (3.35) in classical form, and everything resolved in the link's axes (3.7).
    a = plus(a, cross(alpha, position), cross(w, cross(w, position)))
    w, alpha, a = (apply_transposed(rotation, x) for x in (w, alpha, a))
    axes = joint.link_axes(rotation)
    spin = plus(*(scale(speed, angular) for (angular, _), speed in zip(axes, link.speeds, strict=True)))
    slide = plus(*(scale(speed, linear) for (_, linear), speed in zip(axes, link.speeds, strict=True)))
    alpha = plus(alpha, cross(w, spin), *(scale(rate, angular) for (angular, _), rate in zip(axes, link.rates, strict=True)))
    a = plus(a, scale(2.0, cross(w, slide)), *(scale(rate, linear) for (_, linear), rate in zip(axes, link.rates, strict=True)))
    motion = barrier(Motion(plus(w, spin), alpha, a))
    return motion, _wrench(link.links, motion)


def _wrench(links: Link, motion: Motion) -> tuple[Vector, Vector]:
    """Force m a and moment about the link's origin of the inertia forces of one link, reversed."""
    (wx, wy, wz), (ax, ay, az), a = motion
    xx, yy, zz, xy, xz, yz = wx * wx, wy * wy, wz * wz, wx * wy, wx * wz, wy * wz
    # Acceleration of a point r of the link is a + s r, with s = [alpha x] + [w x][w x].
    s: Matrix = ((-(yy + zz), xy - az, xz + ay), (xy + az, -(xx + zz), yz - ax), (xz - ay, yz + ax, -(xx + yy)))
    h = links.first_moment
    force = plus(scale(links.mass, a), apply(s, h))
    # Moment: integral of r x (a + s r) dm, from the second moments j = integral of r r^T dm.
    ixx, iyy, izz, ixy, ixz, iyz = links.inertia
    half = 0.5 * (ixx + iyy + izz)
    j = full((half - ixx, half - iyy, half - izz, -ixy, -ixz, -iyz))

    def second(row: int, col: int) -> Scalar:
        return dot(s[row], j[col])

    spin = (sub(second(2, 1), second(1, 2)), sub(second(0, 2), second(2, 0)), sub(second(1, 0), second(0, 1)))
    return force, plus(spin, cross(h, a))


def _project(joint: Joint, outer: tuple[Vector, Vector], link: tuple) -> tuple[tuple[Vector, Vector], tuple[Scalar, ...]]:
    """Add what the links further out need, project on the joint's axes, and hand the rest to the parent."""
    links, features, own = link
    force, moment = plus(own[0], outer[0]), plus(own[1], outer[1])
    rotation, position = joint.place(links.placement.rotation, links.placement.position, features)
    needed = tuple(add(dot(linear, force), dot(angular, moment)) for angular, linear in joint.link_axes(rotation))
    force = apply(rotation, force)
    return (force, plus(apply(rotation, moment), cross(position, force))), needed
