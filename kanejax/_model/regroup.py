"""Inertia parameters regrouped into those that the motion depends on: less arithmetic, the same equations of motion.

Mass on the axis of a revolute joint moves the same whichever of the two links it joins the mass is counted with. So every link
hands the mass, first moment and second moment that lie along its joint's axis to its parent, and keeps seven numbers, all of a
massless lamina across the axis; what reaches the world is dropped. A prismatic joint, which does not turn its link, hands over
the link's whole second moment; a ball joint, the mass at its centre. The parameters that are left are base parameters (Gautier
and Khalil 1990, Direct calculation of minimum set of inertial parameters of serial robots); generalized forces and the mass
matrix depend on nothing else.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from kanejax._model.tree import WORLD, Tree

Rows = jax.Array | np.ndarray


class Moments(NamedTuple):
    """Zeroth, first and second moment of the mass of each link about its origin: sums of m, m r and m r r^T."""

    mass: Float[Array, " n"]
    first: Float[Array, "n 3"]
    second: Float[Array, "n 3 3"]


class _Row(NamedTuple):
    """One link: where it hangs, its pose in the parent, and what of it its parent takes."""

    link: Rows
    parent: Rows
    placement: Rows
    point: Rows
    line: Rows
    all_second: Rows
    lamina: Rows


def regroup(tree: Tree, placements: Float[Array, "n 3 4"], moments: Moments, upright: tuple[bool, ...] = ()) -> Moments:
    """Hand to each parent what lies along the joints' axes, from the tips to the base.

    Args:
        tree: the topology.
        placements: pose of each link in its parent link's frame, of which z is the joint's axis.
        moments: of the links.
        upright: links that are to keep as much second moment along their axis as makes their inertia about the y axis vanish,
            instead of none: fewer operations where there is no first moment.
    """
    if not tree.njoint:
        return moments
    kinds = np.array(tree.joint_types)
    parents = np.array([tree.njoint if parent == WORLD else parent for parent in tree.link_parents], np.int32)
    turns = kinds == "revolute"
    rows = _Row(
        np.arange(tree.njoint, dtype=np.int32),
        parents,
        placements,
        turns | (kinds == "ball"),
        turns,
        kinds == "prismatic",
        ~np.array(upright or (False,) * tree.njoint, bool),
    )
    # One row more, for the world.
    totals = jax.tree.map(lambda x: jnp.concatenate((x, jnp.zeros_like(x[:1]))), moments)
    return _about_fixed_axes(tree, lax.scan(_hand_over, totals, rows, reverse=True)[1])


def _hand_over(totals: Moments, row: _Row) -> tuple[Moments, Moments]:
    """Split a link's moments into what it keeps and what its parent gets."""
    mass, first, second = (lax.dynamic_index_in_dim(x, row.link, keepdims=False) for x in totals)
    rotation, position = row.placement[:, :3], row.placement[:, 3]
    z = np.array([False, False, True])
    zz = z[:, None] & z[None, :]
    point = jnp.where(row.point, mass, 0.0)
    line = jnp.where(row.line & z, first, 0.0)
    along = jnp.where(row.lamina, second[2, 2], second[2, 2] + second[0, 0])
    handed = jnp.where(row.all_second, second, jnp.where(row.line & zz, along, 0.0))
    kept = jnp.where(row.all_second, 0.0, jnp.where(row.line & zz, jnp.where(row.lamina, 0.0, -second[0, 0]), second))
    left = Moments(jnp.where(row.point, 0.0, mass), jnp.where(row.line & z, 0.0, first), kept)
    turned = jnp.sum(rotation * line[None, :], -1)
    mixed = position[:, None] * turned[None, :]
    across = jnp.sum(rotation[:, :, None] * handed[None, :, :], 1)
    rotated = jnp.sum(across[:, None, :] * rotation[None, :, :], -1)
    received = Moments(point, point * position + turned, point * position[:, None] * position[None, :] + mixed + mixed.T + rotated)
    return jax.tree.map(lambda x, y: _add_row(x, row.parent, y), totals, received), left


def _add_row(rows: jax.Array, index: Rows, value: jax.Array) -> jax.Array:
    return lax.dynamic_update_index_in_dim(rows, lax.dynamic_index_in_dim(rows, index, keepdims=False) + value, index, 0)


def _about_fixed_axes(tree: Tree, moments: Moments) -> Moments:
    """Of a link whose axis never turns, only the second moment about this axis counts; of one that never turns, only its mass."""
    still: list[bool] = []
    for parent, kind in zip(tree.link_parents, tree.joint_types, strict=True):
        still.append(kind == "prismatic" and (parent == WORLD or still[parent]))
    on_still = np.array([parent == WORLD or still[parent] for parent in tree.link_parents], bool)
    fixed_axis = on_still & (np.array(tree.joint_types) == "revolute")
    yy = np.zeros((3, 3), bool)
    yy[1, 1] = True
    about = (moments.second[:, 0, 0] + moments.second[:, 1, 1])[:, None, None]
    second = jnp.where(fixed_axis[:, None, None], jnp.where(yy[None], about, 0.0), moments.second)
    return moments._replace(first=jnp.where(np.array(still, bool)[:, None], 0.0, moments.first), second=second)
