"""From the model's parameters to those of its links: what the recursions run over.

A link is what one joint moves. Its frame has its origin at the joint's anchor and, for joints with one degree of freedom, its
z axis along the joint's axis. Bodies welded to one another share a link and are fused here, by the parallel-axis theorem; they
stay separate in the model. All of this depends on parameters alone: for a batch of states it is computed once.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._model.model import Model
from kanejax._model.regroup import Moments, regroup
from kanejax._model.tree import WORLD, Tree

# Poses are arrays (n, 3, 4): a rotation to the outer frame's components, and the position of the origin in it.
Poses34 = Float[Array, "_ 3 4"]
# Arrays with one row a link; those of a specialized model are NumPy's, and constants.
Rows = jax.Array | np.ndarray


class LinkParameters(NamedTuple):
    """Parameters of the links, each in its link's frame; moments of the mass about its origin, as `regroup` leaves them.

    Attributes:
        rotation: from link to parent link components at zero displacement, (nlink, 3, 3).
        position: of the link's origin in the parent link's frame at zero displacement, (nlink, 3).
        mass: (nlink,).
        first_moment: sum of m r, (nlink, 3).
        second_moment: sum of m r r^T: xx, yy, zz, xy, xz, yz, (nlink, 6).
    """

    rotation: Rows
    position: Rows
    mass: Rows
    first_moment: Rows
    second_moment: Rows


def link_parameters(model: Model, upright: tuple[bool, ...] = (), moments: Moments | None = None) -> LinkParameters:
    """Parameters of the links from those of bodies and joints.

    Args:
        model: the mechanism.
        upright: as for `regroup`.
        moments: of each body, in its own frame, in place of those of mass, com and central_inertia; the result is linear in them.
    """
    bodies = body_poses_in_links(model)
    placements = _placements(model, bodies)
    moved = _moments_in_links(model, bodies) if moments is None else _moved(moments, bodies)
    fused = Moments(*(_sum_over_bodies(model.tree, x) for x in moved))
    mass, first, second = regroup(model.tree, placements, fused, upright)
    six = jnp.stack([second[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))], -1)
    return LinkParameters(placements[..., :3], placements[..., 3], mass, first, six)


def body_poses_in_links(model: Model) -> Poses34:
    """Poses of the bodies in the frames of the links they are fixed in; in the world where there is none."""
    tree = model.tree
    # Row 0 is the world; then come bodies that have joints; then, level by level, those welded to the ones before.
    order = [WORLD, *(body for body in range(tree.nbody) if body in tree.joint_bodies)]
    identity = jnp.eye(3, 4, dtype=model.dtype)[None]
    links = np.array([tree.body_links[body] for body in order[1:]], int)
    known = jnp.concatenate((identity, _inverse(_joint_poses(model))[links]))
    placements = _body_placements(model)
    while len(order) <= tree.nbody:
        level = [body for body in range(tree.nbody) if body not in order and tree.body_parents[body] in order]
        parents = np.array([order.index(tree.body_parents[body]) for body in level])
        known = jnp.concatenate((known, compose(known[parents], placements[np.array(level)])))
        order += level
    return known[np.argsort(order)[1:]]


def compose(outer: Poses34, inner: Poses34) -> Poses34:
    """Pose of the inner frame where the outer one is posed; products of 3 are summed at full precision on every device."""
    turned = jnp.sum(outer[..., :, :3, None] * inner[..., None, :, :], -2)
    return turned.at[..., 3].add(outer[..., 3])


def _inverse(pose: Poses34) -> Poses34:
    rotation = jnp.swapaxes(pose[..., :3], -1, -2)
    position = -jnp.sum(rotation * pose[..., None, :, 3], -1)
    return jnp.concatenate((rotation, position[..., None]), -1)


def _joint_poses(model: Model) -> Poses34:
    """Pose of each joint's link in the body it moves: z along the axis, origin at the anchor."""
    kinds = model.tree.joint_types
    turns = np.array([kind in ("revolute", "prismatic") for kind in kinds], bool)[:, None]
    axis = jnp.where(turns, model.joint_axis, jnp.array([0.0, 0.0, 1.0], model.dtype)[None])
    axis = axis / jnp.sqrt(jnp.sum(axis * axis, -1, keepdims=True))
    x, y, z = axis[:, 0], axis[:, 1], axis[:, 2]
    # Any rotation about the axis will do, since the results do not depend on it; this one has no singular direction
    # (Duff et al. 2017, Building an orthonormal basis, revisited).
    sign = jnp.where(z < 0, -1.0, 1.0).astype(z.dtype)
    a = -1.0 / (sign + z)
    b = x * y * a
    anchored = np.array([kind != "free" for kind in kinds], bool)
    px, py, pz = (jnp.where(anchored, model.joint_anchor[:, i], 0.0) for i in range(3))
    rows = ((1.0 + sign * x * x * a, b, x, px), (sign * b, sign + y * y * a, y, py), (-sign * x, -y, z, pz))
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def _body_placements(model: Model) -> Poses34:
    """Pose of each body in its parent's frame, from a quaternion of any length."""
    w, x, y, z = (model.body_quaternion[:, i] for i in range(4))
    s = 2.0 / (w * w + x * x + y * y + z * z)
    px, py, pz = (model.body_position[:, i] for i in range(3))
    rows = (
        (1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y), px),
        (s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x), py),
        (s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y), pz),
    )
    return jnp.stack([jnp.stack(row, -1) for row in rows], -2)


