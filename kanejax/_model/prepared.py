"""What the recursions need of a model, computed from its leaves once for a whole batch of states."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._model.links import LinkParameters, link_parameters
from kanejax._model.model import Model
from kanejax._model.regroup import Moments
from kanejax._model.tree import COORDINATES, Tree
from kanejax._scalar import sub
from kanejax._types import Scalar


class Prepared(NamedTuple):
    """Link parameters, gravity, and the parameters of joints and speeds, with trailing batch axes.

    A `Scalar` may be the number 0 instead, where it is known that all are.
    """

    links: LinkParameters
    gravity: jax.Array
    armature: Scalar
    damping: Scalar
    stiffness: Scalar
    spring_reference: jax.Array
    coordinate_reference: Scalar
    coulomb_friction: Scalar
    friction_width: jax.Array


def prepare(model: Model, upright: tuple[bool, ...] = (), moments: Moments | None = None) -> Prepared:
    """Compute the parameters of the links from those of the bodies and joints; `upright` and `moments` as for `link_parameters`."""
    turns_or_slides = np.repeat(
        [COORDINATES[kind] == 1 for kind in model.tree.joint_types], [COORDINATES[kind] for kind in model.tree.joint_types]
    )
    return Prepared(
        link_parameters(model, upright, moments),
        model.gravity,
        model.armature,
        model.damping,
        model.stiffness,
        model.spring_reference,
        jnp.where(turns_or_slides, model.coordinate_reference, 0.0),
        model.coulomb_friction,
        model.friction_width,
    )


def batch_shape(prepared: Prepared) -> tuple[int, ...]:
    """The trailing batch axes of all parameters together; those that are None have none."""
    rotation, position, mass, first, second = prepared.links
    own_axes = [(rotation, 3), (position, 2), (mass, 1), (first, 2), (second, 2), *((x, 1) for x in prepared[1:])]
    return np.broadcast_shapes(*(x.shape[own:] for x, own in own_axes if x is not None))


def displacement(tree: Tree, prepared: Prepared, q: jax.Array) -> jax.Array:
    """Coordinates relative to the pose that the body placements describe; ball and free joints have absolute ones."""
    return sub(q, prepared.coordinate_reference)  # type: ignore[return-value]
