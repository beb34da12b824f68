"""A primal-dual interior-point method for optimal control: Newton's method on all stages at once, with a filter line search.

The method of IPOPT (Waechter and Biegler 2006, whose equations are cited), on equations that Riccati's recursion solves. States and
controls are independent unknowns (multiple shooting), so a guess need not be a motion, and unstable systems make no trouble. Where
the curvature is not positive, or no step along the direction is accepted, the curvature is made greater; in the limit the step is
the shortest one that brings the stages closer together.
"""

import enum
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from kanejax._optimal_control import barrier
from kanejax._optimal_control.barrier import Slacks
from kanejax._optimal_control.products import product
from kanejax._optimal_control.riccati import Quadratic, Slopes, Step, minimizer
from kanejax._optimal_control.stages import (
    AbstractStages,
    Bounds,
    Derivatives,
    FinalValues,
    Path,
    StageValues,
    bounded,
    derivatives,
    values,
)

FIRST_BARRIER = 0.3
# Waechter and Biegler (2006): equations 5 and 6, 7, 18 to 20, section 3.1.
_MULTIPLIERS_OF_SIZE = 100.0
_BARRIER_ERROR, _BARRIER_FACTOR, _BARRIER_POWER, _TO_BOUNDARY = 10.0, 0.2, 1.5, 0.99
_LESS, _ARMIJO, _POWER, _POWER_VIOLATION = 1e-5, 1e-8, 2.3, 1.1
_FIRST_CURVATURE, _LEAST_CURVATURE, _MOST_CURVATURE, _MORE, _LESS_CURVATURE = 1e-4, 1e-10, 1e12, 8.0, 3.0
_HALVINGS, _FILTER = 12, 64
# So many iterations at most.
_HELD = 30
_SLOPE_OF_COST = 100.0


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
    slopes = jax.tree.leaves(jax.grad(lambda path: _cost(*values(stages, path)))(guess))
    steepest = jnp.max(jnp.stack([jnp.max(jnp.abs(x), initial=0.0) for x in slopes]))
    fine = jnp.isfinite(steepest) & jnp.all(jnp.stack([jnp.all(jnp.isfinite(x)) for x in jax.tree.leaves((found, final))]))
    zero, big = jnp.zeros((), dtype), jnp.asarray(jnp.inf, dtype)
    return Search(
        point=point,
        errors=Errors(big, big, big),
        cost=_cost(found, final),
        scale=jnp.minimum(1.0, _SLOPE_OF_COST / jnp.maximum(steepest, 1.0)).astype(dtype),
        mu=mu,
        extra=zero,
        last_extra=jnp.asarray(_FIRST_CURVATURE, dtype),
        negative=jnp.zeros((), jnp.int32),
        most_violation=-jnp.ones((), dtype),
        filter=jnp.zeros((_FILTER, 2), dtype),
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
    moved, accepted, search = _line_search(stages, here, search, change)
    accepted = accepted & step.is_minimum
    done = errors.greatest <= tolerance
    taken = accepted & ~done
    hopeless = ~accepted & (extra > _MOST_CURVATURE)
    stuck = jnp.where(errors.violation > tolerance, int(Result.INFEASIBLE), int(Result.STALLED))
    result = jnp.where(done, int(Result.CONVERGED), jnp.where(hopeless, stuck, int(Result.RUNNING)))
    zero = jnp.zeros_like(extra)
    return search._replace(
        point=jax.tree.map(lambda new, old: jnp.where(taken, new, old), moved, point),
        cost=_cost(here.at.values, here.at.final) / search.scale,
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


def _cost(values: StageValues, final: FinalValues) -> jax.Array:
    return jnp.sum(values.cost) + final.cost


def errors_at(here: Here, point: Point) -> Errors:
    at, nx = here.at, point.path.x.shape[1]
    of_stage = at.cost + barrier.pulled(at.rows, barrier.multiplier(point.stage))
    of_stage = of_stage + jax.vmap(lambda jacobian, multiplier: product(jacobian.T, multiplier))(at.next, point.multiplier)
    of_stage = of_stage.at[1:, :nx].add(-point.multiplier[:-1])
    of_final = at.final_cost + barrier.pulled(at.final_rows, barrier.multiplier(point.final)) - point.multiplier[-1]
    limits = _count(barrier.is_limit, here.bounds)
    equations = _count(barrier.is_equation, here.bounds) + point.multiplier.size
    of_equations = _total(point.multiplier, point.stage.nu, point.final.nu)
    return Errors(
        slope=_greatest(of_stage, of_final) / _size(_of_limits(point) + of_equations, limits + equations),
        violation=_greatest(*_gaps(at.values.next, here.y, here.final_y, here.bounds, point)),
        complementarity=_complementarity(here.bounds, point, jnp.zeros_like(of_equations)),
    )


def _complementarity(bounds: Bounds, point: Point, mu: jax.Array) -> jax.Array:
    """The greatest difference of slacks times multipliers from the barrier's parameter, by the multipliers' size."""
    pairs = ((point.stage, bounds.stage), (point.final, bounds.final))
    products = [jnp.where(barrier.is_limit(each_bounds), each.s * each.z - mu, 0.0) for each, each_bounds in pairs]
    return _greatest(*products) / _size(_of_limits(point), _count(barrier.is_limit, bounds))


def _of_limits(point: Point) -> jax.Array:
    return _total(point.stage.z, point.final.z)


def _count(which: Callable[[jax.Array], jax.Array], bounds: Bounds) -> jax.Array:
    return jnp.sum(which(bounds.stage)) + jnp.sum(which(bounds.final))


def _total(*arrays: jax.Array) -> jax.Array:
    """Sum of all absolute values."""
    return jnp.sum(jnp.stack([jnp.sum(jnp.abs(x)) for x in arrays]))


def _size(total: jax.Array, count: jax.Array) -> jax.Array:
    """Equation 6: above one where multipliers are large."""
    mean = total / jnp.maximum(count, jnp.ones_like(count)).astype(total.dtype)
    return jnp.maximum(mean / _MULTIPLIERS_OF_SIZE, 1.0)


def _greatest(*arrays: jax.Array) -> jax.Array:
    return jnp.max(jnp.stack([jnp.max(jnp.abs(x), initial=0.0) for x in arrays]))


def _gaps(after: jax.Array, y: jax.Array, final_y: jax.Array, bounds: Bounds, point: Point) -> list[jax.Array]:
    """All that has to vanish."""
    return [
        after - point.path.x[1:],
        barrier.room(y, bounds.stage) - point.stage.s,
        barrier.room(final_y, bounds.final) - point.final.s,
        barrier.excess(y, bounds.stage),
        barrier.excess(final_y, bounds.final),
    ]


def _next_barrier(here: Here, point: Point, errors: Errors, mu: jax.Array, tolerance: jax.Array) -> jax.Array:
    """Equation 7, as often as the present barrier's problem counts as solved."""
    least = tolerance / 10.0

    def is_solved(mu: jax.Array) -> jax.Array:
        greatest = errors._replace(complementarity=_complementarity(here.bounds, point, mu)).greatest
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


class _Merit(NamedTuple):
    """Sum of violations, and the barrier function."""

    violation: jax.Array
    value: jax.Array


def _line_search(stages: AbstractStages, here: Here, search: Search, change: Point) -> tuple[Point, jax.Array, Search]:
    """The longest of the halved steps that the filter accepts, whether there is one, and the new filter (section 2.3)."""
    point, mu = search.point, search.mu
    now = _merit(search, here.y, here.final_y, here.bounds, point, here.at.values.next, _cost(here.at.values, here.at.final))
    slope = _slope(here, point, change, mu)
    most = jnp.where(search.most_violation < 0, 1e4 * jnp.maximum(now.violation, 1.0), search.most_violation)
    search = search._replace(most_violation=most)
    fraction = jnp.maximum(_TO_BOUNDARY, 1.0 - mu)
    longest = _longest((point.stage.s, point.final.s), (change.stage.s, change.final.s), fraction)
    of_duals = _longest((point.stage.z, point.final.z), (change.stage.z, change.final.z), fraction)

    def tried(length: jax.Array) -> tuple[Point, jax.Array, jax.Array]:
        moved = _moved(point, change, length, of_duals)
        found, final = values(stages, moved.path)
        y, final_y = bounded(moved.path, found.rows, final.rows)
        moved = moved._replace(
            stage=barrier.kept_near(barrier.reset(point.stage, moved.stage, y, here.bounds.stage, fraction), mu),
            final=barrier.kept_near(barrier.reset(point.final, moved.final, final_y, here.bounds.final, fraction), mu),
        )
        merit = _merit(search, y, final_y, here.bounds, moved, found.next, search.scale * _cost(found, final))
        return moved, *_is_accepted(search, now, merit, slope, length)

    def goes_on(state: tuple) -> jax.Array:
        _, _, accepted, _, count = state
        return ~accepted & (count < _HALVINGS)

    def halve(state: tuple) -> tuple:
        length, *_, count = state
        return 0.5 * length, *tried(0.5 * length), count + 1

    _, moved, accepted, lowers, _ = lax.while_loop(goes_on, halve, (longest, *tried(longest), 0))
    # Equation 22: a step that does not lower the barrier function by what was promised must not be undone later.
    entry = jnp.stack(((1.0 - _LESS) * now.violation, now.value - _LESS * now.violation))
    adds = accepted & ~lowers
    row = jnp.where(adds, search.filtered % _FILTER, _FILTER)
    filtered = search.filtered + adds.astype(search.filtered.dtype)
    return moved, accepted, search._replace(filter=search.filter.at[row].set(entry, mode="drop"), filtered=filtered)


def _is_accepted(search: Search, now: _Merit, new: _Merit, slope: jax.Array, length: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Whether a step is accepted, and whether it lowers the barrier function by what was promised (equations 18 to 20)."""
    fine = jnp.isfinite(new.violation) & jnp.isfinite(new.value) & (new.violation <= search.most_violation)
    listed = jnp.arange(_FILTER, dtype=search.filtered.dtype) < search.filtered
    better = (new.violation <= (1.0 - _LESS) * search.filter[:, 0]) | (new.value <= search.filter[:, 1])
    rounding = 10.0 * jnp.finfo(now.value.dtype).eps * jnp.abs(now.value)
    little = now.violation <= 1e-4 * jnp.maximum(search.most_violation / 1e4, 1.0)
    promised = (slope < 0) & (length * jnp.abs(slope) ** _POWER > now.violation**_POWER_VIOLATION) & little
    lowers = promised & (new.value - now.value - rounding <= _ARMIJO * length * slope)
    nearer = new.violation <= (1.0 - _LESS) * now.violation
    lower = new.value - rounding <= now.value - _LESS * now.violation
    return fine & jnp.all(better | ~listed) & jnp.where(promised, lowers, nearer | lower), lowers


def _merit(
    search: Search, y: jax.Array, final_y: jax.Array, bounds: Bounds, point: Point, after: jax.Array, scaled_cost: jax.Array
) -> _Merit:
    violations = _gaps(after, y, final_y, bounds, point)
    logarithms = jnp.sum(jnp.log(point.stage.s)) + jnp.sum(jnp.log(point.final.s))
    return _Merit(_total(*violations), scaled_cost - search.mu * logarithms)


def _slope(here: Here, point: Point, change: Point, mu: jax.Array) -> jax.Array:
    """Of the barrier function along the step."""
    dv = jnp.concatenate((change.path.x[:-1], change.path.w), 1)
    of_cost = jnp.sum(here.at.cost * dv) + jnp.sum(here.at.final_cost * change.path.x[-1])
    of_slacks = [jnp.sum(by.s / at.s) for at, by in ((point.stage, change.stage), (point.final, change.final))]
    return of_cost - mu * sum(of_slacks)


def _moved(point: Point, change: Point, length: jax.Array, of_duals: jax.Array) -> Point:
    def along(old: Slacks, by: Slacks) -> Slacks:
        return Slacks(old.s + length * by.s, old.z + of_duals * by.z, old.nu + length * by.nu)

    path = jax.tree.map(lambda old, by: old + length * by, point.path, change.path)
    multiplier = point.multiplier + length * change.multiplier
    return Point(path, multiplier, along(point.stage, change.stage), along(point.final, change.final))


def _longest(positive: tuple, changes: tuple, fraction: jax.Array) -> jax.Array:
    """The longest step, at most 1, after which numbers are still positive by a fraction (equation 15)."""
    ratios = [
        jnp.min(jnp.where(by < 0, -fraction * at / jnp.where(by < 0, by, -1.0), jnp.inf), initial=1.0)
        for at, by in zip(positive, changes, strict=True)
    ]
    return jnp.minimum(*ratios)