def _placements(model: Model, bodies: Poses34) -> Poses34:
    """Pose of each link in its parent link's frame, at zero displacement."""
    tree = model.tree
    own, placements = _joint_poses(model), _body_placements(model)
    # The frame, fixed in the parent link, that coincides with the body's frame at zero displacement of the joint.
    parents = np.array([tree.body_parents[body] for body in tree.joint_bodies], int)
    base = placements[np.array(tree.joint_bodies, int)]
    if np.any(parents != WORLD):
        with_world = jnp.concatenate((bodies, jnp.eye(3, 4, dtype=bodies.dtype)[None]))
        base = compose(with_world[parents], base)
    later = np.array([j > 0 and tree.joint_bodies[j - 1] == tree.joint_bodies[j] for j in range(tree.njoint)], bool)
    if np.any(later):
        before = _inverse(own)[np.maximum(np.arange(tree.njoint) - 1, 0)]
        base = jnp.where(later[:, None, None], before, base)
    return compose(base, own)


def _moments_in_links(model: Model, bodies: Poses34) -> Moments:
    """Moments of the mass of each body about the origin of its link."""
    rotation = bodies[..., :3]
    com = jnp.sum(rotation * model.com[:, None, :], -1) + bodies[..., 3]
    first = model.mass[:, None] * com
    central = 0.5 * (model.central_inertia + jnp.swapaxes(model.central_inertia, -1, -2))
    half = jnp.sum(rotation[..., :, :, None] * central[..., None, :, :], -2)
    turned = jnp.sum(half[..., :, None, :] * rotation[..., None, :, :], -1)
    # Inertia is tr(J) 1 - J for the second moment J, whose trace is therefore half that of the inertia.
    spread = 0.5 * jnp.trace(turned, axis1=-2, axis2=-1)[:, None, None] * jnp.eye(3, dtype=turned.dtype)[None] - turned
    return Moments(model.mass, first, spread + first[:, :, None] * com[:, None, :])


def _moved(moments: Moments, bodies: Poses34) -> Moments:
    """Moments about the origins of the links, from those of the bodies in their own frames."""
    rotation, position = bodies[..., :3], bodies[..., 3]
    mass = moments.mass[:, None]
    turned = jnp.sum(rotation * moments.first[:, None, :], -1)
    half = jnp.sum(rotation[..., :, :, None] * moments.second[..., None, :, :], -2)
    rotated = jnp.sum(half[..., :, None, :] * rotation[..., None, :, :], -1)
    mixed = (turned + 0.5 * mass * position)[:, :, None] * position[:, None, :]
    return Moments(moments.mass, turned + mass * position, rotated + mixed + jnp.swapaxes(mixed, -1, -2))


def _sum_over_bodies(tree: Tree, of_bodies: jax.Array) -> jax.Array:
    """Sum over the bodies of each link; zero for links without a body."""
    own = [[body for body, link in enumerate(tree.body_links) if link == joint] for joint in range(tree.njoint)]
    padded = jnp.concatenate((of_bodies, jnp.zeros_like(of_bodies[:1])))
    slots = max((len(bodies) for bodies in own), default=0)
    rows = np.array([bodies + [tree.nbody] * (slots - len(bodies)) for bodies in own], int).reshape(tree.njoint, slots)
    return jnp.sum(padded[rows], 1)
