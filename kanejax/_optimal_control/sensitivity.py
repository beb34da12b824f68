"""How an optimal path changes with the problem: the implicit function theorem on the conditions of optimality.

Near an optimum the bounds that hold act like equations, and the others not at all; the slacks of a barrier that is nearly zero say
which. So path and multipliers are the solution of smooth equations, whose derivatives are Newton's matrix.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.flatten_util import ravel_pytree

from kanejax._optimal_control import barrier
from kanejax._optimal_control.barrier import Slacks
from kanejax._optimal_control.interior_point import first_search, searched
from kanejax._optimal_control.riccati import Quadratic, Slopes, minimizer
from kanejax._optimal_control.search import Point, Search
from kanejax._optimal_control.stages import AbstractStages, Path, derivatives

_REFINEMENTS = 4
# Of a number without bounds.
_LEAST_RATE = 1e-12


@eqx.filter_custom_jvp
def optimum(stages: AbstractStages, guess: Path, iterations: int | jax.Array, tolerance: float | jax.Array) -> Search:
    """The search from a guess to its end; its path has derivatives by the leaves of the stages, of the first order."""
    return searched(stages, first_search(stages, guess), iterations, tolerance)


@optimum.def_jvp
def _optimum_jvp(primals: tuple, tangents: tuple) -> tuple[Search, Search]:
    stages, guess, iterations, tolerance = primals
    search = optimum(stages, guess, iterations, tolerance)
    along = jax.tree.map(_or_zero, stages, tangents[0], is_leaf=lambda x: x is None)
    moving, fixed = eqx.partition(stages, eqx.is_inexact_array)
    conditions = lambda moving: _conditions(eqx.combine(moving, fixed), search.point, search.scale)  # noqa: E731
    change = jax.jvp(conditions, (moving,), (eqx.filter(along, eqx.is_inexact_array),))[1]
    x, w, multiplier, *_ = _solved(stages, search, change)
    still = jax.tree.map(lambda leaf: jnp.zeros_like(leaf) if eqx.is_inexact_array(leaf) else None, search)
    point = still.point._replace(path=Path(x, w), multiplier=multiplier)
    return search, still._replace(point=point)


def _or_zero(leaf: Any, tangent: jax.Array | None) -> jax.Array | None:
    return jnp.zeros_like(leaf) if tangent is None and eqx.is_inexact_array(leaf) else tangent


class _Conditions(NamedTuple):
    """Conditions of optimality, or changes of them, as functions of the problem: all vanish at an optimum.

    Attributes:
        x: slopes of the Lagrangian by the states.
        w: by the controls.
        gap: between the stages.
        held: of what has bounds, from the bound that holds it.
        final_held: at the last node.
    """

    x: jax.Array
    w: jax.Array
    gap: jax.Array
    held: jax.Array
    final_held: jax.Array


def _conditions(stages: AbstractStages, point: Point, scale: jax.Array) -> _Conditions:
    """At a path and its multipliers."""
    nx, own = point.path.x.shape[1], point.path.x.shape[1] + point.path.w.shape[1]
    bounds = stages.bounds()
    of_rows, of_final = barrier.multiplier(point.stage)[:, own:], barrier.multiplier(point.final)[nx:]

    def of_stage(k: jax.Array, v: jax.Array, multiplier: jax.Array, of_rows: jax.Array) -> tuple:
        found = stages.stage(k, v[:nx], v[nx:])
        lagrangian = scale * found.cost + jnp.sum(multiplier * found.next) + jnp.sum(of_rows * found.rows)
        return lagrangian, (found.next, jnp.concatenate((v, found.rows)))

    def of_last(x: jax.Array) -> tuple:
        found = stages.final(x)
        return scale * found.cost + jnp.sum(of_final * found.rows), jnp.concatenate((x, found.rows))

    v, numbers = jnp.concatenate((point.path.x[:-1], point.path.w), 1), jnp.arange(len(point.path.w))
    stage, (after, y) = jax.vmap(jax.grad(of_stage, 1, has_aux=True))(numbers, v, point.multiplier, of_rows)
    last, final_y = jax.grad(of_last, has_aux=True)(point.path.x[-1])
    held, final_held = y - _holding(bounds.stage, point.stage), final_y - _holding(bounds.final, point.final)
    return _Conditions(jnp.concatenate((stage[:, :nx], last[None])), stage[:, nx:], after - point.path.x[1:], held, final_held)


def _holding(bounds: jax.Array, slacks: Slacks) -> jax.Array:
    """The bound that holds a number: the mean of both, by the slopes of their multipliers."""
    rate = _rate(bounds, slacks)
    known = jnp.where(jnp.isfinite(bounds), bounds, 0.0)
    mean = jnp.sum(rate * known, 0) / jnp.maximum(jnp.sum(rate, 0), jnp.finfo(bounds.dtype).tiny)
    return jnp.where(barrier.is_equation(bounds), known[0], mean)


def _rate(bounds: jax.Array, slacks: Slacks) -> jax.Array:
    """Change of the multipliers with the number, by lower and upper bound."""
    return jnp.where(barrier.is_limit(bounds), slacks.z / slacks.s, 0.0)


def _give(bounds: jax.Array, slacks: Slacks) -> jax.Array:
    """By how much a number gives way where its multiplier grows: next to nothing where a bound holds, a lot where none does."""
    rate = jnp.sum(_rate(bounds, slacks), 0)
    return jnp.where(barrier.is_equation(bounds), 0.0, 1.0 / jnp.maximum(rate, _LEAST_RATE))


def _solved(stages: AbstractStages, search: Search, conditions: _Conditions) -> _Conditions:
    """How path and multipliers change so that these changes of the conditions are undone.

    Newton's matrix with the multipliers of all bounds among its unknowns has no large numbers, and it is symmetric, so that JAX can
    transpose the solution. It is solved by Riccati's recursion, in which bounds that hold are a little soft, and refined.
    """
    point, bounds, nx = search.point, stages.bounds(), search.point.path.x.shape[1]
    own = nx + point.path.w.shape[1]
    of_rows, of_final = barrier.multiplier(point.stage)[:, own:], barrier.multiplier(point.final)[nx:]
    at = derivatives(stages, point.path, search.scale, point.multiplier, of_rows, of_final)
    give, final_give = _give(bounds.stage, point.stage), _give(bounds.final, point.final)
    least = barrier.equation_weakness(at.next.dtype)
    hard, final_hard = (1.0 / jnp.maximum(each, least) for each in (give, final_give))
    quadratic = Quadratic(
        at.hessian + jax.vmap(barrier.bent)(at.rows, hard), at.final_hessian + barrier.bent(at.final_rows, final_hard), at.next
    )
    # One vector, for JAX transposes only what depends on all that is known.
    known, apart = ravel_pytree(jax.tree.map(jnp.negative, conditions))

    def product(unknown: jax.Array) -> jax.Array:
        x, w, multiplier, held, final_held = apart(unknown)
        v = jnp.concatenate((x[:-1], w), 1)
        stage = _each(at.hessian, v) + barrier.pulled(at.rows, held)
        stage = stage + jnp.einsum("kxv,kx->kv", at.next, multiplier, precision="highest")
        last = jnp.matmul(at.final_hessian, x[-1], precision="highest") + barrier.pulled(at.final_rows, final_held)
        rows = jnp.concatenate((v, _each(at.rows, v)), 1) - give * held
        final_rows = jnp.concatenate((x[-1], jnp.matmul(at.final_rows, x[-1], precision="highest"))) - final_give * final_held
        states = jnp.concatenate((stage[:, :nx], last[None])).at[1:].add(-multiplier)
        return ravel_pytree((states, stage[:, nx:], _each(at.next, v) - x[1:], rows, final_rows))[0]

    def once(known: jax.Array) -> jax.Array:
        of_x, of_w, of_gap, of_held, of_final_held = apart(known)
        stage = jnp.concatenate((of_x[:-1], of_w), 1) + barrier.pulled(at.rows, hard * of_held)
        step = minimizer(quadratic, Slopes(-stage, -of_x[-1] - barrier.pulled(at.final_rows, final_hard * of_final_held), -of_gap))
        v, last = jnp.concatenate((step.x[:-1], step.w), 1), step.x[-1]
        held = hard * (jnp.concatenate((v, _each(at.rows, v)), 1) - of_held)
        ends = jnp.concatenate((last, jnp.matmul(at.final_rows, last, precision="highest")))
        return ravel_pytree((step.x, step.w, step.multiplier, held, final_hard * (ends - of_final_held)))[0]

    def solution(_: object, known: jax.Array) -> jax.Array:
        def refine(_: object, found: jax.Array) -> jax.Array:
            return found + once(known - product(found))

        return lax.fori_loop(0, _REFINEMENTS, refine, jnp.zeros_like(known))

    return apart(lax.custom_linear_solve(product, known, solution, symmetric=True))


def _each(matrices: jax.Array, vectors: jax.Array) -> jax.Array:
    return jnp.einsum("kij,kj->ki", matrices, vectors, precision="highest")
