"""Guesses off the straight line, from which a search may come to another optimum."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._optimize.displacement import displaced
from kanejax._optimize.optimize import Guess, straight_guess
from kanejax._optimize.task import MotionTask


def bent_guess(task: MotionTask, heights: Float[Array | np.ndarray, "2 waves nv"], guess: Guess | None = None) -> Guess:
    """A guess with waves on all coordinates and speeds, which vanish at the start and the goal.

    `bent_guess(task, 2.0 * rng.normal(size=(2, 3, model.nv)))` is one of many to start from.

    Args:
        task: what is asked for.
        heights: of waves of one half period, two, and so on, of the coordinates and of the speeds.
        guess: to bend, `straight_guess(task)` by default.
    """
    guess = straight_guess(task) if guess is None else guess
    model, count = task.model, heights.shape[1]
    waves = np.sin(np.pi * np.outer(np.linspace(0.0, 1.0, task.steps + 1), np.arange(1, count + 1)))
    of_q, of_u = (
        jnp.matmul(jnp.asarray(waves, model.dtype), each, precision="highest") for each in jnp.asarray(heights, model.dtype)
    )
    q = jax.vmap(lambda q, by: displaced(model.tree, q, by))(guess.q, of_q)
    return Guess(q, guess.u + of_u, guess.u_dot, guess.tau, guess.duration)
