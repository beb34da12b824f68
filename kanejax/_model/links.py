"""From the model's parameters to those of its links: what the recursions run over.

A link is what one joint moves. Its frame has its origin at the joint's anchor and, for joints with one degree of freedom, its z axis
along the joint's axis. Bodies welded to one another share a link and are fused here, by the parallel-axis theorem; they
stay separate in the model. All of this depends on parameters alone: in a batch of states it is computed once.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._model.model import Model
from kanejax._model.tree import WORLD, Tree
from kanejax._scalar import (
    IDENTITY,
    apply,
    barrier,
    matmul,
    outer_symmetric,
    plus,
    rotate_symmetric,
    rotation_from_quaternion,
    scale,
    transpose,
)
from kanejax._types import Matrix, Scalar, Symmetric, Vector

T = TypeVar("T")


class Frames(NamedTuple):
    """Rotations and positions, each component an array with one row a frame and then the batch."""

    rotation: Matrix
    position: Vector


class Links(NamedTuple):
    """Parameters of the links in their own frames, each component an array (nlink, *batch).

    Attributes:
        placement: of the link's frame in the parent link's frame, at zero displacement.
        mass: of all bodies of the link.
        first_moment: mass times the position of the mass centre.
        inertia: about the link's origin.
    """

    placement: Frames
    mass: Scalar
    first_moment: Vector
    inertia: Symmetric


def components(leaf: jax.Array, *shape: int) -> tuple:
    """Split axis 1 (and 2) of a leaf (n, *shape, *batch) into nested tuples of arrays (n, *batch)."""
    if not shape:
        return leaf  # type: ignore[return-value]
    return tuple(components(leaf[:, i], *shape[1:]) for i in range(shape[0]))


def body_frames(model: Model) -> Frames:
    """Frames of the bodies in the frames of the links they are fixed in; of the world where there is none."""
    tree = model.tree
    axes, anchors = _joint_frames(model)
    rotations, positions = _body_placements(model)
    # Row 0 is the world; then come bodies that have joints; then, level by level, those welded to the ones before.
    order = [WORLD, *(body for body in range(tree.nbody) if body in tree.joint_bodies)]
    moved = take((axes, anchors), [tree.body_links[body] for body in order[1:]])
    inverse = transpose(moved[0])
    known = Frames(inverse, scale(-1.0, apply(inverse, moved[1])))
    world = Frames(*jax.tree.map(lambda number, row: jnp.full_like(row[:1], number), (IDENTITY, (0.0, 0.0, 0.0)), (rotations, positions)))
    known = _concatenate(world, known)
    while len(order) <= tree.nbody:
        level = [body for body in range(tree.nbody) if body not in order and tree.body_parents[body] in order]
        parent = take(known, [order.index(tree.body_parents[body]) for body in level])
        rotation, position = take((rotations, positions), level)
        known = _concatenate(known, Frames(matmul(parent.rotation, rotation), plus(parent.position, apply(parent.rotation, position))))
        order += level
    return take(known, [order.index(body) for body in range(tree.nbody)])


def link_parameters(model: Model, frames: Frames | None = None) -> Links:
    """Parameters of the links; `frames` are those of `body_frames`, where they are at hand."""
    frames = body_frames(model) if frames is None else frames
    mass, first_moment, inertia = _fused_inertia(model, frames)
    return Links(_placements(model, frames), mass, first_moment, inertia)


def take(tree: T, index: list[int] | np.ndarray) -> T:
    """Rows of every component, without a gather where they are all of them in order."""
    rows = np.asarray(index, dtype=int)

    def pick(leaf: jax.Array) -> jax.Array:
        if rows.ndim == 1 and len(rows) and np.array_equal(rows, np.arange(rows[0], rows[0] + len(rows))):
            return leaf if len(rows) == leaf.shape[0] else leaf[rows[0] : rows[0] + len(rows)]
        return leaf[rows]

    return jax.tree.map(pick, tree)


def _concatenate(a: T, b: T) -> T:
    def join(x: jax.Array, y: jax.Array) -> jax.Array:
        batch = jnp.broadcast_shapes(x.shape[1:], y.shape[1:])
        return jnp.concatenate([jnp.broadcast_to(rows, rows.shape[:1] + batch) for rows in (x, y)])

    return jax.tree.map(join, *barrier((a, b)))


def _joint_frames(model: Model) -> Frames:
    """Frame of each joint's link in the body it moves: z along the axis, origin at the anchor."""
    tree = model.tree
    x, y, z = components(model.joint_axis, 3)
    turns = _rows([kind in ("revolute", "prismatic") for kind in tree.joint_types], z)
    x, y, z = jnp.where(turns, x, 0.0), jnp.where(turns, y, 0.0), jnp.where(turns, z, 1.0)
    length = jnp.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    # Any rotation about the axis will do, since the results do not depend on it; this one has no singular direction
    # (Duff et al. 2017, Building an orthonormal basis, revisited).
    sign = jnp.where(z < 0, -1.0, 1.0).astype(z.dtype)
    a = -1.0 / (sign + z)
    b = x * y * a
    rotation = ((1.0 + sign * x * x * a, b, x), (sign * b, sign + y * y * a, y), (-sign * x, -y, z))
    anchored = _rows([kind != "free" for kind in tree.joint_types], z)
    return Frames(rotation, tuple(jnp.where(anchored, c, 0.0) for c in components(model.joint_anchor, 3)))  # type: ignore[arg-type]


