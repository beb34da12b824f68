"""Kane's partial velocities of every body and their rates: the ingredients of his equations, made visible.

Written with arrays, for reading; the recursions of `_dynamics` never form them. The partial angular velocity w_r of a body
is what multiplies u_r in its angular velocity, the partial velocity v_r what multiplies u_r in the velocity of its mass centre,
Nie (3.10)-(3.34). All vectors have world components.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._evaluate import check_state
from kanejax._kinematics.change_of_speeds import chosen_partial_rates, chosen_partials, own_speeds
from kanejax._kinematics.pose import Poses, poses
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds, own
from kanejax._model.tree import Tree
from kanejax._types import Coordinates, Speeds


class Axes(NamedTuple):
    """Along what each generalized speed moves its own link: angular velocity, and velocity of the link's origin."""

    angular: Float[Array, "nv 3"]
    linear: Float[Array, "nv 3"]


class PartialVelocities(NamedTuple):
    """Partial angular velocities, and partial velocities of the mass centres (or of given points), of all bodies.

    Attributes:
        angular: what multiplies each speed in a body's angular velocity.
        linear: what multiplies it in the velocity of the point.
    """

    angular: Float[Array, "nbody nv 3"]
    linear: Float[Array, "nbody nv 3"]


def partial_velocities(model: AnyModel, q: Coordinates) -> PartialVelocities:
    """Partial angular velocities and partial velocities of the mass centres, in world axes.

    `angular[k, r]` is Kane's w_r of body k [rad/s a unit of speed r], `linear[k, r]` his v_r of its mass centre.

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.

    Returns:
        Both, in world axes.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    if isinstance(model, WithSpeeds):
        return PartialVelocities(*chosen_partials(model, q, *partial_velocities(model.model, q)))
    at = poses(model, q)
    return partial_velocities_of_points(model.tree, at, at.com)


def partial_velocities_of_points(tree: Tree, at: Poses, points: Float[Array, "nbody 3"]) -> PartialVelocities:
    """The same for one point of each body, given in world axes."""
    axes = speed_axes(tree, at)
    moved = tree.body_moved_by[..., None]
    arm = points[:, None, :] - at.link_origin[tree.speed_joints][None, :, :]
    angular = jnp.where(moved, axes.angular[None, :, :], 0.0)
    return PartialVelocities(angular, jnp.where(moved, axes.linear[None, :, :], 0.0) + jnp.cross(angular, arm))


def partial_velocity_rates(model: AnyModel, q: Coordinates, u: Speeds) -> PartialVelocities:
    """Time derivatives, in the world frame, of `partial_velocities` along the motion, Nie (3.13) and (3.31)-(3.34).

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds.

    Returns:
        The rates of both, in world axes.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q, u=u)
    if isinstance(model, WithSpeeds):
        rates = partial_velocity_rates(model.model, q, own_speeds(model, q, u))
        pairs = zip(partial_velocities(model.model, q), rates, strict=True)
        return PartialVelocities(*chosen_partial_rates(model, q, u, *pairs))
    tree, at = model.tree, poses(model, q)
    axes = speed_axes(tree, at)
    joint = tree.speed_joints
    link_w, link_v = _link_velocities(tree, at, axes, u)
    # Axes are fixed in their links, but for the three of a floating base's velocity, which are fixed in the world.
    turning = np.array([not world for world in _world_axes(tree)])[:, None]
    angular_rate = jnp.cross(link_w[joint], axes.angular)
    linear_rate = jnp.where(turning, jnp.cross(link_w[joint], axes.linear), 0.0)
    moved = tree.body_moved_by[..., None]
    partial = partial_velocities_of_points(tree, at, at.com)
    body_v = jnp.einsum("krc,r->kc", partial.linear, u)
    arm = at.com[:, None, :] - at.link_origin[joint][None, :, :]
    arm_rate = body_v[:, None, :] - link_v[joint][None, :, :]
    angular = jnp.where(moved, angular_rate[None, :, :], 0.0)
    linear = jnp.where(moved, linear_rate[None, :, :], 0.0)
    return PartialVelocities(angular, linear + jnp.cross(angular, arm) + jnp.cross(partial.angular, arm_rate))


def speed_axes(tree: Tree, at: Poses) -> Axes:
    """The axis of motion of each generalized speed."""
    angular, linear = [], []
    still = jnp.zeros(3, at.link_origin.dtype)
    for joint, kind in enumerate(tree.joint_types):
        turn = at.link_rotation[joint]
        if kind == "free":
            linear += [*jnp.eye(3, dtype=turn.dtype), still, still, still]
            angular += [still, still, still, *turn.T]
        elif kind == "ball":
            linear += [still, still, still]
            angular += [*turn.T]
        else:
            angular.append(turn[:, 2] if kind == "revolute" else still)
            linear.append(still if kind == "revolute" else turn[:, 2])
    return Axes(jnp.stack(angular), jnp.stack(linear))


def _world_axes(tree: Tree) -> list[bool]:
    fixed: list[bool] = []
    for kind in tree.joint_types:
        fixed += {"free": [True] * 3 + [False] * 3, "ball": [False] * 3}.get(kind, [False])
    return fixed


def _link_velocities(tree: Tree, at: Poses, axes: Axes, u: Speeds) -> tuple[Float[Array, "nlink 3"], Float[Array, "nlink 3"]]:
    """Angular velocity and velocity of the origin of each link."""
    joint = tree.speed_joints
    moved = tree.link_ancestors[:, joint][..., None]
    arm = at.link_origin[:, None, :] - at.link_origin[joint][None, :, :]
    angular = jnp.where(moved, axes.angular[None, :, :], 0.0)
    linear = jnp.where(moved, axes.linear[None, :, :], 0.0) + jnp.cross(angular, arm)
    return jnp.einsum("krc,r->kc", angular, u), jnp.einsum("krc,r->kc", linear, u)
