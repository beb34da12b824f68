"""Forces and torques on bodies: what external ones contribute, and the reactions that Kane's method eliminates."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._dynamics.kane import world_inertia
from kanejax._evaluate import check_state
from kanejax._kinematics.partial_velocity import partial_velocities, partial_velocities_of_points, partial_velocity_rates
from kanejax._kinematics.pose import poses
from kanejax._model.model import Model
from kanejax._model.specialized import Specialized, whole
from kanejax._types import Coordinates, Forces, Speeds


class Wrenches(NamedTuple):
    """Forces and moments in world axes, one pair for each joint.

    Attributes:
        force: [N].
        moment: [N m] about the joint's anchor.
    """

    force: Float[Array, "n 3"]
    moment: Float[Array, "n 3"]


def external_force(
    model: Model | Specialized,
    q: Coordinates,
    force: Float[Array, "nbody 3"],
    moment: Float[Array, "nbody 3"],
    points: Float[Array, "nbody 3"] | None = None,
) -> Forces:
    """Generalized active force of wrenches on the bodies: sum_k (v_r^k . force_k + w_r^k . moment_k), Nie (2.55).

    Add it to the forces at the joints in `forward_dynamics`; subtract it from what `inverse_dynamics` returns.

    Args:
        model: the mechanism.
        q: generalized coordinates.
        force: on each body, in world axes [N].
        moment: on each body, in world axes [N m].
        points: where each force acts, in world axes [m]; the mass centres if left out, as in MuJoCo's `xfrc_applied`.

    Returns:
        Force [N] or torque [N m] on each speed.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(model, q=q)
    for name, value in (("force", force), ("moment", moment), ("points", points)):
        if value is not None and jnp.shape(value) != (model.nbody, 3):
            raise ValueError(f"{name} has shape {jnp.shape(value)}, but this model needs ({model.nbody}, 3) = (nbody, 3)")
    at = poses(model, q)
    partial = partial_velocities_of_points(model.tree, at, at.com if points is None else points)
    return jnp.einsum("kri,ki->r", partial.linear, force) + jnp.einsum("kri,ki->r", partial.angular, moment)


def joint_reactions(model: Model | Specialized, q: Coordinates, u: Speeds, u_dot: Speeds) -> Wrenches:
    """Wrench that each joint passes on to the link it moves, about the joint's anchor, in world axes, (njoint, 3) each.

    All of it: the part along the joint's axes, which `inverse_dynamics` returns (rotor inertias, springs, dampers and
    friction aside), and the part across, which does no work and which Kane's method leaves out. Newton's and Euler's laws for
    all bodies that the joint carries, with no external wrench.

    Args:
        model: the mechanism.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds.
        u_dot: their rates.

    Returns:
        The wrench on each link by what its joint hangs on.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(model, q=q, u=u, u_dot=u_dot)
    model = whole(model)
    tree, at = model.tree, poses(model, q)
    partial, rates = partial_velocities(model, q), partial_velocity_rates(model, q, u)
    inertia = world_inertia(model, q)
    w = jnp.einsum("kri,r->ki", partial.angular, u)
    alpha = jnp.einsum("kri,r->ki", partial.angular, u_dot) + jnp.einsum("kri,r->ki", rates.angular, u)
    a = jnp.einsum("kri,r->ki", partial.linear, u_dot) + jnp.einsum("kri,r->ki", rates.linear, u)
    force = model.mass[:, None] * (a - model.gravity[None, :])
    moment = jnp.einsum("kij,kj->ki", inertia, alpha) + jnp.cross(w, jnp.einsum("kij,kj->ki", inertia, w))
    first_speed = jnp.array(tree.v_start, dtype=int)
    carried = jnp.asarray(tree.body_moved_by.T, force.dtype)[first_speed]
    arm = at.com[None, :, :] - at.link_origin[:, None, :]
    about = jnp.cross(arm, force[None, :, :]) + moment[None, :, :]
    return Wrenches(carried @ force, jnp.einsum("jk,jki->ji", carried, about))
