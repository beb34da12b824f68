"""Solving the equations of motion link by link: F u_dot = force, in time linear in the number of links.

Gauss elimination from tip to base on Kane's F of Nie (3.56), one generalized speed after the other, in the form of the
inertia that a link has when the joints outside it move freely (Featherstone's articulated-body inertia). World axes keep
the inertia from being rotated from link to link; it is only shifted from origin to origin. Joints with several speeds are
eliminated one speed at a time, so that every joint type takes the same path.
"""

from typing import NamedTuple

import jax

from kanejax._dynamics.inertia_force import minus_gravity
from kanejax._kinematics.position import place_link
from kanejax._model.links import LinkParameters
from kanejax._model.tree import Tree
from kanejax._recursion.joints import Axis, Joint
from kanejax._recursion.rows import Link, ball_coupling, join_speeds, joint_features, split_parameters, split_speeds
from kanejax._recursion.sweeps import base_to_tip, tip_to_base
from kanejax._scalar import (
    IDENTITY,
    SYMMETRIC_ZERO,
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
    minus,
    mul,
    plus,
    rotate_symmetric,
    scale,
    sub,
)
from kanejax._types import Matrix, Scalar, Symmetric, Vector


class Inertia(NamedTuple):
    """Inertia about an origin: moment = rotary alpha + coupling a, force = coupling^T alpha + linear a."""

    rotary: Symmetric
    coupling: Matrix
    linear: Symmetric


NO_INERTIA = Inertia(SYMMETRIC_ZERO, (ZERO, ZERO, ZERO), SYMMETRIC_ZERO)


class Wrench(NamedTuple):
    """Moment about an origin, and force."""

    moment: Vector
    force: Vector


NO_WRENCH = Wrench(ZERO, ZERO)


class WorldLink(NamedTuple):
    """A link in world axes: offset from its parent's origin, axes of motion, and inertia about its own origin."""

    offset: Vector
    axes: tuple[Axis, ...]
    mass: Scalar
    first_moment: Vector
    inertia: Symmetric


class Pivot(NamedTuple):
    """What elimination keeps of one speed: its axis, 1 / D, and U / D, the reaction to unit acceleration along the axis, over D."""

    axis: Axis
    inverse: Scalar
    reaction: Wrench


class Factor(NamedTuple):
    """The factored mass matrix: pivots of every link, and the offset from its parent's origin, for each segment."""

    offsets: list[Vector]
    pivots: list[tuple[Pivot, ...]]


class Motion(NamedTuple):
    """Rotation, angular velocity, and acceleration at zero u_dot of a link's origin, in world axes."""

    rotation: Matrix
    w: Vector
    alpha: Vector
    a: Vector


def forward_dynamics(
    tree: Tree,
    links: LinkParameters,
    gravity: jax.Array | tuple[float, ...],
    armature: Scalar,
    q: jax.Array,
    u: jax.Array,
    tau: jax.Array,
) -> jax.Array:
    """u_dot (nv, *batch) from forces tau applied at the joints; armature is (nv, *batch), or a known 0."""
    if not tree.njoint:
        return tau
    root = Motion(IDENTITY, ZERO, ZERO, minus_gravity(gravity, q))
    parts = zip(split_parameters(tree, links), joint_features(tree, q), split_speeds(tree, u), strict=True)
    moving = base_to_tip(tree, _move, root, list(parts), q)
    coupling = ball_coupling(tree, u)
    # Rotors have the rates of the joints, not those of their steps.
    forces = split_speeds(tree, sub(tau, mul(armature, coupling)))
    inputs = [(*rows, rotor, force) for rows, rotor, force in zip(moving, split_speeds(tree, armature), forces, strict=True)]
    eliminated = tip_to_base(tree, _eliminate_link, (NO_INERTIA, NO_WRENCH), inputs, q)
    factor = Factor([link.offset for link, _ in moving], [pivots for pivots, _ in eliminated])
    return add(_substitute(tree, factor, [left for _, left in eliminated], q), coupling)


def factorize(tree: Tree, links: LinkParameters, armature: Scalar, q: jax.Array) -> Factor:
    """Factor F(q) for `solve`; armature (nv, *batch), or a known 0, q (nq, *batch)."""
    parts = list(zip(split_parameters(tree, links), joint_features(tree, q), strict=True))
    still = base_to_tip(tree, _stand, IDENTITY, parts, q)
    inputs = list(zip(still, split_speeds(tree, armature), strict=True))
    return Factor([link.offset for link in still], tip_to_base(tree, _factor_link, NO_INERTIA, inputs, q))


