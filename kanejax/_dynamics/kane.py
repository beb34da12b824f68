"""Kane's equations in their explicit form, body by body: the reference for the recursions, and for reading.

F_r + F*_r = 0, where the generalized active forces F_r and the generalized inertia forces F*_r are sums over the bodies of
dot products with partial velocities. Written with arrays; the cost grows with the product of bodies and speeds squared.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._evaluate import check_state
from kanejax._kinematics.change_of_speeds import (
    chosen_forces,
    chosen_mass_matrix,
    chosen_partial_rates,
    chosen_partials,
    own_motion,
    product,
)
from kanejax._kinematics.partial_velocity import PartialVelocities, partial_velocities, partial_velocity_rates
from kanejax._kinematics.pose import poses
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds, own
from kanejax._model.model import Model
from kanejax._model.specialized import whole
from kanejax._types import Coordinates, Forces, Speeds


class KaneEquations(NamedTuple):
    """The terms of F u_dot + Z = K + tau, Nie (3.56), at one state; with W^T tau for tau in chosen speeds, see `with_speeds`.

    Attributes:
        partial: partial (angular) velocities of the bodies, Nie (3.12), (3.26).
        rates: their time derivatives, Nie (3.13), (3.31)-(3.34).
        mass_matrix: F, rotor inertias included.
        inertia_remainder: Z, the part of minus F*_r without u_dot, Nie (3.57).
        gravity_force: K, the generalized active force of gravity, Nie (3.54).
    """

    partial: PartialVelocities
    rates: PartialVelocities
    mass_matrix: Float[Array, "nv nv"]
    inertia_remainder: Forces
    gravity_force: Forces


def kane_equations(model: AnyModel, q: Coordinates, u: Speeds) -> KaneEquations:
    """Form Kane's equations from partial velocities, body by body.

    Equal to what `mass_matrix`, `bias_force` and `gravity_force` accumulate tip to base:
    `bias_force` is `inertia_remainder` less `gravity_force`.

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds.

    Returns:
        The terms, and the partial velocities of which they are made.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q, u=u)
    if isinstance(model, WithSpeeds):
        return _in_chosen_speeds(model, q, u)
    model = whole(model)
    partial = partial_velocities(model, q)
    rates = partial_velocity_rates(model, q, u)
    inertia = world_inertia(model, q)
    w = jnp.einsum("kri,r->ki", partial.angular, u)
    # (3.37) and (3.43): accelerations at u_dot = 0.
    alpha = jnp.einsum("kri,r->ki", rates.angular, u)
    a = jnp.einsum("kri,r->ki", rates.linear, u)
    force = model.mass[:, None] * a
    moment = jnp.einsum("kij,kj->ki", inertia, alpha) + jnp.cross(w, jnp.einsum("kij,kj->ki", inertia, w))
    weight = model.mass[:, None] * model.gravity[None, :]
    return KaneEquations(
        partial,
        rates,
        jnp.einsum("kri,kij,ksj->rs", partial.angular, inertia, partial.angular)
        + jnp.einsum("kri,k,ksi->rs", partial.linear, model.mass, partial.linear)
        + jnp.diag(model.armature),
        jnp.einsum("kri,ki->r", partial.angular, moment) + jnp.einsum("kri,ki->r", partial.linear, force),
        jnp.einsum("kri,ki->r", partial.linear, weight),
    )


def _in_chosen_speeds(model: WithSpeeds, q: Coordinates, u: Speeds) -> KaneEquations:
    """The same in chosen speeds; what changes while these stand still belongs to the remainder Z."""
    rates, rates_dot = own_motion(model, q, u, jnp.zeros_like(u))
    equations = kane_equations(model.model, q, rates)
    partial = PartialVelocities(*chosen_partials(model, q, *equations.partial))
    turning = PartialVelocities(*chosen_partial_rates(model, q, u, *zip(equations.partial, equations.rates, strict=True)))
    remainder = equations.inertia_remainder + product(equations.mass_matrix, rates_dot)
    return KaneEquations(
        partial,
        turning,
        chosen_mass_matrix(model, q, equations.mass_matrix),
        chosen_forces(model, q, remainder),
        chosen_forces(model, q, equations.gravity_force),
    )


def world_inertia(model: Model, q: Coordinates) -> Float[Array, "nbody 3 3"]:
    """Central inertia of each body in world axes; the symmetric part of the model's leaf."""
    rotation = poses(model, q).rotation
    central = 0.5 * (model.central_inertia + jnp.swapaxes(model.central_inertia, 1, 2))
    return jnp.einsum("kij,kjl,kml->kim", rotation, central, rotation, precision="highest")
