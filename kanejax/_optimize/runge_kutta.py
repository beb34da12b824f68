"""The classical method of Runge and Kutta, in which forces are constant during a step."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from kanejax._dynamics.equations_of_motion import forward_dynamics
from kanejax._kinematics.coordinate_rates import coordinate_rates
from kanejax._optimize.moment import Moment
from kanejax._optimize.state import State, Step
from kanejax._optimize.task import MotionTask

# Of order four: weights, and the step from the start to the next evaluation and to this one.
_SHARES, _AHEAD, _OFFSETS = (1 / 6, 1 / 3, 1 / 3, 1 / 6), (0.5, 0.5, 1.0, 0.0), (0.0, 0.5, 0.5, 1.0)


class Linear(NamedTuple):
    """Accelerations of all evaluations as linear functions of coordinates, speeds and forces side by side."""

    at: Float[Array, "count nz"]
    value: Float[Array, "count nv"]
    slope: Float[Array, "count nv nz"]


def runge_kutta(task: MotionTask, before: State, w: jax.Array, t: jax.Array, h: jax.Array, linear: Linear | None = None) -> Step:
    """A step; costs are integrated like the state. All evaluations are one loop, which compiles in a fourth of the time.

    Args:
        task: what is asked for.
        before: state at the start of the step.
        w: forces.
        t: time of the start.
        h: length of the step.
        linear: in place of the dynamics.
    """
    model, d = task.model, h / task.substeps
    shares, times = _shares_and_times(task, t, h)

    def acceleration(q: jax.Array, u: jax.Array, linear: Linear | None) -> jax.Array:
        if linear is None:
            return forward_dynamics(model, q, u, w)
        away = jnp.concatenate((q, u, w)) - linear.at
        return linear.value + jnp.sum(linear.slope * away[None], -1)

    def evaluation(carry: tuple, each: tuple) -> tuple:
        start, here, after = carry
        now, share, ahead, is_last, known = each
        moment = Moment(now, here[0], here[1], acceleration(here[0], here[1], known), w)
        rates = coordinate_rates(model, here[0], here[1]), moment.u_dot
        after = jax.tree.map(lambda x, rate: x + share * h * rate, after, rates)
        start = jax.tree.map(lambda new, old: jnp.where(is_last, new, old), after, start)
        here = jax.tree.map(lambda x, rate: x + ahead * d * rate, start, rates)
        return (start, here, after), moment

    state, ahead = (before.q, before.u), jnp.tile(jnp.asarray(_AHEAD, h.dtype), task.substeps)
    rows = times, shares, ahead, np.arange(len(ahead)) % 4 == 3, linear
    (end, _, _), moments = lax.scan(evaluation, (state, state, state), rows)
    return Step(*end, jax.tree.map(lambda x: x[0], moments), shares, moments)


def _shares_and_times(task: MotionTask, t: jax.Array, h: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Of the evaluations in the mean over a step, and when they are."""
    shares, offsets = (jnp.tile(jnp.asarray(each, h.dtype), task.substeps) for each in (_SHARES, _OFFSETS))
    whole = jnp.asarray(np.arange(4 * task.substeps) // 4, h.dtype)
    return shares / task.substeps, t + h * (whole + offsets) / task.substeps