def solve(tree: Tree, factor: Factor, force: jax.Array) -> jax.Array:
    """F^-1 force, linear in the force (nv, *batch)."""
    inputs = list(zip(factor.offsets, factor.pivots, split_speeds(tree, force), strict=True))
    left = tip_to_base(tree, _reduce_link, NO_WRENCH, inputs, force)
    return _substitute(tree, factor, left, force)


def _stand(joint: Joint, parent: Matrix, link: tuple[Link, tuple]) -> tuple[Matrix, WorldLink]:
    """A link in world axes, at rest."""
    links, features = link
    placed = place_link(joint, parent, links, features)
    h, second = barrier((apply(placed.rotation, links.first_moment), rotate_symmetric(placed.rotation, links.second_moment)))
    inertia = barrier(inertia_of(second))
    return placed.rotation, WorldLink(placed.offset, placed.axes, links.mass, h, inertia)


def _move(joint: Joint, parent: Motion, link: tuple[Link, tuple, tuple]) -> tuple[Motion, tuple[WorldLink, Wrench]]:
    """Motion of a link at zero u_dot, and the wrench about its origin that this motion and gravity take."""
    links, features, speeds = link
    placed = place_link(joint, parent.rotation, links, features)
    spin = plus(*(scale(speed, angular) for (angular, _), speed in zip(placed.axes, speeds, strict=True)))
    slide = plus(*(scale(speed, linear) for (_, linear), speed in zip(placed.axes, speeds, strict=True)))
    across = barrier(cross(parent.w, placed.offset))
    w = plus(parent.w, spin)
    alpha = plus(parent.alpha, cross(parent.w, spin))
    # The axis of a sliding joint turns with the parent: Coriolis acceleration, twice.
    a = plus(parent.a, cross(parent.alpha, placed.offset), cross(parent.w, across), scale(2.0, cross(parent.w, slide)))
    w, alpha, a = barrier((w, alpha, a))
    h, second = barrier((apply(placed.rotation, links.first_moment), rotate_symmetric(placed.rotation, links.second_moment)))
    inertia = barrier(inertia_of(second))
    whirl, momentum = barrier((cross(w, h), apply_symmetric(inertia, w)))
    force = plus(scale(links.mass, a), cross(alpha, h), cross(w, whirl))
    moment = plus(apply_symmetric(inertia, alpha), cross(w, momentum), cross(h, a))
    still = WorldLink(placed.offset, placed.axes, links.mass, h, inertia)
    return Motion(placed.rotation, w, alpha, a), (still, Wrench(moment, force))


def _eliminate_link(joint: Joint, outer: tuple[Inertia, Wrench], link: tuple) -> tuple:
    """Eliminate a link's speeds from inertia and forces at once."""
    body, bias, armature, tau = link
    inertia = _add_link(outer[0], body)
    wrench = Wrench(*(plus(x, y) for x, y in zip(outer[1], bias, strict=True)))
    pivots, left = [], []
    for axis, rotor, force in zip(body.axes, armature, tau, strict=True):
        inertia, pivot = _pivot(inertia, axis, rotor)
        wrench, rest = _reduce(wrench, pivot, force)
        pivots.append(pivot)
        left.append(rest)
    return (barrier(_shift(inertia, body.offset)), barrier(_shift_wrench(wrench, body.offset))), (tuple(pivots), tuple(left))


def _factor_link(joint: Joint, outer: Inertia, link: tuple) -> tuple[Inertia, tuple[Pivot, ...]]:
    """Eliminate a link's speeds from the inertia."""
    body, armature = link
    inertia = _add_link(outer, body)
    pivots = []
    for axis, rotor in zip(body.axes, armature, strict=True):
        inertia, pivot = _pivot(inertia, axis, rotor)
        pivots.append(pivot)
    return barrier(_shift(inertia, body.offset)), tuple(pivots)


def _reduce_link(joint: Joint, wrench: Wrench, link: tuple) -> tuple[Wrench, tuple[Scalar, ...]]:
    """Eliminate a link's speeds from the forces."""
    offset, pivots, forces = link
    left = []
    for pivot, force in zip(pivots, forces, strict=True):
        wrench, rest = _reduce(wrench, pivot, force)
        left.append(rest)
    return barrier(_shift_wrench(wrench, offset)), tuple(left)


def _pivot(inertia: Inertia, axis: Axis, rotor: Scalar) -> tuple[Inertia, Pivot]:
    """Let one speed move freely: the inertia that is left, less U U^T / D, and what solving needs of it."""
    response = barrier(_response(inertia, axis))
    inverse = 1.0 / add(_power(axis, response), rotor)
    inverse, reaction = barrier((inverse, Wrench(scale(inverse, response.moment), scale(inverse, response.force))))
    return barrier(_deflate(inertia, response, reaction)), Pivot(axis, inverse, reaction)


