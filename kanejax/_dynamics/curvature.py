"""First and second derivatives of the generalized inertia forces in closed form, for trees of revolute and prismatic joints.

Kane's equations weighted with virtual speeds lambda, sum_r lambda_r tau_r, are one number: the sum over the links of the inertia
wrench times the virtual velocity V, which the partial velocities of Nie (3.46) make of lambda. Turning a joint moves all links
outside it as one rigid body; seen from that body, the velocity v, the acceleration a and the virtual velocity V of its carrier
turn back. So every derivative is the answer of a composite body, the joint and all outside it, to three uniform changes: of V, of v
and of a. All is in world axes about one point, where composite bodies are plain sums, and a second derivative by a pair
of joints is a few products of vectors of the inner and of the outer one. The composites are those of Singh, Russell and Wensing
(2022, Efficient analytical derivatives of rigid-body dynamics using spatial vector algebra), contracted with lambda.
"""

import functools
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._kinematics.position import world_frames
from kanejax._model.links import Rows
from kanejax._model.prepared import Prepared, displacement
from kanejax._model.tree import Tree
from kanejax._scalar import (
    ZERO,
    add,
    apply,
    apply_symmetric,
    apply_transposed,
    barrier,
    column,
    cross,
    dot,
    full,
    inertia_of,
    is_known,
    matmul,
    minus,
    mul,
    plus,
    rotate_symmetric,
    scale,
    sub,
)
from kanejax._types import Matrix, Scalar, Symmetric, Vector

# Angular and linear part of a velocity, or moment and force of a wrench, one of each joint: components (njoint, *batch).
Spatial = tuple[Vector, Vector]


class Curvature(NamedTuple):
    """Derivatives of generalized inertia forces, and of their weighted sum, (nv, nv, *batch); the force or the first on rows.

    Those by the speeds and u_dot twice, and by u_dot twice, are zero.
    """

    force_by_q: jax.Array
    force_by_u: jax.Array
    mass_matrix: jax.Array
    q_q: jax.Array
    u_q: jax.Array
    u_u: jax.Array
    a_q: jax.Array


class _Body(NamedTuple):
    """Mass, first and second moment about the common point."""

    mass: Scalar
    first: Vector
    second: Symmetric


class _Outside(NamedTuple):
    """Sums over a joint's link and all that it carries.

    Attributes:
        body: the composite body.
        momentum: linear.
        wrench: of inertia.
        virtual: momentum at the virtual velocity.
        rate: the slope of the weighted sum by the angular velocity of all.
        spin: K, half of the moment by a change of the angular velocity.
        bend: T, half of the change of `rate` by the angular velocity.
    """

    body: _Body
    momentum: Vector
    wrench: Spatial
    virtual: Spatial
    rate: Vector
    spin: Matrix
    bend: Matrix


def inertia_force_curvature(
    tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array, u_dot: jax.Array, weights: jax.Array
) -> Curvature:
    """Of the generalized inertia forces, without armature and passive forces; components (nv, *batch).

    Args:
        tree: of revolute and prismatic joints.
        prepared: parameters.
        q: coordinates.
        u: speeds.
        u_dot: their rates.
        weights: lambda.
    """
    axis, bodies = _axes_and_bodies(tree, prepared, q)
    v, virtual = (barrier(_of_carriers(tree, _scaled(x, axis))) for x in (u, weights))
    turning = barrier(_motion_cross(v, axis))
    x, y, z = (-prepared.gravity[i][None] for i in range(3))
    at_rest = (ZERO, (x, y, z))
    gained = barrier(_of_carriers(tree, _sum(_scaled(u_dot, axis), _scaled(u, turning))))
    a = _sum(at_rest, gained)
    # What V, v and a of the carrier become when the joint turns.
    by_virtual = barrier(_motion_cross(virtual, axis))
    before = _less(a, _scaled(u, turning))
    by_a = barrier(_sum(_motion_cross(before, axis), _motion_cross(_less(v, _scaled(u, axis)), turning)))
    outside = _outside(tree, bodies, v, a, virtual)
    by_joint = _Changes(axis, turning, by_virtual, by_a)
    return _derivatives(tree, by_joint, _answers(outside, by_joint))


class _Changes(NamedTuple):
    """Of each joint: its axis S, S' = v x S, and how V and a change with its coordinate."""

    axis: Spatial
    turning: Spatial
    virtual: Spatial
    a: Spatial


class _Answers(NamedTuple):
    """Wrenches of the composite bodies, which changes of their carriers are multiplied with.

    Attributes:
        inertia: I S.
        turned: B' S.
        q_v, q_a, q_virtual: slopes of the derivative by the coordinate.
        u_v, u_virtual: slopes of the derivative by the speed.
    """

    inertia: Spatial
    turned: Spatial
    q_v: Spatial
    q_a: Spatial
    q_virtual: Spatial
    u_v: Spatial
    u_virtual: Spatial


