"""Random states at which implementations are compared."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kanejax._model.coordinates import coordinates_within_ranges, numbers_for_coordinates
from kanejax._model.model import Model


class States(NamedTuple):
    """Random states, one a row, float64 numbers that float32 can represent.

    Attributes:
        q: generalized coordinates, (samples, nq).
        u: generalized speeds, (samples, nv).
        u_dot: their rates, (samples, nv), the input of inverse dynamics.
        tau: forces at the joints, (samples, nv), the input of forward dynamics.
    """

    q: np.ndarray
    u: np.ndarray
    u_dot: np.ndarray
    tau: np.ndarray


def sample_states(model: Model, samples: int, seed: int, inverse_dynamics: Callable[[States], np.ndarray]) -> States:
    """Draw random states of a model.

    Args:
        model: says how many numbers there are, and which ranges the joints have.
        samples: number of states.
        seed: of the random numbers.
        inverse_dynamics: forces (samples, nv) of states, which say how large forces at the joints are.
    """
    random = np.random.default_rng(seed)
    q = _rounded(sample_coordinates(model, samples, random))
    u, u_dot, tau = (_rounded(random.normal(size=(samples, model.nv))) for _ in range(3))
    size = np.sqrt(np.mean(inverse_dynamics(States(q, u, u_dot, tau)) ** 2, axis=0))
    return States(q, u, u_dot, _rounded(tau * size))


def sample_coordinates(model: Model, samples: int, random: np.random.Generator) -> np.ndarray:
    """Draw generalized coordinates (samples, nq) within the joints' ranges, quaternions uniform over the rotations."""
    return coordinates_within_ranges(model, random.random((samples, numbers_for_coordinates(model))))


def _rounded(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32).astype(np.float64)
