"""Linear equations with the structure of optimal control, by Riccati's recursion: the cost is linear in the number of stages."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.scipy.linalg import cho_solve
from jaxtyping import Array, Bool, Float

from kanejax._optimal_control.products import product


class Quadratic(NamedTuple):
    """Curvature of a cost by state and control of each stage, of the final cost, and the derivatives of the next states."""

    hessian: Float[Array, "N nx+nw nx+nw"]
    final: Float[Array, "nx nx"]
    next: Float[Array, "N nx nx+nw"]


class Slopes(NamedTuple):
    """Gradients of the stages' costs and of the final one, and by how much states are to jump between stages."""

    stage: Float[Array, "N nx+nw"]
    final: Float[Array, " nx"]
    gap: Float[Array, "N nx"]


class Step(NamedTuple):
    """Changes of states and controls, and the multipliers of the next states.

    Attributes:
        x: of the states.
        w: of the controls.
        multiplier: of next[k] v[k] + gap[k] - x[k + 1] in the Lagrangian.
        gains: of the controls by the states: the change of w is gains @ (change of x) and what does not depend on x.
        is_minimum: whether the curvature is positive in all directions that the next states leave.
    """

    x: Float[Array, "N+1 nx"]
    w: Float[Array, "N nw"]
    multiplier: Float[Array, "N nx"]
    gains: Float[Array, "N nw nx"]
    is_minimum: Bool[Array, ""]


def minimizer(quadratic: Quadratic, slopes: Slopes, extra: float | jax.Array = 0.0) -> Step:
    """Minimise the sum of 1/2 v' hessian v + stage . v with v = (x, w), where x[k + 1] = next[k] v[k] + gap[k].

    The value of all that follows a node, 1/2 x' P x + p . x, is found from the last node to the first. The first state is free:
    curvature has to hold it.

    Args:
        quadratic: curvatures, and the derivatives of the next states.
        slopes: gradients and jumps.
        extra: curvature that is added in all directions.

    Returns:
        The step, which means nothing where it is not a minimum.
    """
    nx, own = quadratic.final.shape[0], quadratic.hessian.shape[1]
    more = extra * jnp.eye(own, own + 1, dtype=quadratic.final.dtype)
    # The slope is one more column, and all stages' are joined at once: small arrays cost their number, not their size.
    sides = jnp.concatenate((quadratic.hessian, slopes.stage[..., None]), -1)

    def backwards(value: tuple, stage: tuple) -> tuple:
        matrix, vector, fine = value
        side, jacobian, gap = stage
        moved = product(matrix, gap) + vector
        pulled = product(jacobian.T, jnp.concatenate((product(matrix, jacobian), moved[:, None]), 1))
        side, is_positive = _eliminated(side + more + pulled, nx)
        # Rounding would make it less and less symmetric.
        before = 0.5 * (side[:nx, :nx] + side[:nx, :nx].T), side[:nx, own]
        return (*before, fine & is_positive), (matrix, vector, -side[nx:, :nx], -side[nx:, own])

    start = (quadratic.final + more[:nx, :nx], slopes.final, jnp.array(True))
    (matrix, vector, fine), found = lax.scan(backwards, start, (sides, quadratic.next, slopes.gap), reverse=True)
    matrices, vectors, gains, offsets = found
    factor = jnp.linalg.cholesky(matrix, symmetrize_input=False)
    first = -cho_solve((factor, True), vector)

    def forwards(x: jax.Array, stage: tuple) -> tuple:
        gain, offset, jacobian, gap = stage
        w = product(gain, x) + offset
        after = product(jacobian, jnp.concatenate((x, w))) + gap
        return after, (after, w)

    _, (after, w) = lax.scan(forwards, first, (gains, offsets, quadratic.next, slopes.gap))
    multiplier = jnp.einsum("kij,kj->ki", matrices, after, precision="highest") + vectors
    fine = fine & jnp.all(jnp.isfinite(factor))
    return Step(jnp.concatenate((first[None], after)), w, multiplier, gains, fine)


def _eliminated(side: Float[Array, "own own+1"], nx: int) -> tuple[Float[Array, "own own+1"], Bool[Array, ""]]:
    """Controls eliminated from the equations of a stage: their rows become those of x in the law of control, with the other sign.

    One pivot after another, without exchanging any, which positive curvature allows: a call of LAPACK takes longer than all of it.
    """
    is_positive = jnp.array(True)
    for k in range(nx, len(side)):
        pivot, column = side[k, k], side[:, k]
        row = side[k] / pivot
        side = (side - column[:, None] * row[None]).at[k].set(row)
        is_positive = is_positive & (pivot > 0)
    return side, is_positive
