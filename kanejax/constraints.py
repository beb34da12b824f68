"""Constraints on a motion: distances of spheres, and poses of a body to arrive at or to keep."""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from kanejax._kinematics.pose import poses
from kanejax._optimize.body_point import BodyPoint, Vector
from kanejax._optimize.moment import Constraint, Moment

__all__ = ["Constraint", "direction", "plane_clearance", "position", "sphere_clearance"]


@final
class _Position(eqx.Module):
    point: BodyPoint

    def __call__(self, model: Any, at: Moment) -> Float[Array, "3"]:
        return self.point.place(model, at.q)


def position(
    body: str,
    target: Vector,
    point: Vector = (0.0, 0.0, 0.0),
    *,
    tolerance: ArrayLike = 0.0,
    at_end: bool = True,
) -> Constraint:
    """A point of a body is at a target, in world axes.

    Args:
        body: that the point is fixed in.
        target: where it is to be [m].
        point: in the body's frame.
        tolerance: by how much each component may differ; 0 makes equations.
        at_end: at the end of the motion only.
    """
    middle, room = jnp.asarray(target), jnp.broadcast_to(jnp.asarray(tolerance), (3,))
    name = f"position of {body}"
    return Constraint(_Position(BodyPoint(jnp.asarray(point), body)), middle - room, middle + room, name=name, at_end=at_end)


@final
class _Direction(eqx.Module):
    target: Float[Array, "3"]
    axis: Float[Array, "3"]
    body: str = eqx.field(static=True)

    def __call__(self, model: Any, at: Moment) -> Float[Array, "1"]:
        rotation = poses(model, at.q).rotation[model.tree.body(self.body)]
        pointing = jnp.sum(rotation * _unit(self.axis.astype(at.q.dtype))[None], -1)
        return jnp.sum(pointing * _unit(self.target.astype(at.q.dtype)))[None]


def direction(
    body: str,
    target: Vector,
    axis: Vector = (0.0, 0.0, 1.0),
    *,
    angle: ArrayLike,
    at_end: bool = True,
) -> Constraint:
    """An axis of a body points along a target direction to within an angle.

    Args:
        body: that the axis is fixed in.
        target: direction in world axes.
        axis: direction in the body's frame.
        angle: greatest between the two [rad].
        at_end: at the end of the motion only.
    """
    function = _Direction(jnp.asarray(target), jnp.asarray(axis), body)
    return Constraint(function, jnp.cos(jnp.asarray(angle)), jnp.inf, name=f"direction of {body}", at_end=at_end)


@final
class _Distance(eqx.Module):
    """Squared distance of two points over a length, of which the square root has no slope where they meet."""

    first: BodyPoint
    second: Any

    def __call__(self, model: Any, at: Moment) -> Float[Array, "1"]:
        is_moving = isinstance(self.second, BodyPoint)
        other = self.second.place(model, at.q) if is_moving else self.second.astype(at.q.dtype)
        return jnp.sum((self.first.place(model, at.q) - other) ** 2)[None]


def sphere_clearance(
    body: str,
    radius: ArrayLike,
    obstacle: Vector | str,
    obstacle_radius: ArrayLike,
    *,
    center: Vector = (0.0, 0.0, 0.0),
    obstacle_center: Vector = (0.0, 0.0, 0.0),
    name: str | None = None,
) -> Constraint:
    """A sphere fixed in a body stays clear of another, fixed in the world or in another body.

    Args:
        body: that carries the sphere.
        radius: of the sphere [m].
        obstacle: centre of the other sphere in world axes, or the name of the body that carries it.
        obstacle_radius: of the other sphere [m].
        center: of the sphere in its body's frame.
        obstacle_center: of the other in its body's frame, if it has one.
        name: for results and errors.
    """
    second = BodyPoint(jnp.asarray(obstacle_center), obstacle) if isinstance(obstacle, str) else jnp.asarray(obstacle)
    least = (jnp.asarray(radius) + jnp.asarray(obstacle_radius)) ** 2
    other = obstacle if isinstance(obstacle, str) else "an obstacle"
    function = _Distance(BodyPoint(jnp.asarray(center), body), second)
    return Constraint(function, least, jnp.inf, name=name or f"clearance of {body} from {other}")


@final
class _Height(eqx.Module):
    center: BodyPoint
    normal: Float[Array, "3"]

    def __call__(self, model: Any, at: Moment) -> Float[Array, "1"]:
        return jnp.sum(self.center.place(model, at.q) * _unit(self.normal.astype(at.q.dtype)))[None]


def plane_clearance(
    body: str,
    radius: ArrayLike,
    normal: Vector = (0.0, 0.0, 1.0),
    offset: ArrayLike = 0.0,
    *,
    center: Vector = (0.0, 0.0, 0.0),
    name: str | None = None,
) -> Constraint:
    """A sphere fixed in a body stays on the side of a plane to which its normal points.

    Args:
        body: that carries the sphere.
        radius: of the sphere [m].
        normal: of the plane, of any length, in world axes.
        offset: of the plane from the origin along its normal [m].
        center: of the sphere in its body's frame.
        name: for results and errors.
    """
    function = _Height(BodyPoint(jnp.asarray(center), body), jnp.asarray(normal))
    least = jnp.asarray(radius) + jnp.asarray(offset)
    return Constraint(function, least, jnp.inf, name=name or f"clearance of {body} from a plane")


def _unit(vector: jax.Array) -> jax.Array:
    return vector / jnp.sqrt(jnp.sum(vector * vector))
