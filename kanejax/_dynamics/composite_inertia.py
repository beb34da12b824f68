"""The mass matrix in the links' own axes, and its factor: the fewest operations where parameters are known numbers.

F_rs is the power, on unit speed s, of the wrench that everything outside joint r needs for unit acceleration along r (the
composite inertia of Walker and Orin 1982, Nie's (3.56) summed link by link). Written out row by row, so that zeros and ones of
axes, placements and regrouped inertias fold; the elimination then goes from the tips to the base, which leaves F's zeros zeros.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from kanejax._model.links import LinkParameters
from kanejax._model.tree import WORLD, Tree
from kanejax._recursion.joints import Axis
from kanejax._recursion.rows import Frames, joint_features, split_parameters
from kanejax._recursion.sweeps import written_out
from kanejax._scalar import (
    add,
    apply,
    apply_symmetric,
    barrier,
    cross,
    dot,
    inertia_of,
    is_known,
    mul,
    outer_symmetric,
    plus,
    rotate_symmetric,
    scale,
    sub,
)
from kanejax._types import Scalar, Symmetric, Vector

# Entries of F by the speeds of their row and column, the larger first; those that are missing are zero.
Entries = dict[tuple[int, int], Scalar]


class Moments(NamedTuple):
    """Mass, first and second moment about a link's origin."""

    mass: Scalar
    first: Vector
    second: Symmetric


class Row(NamedTuple):
    """One row of the recursions: its speeds and their axes, the row it hangs on, and its pose in that row's frame."""

    speeds: tuple[int, ...]
    axes: tuple[Axis, ...]
    parent: int
    placement: Frames
    moments: Moments


class Factor(NamedTuple):
    """F = L^T D L: the rows of L below the diagonal, and 1 / D."""

    lower: Entries
    inverse: tuple[Scalar, ...]


def mass_matrix(tree: Tree, links: LinkParameters, armature: Scalar, q: jax.Array) -> jax.Array:
    """F(q), (nv, nv, *batch)."""
    entries, shape = mass_entries(tree, links, armature, q), q.shape[1:]
    both = [entries.get((max(i, j), min(i, j)), 0.0) for i in range(tree.nv) for j in range(tree.nv)]
    # Materialised before: XLA evaluates what is fused into a stack for every row of it.
    columns = barrier([jnp.broadcast_to(jnp.asarray(x, q.dtype), shape) for x in both])
    return jnp.stack(columns).reshape(tree.nv, tree.nv, *shape)


def factorize(tree: Tree, links: LinkParameters, armature: Scalar, q: jax.Array) -> Factor:
    """Factor F(q), from the tips to the base; armature (nv, *batch), or a known 0, q (nq, *batch)."""
    entries = mass_entries(tree, links, armature, q)
    lower: Entries = {}
    inverse: list[Scalar] = [0.0] * tree.nv
    for k in reversed(range(tree.nv)):
        pivot = entries[k, k]
        # A joint that moves nothing has infinite accelerations, as where its inertia is not known while tracing.
        inverse[k] = math.inf if is_known(pivot) and pivot == 0 else barrier(1.0 / pivot)
        columns = [i for i in range(k) if (k, i) in entries]
        for i in columns:
            lower[k, i] = barrier(mul(entries[k, i], inverse[k]))
            for j in (j for j in columns if j <= i):
                entries[i, j] = barrier(sub(entries[i, j], mul(lower[k, i], entries[k, j])))
    return Factor(lower, tuple(inverse))


def solve(tree: Tree, factor: Factor, force: jax.Array) -> jax.Array:
    """F^-1 force, linear in the force (nv, *batch)."""
    left = [force[i] for i in range(tree.nv)]
    for (k, i), entry in factor.lower.items():
        left[i] = barrier(sub(left[i], mul(entry, left[k])))
    rates = [mul(inverse, x) for inverse, x in zip(factor.inverse, left, strict=True)]
    for k in range(tree.nv):
        for i in (i for i in range(k) if (k, i) in factor.lower):
            rates[k] = sub(rates[k], mul(factor.lower[k, i], rates[i]))
        rates[k] = barrier(rates[k])
    return jnp.stack(rates)


def mass_entries(tree: Tree, links: LinkParameters, armature: Scalar, q: jax.Array) -> Entries:
    """The entries of F(q) on and below the diagonal."""
    rows = _rows(tree, links, q)
    composite = [row.moments for row in rows]
    entries: Entries = {}
    for i, row in reversed(list(enumerate(rows))):
        for axis, speed in zip(row.axes, row.speeds, strict=True):
            _add_column(entries, rows, i, speed, barrier(_momentum(composite[i], axis)))
            rotor = armature if is_known(armature) else armature[speed]
            entries[speed, speed] = add(entries[speed, speed], rotor)
        if row.parent != WORLD:
            moved = barrier(_moved(composite[i], row.placement))
            composite[row.parent] = barrier(jax.tree.map(add, composite[row.parent], moved))
    return entries


def _rows(tree: Tree, links: LinkParameters, q: jax.Array) -> list[Row]:
    parts = zip(split_parameters(tree, links), joint_features(tree, q), strict=True)
    rows, last_of_link = [], {WORLD: WORLD}
    for segment, i, joint, (link, features) in written_out(tree, list(parts)):
        number = segment.links[i]
        parent = last_of_link[tree.link_parents[number]] if segment.first[i] else len(rows) - 1
        rotation, position = barrier(joint.place(link.placement.rotation, link.placement.position, features))
        moments = Moments(link.mass, link.first_moment, link.second_moment)
        rows.append(Row(segment.speeds[i], joint.link_axes(rotation), parent, Frames(rotation, position), moments))
        last_of_link[number] = len(rows) - 1
    return rows


def _momentum(moments: Moments, axis: Axis) -> tuple[Vector, Vector]:
    """Angular momentum about the origin and linear momentum for unit speed along an axis."""
    angular, linear = axis
    turning = apply_symmetric(inertia_of(moments.second), angular)
    return plus(turning, cross(moments.first, linear)), plus(scale(moments.mass, linear), cross(angular, moments.first))


def _add_column(entries: Entries, rows: list[Row], i: int, speed: int, momentum: tuple[Vector, Vector]) -> None:
    """Entries of one speed with itself, the speeds before it in its row, and those of all rows further in."""
    moment, force = momentum
    while i != WORLD:
        row = rows[i]
        for (angular, linear), other in zip(row.axes, row.speeds, strict=True):
            if other <= speed:
                entries[speed, other] = barrier(add(dot(angular, moment), dot(linear, force)))
        force = apply(row.placement.rotation, force)
        moment = plus(apply(row.placement.rotation, moment), cross(row.placement.position, force))
        moment, force, i = *barrier((moment, force)), row.parent


def _moved(moments: Moments, placement: Frames) -> Moments:
    """The moments about the parent's origin, in its axes."""
    mass, first, second = moments
    rotation, position = placement
    turned, rotated = barrier((apply(rotation, first), rotate_symmetric(rotation, second)))
    (x, y, z), (a, b, c) = position, turned
    mixed = (
        mul(2.0, mul(x, a)), mul(2.0, mul(y, b)), mul(2.0, mul(z, c)),
        add(mul(x, b), mul(y, a)), add(mul(x, c), mul(z, a)), add(mul(y, c), mul(z, b)),
    )  # fmt: skip
    return Moments(mass, plus(turned, scale(mass, position)), plus(rotated, mixed, scale(mass, outer_symmetric(position))))
