"""Orientations and positions of the links in world axes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from kanejax._model.links import LinkParameters
from kanejax._model.tree import Tree
from kanejax._recursion.joints import Axis, Joint
from kanejax._recursion.rows import Frames, Link, join_links, joint_features, split_parameters
from kanejax._recursion.sweeps import base_to_tip
from kanejax._scalar import IDENTITY, ZERO, apply, barrier, matmul, plus
from kanejax._types import Matrix, Scalar, Vector

WORLD_FRAMES = Frames(IDENTITY, ZERO)


class Placed(NamedTuple):
    """A link in world axes: its rotation, the vector from its parent's origin to its own, and its axes of motion."""

    rotation: Matrix
    offset: Vector
    axes: tuple[Axis, ...]


def place_link(joint: Joint, parent_rotation: Matrix, links: Link, features: tuple[Scalar, ...]) -> Placed:
    """Resolve a link's placement in world axes, Nie (3.5): the rotation is the product of those from the base on."""
    rotation, position = joint.place(*links.placement, features)
    rotation, offset = barrier((matmul(parent_rotation, rotation), apply(parent_rotation, position)))
    return Placed(rotation, offset, joint.world_axes(rotation))


def world_frames(tree: Tree, links: LinkParameters, q: jax.Array) -> Frames:
    """Rotation from link to world axes and origin of every link, components (nlink, *batch)."""

    def step(joint: Joint, parent: Frames, link: tuple[Link, tuple[Scalar, ...]]) -> tuple[Frames, Frames]:
        placed = place_link(joint, parent.rotation, *link)
        frames = Frames(placed.rotation, plus(parent.position, placed.offset))
        return frames, frames

    if not tree.njoint:
        return jax.tree.map(lambda _: jnp.zeros((0, *q.shape[1:]), q.dtype), WORLD_FRAMES)
    inputs = list(zip(split_parameters(tree, links), joint_features(tree, q), strict=True))
    return join_links(tree, base_to_tip(tree, step, WORLD_FRAMES, inputs, q), q)
