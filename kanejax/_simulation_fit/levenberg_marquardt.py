"""Steps of Gauss, Newton, Levenberg and Marquardt for multiple shooting.

The damping shortens a step in all unknowns: the parameters' steps are held by the lengths of their columns (Marquardt 1963), and of
what only the states of the pieces change, the share 1 / (1 + damping) is taken. Derivatives by free coordinates vanish near a
border: a number that one step took there would never come back. So numbers with bounds move as derivatives by the numbers say, and
no step goes farther than nine tenths of the way.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from kanejax._parameters.parameterization import Parameterization
from kanejax._simulation_fit.shooting import Linearization

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e9
# A step is taken if it lowers the cost by this share of what was promised.
_ENOUGH = 1e-4


class Proposal(NamedTuple):
    """A step.

    Attributes:
        theta: free coordinates after it.
        starts: states of the pieces after it.
        promised: by how much it lowers the cost, as it was linearised.
        slope: greatest cosine between the residuals and a column of the Jacobian.
    """

    theta: Float[Array, " m"]
    starts: Float[Array, "pieces nx"]
    promised: Float[Array, ""]
    slope: Float[Array, ""]


def proposal(
    parameterization: Parameterization, theta: jax.Array, starts: jax.Array, at: Linearization, damping: jax.Array
) -> Proposal:
    """The damped step from `theta` and `starts`, where the residuals were linearised."""
    columns, target = _system(parameterization, theta, at.factor)
    lengths = jnp.linalg.norm(columns, axis=0)
    scale = jnp.maximum(lengths, jnp.finfo(theta.dtype).eps * jnp.max(lengths, initial=1e-30))
    damped = jnp.concatenate((columns / scale[None], jnp.sqrt(damping) * jnp.eye(len(theta), dtype=theta.dtype)))
    limits = (limit * scale for limit in parameterization.step_limits(theta))
    step = limited(damped, jnp.append(target, jnp.zeros_like(theta)), *limits) / scale
    moved = parameterization.moved(theta, step)
    share = 1.0 / (1.0 + damping)
    change = jnp.append(parameterization.phi(moved) - parameterization.phi(theta), share)
    own = at.back[..., -1]
    lowered = jnp.sum(target**2) - jnp.sum((_times(columns, step) + target) ** 2) + (1.0 - (1.0 - share) ** 2) * jnp.sum(own**2)
    size = jnp.maximum(jnp.linalg.norm(target), jnp.finfo(theta.dtype).tiny)
    slope = jnp.max(jnp.abs(_times(columns.T, target)) / scale, initial=0.0) / size
    return Proposal(moved, starts + _states_step(at.back, change), lowered, slope)


def limited(columns: jax.Array, target: jax.Array, low: jax.Array, high: jax.Array) -> jax.Array:
    """What makes `columns @ step + target` least; what would go beyond a limit stays there, and the rest makes the best of it."""
    whole, farthest = _least(columns, target)
    step = jnp.clip(farthest, low, high)
    beyond = step != farthest
    triangle, given = whole[:-1, :-1], jnp.where(beyond, step, 0.0)
    # What stays is not sought any more; the ones keep the triangle regular.
    rest = jnp.concatenate((jnp.where(beyond[None], 0.0, triangle), jnp.diag(beyond.astype(step.dtype))))
    known = jnp.append(whole[:-1, -1] + _times(triangle, given), jnp.zeros_like(step))
    return jnp.where(beyond, step, jnp.clip(_least(rest, known)[1], low, high))


def _least(columns: jax.Array, target: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The triangle of columns and target, and what makes `columns @ step + target` least."""
    # A column of the right-hand side more gives Q^T b.
    triangle = jnp.linalg.qr(jnp.concatenate((columns, target[:, None]), 1), mode="r")
    return triangle, -jax.scipy.linalg.solve_triangular(triangle[:-1, :-1], triangle[:-1, -1])


def cost(parameterization: Parameterization, theta: jax.Array, at: Linearization) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Sum of squared residuals and priors, and of squared gaps."""
    prior = parameterization.prior(theta)
    return at.misfit + jnp.sum(prior * prior), at.gaps


def next_damping(damping: float, reached: float, promised: float, failures: int) -> tuple[bool, float]:
    """Whether to take a step that lowered the cost by `reached`, not a number if nothing came of it, and the next damping.

    After `failures` before, what did at last is kept.
    """
    ratio = reached / promised if promised > 0 else -1.0
    if not ratio > _ENOUGH:
        return False, max(damping * 8.0, FIRST_DAMPING)
    if ratio > 0.75:
        return True, damping if failures else max(damping / 10.0, LEAST_DAMPING)
    return True, damping if ratio > 0.25 else max(damping * 4.0, FIRST_DAMPING)


def _system(parameterization: Parameterization, theta: jax.Array, factor: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Jacobian with respect to theta, and residuals, which the states leave; priors included."""
    by_theta, prior_by_theta = jax.jacfwd(lambda x: (parameterization.phi(x), parameterization.prior(x)))(theta)
    columns = jnp.concatenate((jnp.matmul(factor[:, :-1], by_theta, precision="highest"), prior_by_theta))
    return columns, jnp.append(factor[:, -1], parameterization.prior(theta))


def _states_step(back: jax.Array, change: jax.Array) -> jax.Array:
    """The states' steps, from the last piece to the first."""
    nx = back.shape[1]

    def before(after: jax.Array, rows: jax.Array) -> tuple[jax.Array, jax.Array]:
        known = _times(rows[:, nx:], jnp.concatenate((after, change)))
        step = -jax.scipy.linalg.solve_triangular(rows[:, :nx], known)
        return step, step

    return lax.scan(before, jnp.zeros(nx, back.dtype), back, reverse=True)[1]


def _times(matrix: jax.Array, vector: jax.Array) -> jax.Array:
    return jnp.matmul(matrix, vector, precision="highest")
