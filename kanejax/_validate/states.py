"""Random states at which implementations are compared."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from kanejax._model.model import Model
from kanejax._model.tree import COORDINATES

# Coordinates of joints without a range are drawn from this interval, in rad or m; wider ranges are cut to it.
_WIDTH = {"revolute": math.pi, "prismatic": 1.0}


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
    q = np.empty((samples, model.nq))
    ranges = np.asarray(model.joint_range, float)
    for kind, start, limits in zip(model.tree.joint_types, model.tree.q_start, ranges, strict=True):
        end = start + COORDINATES[kind]
        if kind in _WIDTH:
            q[:, start] = random.uniform(*_interval(limits, _WIDTH[kind]), size=samples)
            continue
        if kind == "free":
            q[:, start : start + 3] = random.uniform(-1.0, 1.0, size=(samples, 3))
        turn = random.normal(size=(samples, 4))
        q[:, end - 4 : end] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    return q


def _interval(limits: np.ndarray, width: float) -> tuple[float, float]:
    """The part of a joint's range within `width` of zero, or of the end of the range that is nearest to zero."""
    low, high = (float(limit) for limit in limits)
    center = min(max(0.0, low), high)
    return max(low, center - width), min(high, center + width)


def _rounded(values: np.ndarray) -> np.ndarray:
    return values.astype(np.float32).astype(np.float64)
