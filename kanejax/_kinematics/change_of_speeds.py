"""From a model's own speeds to chosen ones and back: u = Y(q, t) rates + Z(q, t), Nie (2.13), and its time derivative."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from kanejax._evaluate import check_state
from kanejax._kinematics.coordinate_rates import coordinate_rates, unit_quaternions
from kanejax._model.generalized_speeds import SpeedTerms, WithSpeeds
from kanejax._types import Coordinates, Forces, Speeds


def speeds_from_rates(model: WithSpeeds, q: Coordinates, rates: Speeds) -> Speeds:
    """The chosen speeds, Nie (2.13), from the model's own: from q_dot, but for ball and free joints.

    Args:
        model: what `with_speeds` returns.
        q: generalized coordinates.
        rates: the model's own speeds, (nv,).

    Returns:
        u.

    Raises:
        ValueError: a shape or data type does not fit, or the chosen speeds do not determine the motion at q; values are looked at
            outside of jit and vmap only.
    """
    check_state(model.model, q=q, rates=rates)
    check_regular(model, q)
    return chosen_speeds(model, q, rates)


def rates_from_speeds(model: WithSpeeds, q: Coordinates, u: Speeds) -> Speeds:
    """The model's own speeds from the chosen ones, as Nie (2.19) from (2.18); the inverse of `speeds_from_rates`.

    Args:
        model: what `with_speeds` returns.
        q: generalized coordinates.
        u: the chosen speeds.

    Returns:
        The model's own speeds.

    Raises:
        ValueError: as `speeds_from_rates` does.
    """
    check_state(model.model, q=q, u=u)
    check_regular(model, q)
    return own_speeds(model, q, u)


def speed_conditioning(model: WithSpeeds, q: Coordinates) -> Float[Array, ""]:
    """How well the chosen speeds determine the motion: the reciprocal condition number of Y, with the sign of its determinant.

    1 or -1 at best. It is zero where the chosen speeds are singular, as those of Nie (2.18) are at q2 = 0 and pi, and it changes
    sign where a motion crosses such a place. What is computed from the speeds loses as many digits as this has zeros.

    Args:
        model: what `with_speeds` returns.
        q: generalized coordinates.

    Returns:
        A number from -1 to 1.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(model.model, q=q)
    return _conditioning(model, q)


@eqx.filter_jit
def _conditioning(model: WithSpeeds, q: Coordinates) -> Float[Array, ""]:
    matrix = speed_terms(model, q).matrix
    singular_values = jnp.linalg.svd(matrix, compute_uv=False)
    return jnp.sign(jnp.linalg.det(matrix)) * singular_values[-1] / singular_values[0]


def check_regular(model: WithSpeeds, q: Coordinates, name: str = "q") -> None:
    """Check that Y can be inverted, where its value is known.

    Raises:
        ValueError: it cannot, to rounding errors.
    """
    conditioning = speed_conditioning(model, q)
    if isinstance(conditioning, Tracer):
        return
    if not np.abs(conditioning) > 10 * model.nv * jnp.finfo(model.dtype).eps:
        raise ValueError(
            f"the chosen speeds do not determine the motion at {name} = {np.asarray(q)}: the reciprocal condition number of their "
            f"matrix is {abs(float(conditioning)):.3g}; choose other speeds, or stay away from this configuration"
        )


def speed_terms(model: WithSpeeds, q: Coordinates) -> SpeedTerms:
    """Y and Z; the choice sees quaternions of unit length."""
    return model.speeds.terms(model.model, unit_quaternions(model.tree, q), model.t)


def speed_term_rates(model: WithSpeeds, q: Coordinates, rates: Speeds) -> tuple[SpeedTerms, SpeedTerms]:
    """Y and Z, and their time derivatives along the motion with the model's own speeds `rates`."""
    along = (coordinate_rates(model.model, q, rates), jnp.ones_like(model.t))
    return jax.jvp(lambda q, t: speed_terms(model.at(t), q), (q, model.t), along)


def chosen_speeds(model: WithSpeeds, q: Coordinates, rates: Speeds) -> Speeds:
    """Y rates + Z."""
    matrix, drift = speed_terms(model, q)
    return product(matrix, rates) + drift


def own_speeds(model: WithSpeeds, q: Coordinates, u: Speeds) -> Speeds:
    """W (u - Z), with W the inverse of Y."""
    matrix, drift = speed_terms(model, q)
    return jnp.linalg.solve(matrix, u - drift)


def chosen_accelerations(model: WithSpeeds, q: Coordinates, rates: Speeds, rates_dot: Speeds) -> Speeds:
    """u_dot from the model's own speeds and their rates: Y rates_dot + Y_dot rates + Z_dot."""
    (matrix, _), (matrix_rate, drift_rate) = speed_term_rates(model, q, rates)
    return product(matrix, rates_dot) + product(matrix_rate, rates) + drift_rate


def own_motion(model: WithSpeeds, q: Coordinates, u: Speeds, u_dot: Speeds) -> tuple[Speeds, Speeds]:
    """The model's own speeds and their rates."""
    rates = own_speeds(model, q, u)
    (matrix, _), (matrix_rate, drift_rate) = speed_term_rates(model, q, rates)
    return rates, jnp.linalg.solve(matrix, u_dot - product(matrix_rate, rates) - drift_rate)


def chosen_forces(model: WithSpeeds, q: Coordinates, forces: Forces) -> Forces:
    """W^T forces: generalized forces of the chosen speeds from those of the model's own, which do the same work."""
    return jnp.linalg.solve(speed_terms(model, q).matrix.T, forces)


def chosen_mass_matrix(model: WithSpeeds, q: Coordinates, mass_matrix: Float[Array, "nv nv"]) -> Float[Array, "nv nv"]:
    """W^T F W, symmetric to rounding errors."""
    inverse = jnp.linalg.inv(speed_terms(model, q).matrix)
    return product(inverse.T, product(mass_matrix, inverse))


def chosen_partials(model: WithSpeeds, q: Coordinates, *partials: Float[Array, "nbody nv 3"]) -> list[Float[Array, "nbody nv 3"]]:
    """Partial velocities of the chosen speeds from those of the model's own, any number of them: columns times W."""
    inverse = jnp.linalg.inv(speed_terms(model, q).matrix)
    return [_by_speed(partial, inverse) for partial in partials]


def chosen_partial_rates(
    model: WithSpeeds, q: Coordinates, u: Speeds, *pairs: tuple[Float[Array, "nbody nv 3"], Float[Array, "nbody nv 3"]]
) -> list[Float[Array, "nbody nv 3"]]:
    """Their time derivatives, from pairs of partial velocities of the model's own speeds and time derivatives of these."""
    (matrix, _), (matrix_rate, _) = speed_term_rates(model, q, own_speeds(model, q, u))
    inverse = jnp.linalg.inv(matrix)
    inverse_rate = -product(inverse, product(matrix_rate, inverse))
    return [_by_speed(rate, inverse) + _by_speed(partial, inverse_rate) for partial, rate in pairs]


def _by_speed(partial: jax.Array, matrix: jax.Array) -> jax.Array:
    return jnp.einsum("kri,rs->ksi", partial, matrix, precision="highest")


def product(matrix: jax.Array, x: jax.Array) -> jax.Array:
    """Matrix product at full precision on every device."""
    return jnp.matmul(matrix, x, precision="highest")