def _body_placements(model: Model) -> Frames:
    quaternion = components(model.body_quaternion, 4)
    return Frames(rotation_from_quaternion(quaternion), components(model.body_position, 3))  # type: ignore[arg-type]


def _placements(model: Model, frames: Frames) -> Frames:
    """Frame of each link in its parent link's frame, at zero displacement."""
    tree = model.tree
    own = _joint_frames(model)
    placements = _body_placements(model)
    first = [j for j in range(tree.njoint) if j == 0 or tree.joint_bodies[j - 1] != tree.joint_bodies[j]]
    later = [j for j in range(tree.njoint) if j not in first]
    # The frame, fixed in the parent link, that coincides with the body's frame at zero displacement of the joint.
    body = [tree.joint_bodies[joint] for joint in first]
    rotation, position = take(placements, body)
    parents = [tree.body_parents[b] for b in body]
    if all(parent == WORLD for parent in parents):
        base = Frames(rotation, position)
    else:
        carried = _with_world(frames, parents)
        base = Frames(matmul(carried.rotation, rotation), plus(carried.position, apply(carried.rotation, position)))
    if later:
        before = take(own, [joint - 1 for joint in later])
        inverse = transpose(before.rotation)
        base = _concatenate(base, Frames(inverse, scale(-1.0, apply(inverse, before.position))))
        base = take(base, [(first + later).index(joint) for joint in range(tree.njoint)])
    return Frames(matmul(base.rotation, own.rotation), plus(base.position, apply(base.rotation, own.position)))


def _with_world(frames: Frames, bodies: list[int]) -> Frames:
    """Frames of the given bodies, the identity for the world."""
    rows = take(frames, [max(body, 0) for body in bodies])
    real = _rows([body != WORLD for body in bodies], rows.position[0])
    identity = Frames(IDENTITY, (0.0, 0.0, 0.0))
    return jax.tree.map(lambda row, number: jnp.where(real, row, number), rows, identity)


def _fused_inertia(model: Model, frames: Frames) -> tuple[Scalar, Vector, Symmetric]:
    """Mass, first moment and inertia about its origin of each link, summed over its bodies."""
    tree = model.tree
    i = components(model.central_inertia, 3, 3)
    central = (i[0][0], i[1][1], i[2][2], 0.5 * (i[0][1] + i[1][0]), 0.5 * (i[0][2] + i[2][0]), 0.5 * (i[1][2] + i[2][1]))
    com = plus(frames.position, apply(frames.rotation, components(model.com, 3)))
    first_moment = scale(model.mass, com)
    xx, yy, zz, xy, xz, yz = outer_symmetric(com)
    offset = (yy + zz, xx + zz, xx + yy, -xy, -xz, -yz)
    inertia = plus(rotate_symmetric(frames.rotation, central), scale(model.mass, offset))
    return _sum_over_bodies(tree, (model.mass, first_moment, inertia))


def _sum_over_bodies(tree: Tree, of_bodies: T) -> T:
    """Sum of each component over the bodies of a link; zero for links without a body."""
    bodies = [[body for body, link in enumerate(tree.body_links) if link == joint] for joint in range(tree.njoint)]
    if all(len(own) == 1 for own in bodies):
        return take(of_bodies, [own[0] for own in bodies])
    of_bodies = barrier(of_bodies)
    total = None
    for slot in range(max(1, *(len(own) for own in bodies)) if bodies else 0):
        filled = [len(own) > slot for own in bodies]
        rows = take(of_bodies, [own[slot] if len(own) > slot else 0 for own in bodies])
        part = jax.tree.map(lambda row: jnp.where(_rows(filled, row), row, 0.0), rows)  # noqa: B023
        total = part if total is None else jax.tree.map(jnp.add, total, part)
    return of_bodies if total is None else total


def _rows(mask: list[bool], like: jax.Array) -> np.ndarray:
    """A constant mask (n, 1, ...) that broadcasts along the batch of `like`."""
    return np.asarray(mask, dtype=bool).reshape((-1,) + (1,) * (like.ndim - 1))
