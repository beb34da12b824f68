"""What an optimization returns."""

from collections.abc import Mapping
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from kanejax._optimal_control.search import Errors, Result, Search
from kanejax._optimize.moment import Moment
from kanejax._optimize.steps import step
from kanejax._optimize.transcription import MotionStages


@final
class OptimalMotion(eqx.Module):
    """A motion, what it costs, and how well it fulfils the conditions of optimality; with a leading batch axis after `jax.vmap`.

    Attributes:
        ts: times of the nodes [s].
        q: generalized coordinates at the nodes.
        u: generalized speeds at the nodes.
        u_dot: rates of the speeds during each step.
        tau: forces during each step, in its middle with the integrator "midpoint".
        duration: [s].
        cost: sum of all terms.
        costs: each term with its weight.
        result: a `Result`, as an integer.
        iterations: of the solver.
        errors: of the conditions of optimality.
    """

    ts: Float[Array, "*batch nodes"]
    q: Float[Array, "*batch nodes nq"]
    u: Float[Array, "*batch nodes nv"]
    u_dot: Float[Array, "*batch steps nv"]
    tau: Float[Array, "*batch steps nv"]
    duration: Float[Array, "*batch"]
    cost: Float[Array, "*batch"]
    costs: Mapping[str, Float[Array, "*batch"]]
    result: Int[Array, "*batch"]
    iterations: Int[Array, "*batch"]
    errors: Errors

    @property
    def converged(self) -> Bool[Array | np.ndarray, "*batch"]:
        """Whether the conditions of optimality hold to the tolerance."""
        return self.result == int(Result.CONVERGED)


def motion_of(stages: MotionStages, search: Search) -> OptimalMotion:
    """The motion at which a search is."""
    task, path = stages.task, search.point.path
    numbers = jnp.arange(task.steps + 1)
    states = jax.vmap(stages.state)(numbers, path.x)
    h = states.duration[0] / task.steps
    ts = numbers.astype(h.dtype) * h
    before = jax.tree.map(lambda x: x[:-1], states)
    moments: Moment = jax.vmap(lambda t, state, w: step(task, state, w, t, h).moment)(ts[:-1], before, path.w)
    costs = stages.costs(path)
    return OptimalMotion(
        ts=ts,
        q=states.q,
        u=states.u,
        u_dot=moments.u_dot,
        tau=moments.tau,
        duration=states.duration[0],
        cost=sum(costs.values(), jnp.zeros((), ts.dtype)),
        costs=costs,
        result=search.result,
        iterations=search.iterations,
        errors=search.errors,
    )
