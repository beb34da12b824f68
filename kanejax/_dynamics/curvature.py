"""First and second derivatives of the generalized inertia forces in closed form.

Kane's equations weighted with virtual speeds lambda, sum_r lambda_r tau_r, are one number: the sum over the links of the inertia
wrench times the virtual velocity V, which the partial velocities of Nie (3.46) make of lambda. Turning a joint moves all links
outside it as one rigid body; seen from that body, the velocity v, the acceleration a and the virtual velocity V of its carrier
turn back. So every derivative is the answer of a composite body, the joint and all outside it, to three uniform changes: of V, of v
and of a. All is in world axes about one point, where composite bodies are plain sums, and a second derivative by a pair
of joints is a few products of vectors of the inner and of the outer one. The composites are those of Singh, Russell and Wensing
(2022, Efficient analytical derivatives of rigid-body dynamics using spatial vector algebra), contracted with lambda.

Coordinates are counted by displacements, one a speed. Those of a ball are about its body's axes, which turn with it: to turn about
one and then about another is not the same in the other order, and the second derivative is the mean of both.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._dynamics.spatial import Spatial, difference, each, motion_cross, scaled, total, wrench_cross
from kanejax._dynamics.speed_axes import Carriers, carriers, speed_axes
from kanejax._kinematics.position import world_frames
from kanejax._model.links import Rows
from kanejax._model.prepared import Prepared, displacement
from kanejax._model.tree import Tree
from kanejax._recursion.rows import Frames
from kanejax._scalar import (
    ZERO,
    add,
    apply,
    apply_symmetric,
    apply_transposed,
    barrier,
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
    """Sums over all links that a speed moves.

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
        tree: joints and links.
        prepared: parameters.
        q: coordinates.
        u: speeds.
        u_dot: their rates.
        weights: lambda.
    """
    of, (axis, bodies) = carriers(tree), _axes_and_bodies(tree, prepared, q)
    moving, turned = scaled(u, axis), scaled(weights, axis)
    v, virtual = (barrier(_mixed(of.of_speeds, x)) for x in (moving, turned))
    before_v, before_virtual = difference(v, _of_joint(of, moving)), difference(virtual, _of_joint(of, turned))
    turning = barrier(motion_cross(before_v, axis))
    x, y, z = (-prepared.gravity[i][None] for i in range(3))
    at_rest = (ZERO, (x, y, z))
    own = barrier(total(scaled(u_dot, axis), scaled(u, turning)))
    gained = barrier(_mixed(of.of_speeds, own))
    a = total(at_rest, gained)
    by_joint = _Changes(
        axis,
        turning,
        barrier(motion_cross(before_virtual, axis)),
        barrier(total(motion_cross(difference(a, _of_joint(of, own)), axis), motion_cross(before_v, turning))),
        # A hinge's own speed does not move its axis.
        scaled(2.0, turning) if of.has_one_each else barrier(total(turning, motion_cross(v, axis))),
    )
    outside = _outside(of, bodies, v, a, virtual)
    return _derivatives(of, by_joint, _answers(outside, by_joint))


class _Changes(NamedTuple):
    """Of each speed: its axis S, and how v, V and a of the joint's carrier change as seen from what the joint turns.

    Attributes:
        axis: S.
        turning: of v, by the coordinate: S' = v x S.
        virtual: of V, by the coordinate.
        a: of a, by the coordinate.
        a_by_u: of a, by the speed.
    """

    axis: Spatial
    turning: Spatial
    virtual: Spatial
    a: Spatial
    a_by_u: Spatial


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
    origin = each(lambda x: x - x[:1], origin)
    axis, like = speed_axes(tree, Frames(rotation, origin)), origin[0]
    mass = jnp.broadcast_to(_rows(links.mass, like), like.shape)
    hx, hy, hz = (_rows(links.first_moment[:, i], like) for i in range(3))
    turned = apply(rotation, (hx, hy, hz))
    first = plus(turned, scale(mass, origin))
    xx, yy, zz, xy, xz, yz = (_rows(links.second_moment[:, i], like) for i in range(6))
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


def _outside(of: Carriers, bodies: _Body, v: Spatial, a: Spatial, virtual: Spatial) -> _Outside:
    if not of.has_one_each:
        v, a, virtual = jax.tree.map(lambda x: x[of.last], (v, a, virtual))
    momentum, virtual_momentum = barrier((_momentum(bodies, v), _momentum(bodies, virtual)))
    wrench = total(_momentum(bodies, a), wrench_cross(v, momentum))
    (w, linear), (big_w, big_linear), h, second = v, virtual, bodies.first, full(bodies.second)
    rate = plus(apply(second, cross(w, big_w)), cross(linear, cross(big_w, h)), cross(momentum[1], big_linear))
    spin = each(lambda row: scale(-1.0, row), each(plus, _matrix(w, second), _matrix(h, _skew(linear))))
    inner = dot(big_linear, h)
    diagonal: Matrix = (inner, 0.0, 0.0), (0.0, inner, 0.0), (0.0, 0.0, inner)
    bend = each(minus, each(plus, _matrix(big_w, second), each(lambda x: scale(x, h), big_linear)), diagonal)
    own = _Outside(bodies, momentum[1], wrench, virtual_momentum, scale(2.0, rate), spin, bend)
    return barrier(_mixed(of.of_links, own))


def _answers(outside: _Outside, by: _Changes) -> _Answers:
    spun = _spun(outside, by.turning)
    return barrier(
        _Answers(
            inertia=_momentum(outside.body, by.axis),
            turned=_spun_back(outside, by.axis),
            q_v=total(
                total(_spun_back(outside, by.virtual), wrench_cross(by.axis, (outside.rate, ZERO))),
                total(_bent(outside, by.turning), scaled(2.0, wrench_cross(by.turning, outside.virtual))),
            ),
            q_a=total(_momentum(outside.body, by.virtual), wrench_cross(by.axis, outside.virtual)),
            q_virtual=total(total(wrench_cross(by.axis, outside.wrench), spun), _momentum(outside.body, by.a)),
            u_v=total(_bent(outside, by.axis), scaled(2.0, wrench_cross(by.axis, outside.virtual))),
            u_virtual=total(_spun(outside, by.axis), _momentum(outside.body, by.a_by_u)),
        )
    )


def _derivatives(carriers: Carriers, by: _Changes, of: _Answers) -> Curvature:
    """Each is a product of what answers at the outer joint of a pair with what changes at the inner one."""
    carried = carriers.of_speeds.reshape(*carriers.of_speeds.shape, *[1] * (by.axis[1][0].ndim - 1))

    def joined(outer: list, inner: list | None) -> jax.Array:
        """Rows by the joint that answers, where it is the outer one; the others from the second product, or mirrored."""
        lower = jnp.where(carried, _pairs(outer), 0.0)
        other = jnp.where(carried, lower if inner is None else _pairs(inner), 0.0).swapaxes(0, 1)
        return jnp.where(carried, lower, other)

    def mean(twice: jax.Array) -> jax.Array:
        return twice if carriers.has_one_each else 0.5 * (twice + twice.swapaxes(0, 1))

    return Curvature(
        force_by_q=joined([(of.inertia, by.a), (of.turned, by.turning)], [(of.q_virtual, by.axis)]),
        force_by_u=joined([(of.inertia, by.a_by_u), (of.turned, by.axis)], [(of.u_virtual, by.axis)]),
        mass_matrix=joined([(of.inertia, by.axis)], None),
        q_q=mean(joined([(of.q_virtual, by.virtual), (of.q_v, by.turning), (of.q_a, by.a)], None)),
        u_q=joined([(of.u_virtual, by.virtual), (of.u_v, by.turning)], [(of.q_v, by.axis), (of.q_a, by.a_by_u)]),
        u_u=mean(joined([(of.u_v, by.axis)], None)),
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


def _skew(a: Vector) -> Matrix:
    return ((0.0, sub(0.0, a[2]), a[1]), (a[2], 0.0, sub(0.0, a[0])), (sub(0.0, a[1]), a[0], 0.0))


def _matrix(a: Vector, m: Matrix) -> Matrix:
    """The matrix of a x (m b) for b."""
    return matmul(_skew(a), m)


def _of_joint(of: Carriers, own: Spatial) -> Spatial:
    """Sums over the speeds of each joint."""
    return own if of.has_one_each else _mixed(of.together, own)


def _mixed[T](which: np.ndarray, own: T) -> T:
    """Sums over the rows that each row marks, of all components at once."""
    leaves, structure = jax.tree.flatten(own)
    stacked = jnp.stack(leaves, 1)
    # A product with a matrix of zeros and ones takes longer.
    summed = jnp.stack([functools.reduce(jnp.add, [stacked[j] for j in np.flatnonzero(row)]) for row in which])
    return jax.tree.unflatten(structure, [summed[:, i] for i in range(len(leaves))])
