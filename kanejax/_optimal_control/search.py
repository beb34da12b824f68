"""Where a search for an optimum is, and how good that is."""

import enum
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from kanejax._optimal_control import barrier
from kanejax._optimal_control.barrier import Slacks
from kanejax._optimal_control.products import product
from kanejax._optimal_control.stages import Bounds, Derivatives, FinalValues, Path, StageValues

# Waechter and Biegler (2006), equation 6.
_MULTIPLIERS_OF_SIZE = 100.0


class Result(enum.IntEnum):
    """How a solver ended."""

    CONVERGED = 0
    """The conditions of optimality hold to the tolerance."""
    RUNNING = 1
    """It has not ended, or it came to the greatest number of iterations."""
    INFEASIBLE = 2
    """No step brings the stages closer together, or nearer to their bounds."""
    STALLED = 3
    """All bounds and stages hold, but no step lowers the cost."""
    NON_FINITE = 4
    """Something is infinite or not a number at the guess."""
    NOT_RUN = 5
    """A batch was interrupted before it began."""


class Point(NamedTuple):
    """A path, the multipliers of the next states, and the slacks of all bounds."""

    path: Path
    multiplier: Float[Array, "N nx"]
    stage: Slacks
    final: Slacks


class Errors(NamedTuple):
    """Of the conditions of optimality.

    Attributes:
        slope: greatest slope of the Lagrangian, divided by the multipliers' size if that is above 100.
        violation: greatest gap between stages, violation of a bound, or error of an equation.
        complementarity: greatest product of a slack and its multiplier, divided likewise.
    """

    slope: Float[Array, ""]
    violation: Float[Array, ""]
    complementarity: Float[Array, ""]

    @property
    def greatest(self) -> Float[Array, ""]:
        """Of the three."""
        return jnp.maximum(jnp.maximum(self.slope, self.violation), self.complementarity)


class Search(NamedTuple):
    """What goes from iteration to iteration.

    Attributes:
        point: where it is.
        errors: at the point.
        cost: at the point.
        scale: of the cost.
        mu: the barrier's parameter.
        extra: curvature that is added next.
        last_extra: that helped last.
        negative: iterations in a row in which it was needed, with the same barrier.
        most_violation: sum of violations above which no step is accepted.
        filter: pairs of violation and barrier function, which a new point has to be better than in one.
        filtered: how many there are.
        iterations: so far.
        result: a `Result`.
    """

    point: Point
    errors: Errors
    cost: Float[Array, ""]
    scale: Float[Array, ""]
    mu: Float[Array, ""]
    extra: Float[Array, ""]
    last_extra: Float[Array, ""]
    negative: Int[Array, ""]
    most_violation: Float[Array, ""]
    filter: Float[Array, "n 2"]
    filtered: Int[Array, ""]
    iterations: Int[Array, ""]
    result: Int[Array, ""]


class Here(NamedTuple):
    """What is known at a point: derivatives, what has bounds, and its bounds."""

    at: Derivatives
    y: jax.Array
    final_y: jax.Array
    bounds: Bounds


def total_cost(values: StageValues, final: FinalValues) -> jax.Array:
    """Of all stages and the last node."""
    return jnp.sum(values.cost) + final.cost


def errors_at(here: Here, point: Point) -> Errors:
    """Of the conditions of optimality at a point."""
    at, nx = here.at, point.path.x.shape[1]
    of_stage = at.cost + barrier.pulled(at.rows, barrier.multiplier(point.stage))
    of_stage = of_stage + jax.vmap(lambda jacobian, multiplier: product(jacobian.T, multiplier))(at.next, point.multiplier)
    of_stage = of_stage.at[1:, :nx].add(-point.multiplier[:-1])
    of_final = at.final_cost + barrier.pulled(at.final_rows, barrier.multiplier(point.final)) - point.multiplier[-1]
    limits = _count(barrier.is_limit, here.bounds)
    equations = _count(barrier.is_equation, here.bounds) + point.multiplier.size
    of_equations = total(point.multiplier, point.stage.nu, point.final.nu)
    return Errors(
        slope=_greatest(of_stage, of_final) / _size(_of_limits(point) + of_equations, limits + equations),
        violation=_greatest(*gaps(at.values.next, here.y, here.final_y, here.bounds, point)),
        complementarity=complementarity(here.bounds, point, jnp.zeros_like(of_equations)),
    )


def complementarity(bounds: Bounds, point: Point, mu: jax.Array) -> jax.Array:
    """The greatest difference of slacks times multipliers from the barrier's parameter, by the multipliers' size."""
    pairs = ((point.stage, bounds.stage), (point.final, bounds.final))
    products = [jnp.where(barrier.is_limit(each_bounds), each.s * each.z - mu, 0.0) for each, each_bounds in pairs]
    return _greatest(*products) / _size(_of_limits(point), _count(barrier.is_limit, bounds))


def _of_limits(point: Point) -> jax.Array:
    return total(point.stage.z, point.final.z)


def _count(which: Callable[[jax.Array], jax.Array], bounds: Bounds) -> jax.Array:
    return jnp.sum(which(bounds.stage)) + jnp.sum(which(bounds.final))


def total(*arrays: jax.Array) -> jax.Array:
    """Sum of all absolute values."""
    return jnp.sum(jnp.stack([jnp.sum(jnp.abs(x)) for x in arrays]))


def _size(total: jax.Array, count: jax.Array) -> jax.Array:
    """Equation 6: above one where multipliers are large."""
    mean = total / jnp.maximum(count, jnp.ones_like(count)).astype(total.dtype)
    return jnp.maximum(mean / _MULTIPLIERS_OF_SIZE, 1.0)


def _greatest(*arrays: jax.Array) -> jax.Array:
    return jnp.max(jnp.stack([jnp.max(jnp.abs(x), initial=0.0) for x in arrays]))


def gaps(after: jax.Array, y: jax.Array, final_y: jax.Array, bounds: Bounds, point: Point) -> list[jax.Array]:
    """All that has to vanish."""
    return [
        after - point.path.x[1:],
        barrier.room(y, bounds.stage) - point.stage.s,
        barrier.room(final_y, bounds.final) - point.final.s,
        barrier.excess(y, bounds.stage),
        barrier.excess(final_y, bounds.final),
    ]
