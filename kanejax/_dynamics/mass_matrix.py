"""Kane's F, the mass matrix, from inertias summed tip to base.

F_rs = sum_k (m v_r . v_s + w_r . I . w_s), Nie (3.56). The sum over all links that both speeds move is taken once, as the
inertia of everything outside a joint, about the world's origin: there inertias simply add up.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._kinematics.position import WORLD_FRAMES, place_link
from kanejax._model.links import LinkParameters
from kanejax._model.tree import Tree
from kanejax._recursion.joints import Axis, Joint
from kanejax._recursion.rows import Frames, Link, join_speeds, joint_features, split_parameters
from kanejax._recursion.sweeps import base_to_tip, tip_to_base
from kanejax._scalar import (
    SYMMETRIC_ZERO,
    ZERO,
    add,
    apply,
    apply_symmetric,
    barrier,
    cross,
    inertia_of,
    is_known,
    minus,
    outer_symmetric,
    plus,
    rotate_symmetric,
    scale,
)
from kanejax._types import Scalar, Symmetric, Vector


class RigidInertia(NamedTuple):
    """Mass, first moment and inertia about the world's origin."""

    mass: Scalar
    first_moment: Vector
    inertia: Symmetric


def mass_matrix(tree: Tree, links: LinkParameters, armature: Scalar, q: jax.Array) -> jax.Array:
    """F(q), (nv, nv, *batch); `q` is (nq, *batch), relative to the coordinate references."""
    if not tree.njoint:
        return jnp.zeros((0, 0, *q.shape[1:]), q.dtype)
    q = _at_origin(tree, q)
    parts = list(zip(split_parameters(tree, links), joint_features(tree, q), strict=True))
    placed = base_to_tip(tree, _place, WORLD_FRAMES, parts, q)
    momenta = tip_to_base(tree, _momentum, RigidInertia(0.0, ZERO, SYMMETRIC_ZERO), placed, q)
    by_speed = _components(tree, [axes for axes, _ in placed], q)
    momentum_by_speed = _components(tree, momenta, q)
    by_speed, momentum_by_speed = barrier((by_speed, momentum_by_speed))
    products = functools.reduce(jnp.add, [a[:, None] * m[None, :] for a, m in zip(by_speed, momentum_by_speed, strict=True)])
    return _symmetric(tree, products, armature)


def _at_origin(tree: Tree, q: jax.Array) -> jax.Array:
    """The mass matrix does not depend on where a floating base is; at the origin float32 loses nothing."""
    keep = np.ones(tree.nq, bool)
    for kind, start in zip(tree.joint_types, tree.q_start, strict=True):
        if kind == "free":
            keep[start : start + 3] = False
    return q if keep.all() else jnp.where(keep.reshape((-1,) + (1,) * (q.ndim - 1)), q, 0.0)


def _place(joint: Joint, parent: Frames, link: tuple[Link, tuple]) -> tuple[Frames, tuple]:
    """Axes of motion and inertia of a link about the world's origin."""
    links, features = link
    placed = place_link(joint, parent.rotation, links, features)
    origin = plus(parent.position, placed.offset)
    h, second = barrier((apply(placed.rotation, links.first_moment), rotate_symmetric(placed.rotation, links.second_moment)))
    inertia = barrier(inertia_of(second))
    axes = tuple((angular, plus(linear, cross(origin, angular))) for angular, linear in placed.axes)
    return Frames(placed.rotation, origin), barrier((axes, RigidInertia(links.mass, *_about_world(links.mass, h, inertia, origin))))


def _about_world(mass: Scalar, h: Vector, inertia: Symmetric, origin: Vector) -> tuple[Vector, Symmetric]:
    """First moment and inertia about the world's origin, from those about `origin`."""
    xx, yy, zz, xy, xz, yz = outer_symmetric(origin)
    steiner = scale(mass, (yy + zz, xx + zz, xx + yy, -xy, -xz, -yz))
    ox, oy, oz = origin
    hx, hy, hz = h
    mixed = (
        2.0 * (oy * hy + oz * hz), 2.0 * (ox * hx + oz * hz), 2.0 * (ox * hx + oy * hy),
        -(ox * hy + oy * hx), -(ox * hz + oz * hx), -(oy * hz + oz * hy),
    )  # fmt: skip
    return plus(h, scale(mass, origin)), plus(inertia, steiner, mixed)


def _momentum(joint: Joint, outer: RigidInertia, link: tuple[tuple[Axis, ...], RigidInertia]) -> tuple[RigidInertia, tuple]:
    """Angular and linear momentum of everything outside a joint for unit speed along each of its axes."""
    axes, own = link
    mass = add(outer.mass, own.mass)
    h, inertia = plus(outer.first_moment, own.first_moment), plus(outer.inertia, own.inertia)
    momenta = tuple(
        (plus(apply_symmetric(inertia, angular), cross(h, linear)), minus(scale(mass, linear), cross(h, angular)))
        for angular, linear in axes
    )
    return barrier(RigidInertia(mass, h, inertia)), momenta


def _components(tree: Tree, pairs: list[tuple[tuple[Vector, Vector], ...]], like: jax.Array) -> list[jax.Array]:
    """The six components of a pair of vectors for each speed, as arrays (nv, *batch)."""
    return [
        join_speeds(tree, [tuple((*pair[0], *pair[1])[c] for pair in of_segment) for of_segment in pairs], like) for c in range(6)
    ]


def _symmetric(tree: Tree, products: jax.Array, armature: Scalar) -> jax.Array:
    """Keep products where the second speed's joint hangs on the first's, mirror them, and add the rotors."""
    joint = tree.speed_joints
    carried = tree.link_ancestors[joint[None, :], joint[:, None]]
    trailing = (1,) * (products.ndim - 2)
    mask, eye = carried.reshape(*carried.shape, *trailing), np.eye(tree.nv, dtype=bool).reshape(*carried.shape, *trailing)
    mirrored = jnp.where(mask.swapaxes(0, 1), products.swapaxes(0, 1), 0.0)
    rotors = 0.0 if is_known(armature) else jnp.where(eye, armature[:, None], 0.0)
    return add(jnp.where(mask, products, mirrored), rotors)
