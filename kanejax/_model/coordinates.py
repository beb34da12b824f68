"""Coordinates within the joints' ranges, from uniform numbers."""

import math

import numpy as np
from jaxtyping import Float

from kanejax._model.model import Model
from kanejax._model.tree import COORDINATES

# Coordinates of joints without a range lie in this interval around zero, in rad or m; wider ranges are cut to it.
_WIDTH = {"revolute": math.pi, "prismatic": 1.0}
# Numbers for a joint: a position, three for a rotation, or both.
_NUMBERS = {"revolute": 1, "prismatic": 1, "ball": 3, "free": 6}


def numbers_for_coordinates(model: Model) -> int:
    """How many uniform numbers `coordinates_within_ranges` turns into coordinates."""
    return sum(_NUMBERS[kind] for kind in model.tree.joint_types)


def coordinates_within_ranges(model: Model, numbers: Float[np.ndarray, "count width"]) -> Float[np.ndarray, "count nq"]:
    """Generalized coordinates within the joints' ranges, quaternions uniform over the rotations.

    Joints without a range take up to half a turn or a metre to either side; a free body lies within a metre of the origin.

    Args:
        model: the mechanism.
        numbers: uniform between 0 and 1, as many for each as `numbers_for_coordinates` says.
    """
    q = np.empty((len(numbers), model.nq))
    ranges = np.asarray(model.joint_range, float)
    used = 0
    for kind, start, limits in zip(model.tree.joint_types, model.tree.q_start, ranges, strict=True):
        own = numbers[:, used : used + _NUMBERS[kind]]
        used += _NUMBERS[kind]
        if kind in _WIDTH:
            low, high = _interval(limits, _WIDTH[kind])
            q[:, start] = low + (high - low) * own[:, 0]
            continue
        end = start + COORDINATES[kind]
        q[:, start : end - 4] = 2.0 * own[:, :-3] - 1.0
        q[:, end - 4 : end] = _rotations(own[:, -3:])
    return q


def _rotations(numbers: Float[np.ndarray, "count 3"]) -> Float[np.ndarray, "count 4"]:
    """Unit quaternions, uniform over the rotations (Shoemake 1992)."""
    size, first, second = numbers[:, 0], 2.0 * np.pi * numbers[:, 1], 2.0 * np.pi * numbers[:, 2]
    a, b = np.sqrt(1.0 - size), np.sqrt(size)
    return np.stack((a * np.sin(first), a * np.cos(first), b * np.sin(second), b * np.cos(second)), 1)


def _interval(limits: Float[np.ndarray, "2"], width: float) -> tuple[float, float]:
    """The part of a joint's range within `width` of zero, or of the end of the range that is nearest to zero."""
    low, high = (float(limit) for limit in limits)
    center = min(max(0.0, low), high)
    return max(low, center - width), min(high, center + width)
