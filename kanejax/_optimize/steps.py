"""One time step of a motion, by each of the ways of integration."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from kanejax._dynamics.equations_of_motion import forward_dynamics, inverse_dynamics
from kanejax._optimize.curvature import curved_forward_dynamics, curved_inverse_dynamics
from kanejax._optimize.displacement import displaced
from kanejax._optimize.moment import Moment
from kanejax._optimize.runge_kutta import runge_kutta
from kanejax._optimize.state import State, Step
from kanejax._optimize.task import MotionTask


class Scheme(NamedTuple):
    """A way of integration that asks for the dynamics once a step.

    Attributes:
        place: (task, state before, control, length of the step) -> coordinates and speeds where it asks.
        after: (task, state before, those coordinates and speeds, u_dot, tau, time, length) -> the step.
    """

    place: Callable[[MotionTask, State, jax.Array, jax.Array], tuple[jax.Array, jax.Array]]
    after: Callable[..., Step]


# Inverse dynamics gives forces, forward dynamics accelerations; and both with their derivatives.
DYNAMICS = {"inverse": (inverse_dynamics, curved_inverse_dynamics), "forward": (forward_dynamics, curved_forward_dynamics)}


def scheme(task: MotionTask) -> Scheme | None:
    """The task's way, None where it asks for the dynamics more often."""
    return _SCHEMES.get((task.dynamics, task.integrator))


def step(task: MotionTask, before: State, w: jax.Array, t: jax.Array, h: jax.Array) -> Step:
    """The motion during the step of length h at time t."""
    way = scheme(task)
    if way is None:
        return runge_kutta(task, before, w, t, h)
    place = way.place(task, before, w, h)
    return step_with(task, before, w, DYNAMICS[task.dynamics][0](task.model, *place, w), t, h)


def step_with(task: MotionTask, before: State, w: jax.Array, found: jax.Array, t: jax.Array, h: jax.Array) -> Step:
    """The same with what the dynamics gave."""
    way = scheme(task)
    assert way is not None
    u_dot, tau = (w, found) if task.dynamics == "inverse" else (found, w)
    return way.after(task, before, *way.place(task, before, w, h), u_dot, tau, t, h)


def _of_one(q: jax.Array, u: jax.Array, moment: Moment) -> Step:
    """A step of which one moment is the mean."""
    return Step(q, u, moment, jnp.ones(1, q.dtype), jax.tree.map(lambda x: x[None], moment))


def _begin(task: MotionTask, before: State, w: jax.Array, h: jax.Array) -> tuple[jax.Array, jax.Array]:
    return before.q, before.u


def _after_euler(
    task: MotionTask, before: State, q: jax.Array, u: jax.Array, u_dot: jax.Array, tau: jax.Array, t: jax.Array, h: jax.Array
) -> Step:
    after = before.u + h * u_dot
    return _of_one(displaced(task.model.tree, before.q, h * after), after, Moment(t, q, u, u_dot, tau))


def _middle(task: MotionTask, before: State, w: jax.Array, h: jax.Array) -> tuple[jax.Array, jax.Array]:
    return displaced(task.model.tree, before.q, 0.5 * h * (before.u + 0.25 * h * w)), before.u + 0.5 * h * w


def _after_midpoint(
    task: MotionTask, before: State, q: jax.Array, u: jax.Array, u_dot: jax.Array, tau: jax.Array, t: jax.Array, h: jax.Array
) -> Step:
    moment = Moment(t + 0.5 * h, q, u, u_dot, tau)
    return _of_one(displaced(task.model.tree, before.q, h * u), before.u + h * u_dot, moment)


_SCHEMES = {
    ("inverse", "euler"): Scheme(_begin, _after_euler),
    ("inverse", "midpoint"): Scheme(_middle, _after_midpoint),
    ("forward", "euler"): Scheme(_begin, _after_euler),
}
