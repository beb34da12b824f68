"""The regressor of the equations of motion: how forces at the joints depend on the inertia parameters of the bodies."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._dynamics.equations_of_motion import inverse_dynamics_kernel
from kanejax._evaluate import check_state, evaluate_prepared
from kanejax._model.inertia import second_moment
from kanejax._model.model import Model
from kanejax._model.prepared import Prepared, prepare
from kanejax._model.regroup import Moments
from kanejax._types import Coordinates, Speeds


def regressor(model: Model, q: Coordinates, u: Speeds, u_dot: Speeds) -> Float[Array, "nv nbody 10"]:
    """Derivative of `inverse_dynamics` with respect to the inertia parameters, in which it is linear.

    `inverse_dynamics(model, q, u, u_dot)` is the product with `inertia_parameters(model)`, plus what armature, springs, dampers and
    friction take. Exact: reverse mode through the recursion, once for each speed.

    Args:
        model: the mechanism; its mass, com and central_inertia do not matter.
        q: generalized coordinates.
        u: generalized speeds.
        u_dot: their rates.

    Returns:
        For each speed, body and parameter, in the order of `inertia_parameters`.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(model, q=q, u=u, u_dot=u_dot)
    zeros = jnp.zeros((model.nbody, 10), model.dtype)
    prepared = prepare_with(model, zeros)
    # How the links' parameters depend on the bodies': the same for all states.
    of_links = jax.jacfwd(lambda parameters: moments_of_links(prepare_with(model, parameters)))(zeros)

    def force(moments: tuple[jax.Array, ...]) -> jax.Array:
        mass, first, second = moments
        links = prepared.links._replace(mass=mass, first_moment=first, second_moment=second)
        return evaluate_prepared(inverse_dynamics_kernel, model.tree, prepared._replace(links=links), q, u, u_dot)

    by_links = jax.jacrev(force)(moments_of_links(prepared))
    parts = [_product(a, b, model.nv, zeros.size) for a, b in zip(by_links, of_links, strict=True)]
    return sum(parts[1:], parts[0]).reshape(model.nv, model.nbody, 10)


def prepare_with(model: Model, parameters: Float[Array, "nbody 10"]) -> Prepared:
    """What the recursions need of a model, with other inertia parameters; linear in them."""
    moments = Moments(parameters[:, 0], parameters[:, 1:4], second_moment(parameters))
    return prepare(model, moments=moments)


def moments_of_links(prepared: Prepared) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The part of the prepared parameters that depends on the inertia parameters."""
    links = prepared.links
    return jnp.asarray(links.mass), jnp.asarray(links.first_moment), jnp.asarray(links.second_moment)


def _product(by_links: jax.Array, of_links: jax.Array, nv: int, size: int) -> jax.Array:
    count = int(np.prod(by_links.shape[1:]))
    return jnp.matmul(by_links.reshape(nv, count), of_links.reshape(count, size), precision="highest")
