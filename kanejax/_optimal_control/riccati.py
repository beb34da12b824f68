"""Linear equations with the structure of optimal control, by Riccati's recursion: the cost is linear in the number of stages."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.scipy.linalg import cho_solve, solve_triangular
from jaxtyping import Array, Bool, Float


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


def minimizer(quadratic: Quadratic, slopes: Slopes) -> Step:
    """Minimise the sum of 1/2 v' hessian v + stage . v with v = (x, w), where x[k + 1] = next[k] v[k] + gap[k].

    The value of all that follows a node, 1/2 x' P x + p . x, is found from the last node to the first; where the curvature is not
    positive, numbers are not finite. The first state is free: curvature has to hold it.
    """
    nx = quadratic.final.shape[0]

    def backwards(value: tuple, stage: tuple) -> tuple:
        matrix, vector, fine = value
        hessian, slope, jacobian, gap = stage
        curvature = hessian + _times(jacobian.T, _times(matrix, jacobian))
        slope = slope + _times(jacobian.T, _times(matrix, gap) + vector)
        factor = jnp.linalg.cholesky(curvature[nx:, nx:], symmetrize_input=False)
        known = jnp.concatenate((curvature[nx:, :nx], slope[nx:, None]), 1)
        half = solve_triangular(factor, known, lower=True)
        law = -solve_triangular(factor, half, lower=True, trans=1)
        left = half[:, :nx]
        before = curvature[:nx, :nx] - _times(left.T, left)
        # Rounding would make it less and less symmetric.
        before = 0.5 * (before + before.T), slope[:nx] - _times(left.T, half[:, nx])
        return (*before, fine & jnp.all(jnp.isfinite(factor))), (matrix, vector, law)

    start = (quadratic.final, slopes.final, jnp.array(True))
    stages = (quadratic.hessian, slopes.stage, quadratic.next, slopes.gap)
    (matrix, vector, fine), (matrices, vectors, laws) = lax.scan(backwards, start, stages, reverse=True)
    factor = jnp.linalg.cholesky(matrix, symmetrize_input=False)
    first = -cho_solve((factor, True), vector)

    def forwards(x: jax.Array, stage: tuple) -> tuple:
        law, jacobian, gap, matrix, vector = stage
        w = _times(law[:, :nx], x) + law[:, nx]
        after = _times(jacobian, jnp.concatenate((x, w))) + gap
        return after, (x, w, _times(matrix, after) + vector)

    last, (x, w, multiplier) = lax.scan(forwards, first, (laws, quadratic.next, slopes.gap, matrices, vectors))
    fine = fine & jnp.all(jnp.isfinite(factor))
    return Step(jnp.concatenate((x, last[None])), w, multiplier, laws[..., :nx], fine)


def _times(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.matmul(a, b, precision="highest")
