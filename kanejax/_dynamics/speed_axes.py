"""The axes of motion of all generalized speeds in world axes, and which of them carry which."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._dynamics.spatial import Spatial, each
from kanejax._model.tree import SPEEDS, Tree
from kanejax._recursion.rows import Frames
from kanejax._scalar import column, cross
from kanejax._types import Matrix, Vector


class Carriers(NamedTuple):
    """Which speeds move what, as booleans; the velocity and the rotation of a free joint count as two joints.

    Attributes:
        of_speeds: (nv, nv): [i, j] says that the joint of speed j carries that of i, or is it.
        together: (nv, nv): speeds of one joint.
        of_links: (nv, njoint): [i, k] says that speed i moves link k.
        last: (njoint,) the last speed of each link.
        has_one_each: whether every joint has one speed.
    """

    of_speeds: np.ndarray
    together: np.ndarray
    of_links: np.ndarray
    last: np.ndarray
    has_one_each: bool


@functools.cache
def carriers(tree: Tree) -> Carriers:
    """What carries what in a tree."""
    link, turns = tree.speed_joints, _kinds(tree) != "velocity"
    is_same = link[:, None] == link[None]
    carried = tree.link_ancestors[link][:, link] & (~is_same | (turns[:, None] >= turns[None]))
    counts = np.array([SPEEDS[kind] for kind in tree.joint_types], int)
    return Carriers(
        carried,
        is_same & (turns[:, None] == turns[None]),
        tree.link_ancestors[:, link].T,
        np.cumsum(counts) - 1,
        bool(np.all(counts == 1)),
    )


def speed_axes(tree: Tree, frames: Frames) -> Spatial:
    """Velocity of what each speed moves for a unit of it, at the point that the links' origins are counted from, (nv, *batch)."""
    kinds, link = _kinds(tree), tree.speed_joints
    alike = (-1, *[1] * (jnp.ndim(frames.position[0]) - 1))
    slides = np.isin(kinds, ("slide", "velocity")).reshape(alike)
    direction = _directions(tree, frames.rotation)
    origin = frames.position if carriers(tree).has_one_each else each(lambda x: jnp.asarray(x)[link], frames.position)
    about = cross(origin, direction)
    angular = each(lambda x: jnp.where(slides, 0.0, x), direction)
    return angular, each(lambda x, y: jnp.where(slides, x, y), direction, about)


def _directions(tree: Tree, rotation: Matrix) -> Vector:
    """Of the axes: z of the link, each of its axes in turn, or each of the world's."""
    if carriers(tree).has_one_each:
        return column(rotation, 2)
    kinds, link = _kinds(tree), tree.speed_joints
    within = np.arange(tree.nv) - np.array(tree.v_start, int)[link]
    which = np.where(np.isin(kinds, ("hinge", "slide")), 2, within % 3)
    alike = (-1, *[1] * (jnp.ndim(rotation[0][2]) - 1))
    columns = [column(rotation, i) for i in range(3)]

    def component(i: int) -> jax.Array:
        of_links = jnp.stack([axis[i] for axis in columns])[which, link]
        of_world = jnp.asarray((which == i).reshape(alike), of_links.dtype)
        return jnp.where((kinds == "velocity").reshape(alike), of_world, of_links)

    return component(0), component(1), component(2)


def _kinds(tree: Tree) -> np.ndarray:
    """What each speed is: of a hinge, of a slide, or a free joint's velocity; or it turns a body about an axis of its own."""
    words = {"revolute": ["hinge"], "prismatic": ["slide"], "ball": ["turn"] * 3, "free": ["velocity"] * 3 + ["turn"] * 3}
    return np.array([word for kind in tree.joint_types for word in words[kind]])
