"""Energies and momenta."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._dynamics.active_force import rotation_between
from kanejax._dynamics.inertia_force import inertia_force
from kanejax._dynamics.kane import world_inertia
from kanejax._evaluate import check_state, evaluate
from kanejax._kinematics.change_of_speeds import own_speeds
from kanejax._kinematics.partial_velocity import partial_velocities
from kanejax._kinematics.pose import poses
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds, own
from kanejax._model.model import Model
from kanejax._model.prepared import Prepared, displacement
from kanejax._model.specialized import Specialized, whole
from kanejax._model.tree import Tree
from kanejax._types import Coordinates, Speeds


class Momentum(NamedTuple):
    """Linear and angular momentum of the whole mechanism, in world axes.

    Attributes:
        linear: momentum [kg m/s].
        angular: angular momentum [kg m^2/s] about the point that `momentum` was asked for.
    """

    linear: Float[Array, "3"]
    angular: Float[Array, "3"]


def kinetic_energy(model: AnyModel, q: Coordinates, u: Speeds) -> Float[Array, ""]:
    """U . F(q) u / 2 [J], rotor inertias included; MuJoCo's second entry of `energy`.

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds.

    Returns:
        The energy [J].

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q, u=u)
    if isinstance(model, WithSpeeds):
        return kinetic_energy(model.model, q, own_speeds(model, q, u))
    momentum = evaluate(_generalized_momentum, model, q, u)
    return 0.5 * jnp.dot(u, momentum, precision="highest")


def potential_energy(model: Model | Specialized, q: Coordinates) -> Float[Array, ""]:
    """Energy [J] of gravity, zero with all mass centres at the world's origin, and of springs; MuJoCo's first of `energy`.

    Args:
        model: the mechanism.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.

    Returns:
        The energy [J].

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(model, q=q)
    model = whole(model)
    heights = poses(model, q).com @ model.gravity
    return -jnp.dot(model.mass, heights, precision="highest") + spring_energy(model, q)


def spring_energy(model: Model | Specialized, q: Coordinates) -> Float[Array, ""]:
    """Energy [J] stored in the joints' springs: stiffness times the squared displacement, halved."""
    check_state(model, q=q)
    model = whole(model)
    tree, reference = model.tree, model.spring_reference
    (plain_v, plain_q), (turning_v, turning_q) = tree.plain_speeds, tree.turning_speeds
    along = model.stiffness[tree.speed_joints[plain_v]] * (q[plain_q] - reference[plain_q]) ** 2
    turn = rotation_between([reference[turning_q + i] for i in range(4)], [q[turning_q + i] for i in range(4)])
    about = model.stiffness[tree.speed_joints[turning_v]] * sum(x * x for x in turn)
    return 0.5 * (jnp.sum(along) + jnp.sum(about))


def momentum(model: AnyModel, q: Coordinates, u: Speeds, point: Float[Array, "3"] | None = None) -> Momentum:
    """Linear momentum, and angular momentum about `point` (the common mass centre if left out), in world axes.

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds.
        point: in world axes [m]; it does not move.

    Returns:
        Both momenta.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q, u=u)
    if isinstance(model, WithSpeeds):
        return momentum(model.model, q, own_speeds(model, q, u), point)
    model = whole(model)
    at, partial = poses(model, q), partial_velocities(model, q)
    w, v = jnp.einsum("kri,r->ki", partial.angular, u), jnp.einsum("kri,r->ki", partial.linear, u)
    linear = model.mass[:, None] * v
    about = center_of_mass(model, q) if point is None else point
    spin = jnp.einsum("kij,kj->ki", world_inertia(model, q), w)
    return Momentum(linear.sum(0), (jnp.cross(at.com - about[None, :], linear) + spin).sum(0))


def center_of_mass(model: Model | Specialized, q: Coordinates) -> Float[Array, "3"]:
    """Mass centre of all bodies [m], in world axes.

    Args:
        model: the mechanism.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.

    Returns:
        The point [m]; nan for a mechanism without mass.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    model = whole(model)
    return model.mass @ poses(model, q).com / model.mass.sum()


def _generalized_momentum(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array) -> jax.Array:
    """F(q) u, as the inertia force of accelerations u at rest."""
    still, weightless = jnp.zeros_like(u), (0.0, 0.0, 0.0)
    return inertia_force(tree, prepared.links, weightless, displacement(tree, prepared, q), still, u) + prepared.armature * u
