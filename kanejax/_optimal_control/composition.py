"""Second derivatives of a stage that is made of a costly function and cheap ones around it, by the chain rule."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._optimal_control.stages import Expansion, StageValues, expansion

# Values of the costly function -> the slope of what it serves.
Weigh = Callable[[jax.Array], jax.Array]


class Curved(NamedTuple):
    """A function of z, and the second derivatives of its weighted sum.

    Attributes:
        value: of the function.
        jacobian: its derivatives.
        curvature: second derivatives of the sum of its values, with the weights at this value.
    """

    value: Float[Array, " ny"]
    jacobian: Float[Array, "ny nz"]
    curvature: Float[Array, "nz nz"]


def composed_expansion(
    outer: Callable[[jax.Array, jax.Array], StageValues],
    arguments: Callable[[jax.Array], jax.Array],
    inner: Callable[[Weigh], Curved],
    v: Float[Array, " own"],
    weights: StageValues,
) -> Expansion:
    """The expansion of outer(v, y) with y = inner(arguments(v)), where the inner function differentiates itself.

    The outer functions are differentiated with the inner one made linear; its curvature is added apart.

    Args:
        outer: of state and control, and of what the inner function gives.
        arguments: of the inner function.
        inner: at arguments(v).
        v: state and control.
        weights: of the values in the Lagrangian.
    """
    z, pull_back = jax.vjp(arguments, v)

    def weigh(y: jax.Array) -> jax.Array:
        return jax.vjp(lambda y: outer(v, y), y)[1](weights)[0]

    found = inner(weigh)

    def linear(v: jax.Array) -> StageValues:
        return outer(v, found.value + jnp.matmul(found.jacobian, arguments(v) - z, precision="highest"))

    def pulled(rows: jax.Array) -> jax.Array:
        return jax.vmap(lambda row: pull_back(row)[0])(rows)

    around = expansion(linear, v, weights)
    return around._replace(hessian=around.hessian + pulled(pulled(found.curvature).T))


def chained_expansion(
    chain: Callable[[jax.Array, jax.Array], tuple[StageValues, jax.Array]],
    evaluations: Any,
    curvature: Callable[[Any, jax.Array], jax.Array],
    v: Float[Array, " own"],
    shape: tuple[int, ...],
    weights: StageValues,
) -> Expansion:
    """The expansion of a stage that asks for a costly function several times, each time where the answers before have led.

    Args:
        chain: function of v and of what is added to the answers, with the costly function made linear: values, and the arguments of
            all evaluations, (count, nz).
        evaluations: what is known of each.
        curvature: of the costly function at one of them, from weights of its answer.
        v: state and control.
        shape: of all answers.
        weights: of the values in the Lagrangian.
    """
    nothing = jnp.zeros(shape, v.dtype)
    adjoint = jax.vjp(lambda added: chain(v, added)[0], nothing)[1](weights)[0]
    curved = jax.vmap(curvature)(evaluations, adjoint)
    around = expansion(lambda v: chain(v, nothing)[0], v, weights)
    moved = jax.jacfwd(lambda v: chain(v, nothing)[1])(v)
    pressed = jnp.einsum("izy,iyx->izx", curved, moved, precision="highest")
    inside = jnp.einsum("izv,izx->vx", moved, pressed, precision="highest")
    return around._replace(hessian=around.hessian + inside)
