"""Guesses off the straight line, from which a search may come to another optimum."""

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._optimize.displacement import displaced
from kanejax._optimize.optimize import Guess
from kanejax._optimize.task import MotionTask

_WAVES = 3


def bent_guess(task: MotionTask, guess: Guess, bend: float, seed: tuple[int, ...]) -> Guess:
    """A guess with three waves of random height on all coordinates and speeds; none at the start and the goal.

    Args:
        task: what is asked for.
        guess: to bend.
        bend: standard deviation of the heights.
        seed: of the random numbers.
    """
    model = task.model
    heights = bend * np.random.default_rng(seed).normal(size=(2, _WAVES, model.nv))
    waves = np.sin(np.pi * np.outer(np.linspace(0.0, 1.0, task.steps + 1), np.arange(1, _WAVES + 1)))
    of_q, of_u = (jnp.asarray(waves @ each, model.dtype) for each in heights)
    q = jax.vmap(lambda q, by: displaced(model.tree, q, by))(guess.q, of_q)
    return Guess(q, guess.u + of_u, guess.u_dot, guess.tau, guess.duration)
