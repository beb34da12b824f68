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
    is_known,
    mul,
    outer_symmetric,
    plus,
    scale,
    sub,
)
from kanejax._types import Matrix, Scalar, Symmetric, Vector


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
    u_dot: Scalar,
) -> jax.Array:
    """Minus the generalized inertia and gravity forces, (nv, *batch): M(q) u_dot + bias(q, u), without armature.

    `q` is relative to the coordinate references, `gravity` is (3, *batch), `u_dot` may be a known 0.
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
    a = plus(a, apply(_field(w, alpha)[0], position))
    w, alpha, a = (apply_transposed(rotation, x) for x in (w, alpha, a))
    axes = joint.link_axes(rotation)
    spin = plus(*(scale(speed, angular) for (angular, _), speed in zip(axes, link.speeds, strict=True)))
    slide = plus(*(scale(speed, linear) for (_, linear), speed in zip(axes, link.speeds, strict=True)))
    alpha = plus(alpha, cross(w, spin), *(scale(rate, angular) for (angular, _), rate in zip(axes, link.rates, strict=True)))
    a = plus(a, cross(w, scale(2.0, slide)), *(scale(rate, linear) for (_, linear), rate in zip(axes, link.rates, strict=True)))
    motion = barrier(Motion(plus(w, spin), alpha, a))
    return motion, _wrench(link.links, motion)


def _wrench(links: Link, motion: Motion) -> tuple[Vector, Vector]:
    """Force and moment about the link's origin of the inertia forces of one link, reversed."""
    w, alpha, a = motion
    (ax, ay, az), (s, (xx, yy, zz, xy, xz, yz)) = alpha, _field(w, alpha)
    h = links.first_moment
    force = plus(scale(links.mass, a), apply(s, h))
    # Moment: integral of r x (a + s r) dm, from the second moments; diagonal ones as in Euler's equations, where Ixx is jyy + jzz.
    jxx, jyy, jzz, jxy, jxz, jyz = links.second_moment
    (_, s01, s02), (s10, _, s12), (s20, s21, _) = s
    spin = (
        add(_euler(jyy, jzz, ax, yz, s21), sub(mul(jyz, sub(zz, yy)), sub(mul(jxz, s10), mul(jxy, s20)))),
        sub(add(mul(jyz, s01), sub(mul(jxz, sub(xx, zz)), mul(jxy, s21))), _euler(jxx, jzz, ay, xz, s20, -1.0)),
        add(_euler(jxx, jyy, az, xy, s10), sub(mul(jxy, sub(yy, xx)), sub(mul(jyz, s02), mul(jxz, s12)))),
    )
    return force, plus(spin, cross(h, a))


def _field(w: Vector, alpha: Vector) -> tuple[Matrix, Symmetric]:
    """The s of a + s r, the acceleration of a point r of a link: [alpha x] + [w x][w x]; also w w^T."""
    (ax, ay, az), products = alpha, outer_symmetric(w)
    xx, yy, zz, xy, xz, yz = products
    return (
        (sub(0.0, add(yy, zz)), sub(xy, az), add(xz, ay)),
        (add(xy, az), sub(0.0, add(xx, zz)), sub(yz, ax)),
        (sub(xz, ay), add(yz, ax), sub(0.0, add(xx, yy))),
    ), products


def _euler(one: Scalar, other: Scalar, alpha: Scalar, product: Scalar, both: Scalar, sign: float = 1.0) -> Scalar:
    """Turn of Euler's equations: sign (one + other) alpha + (one - other) product, where `both` is sign alpha + product."""
    total, difference = add(one, other), sub(one, other)
    if difference is total or (is_known(total) and is_known(difference) and difference == total):
        return mul(total, both)
    return add(mul(mul(sign, total), alpha), mul(difference, product))


def _project(joint: Joint, outer: tuple[Vector, Vector], link: tuple) -> tuple[tuple[Vector, Vector], tuple[Scalar, ...]]:
    """Add what the links further out need, project on the joint's axes, and hand the rest to the parent."""
    links, features, own = link
    force, moment = plus(own[0], outer[0]), plus(own[1], outer[1])
    rotation, position = joint.place(links.placement.rotation, links.placement.position, features)
    needed = tuple(add(dot(linear, force), dot(angular, moment)) for angular, linear in joint.link_axes(rotation))
    force = apply(rotation, force)
    return (force, plus(apply(rotation, moment), cross(position, force))), needed
