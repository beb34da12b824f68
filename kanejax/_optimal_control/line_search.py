"""A line search with a filter: a step has to bring the stages closer together, or to lower the barrier function."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax

from kanejax._optimal_control import barrier
from kanejax._optimal_control.barrier import Slacks
from kanejax._optimal_control.search import Here, Point, Search, gaps, total, total_cost
from kanejax._optimal_control.stages import AbstractStages, Bounds, bounded, values

# Waechter and Biegler (2006): equations 8 and 18 to 20.
_TO_BOUNDARY = 0.99
_LESS, _ARMIJO, _POWER, _POWER_VIOLATION = 1e-5, 1e-8, 2.3, 1.1
_HALVINGS = 12
# So many pairs of violation and barrier function are kept.
FILTER = 64


class _Merit(NamedTuple):
    """Sum of violations, and the barrier function."""

    violation: jax.Array
    value: jax.Array


def line_search(stages: AbstractStages, here: Here, search: Search, change: Point) -> tuple[Point, jax.Array, Search]:
    """The longest of the halved steps that the filter accepts, whether there is one, and the new filter (section 2.3)."""
    point, mu = search.point, search.mu
    now = _merit(search, here.y, here.final_y, here.bounds, point, here.at.values.next, total_cost(here.at.values, here.at.final))
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
        merit = _merit(search, y, final_y, here.bounds, moved, found.next, search.scale * total_cost(found, final))
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
    row = jnp.where(adds, search.filtered % FILTER, FILTER)
    filtered = search.filtered + adds.astype(search.filtered.dtype)
    return moved, accepted, search._replace(filter=search.filter.at[row].set(entry, mode="drop"), filtered=filtered)


def _is_accepted(search: Search, now: _Merit, new: _Merit, slope: jax.Array, length: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Whether a step is accepted, and whether it lowers the barrier function by what was promised (equations 18 to 20)."""
    fine = jnp.isfinite(new.violation) & jnp.isfinite(new.value) & (new.violation <= search.most_violation)
    listed = jnp.arange(FILTER, dtype=search.filtered.dtype) < search.filtered
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
    violations = gaps(after, y, final_y, bounds, point)
    logarithms = jnp.sum(jnp.log(point.stage.s)) + jnp.sum(jnp.log(point.final.s))
    return _Merit(total(*violations), scaled_cost - search.mu * logarithms)


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