def _axes_and_bodies(tree: Tree, prepared: Prepared, q: jax.Array) -> tuple[Spatial, _Body]:
    links = prepared.links
    rotation, origin = barrier(tuple(world_frames(tree, links, displacement(tree, prepared, q))))
    # About the first link, for digits are lost where the world's origin is far.
    origin = _each(lambda x: x - x[:1], origin)
    slides = np.array([kind == "prismatic" for kind in tree.joint_types]).reshape(-1, *[1] * (q.ndim - 1))
    z = column(rotation, 2)
    about = cross(origin, z)
    axis = _each(lambda x: jnp.where(slides, 0.0, x), z), _each(lambda x, y: jnp.where(slides, x, y), z, about)
    mass = jnp.broadcast_to(_rows(links.mass, q), q.shape)
    hx, hy, hz = (_rows(links.first_moment[:, i], q) for i in range(3))
    turned = apply(rotation, (hx, hy, hz))
    first = plus(turned, scale(mass, origin))
    xx, yy, zz, xy, xz, yz = (_rows(links.second_moment[:, i], q) for i in range(6))
    second = rotate_symmetric(rotation, (xx, yy, zz, xy, xz, yz))
    # Sum of m (p + r)(p + r)' = R J R' + p h' + (R m r) p' with h the first moment about the common point.
    moved = tuple(
        add(mul(origin[i], first[j]), mul(turned[i], origin[j])) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    )
    return barrier(axis), barrier(_Body(mass, first, plus(second, moved)))


def _rows(parameter: Rows, like: jax.Array) -> jax.Array:
    """One number a link, with the batch's axes."""
    parameter = jnp.asarray(parameter)
    return parameter.reshape(*parameter.shape, *[1] * (like.ndim - parameter.ndim))


def _outside(tree: Tree, bodies: _Body, v: Spatial, a: Spatial, virtual: Spatial) -> _Outside:
    momentum, virtual_momentum = barrier((_momentum(bodies, v), _momentum(bodies, virtual)))
    wrench = _sum(_momentum(bodies, a), _wrench_cross(v, momentum))
    (w, linear), (big_w, big_linear), h, second = v, virtual, bodies.first, full(bodies.second)
    rate = plus(apply(second, cross(w, big_w)), cross(linear, cross(big_w, h)), cross(momentum[1], big_linear))
    spin = _each(lambda row: scale(-1.0, row), _each(plus, _matrix(w, second), _matrix(h, _skew(linear))))
    inner = dot(big_linear, h)
    diagonal: Matrix = (inner, 0.0, 0.0), (0.0, inner, 0.0), (0.0, 0.0, inner)
    bend = _each(minus, _each(plus, _matrix(big_w, second), _each(lambda x: scale(x, h), big_linear)), diagonal)
    own = _Outside(bodies, momentum[1], wrench, virtual_momentum, scale(2.0, rate), spin, bend)
    return barrier(_over_carried(tree, own))


def _answers(outside: _Outside, by: _Changes) -> _Answers:
    spun = _spun(outside, by.turning)
    return barrier(
        _Answers(
            inertia=_momentum(outside.body, by.axis),
            turned=_spun_back(outside, by.axis),
            q_v=_sum(
                _sum(_spun_back(outside, by.virtual), _wrench_cross(by.axis, (outside.rate, ZERO))),
                _sum(_bent(outside, by.turning), _scaled(2.0, _wrench_cross(by.turning, outside.virtual))),
            ),
            q_a=_sum(_momentum(outside.body, by.virtual), _wrench_cross(by.axis, outside.virtual)),
            q_virtual=_sum(_sum(_wrench_cross(by.axis, outside.wrench), spun), _momentum(outside.body, by.a)),
            u_v=_sum(_bent(outside, by.axis), _scaled(2.0, _wrench_cross(by.axis, outside.virtual))),
            u_virtual=_sum(_spun(outside, by.axis), _scaled(2.0, _momentum(outside.body, by.turning))),
        )
    )


