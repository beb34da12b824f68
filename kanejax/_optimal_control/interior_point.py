"""A primal-dual interior-point method for optimal control: Newton's method on all stages at once, with a filter line search.

The method of IPOPT (Waechter and Biegler 2006, whose equations are cited), on equations that Riccati's recursion solves. States and
controls are independent unknowns (multiple shooting), so a guess need not be a motion, and unstable systems make no trouble. Where
the curvature is not positive, or no step along the direction is accepted, the curvature is made greater; in the limit the step is
the shortest one that brings the stages closer together.
"""

import jax
import jax.numpy as jnp
from jax import lax

from kanejax._optimal_control import barrier
from kanejax._optimal_control.line_search import FILTER, line_search
from kanejax._optimal_control.riccati import Quadratic, Slopes, Step, minimizer
from kanejax._optimal_control.search import Errors, Here, Point, Result, Search, complementarity, errors_at, total_cost
from kanejax._optimal_control.stages import AbstractStages, Bounds, Path, bounded, derivatives, values

FIRST_BARRIER = 0.3
# Waechter and Biegler (2006): equation 7, section 3.1.
_BARRIER_ERROR, _BARRIER_FACTOR, _BARRIER_POWER = 10.0, 0.2, 1.5
_FIRST_CURVATURE, _LEAST_CURVATURE, _MOST_CURVATURE, _MORE, _LESS_CURVATURE = 1e-4, 1e-10, 1e12, 8.0, 3.0
# So many iterations at most.
_HELD = 30
_SLOPE_OF_COST = 100.0


def first_search(stages: AbstractStages, guess: Path) -> Search:
    """At the guess."""
    dtype = guess.x.dtype
    found, final = values(stages, guess)
    bounds = stages.bounds()
    y, final_y = bounded(guess, found.rows, final.rows)
    mu = jnp.asarray(FIRST_BARRIER, dtype)
    point = Point(
        guess,
        jnp.zeros_like(guess.x[1:]),
        barrier.first_slacks(y, bounds.stage, mu),
        barrier.first_slacks(final_y, bounds.final, mu),
    )
    slopes = jax.tree.leaves(jax.grad(lambda path: total_cost(*values(stages, path)))(guess))
    steepest = jnp.max(jnp.stack([jnp.max(jnp.abs(x), initial=0.0) for x in slopes]))
    fine = jnp.isfinite(steepest) & jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves((found, final))]))
    zero, big = jnp.zeros((), dtype), jnp.asarray(jnp.inf, dtype)
    return Search(
        point=point,
        errors=Errors(big, big, big),
        cost=total_cost(found, final),
        scale=jnp.minimum(1.0, _SLOPE_OF_COST / jnp.maximum(steepest, 1.0)).astype(dtype),
        mu=mu,
        extra=zero,
        last_extra=jnp.asarray(_FIRST_CURVATURE, dtype),
        negative=jnp.zeros((), jnp.int32),
        most_violation=-jnp.ones((), dtype),
        filter=jnp.zeros((FILTER, 2), dtype),
        filtered=jnp.zeros((), jnp.int32),
        iterations=jnp.zeros((), jnp.int32),
        result=jnp.where(fine, int(Result.RUNNING), int(Result.NON_FINITE)).astype(jnp.int32),
    )


def searched(stages: AbstractStages, search: Search, iterations: int | jax.Array, tolerance: float | jax.Array) -> Search:
    """At most so many iterations more."""
    last = search.iterations + jnp.asarray(iterations, search.iterations.dtype)
    tolerance = jnp.asarray(tolerance, search.cost.dtype)

    def runs(search: Search) -> jax.Array:
        return (search.result == Result.RUNNING) & (search.iterations < last)

    bounds = stages.bounds()
    return lax.while_loop(runs, lambda search: _iteration(stages, bounds, search, tolerance), search)


