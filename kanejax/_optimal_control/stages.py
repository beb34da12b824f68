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


class AbstractStages(eqx.Module):
    """Minimise the sum of all stages' costs and the final one, with x[k + 1] = next(k, x[k], w[k]) and all bounds held.

    Boundary values of the state are bounds of the first and the last node. Whatever changes from problem to problem is a leaf.
    """

    @abc.abstractmethod
    def stage(self, k: Int[Array, ""], x: Float[Array, " nx"], w: Float[Array, " nw"]) -> StageValues:
        """Stage k."""

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

    The Lagrangian is scale * cost + of_next . next + of_rows . rows. Its gradient and all values are differentiated together, in
    forward mode, so that what the dynamics need at the state is computed once.
    """
    nx = path.x.shape[1]

    def scaled(k: jax.Array, v: jax.Array) -> StageValues:
        found = stages.stage(k, v[:nx], v[nx:])
        return found._replace(cost=scale * found.cost)

    def scaled_final(x: jax.Array) -> FinalValues:
        found = stages.final(x)
        return found._replace(cost=scale * found.cost)

    def of_stage(k: jax.Array, v: jax.Array, of_next: jax.Array, of_rows: jax.Array) -> tuple:
        one = jnp.ones((), v.dtype)
        return _jacobian(lambda v: _with_gradient(lambda v: scaled(k, v), v, StageValues(of_next, one, of_rows)), v)

    v = jnp.concatenate((path.x[:-1], path.w), 1)
    (found, _), (slopes, hessian) = jax.vmap(of_stage)(_numbers(path), v, of_next, of_rows)
    one = FinalValues(jnp.ones((), v.dtype), of_final)
    (final, _), (final_slopes, final_hessian) = _jacobian(lambda x: _with_gradient(scaled_final, x, one), path.x[-1])
    return Derivatives(
        found, final, slopes.next, slopes.rows, slopes.cost, hessian, final_slopes.rows, final_slopes.cost, final_hessian
    )


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