def _reduce(wrench: Wrench, pivot: Pivot, force: Scalar) -> tuple[Wrench, Scalar]:
    """Take one speed's share out of the wrench; also its acceleration while the parent's is zero."""
    left = barrier(sub(force, _power(pivot.axis, wrench)))
    moment = plus(wrench.moment, scale(left, pivot.reaction.moment))
    return barrier(Wrench(moment, plus(wrench.force, scale(left, pivot.reaction.force)))), mul(pivot.inverse, left)


def _substitute(tree: Tree, factor: Factor, left: list, like: jax.Array) -> jax.Array:
    """Substitute back base to tip: u_dot, which each speed owes to its own force and to the acceleration of its parent."""
    inputs = list(zip(factor.offsets, factor.pivots, left, strict=True))
    return join_speeds(tree, base_to_tip(tree, _substitute_link, (ZERO, ZERO), inputs, like), like)


def _substitute_link(joint: Joint, parent: tuple[Vector, Vector], link: tuple) -> tuple:
    offset, pivots, left = link
    alpha, a = parent
    a = plus(a, cross(alpha, offset))
    rates: list[Scalar] = []
    # The speed that was eliminated last knows only the parent; the one before it, this one too.
    for pivot, own in reversed(list(zip(pivots, left, strict=True))):
        rate = barrier(sub(own, add(dot(pivot.reaction.moment, alpha), dot(pivot.reaction.force, a))))
        alpha, a = plus(alpha, scale(rate, pivot.axis[0])), plus(a, scale(rate, pivot.axis[1]))
        rates.append(rate)
    return barrier((alpha, a)), tuple(reversed(rates))


def _power(axis: Axis, wrench: Wrench) -> Scalar:
    """Power of a wrench on unit speed along an axis."""
    return add(dot(axis[0], wrench.moment), dot(axis[1], wrench.force))


def _add_link(inertia: Inertia, link: WorldLink) -> Inertia:
    hx, hy, hz = link.first_moment
    (c00, c01, c02), (c10, c11, c12), (c20, c21, c22) = inertia.coupling
    coupling = ((c00, c01 - hz, c02 + hy), (c10 + hz, c11, c12 - hx), (c20 - hy, c21 + hx, c22))
    xx, yy, zz, xy, xz, yz = inertia.linear
    linear = (xx + link.mass, yy + link.mass, zz + link.mass, xy, xz, yz)
    return Inertia(plus(inertia.rotary, link.inertia), coupling, linear)


def _response(inertia: Inertia, axis: Axis) -> Wrench:
    """Wrench for unit acceleration along an axis."""
    angular, linear = axis
    moment = plus(apply_symmetric(inertia.rotary, angular), apply(inertia.coupling, linear))
    return Wrench(moment, plus(apply_transposed(inertia.coupling, angular), apply_symmetric(inertia.linear, linear)))


def _deflate(inertia: Inertia, response: Wrench, reaction: Wrench) -> Inertia:
    """Inertia once a speed moves freely: less U U^T / D."""
    rotary = minus(inertia.rotary, _outer(response.moment, reaction.moment))
    linear = minus(inertia.linear, _outer(response.force, reaction.force))
    coupling = tuple(minus(row, scale(x, reaction.force)) for row, x in zip(inertia.coupling, response.moment, strict=True))
    return Inertia(rotary, coupling, linear)  # type: ignore[arg-type]


def _outer(a: Vector, b: Vector) -> Symmetric:
    """Symmetric product a b^T, for b parallel to a."""
    return (mul(a[0], b[0]), mul(a[1], b[1]), mul(a[2], b[2]), mul(a[0], b[1]), mul(a[0], b[2]), mul(a[1], b[2]))


def _shift(inertia: Inertia, offset: Vector) -> Inertia:
    """The same inertia about the parent's origin, from which `offset` points to the present one."""
    linear = full(inertia.linear)
    lifted = tuple(cross(offset, column(linear, j)) for j in range(3))
    coupling = barrier(tuple(tuple(add(inertia.coupling[i][j], lifted[j][i]) for j in range(3)) for i in range(3)))
    across = tuple(cross(offset, row) for row in inertia.coupling)
    back = tuple(cross(row, offset) for row in coupling)

    def entry(i: int, j: int) -> Scalar:
        return sub(across[j][i], back[i][j])

    gain = (entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2))
    return Inertia(plus(inertia.rotary, gain), coupling, inertia.linear)  # type: ignore[arg-type]


def _shift_wrench(wrench: Wrench, offset: Vector) -> Wrench:
    return Wrench(plus(wrench.moment, cross(offset, wrench.force)), wrench.force)