def _derivatives(tree: Tree, by: _Changes, of: _Answers) -> Curvature:
    """Each is a product of what answers at the outer joint of a pair with what changes at the inner one."""
    carried = tree.link_ancestors.reshape(*tree.link_ancestors.shape, *[1] * (by.axis[1][0].ndim - 1))

    def joined(outer: list, inner: list | None) -> jax.Array:
        """Rows by the joint that answers, where it is the outer one; the others from the second product, or mirrored."""
        lower = jnp.where(carried, _pairs(outer), 0.0)
        other = jnp.where(carried, lower if inner is None else _pairs(inner), 0.0).swapaxes(0, 1)
        return jnp.where(carried, lower, other)

    twice = _scaled(2.0, by.turning)
    return Curvature(
        force_by_q=joined([(of.inertia, by.a), (of.turned, by.turning)], [(of.q_virtual, by.axis)]),
        force_by_u=joined([(of.inertia, twice), (of.turned, by.axis)], [(of.u_virtual, by.axis)]),
        mass_matrix=joined([(of.inertia, by.axis)], None),
        q_q=joined([(of.q_virtual, by.virtual), (of.q_v, by.turning), (of.q_a, by.a)], None),
        u_q=joined([(of.u_virtual, by.virtual), (of.u_v, by.turning)], [(of.q_v, by.axis), (of.q_a, twice)]),
        u_u=joined([(of.u_v, by.axis)], None),
        a_q=joined([(of.inertia, by.virtual)], [(of.q_a, by.axis)]),
    )


def _pairs(factors: Sequence[tuple[Spatial, Spatial]]) -> jax.Array:
    """Sum of products of wrenches, on rows, and velocities, on columns."""
    products = [
        x[:, None] * y[None]
        for wrench, velocity in factors
        for x, y in zip((*wrench[0], *wrench[1]), (*velocity[0], *velocity[1]), strict=True)
        if not is_known(x) and not is_known(y)
    ]
    return functools.reduce(jnp.add, products)


def _momentum(body: _Body, v: Spatial) -> Spatial:
    """I v."""
    angular, linear = v
    moment = plus(apply_symmetric(inertia_of(body.second), angular), cross(body.first, linear))
    return moment, minus(scale(body.mass, linear), cross(body.first, angular))


def _spun(outside: _Outside, v: Spatial) -> Spatial:
    """B v: the change of the inertia wrench by one of the velocity, a fixed but for what follows from it."""
    return scale(2.0, apply(outside.spin, v[0])), scale(2.0, cross(v[0], outside.momentum))


def _spun_back(outside: _Outside, v: Spatial) -> Spatial:
    """B' v."""
    return scale(2.0, plus(apply_transposed(outside.spin, v[0]), cross(outside.momentum, v[1]))), ZERO


def _bent(outside: _Outside, v: Spatial) -> Spatial:
    """Slope by the velocity of what a change v of the velocity makes of the weighted sum."""
    return scale(2.0, apply(outside.bend, v[0])), scale(2.0, cross(outside.virtual[1], v[0]))


def _motion_cross(a: Spatial, b: Spatial) -> Spatial:
    return cross(a[0], b[0]), plus(cross(a[0], b[1]), cross(a[1], b[0]))


def _wrench_cross(v: Spatial, wrench: Spatial) -> Spatial:
    return plus(cross(v[0], wrench[0]), cross(v[1], wrench[1])), cross(v[0], wrench[1])


def _sum(a: Spatial, b: Spatial) -> Spatial:
    return plus(a[0], b[0]), plus(a[1], b[1])


def _less(a: Spatial, b: Spatial) -> Spatial:
    return minus(a[0], b[0]), minus(a[1], b[1])


def _scaled(s: Scalar, a: Spatial) -> Spatial:
    return scale(s, a[0]), scale(s, a[1])


def _skew(a: Vector) -> Matrix:
    return ((0.0, sub(0.0, a[2]), a[1]), (a[2], 0.0, sub(0.0, a[0])), (sub(0.0, a[1]), a[0], 0.0))


def _matrix(a: Vector, m: Matrix) -> Matrix:
    """The matrix of a x (m b) for b."""
    return matmul(_skew(a), m)


def _each(function: Callable, *of: Vector | Matrix) -> tuple:
    """Of components, or rows."""
    return tuple(function(*parts) for parts in zip(*of, strict=True))


def _of_carriers(tree: Tree, own: Spatial) -> Spatial:
    """Sums over a link and those that carry it."""
    return _mixed(tree.link_ancestors, own)


def _over_carried(tree: Tree, own: _Outside) -> _Outside:
    """Sums over a link and those that it carries."""
    return _mixed(tree.link_ancestors.T, own)


def _mixed[T](which: np.ndarray, own: T) -> T:
    """Sums over the links that each row marks; one product for all components."""
    leaves, structure = jax.tree.flatten(own)
    stacked = jnp.stack(leaves, 1)
    summed = jnp.tensordot(jnp.asarray(which, stacked.dtype), stacked, 1, precision="highest")
    return jax.tree.unflatten(structure, [summed[:, i] for i in range(len(leaves))])
