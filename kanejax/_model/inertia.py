"""The ten inertia parameters of a body, in which the equations of motion are linear, and back to mass, centre and inertia."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._model.model import Model

NAMES = ("m", "mcx", "mcy", "mcz", "Ixx", "Iyy", "Izz", "Ixy", "Ixz", "Iyz")
# Rows and columns of the six numbers of a symmetric matrix, in the order of the names.
ROWS, COLUMNS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)

InertiaParameters = Float[Array, "*bodies 10"]


def inertia_parameters(model: Model) -> Float[Array, "nbody 10"]:
    """The inertia parameters of each body: m, mcx, mcy, mcz, Ixx, Iyy, Izz, Ixy, Ixz, Iyz.

    In the body's axes and about the origin of its frame, not about the mass centre: so generalized forces are linear in them.

    Args:
        model: the mechanism.

    Returns:
        [kg], [kg m], [kg m^2].
    """
    mass, com = model.mass, model.com
    central = 0.5 * (model.central_inertia + jnp.swapaxes(model.central_inertia, -1, -2))
    return jnp.concatenate((mass[:, None], mass[:, None] * com, six(central + _point_inertia(mass, com))), -1)


def with_inertia_parameters(model: Model, parameters: Float[Array, "nbody 10"]) -> Model:
    """The model with the bodies' mass, mass centre and central inertia from `inertia_parameters`.

    A body without mass keeps its mass centre, and has no first moment whatever `parameters` say. Nothing is checked, see
    `check_model`.

    Args:
        model: the mechanism.
        parameters: in the order of `inertia_parameters`.

    Returns:
        The changed model.
    """
    mass, first = parameters[:, 0], parameters[:, 1:4]
    massless = mass == 0
    com = jnp.where(massless[:, None], model.com, first / jnp.where(massless, 1.0, mass)[:, None])
    central = symmetric(parameters[:, 4:]) - _point_inertia(mass, com)
    return eqx.tree_at(lambda m: (m.mass, m.com, m.central_inertia), model, (mass, com, central))


def second_moment(parameters: InertiaParameters) -> Float[Array, "*bodies 3 3"]:
    """Sum of m r r^T about the origin, from the inertia there: tr(I) / 2 - I."""
    inertia = symmetric(parameters[..., 4:])
    half_trace = 0.5 * jnp.sum(parameters[..., 4:7], -1)
    return half_trace[..., None, None] * _ones(inertia) - inertia


def six(matrix: Float[Array, "*bodies 3 3"]) -> Float[Array, "*bodies 6"]:
    """Entries xx, yy, zz, xy, xz, yz of a symmetric matrix."""
    return matrix[..., np.array(ROWS), np.array(COLUMNS)]


def symmetric(numbers: Float[Array, "*bodies 6"]) -> Float[Array, "*bodies 3 3"]:
    """The symmetric matrix with entries xx, yy, zz, xy, xz, yz."""
    return numbers[..., np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])]


def _point_inertia(mass: Float[Array, " nbody"], com: Float[Array, "nbody 3"]) -> Float[Array, "nbody 3 3"]:
    """Inertia of the whole mass at its centre about the origin: m (c^2 - c c^T)."""
    outer = com[:, :, None] * com[:, None, :]
    squared = jnp.trace(outer, axis1=-2, axis2=-1)
    return mass[:, None, None] * (squared[:, None, None] * _ones(outer) - outer)


def _ones(like: Float[Array, "*bodies 3 3"]) -> Float[Array, "*bodies 3 3"]:
    return jnp.broadcast_to(jnp.eye(3, dtype=like.dtype), like.shape)
