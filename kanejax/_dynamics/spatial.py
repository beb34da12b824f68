"""Velocities and wrenches about one point, angular and linear part side by side."""

from collections.abc import Callable

from kanejax._scalar import cross, minus, plus, scale
from kanejax._types import Matrix, Scalar, Vector

# Angular and linear part of a velocity, or moment and force of a wrench: components (rows, *batch).
Spatial = tuple[Vector, Vector]


def motion_cross(a: Spatial, b: Spatial) -> Spatial:
    """How a velocity b changes that moves with a."""
    return cross(a[0], b[0]), plus(cross(a[0], b[1]), cross(a[1], b[0]))


def wrench_cross(v: Spatial, wrench: Spatial) -> Spatial:
    """How a wrench changes that moves with v."""
    return plus(cross(v[0], wrench[0]), cross(v[1], wrench[1])), cross(v[0], wrench[1])


def total(a: Spatial, b: Spatial) -> Spatial:
    """The sum."""
    return plus(a[0], b[0]), plus(a[1], b[1])


def difference(a: Spatial, b: Spatial) -> Spatial:
    """The first without the second."""
    return minus(a[0], b[0]), minus(a[1], b[1])


def scaled(s: Scalar, a: Spatial) -> Spatial:
    """A multiple."""
    return scale(s, a[0]), scale(s, a[1])


def each(function: Callable, *of: Vector | Matrix) -> tuple:
    """A function of components, or of rows."""
    return tuple(function(*parts) for parts in zip(*of, strict=True))
