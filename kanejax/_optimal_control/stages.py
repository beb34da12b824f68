"""An optimal control problem in discrete time, stage by stage."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int


class StageValues(NamedTuple):
    """What one stage makes of its state and control.

    Attributes:
        next: the state of the next node.
        cost: the stage's share of the cost.
        rows: functions that have bounds, beyond the state and the control themselves.
    """

    next: Float[Array, " nx"]
    cost: Float[Array, ""]
    rows: Float[Array, " nc"]


class FinalValues(NamedTuple):
    """What the last node makes of its state: its cost, and functions that have bounds."""

    cost: Float[Array, ""]
    rows: Float[Array, " nf"]


class Bounds(NamedTuple):
    """Least and greatest values, infinite where there is none; equal ones make an equation.

    Attributes:
        stage: of the state, the control and the rows of each stage, in this order.
        final: of the last state and the last node's rows.
    """

    stage: Float[Array, "2 N nx+nw+nc"]
    final: Float[Array, "2 nx+nf"]


class Expansion(NamedTuple):
    """A stage about a point: values, their derivatives on the last axis, and second derivatives of their weighted sum."""

    values: StageValues
    slopes: StageValues
    hessian: Float[Array, "own own"]


class AbstractStages(eqx.Module):
    """Minimise the sum of all stages' costs and the final one, with x[k + 1] = next(k, x[k], w[k]) and all bounds held.

    Boundary values of the state are bounds of the first and the last node. Whatever changes from problem to problem is a leaf.
    """

    @abc.abstractmethod
    def stage(self, k: Int[Array, ""], x: Float[Array, " nx"], w: Float[Array, " nw"]) -> StageValues:
        """Stage k."""

    def expansion(self, k: Int[Array, ""], v: Float[Array, " own"], weights: StageValues) -> Expansion:
        """Stage k about v, state and control side by side; a subclass may know a cheaper way."""
        nx = len(weights.next)
        return expansion(lambda v: self.stage(k, v[:nx], v[nx:]), v, weights)

    @abc.abstractmethod
    def final(self, x: Float[Array, " nx"]) -> FinalValues:
        """The last node."""

    @abc.abstractmethod
    def bounds(self) -> Bounds:
        """Of everything."""


class Path(NamedTuple):
    """States of all nodes and controls of all stages."""

    x: Float[Array, "N+1 nx"]
    w: Float[Array, "N nw"]


def values(stages: AbstractStages, path: Path) -> tuple[StageValues, FinalValues]:
    """Of all stages."""
    return jax.vmap(stages.stage)(_numbers(path), path.x[:-1], path.w), stages.final(path.x[-1])


def bounded(path: Path, stage: jax.Array, final: jax.Array) -> tuple[Float[Array, "N ny"], Float[Array, " nyN"]]:
    """What has bounds, in their order, from the path and the rows."""
    return jnp.concatenate((path.x[:-1], path.w, stage), 1), jnp.concatenate((path.x[-1], final))


class Derivatives(NamedTuple):
    """Values of all stages, first derivatives, and second derivatives of the Lagrangian, by state and control side by side.

    Attributes:
        values: of the stages.
        final: values of the last node.
        next: derivatives of the next states.
        rows: of the rows.
        cost: of the costs.
        hessian: of the Lagrangian of each stage.
        final_rows: derivatives of the last node's rows by its state.
        final_cost: of its cost.
        final_hessian: of its Lagrangian.
    """

    values: StageValues
    final: FinalValues
    next: Float[Array, "N nx nx+nw"]
    rows: Float[Array, "N nc nx+nw"]
    cost: Float[Array, "N nx+nw"]
    hessian: Float[Array, "N nx+nw nx+nw"]
    final_rows: Float[Array, "nf nx"]
    final_cost: Float[Array, " nx"]
    final_hessian: Float[Array, "nx nx"]


def derivatives(
    stages: AbstractStages, path: Path, scale: jax.Array, of_next: jax.Array, of_rows: jax.Array, of_final: jax.Array
) -> Derivatives:
    """Derivatives on a path; costs are multiplied by the scale.

    The Lagrangian is scale * cost + of_next . next + of_rows . rows.
    """
    v = jnp.concatenate((path.x[:-1], path.w), 1)
    along = jax.vmap(lambda k, v, next_, rows: stages.expansion(k, v, StageValues(next_, scale, rows)))
    found, slopes, hessian = along(_numbers(path), v, of_next, of_rows)
    (final, _), (final_slopes, final_hessian) = _jacobian(
        lambda x: _with_gradient(stages.final, x, FinalValues(scale, of_final)), path.x[-1]
    )
    return Derivatives(
        found._replace(cost=scale * found.cost),
        final._replace(cost=scale * final.cost),
        slopes.next,
        slopes.rows,
        scale * slopes.cost,
        hessian,
        final_slopes.rows,
        scale * final_slopes.cost,
        final_hessian,
    )


def expansion(stage: Callable[[jax.Array], StageValues], v: Float[Array, " own"], weights: StageValues) -> Expansion:
    """A function about v; its gradient and values are differentiated together, in forward mode, and share what they compute."""
    (found, _), (slopes, hessian) = _jacobian(lambda v: _with_gradient(stage, v, weights), v)
    return Expansion(found, slopes, hessian)


def _with_gradient(function: Callable[[jax.Array], Any], at: jax.Array, cotangents: Any) -> tuple[Any, jax.Array]:
    """Values, and the gradient of their sum with these weights."""
    found, pull_back = jax.vjp(function, at)
    return found, pull_back(cotangents)[0]


def _jacobian(function: Callable[[jax.Array], Any], at: jax.Array) -> tuple[Any, Any]:
    """Values, and derivatives on the last axis."""

    def push(direction: jax.Array) -> tuple[Any, Any]:
        return jax.jvp(function, (at,), (direction,))

    return jax.vmap(push, out_axes=(None, -1))(jnp.eye(len(at), dtype=at.dtype))


def _numbers(path: Path) -> Int[Array, " N"]:
    return jnp.arange(len(path.w))