def _iteration(stages: AbstractStages, bounds: Bounds, search: Search, tolerance: jax.Array) -> Search:
    point = search.point
    here = _here(stages, bounds, search)
    errors = errors_at(here, point)
    # Near a saddle the barrier's problem seems solved, and with a lower barrier the way along its negative curvature is short.
    held = (search.negative > 0) & (search.negative <= _HELD)
    mu = jnp.where(held, search.mu, _next_barrier(here, point, errors, search.mu, tolerance))
    step, extra = _direction(here, search, mu)
    again = jnp.where(mu == search.mu, search.negative + 1, 1)
    change = _change(here, point, step, mu)
    # A filter belongs to one barrier function.
    search = search._replace(errors=errors, mu=mu, filtered=jnp.where(mu == search.mu, search.filtered, 0))
    moved, accepted, search = line_search(stages, here, search, change)
    accepted = accepted & step.is_minimum
    done = errors.greatest <= tolerance
    taken = accepted & ~done
    hopeless = ~accepted & (extra > _MOST_CURVATURE)
    stuck = jnp.where(errors.violation > tolerance, int(Result.INFEASIBLE), int(Result.STALLED))
    result = jnp.where(done, int(Result.CONVERGED), jnp.where(hopeless, stuck, int(Result.RUNNING)))
    zero = jnp.zeros_like(extra)
    return search._replace(
        point=jax.tree.map(lambda new, old: jnp.where(taken, new, old), moved, point),
        cost=total_cost(here.at.values, here.at.final) / search.scale,
        extra=jnp.where(accepted, zero, jnp.maximum(extra * 10.0, _FIRST_CURVATURE)),
        last_extra=jnp.where(extra > 0, extra, search.last_extra),
        negative=jnp.where(extra > 0, again, 0).astype(jnp.int32),
        filtered=jnp.where(accepted, search.filtered, 0),
        iterations=search.iterations + 1,
        result=result.astype(jnp.int32),
    )


def _here(stages: AbstractStages, bounds: Bounds, search: Search) -> Here:
    point = search.point
    nx, nw = point.path.x.shape[1], point.path.w.shape[1]
    of_rows, of_final = barrier.multiplier(point.stage)[:, nx + nw :], barrier.multiplier(point.final)[nx:]
    at = derivatives(stages, point.path, search.scale, point.multiplier, of_rows, of_final)
    return Here(at, *bounded(point.path, at.values.rows, at.final.rows), bounds)


def _next_barrier(here: Here, point: Point, errors: Errors, mu: jax.Array, tolerance: jax.Array) -> jax.Array:
    """Equation 7, as often as the present barrier's problem counts as solved."""
    least = tolerance / 10.0

    def is_solved(mu: jax.Array) -> jax.Array:
        greatest = errors._replace(complementarity=complementarity(here.bounds, point, mu)).greatest
        return (greatest <= _BARRIER_ERROR * mu) & (mu > least)

    def lower(mu: jax.Array) -> jax.Array:
        return jnp.maximum(least, jnp.minimum(_BARRIER_FACTOR * mu, mu**_BARRIER_POWER))

    return lax.while_loop(is_solved, lower, mu)


def _direction(here: Here, search: Search, mu: jax.Array) -> tuple[Step, jax.Array]:
    """Newton's direction, and the curvature that had to be added for it to lead downwards (section 3.1)."""
    at, point = here.at, search.point
    weights = barrier.weights(here.y, here.bounds.stage, point.stage, mu)
    final = barrier.weights(here.final_y, here.bounds.final, point.final, mu)
    slopes = Slopes(
        at.cost + barrier.pulled(at.rows, weights.slope),
        at.final_cost + barrier.pulled(at.final_rows, final.slope),
        at.values.next - point.path.x[1:],
    )
    curved = at.hessian + jax.vmap(barrier.bent)(at.rows, weights.curvature)
    final_curved = at.final_hessian + barrier.bent(at.final_rows, final.curvature)

    def attempt(extra: jax.Array) -> Step:
        return minimizer(Quadratic(curved, final_curved, at.next), slopes, extra)

    def fails(state: tuple) -> jax.Array:
        extra, step = state
        return ~step.is_minimum & (extra <= _MOST_CURVATURE)

    def again(state: tuple) -> tuple:
        extra, _ = state
        first = jnp.maximum(search.last_extra / _LESS_CURVATURE, _LEAST_CURVATURE)
        extra = jnp.where(extra == 0, first, extra * _MORE)
        return extra, attempt(extra)

    extra, step = lax.while_loop(fails, again, (search.extra, attempt(search.extra)))
    return step, extra


def _change(here: Here, point: Point, step: Step, mu: jax.Array) -> Point:
    """Newton's step of everything."""
    dv = jnp.concatenate((step.x[:-1], step.w), 1)
    dy = jnp.concatenate((dv, jnp.einsum("kcv,kv->kc", here.at.rows, dv, precision="highest")), 1)
    last = step.x[-1]
    final_dy = jnp.concatenate((last, jnp.matmul(here.at.final_rows, last, precision="highest")))
    return Point(
        Path(step.x, step.w),
        step.multiplier - point.multiplier,
        barrier.change(here.y, dy, here.bounds.stage, point.stage, mu),
        barrier.change(here.final_y, final_dy, here.bounds.final, point.final, mu),
    )
