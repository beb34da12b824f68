"""Nominal bodies: where log-Cholesky coordinates are zero.

They need a positive definite pseudo-inertia. Models have bodies without one: massless frames, point masses, thin rods, flat plates,
and numbers that break A + B >= C. For these, the nearest body that has one stands in: the mass centre stays, the second moments
about it are raised in their principal axes, and what is missing altogether comes from the sizes of the other bodies.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from kanejax._model.model import Model
from kanejax._model.tree import WORLD

# Second moments are raised to this fraction of the largest: a hundredth of the length.
LEAST_SECOND_MOMENT = 1e-4
# A mass, or all second moments, below this fraction of the size that stands in count as missing.
_MISSING = 1e-4
# What stands in, as a fraction of the mean mass and the mean radius of gyration of the bodies that move.
_MASS, _RADIUS = 0.01, 0.1
# Those means, in kg and m, where no body has any.
_MEAN_MASS, _MEAN_RADIUS = 1.0, 0.1


class Size(NamedTuple):
    """What a body gets that has none: mass [kg], and radius of gyration [m] about its mass centre."""

    mass: float
    radius: float


class NominalBody(NamedTuple):
    """A body with a positive definite pseudo-inertia.

    Attributes:
        factor: upper triangular factor of the pseudo-inertia.
        second: of the second moment about the mass centre.
        changes: what differs from the model's body, in words; empty where nothing does.
    """

    factor: Float[np.ndarray, "4 4"]
    second: Float[np.ndarray, "3 3"]
    changes: tuple[str, ...]


def default_size(model: Model) -> Size:
    """A hundredth of the mean mass, and a tenth of the mean radius of gyration, of the moving bodies that have some."""
    moves = np.array([link != WORLD for link in model.tree.body_links], bool)
    mass = np.asarray(model.mass, float)
    heavy = moves & (mass > 0)
    trace = np.trace(np.asarray(model.central_inertia, float), axis1=1, axis2=2)
    radius = np.sqrt(np.maximum(trace[heavy], 0.0) / (3.0 * mass[heavy]))
    radius = radius[radius > 0]
    mean_mass = mass[heavy].mean() if heavy.any() else _MEAN_MASS
    return Size(_MASS * float(mean_mass), _RADIUS * float(radius.mean() if len(radius) else _MEAN_RADIUS))


def nominal_body(mass: float, com: np.ndarray, central_inertia: np.ndarray, size: Size) -> NominalBody:
    """The nearest body with a positive definite pseudo-inertia; `size` is for what is missing."""
    changes = []
    if mass <= _MISSING * size.mass:
        changes.append(f"a mass of {size.mass:.3g} kg in place of {mass:.3g} kg")
        mass = size.mass
    inertia = 0.5 * (central_inertia + central_inertia.T)
    values, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    # A ball with radius of gyration r about each axis has second moments m r^2 / 2.
    ball = 0.5 * mass * size.radius**2
    if values[-1] <= _MISSING * ball:
        changes.append(f"the inertia of a ball with a radius of gyration of {size.radius:.3g} m")
        values = np.full(3, ball)
    elif values[0] < LEAST_SECOND_MOMENT * values[-1]:
        changes.append(f"second moments of at least {LEAST_SECOND_MOMENT:g} of the largest about the mass centre")
        values = np.maximum(values, LEAST_SECOND_MOMENT * values[-1])
    second = upper_factor((axes * values) @ axes.T)
    factor = np.zeros((4, 4))
    factor[:3, :3], factor[:3, 3], factor[3, 3] = second, np.sqrt(mass) * com, np.sqrt(mass)
    return NominalBody(factor, second, tuple(changes))


def upper_factor(matrix: np.ndarray) -> np.ndarray:
    """The upper triangular L with L L^T = matrix."""
    return np.linalg.cholesky(matrix[::-1, ::-1])[::-1, ::-1]
