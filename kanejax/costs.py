"""Terms of the cost of a motion, of which a task has one or several: `(kanejax.costs.torque(), kanejax.costs.duration(40.0))`."""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from kanejax._kinematics.coordinate_rates import coordinate_rates
from kanejax._optimize.body_point import BodyPoint, Vector
from kanejax._optimize.moment import Cost, Moment

__all__ = ["Cost", "acceleration", "duration", "energy", "jerk", "manipulability", "speed", "torque", "torque_rate", "tracking"]


@final
class _Squares(eqx.Module):
    """Weighted sum of the squares of a field of the moment."""

    weights: Float[Array, " *nv"]
    field: str = eqx.field(static=True)

    def __call__(self, model: Any, at: Moment) -> Float[Array, ""]:
        """At one moment."""
        return jnp.sum(self.weights * getattr(at, self.field) ** 2)


def torque(weights: ArrayLike = 1.0) -> Cost:
    """Integral of the squared forces at the joints [(N m)^2 s]; weights, one for all or (nv,).

    Args:
        weights: one for all, or (nv,), in the order of the speeds.

    Returns:
        The term, for the costs of a `MotionTask`, alone or among others.
    """
    return Cost(_Squares(jnp.asarray(weights, float), "tau"), name="torque")


def torque_rate(weights: ArrayLike = 1.0) -> Cost:
    """Integral of the squared change of the forces a unit of time [(N m)^2 / s].

    Args:
        weights: one for all, or (nv,), in the order of the speeds.

    Returns:
        The term, for the costs of a `MotionTask`, alone or among others.
    """
    return Cost(_Squares(jnp.asarray(weights, float), "tau_rate"), name="torque_rate", needs=("tau_rate",))


def speed(weights: ArrayLike = 1.0) -> Cost:
    """Integral of the squared speeds.

    Args:
        weights: one for all, or (nv,), in the order of the speeds.

    Returns:
        The term, for the costs of a `MotionTask`, alone or among others.
    """
    return Cost(_Squares(jnp.asarray(weights, float), "u"), name="speed")


def acceleration(weights: ArrayLike = 1.0) -> Cost:
    """Integral of the squared rates of the speeds.

    Args:
        weights: one for all, or (nv,), in the order of the speeds.

    Returns:
        The term, for the costs of a `MotionTask`, alone or among others.
    """
    return Cost(_Squares(jnp.asarray(weights, float), "u_dot"), name="acceleration")


def jerk(weights: ArrayLike = 1.0) -> Cost:
    """Integral of the squared change of u_dot a unit of time.

    Args:
        weights: one for all, or (nv,), in the order of the speeds.

    Returns:
        The term, for the costs of a `MotionTask`, alone or among others.
    """
    return Cost(_Squares(jnp.asarray(weights, float), "jerk"), name="jerk", needs=("jerk",))


def duration(weight: ArrayLike = 1.0) -> Cost:
    """The duration [s] of the motion, where it is sought.

    Args:
        weight: factor.

    Returns:
        The term, for the costs of a `MotionTask`, alone or among others.
    """
    return Cost(_end_time, weight, name="duration", at_end=True)


def energy(weight: ArrayLike = 1.0, *, width: ArrayLike = 1.0) -> Cost:
    """Integral of the mechanical power of the joints, abs(tau u) [J], regenerating none.

    Args:
        weight: factor.
        width: power [W] below which abs is rounded, sqrt(power^2 + width^2) - width.

    Returns:
        The term, for the costs of a `MotionTask`, alone or among others.
    """
    return Cost(_Power(jnp.asarray(width, float)), weight, name="energy")


def tracking(q: Float[ArrayLike, "nodes nq"], duration: ArrayLike, weights: ArrayLike = 1.0) -> Cost:
    """Integral of the squared distance of the coordinates from those of a path, linear between its nodes.

    Args:
        q: coordinates at equally spaced times from the start to the end of the motion.
        duration: time [s] that the path takes.
        weights: one for all or (nq,).

    Returns:
        The term, for the costs of a `MotionTask`, alone or among others.
    """
    return Cost(_Tracking(*(jnp.asarray(each, float) for each in (q, duration, weights))), name="tracking")


def manipulability(body: str, point: Vector = (0.0, 0.0, 0.0), weight: ArrayLike = 1.0) -> Cost:
    """Integral of minus the logarithm of Yoshikawa's manipulability (1985) of a point's velocity, sqrt(det(J J')).

    Args:
        body: that the point is fixed in.
        point: in the body's frame.
        weight: factor.

    Returns:
        The term, for the costs of a `MotionTask`, alone or among others.
    """
    return Cost(_Manipulability(BodyPoint(jnp.asarray(point, float), body)), weight, name=f"manipulability of {body}")


def _end_time(model: Any, at: Moment) -> Float[Array, ""]:
    return at.t


@final
class _Power(eqx.Module):
    width: Float[Array, ""]

    def __call__(self, model: Any, at: Moment) -> Float[Array, ""]:
        power = at.tau * at.u
        return jnp.sum(jnp.sqrt(power**2 + self.width**2) - self.width)


@final
class _Tracking(eqx.Module):
    q: Float[Array, "nodes nq"]
    duration: Float[Array, ""]
    weights: Float[Array, " *nq"]

    def __call__(self, model: Any, at: Moment) -> Float[Array, ""]:
        last = len(self.q) - 1
        place = jnp.clip(at.t / self.duration * last, 0.0, last)
        left = jnp.clip(jnp.floor(place).astype(int), 0, last - 1)
        share = place - left.astype(place.dtype)
        wanted = (1.0 - share) * self.q[left] + share * self.q[left + 1]
        return jnp.sum(self.weights * (at.q - wanted) ** 2)


@final
class _Manipulability(eqx.Module):
    point: BodyPoint

    def __call__(self, model: Any, at: Moment) -> Float[Array, ""]:
        """By the Jacobian with respect to the speeds."""

        def place(q: jax.Array) -> jax.Array:
            return self.point.place(model, q)

        moving = lambda u: jax.jvp(place, (at.q,), (coordinate_rates(model, at.q, u),))[1]  # noqa: E731
        jacobian = jax.vmap(moving)(jnp.eye(model.nv, dtype=at.q.dtype)).T
        return -0.5 * jnp.linalg.slogdet(jnp.matmul(jacobian, jacobian.T, precision="highest"))[1]
