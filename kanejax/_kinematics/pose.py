"""Where bodies and links are: the public side of `position`."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._evaluate import check_state, evaluate
from kanejax._kinematics.position import world_frames
from kanejax._model.links import body_poses_in_links, compose
from kanejax._model.model import Model
from kanejax._model.prepared import Prepared, displacement
from kanejax._model.specialized import Specialized, whole
from kanejax._model.tree import Tree
from kanejax._scalar import barrier
from kanejax._types import Coordinates


class Poses(NamedTuple):
    """Orientation and position, in world axes, of every body and link.

    Attributes:
        rotation: from body to world components.
        origin: of the body's frame.
        com: mass centre of the body.
        link_rotation: from link to world components; a link's z axis is the axis of its joint.
        link_origin: of the link's frame, which is the joint's anchor.
    """

    rotation: Float[Array, "nbody 3 3"]
    origin: Float[Array, "nbody 3"]
    com: Float[Array, "nbody 3"]
    link_rotation: Float[Array, "njoint 3 3"]
    link_origin: Float[Array, "njoint 3"]


def poses(model: Model | Specialized, q: Coordinates) -> Poses:
    """Orientations and positions of all bodies: MuJoCo's `xmat`, `xpos` and `xipos`, the world left out.

    Args:
        model: the mechanism.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.

    Returns:
        Rotations, and points [m].

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(model, q=q)
    model = whole(model)
    link_rotation, link_origin = evaluate(_link_frames, model, q)
    links = jnp.concatenate((link_rotation, link_origin[..., None]), -1)
    links = jnp.concatenate((links, jnp.eye(3, 4, dtype=links.dtype)[None]))
    # Bodies without a link are fixed in the world, the last row.
    bodies = compose(links[np.array(model.tree.body_links, int)], body_poses_in_links(model))
    rotation, origin = bodies[..., :3], bodies[..., 3]
    com = origin + jnp.sum(rotation * model.com[:, None, :], -1)
    return Poses(rotation, origin, com, link_rotation, link_origin)


def _link_frames(tree: Tree, prepared: Prepared, q: jax.Array) -> tuple[jax.Array, jax.Array]:
    frames = world_frames(tree, prepared.links, displacement(tree, prepared, q))
    rotation, position = barrier((frames.rotation, frames.position))
    return jnp.stack([jnp.stack(row, 1) for row in rotation], 1), jnp.stack(position, 1)
