"""Free coordinates of the numbers of one unknown, and where they start."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._errors import InvalidParameterError
from kanejax._model.model import Model
from kanejax._parameters.coordinates import (
    AbstractCoordinates,
    BoundedCoordinates,
    CentralInertiaCoordinates,
    InertiaCoordinates,
)
from kanejax._parameters.leaves import LEAVES, Element, default_bounds
from kanejax._parameters.nominal_body import NominalBody, Size, default_size, nominal_body
from kanejax._parameters.unknowns import Unknown, bounds_of_parts

# A bounded number that is nearer to its bound than the first fraction of its scale, or of the interval, starts at the second.
_NEAR_BOUND, _SAFE_START = 1e-3, 0.1
_NEAR_END, _SAFE_FRACTION = 1e-3, 0.01


class Start(NamedTuple):
    """Coordinates, where they start, and sentences on how that differs from the given plant."""

    coordinates: AbstractCoordinates
    theta: jax.Array
    notes: tuple[str, ...] = ()


def start_of_bodies(model: Model, unknown: Unknown, chosen: list[Element]) -> Start:
    """Log-Cholesky coordinates about the given bodies, or the nearest that can exist."""
    size = Size(*unknown.scale) if isinstance(unknown.scale, tuple) else default_size(model)
    bodies: list[NominalBody] = []
    for element in chosen:
        mass, com, inertia = (np.asarray(leaf[element.row], float) for leaf in (model.mass, model.com, model.central_inertia))
        if unknown.leaf == "central_inertia":
            mass = np.maximum(mass, size.mass)
        bodies.append(nominal_body(float(mass), com, inertia, size))
    notes = tuple(
        f"body {element.owner!r} starts with {' and '.join(body.changes)}: its own numbers leave no room to change"
        for element, body in zip(chosen, bodies, strict=True)
        if body.changes
    )
    if unknown.leaf == "inertia":
        factor = jnp.asarray(np.stack([body.factor for body in bodies]), model.dtype)
        return Start(InertiaCoordinates(factor), jnp.zeros(10 * len(bodies), model.dtype), notes)
    factor = jnp.asarray(np.stack([body.second for body in bodies]), model.dtype)
    return Start(CentralInertiaCoordinates(factor), jnp.zeros(6 * len(bodies), model.dtype), notes)


def start_of_numbers(model: Model, unknown: Unknown, names: list[str], units: list[str], nominal: np.ndarray) -> Start:
    """Coordinates of single numbers, which start away from their bounds."""
    low, high = _bounds(unknown, names, nominal)
    typical = default_size(model).mass if unknown.leaf == "mass" else LEAVES[unknown.leaf].scale
    scale = np.full(len(nominal), typical if unknown.scale is None else unknown.scale)
    if unknown.scale is None:
        distance = np.where(np.isfinite(low), nominal - low, high - nominal)
        scale = np.where(np.isfinite(low) ^ np.isfinite(high), np.maximum(typical, distance), scale)
    start = np.array([_safe_start(*numbers) for numbers in zip(nominal, low, high, scale, strict=True)])
    coordinates = BoundedCoordinates(*(jnp.asarray(x, model.dtype) for x in (low, high, nominal, scale)))
    return Start(coordinates, coordinates.theta(jnp.asarray(start, model.dtype)), _notes_of_moved(names, units, nominal, start))


def _notes_of_moved(names: list[str], units: list[str], nominal: np.ndarray, start: np.ndarray) -> tuple[str, ...]:
    """One sentence for all numbers that start alike elsewhere than at their bounds."""
    moved: dict[str, list[str]] = {}
    for name, unit, old, new in zip(names, units, nominal, start, strict=True):
        if new != old:
            moved.setdefault(f"{new:.3g}{unit and ' '}{unit} in place of {old:.3g}", []).append(name)
    reason = "so near to a bound it would hardly move"
    return tuple(f"{', '.join(group)}: starts at {change}; {reason}" for change, group in moved.items())


def _bounds(unknown: Unknown, names: list[str], nominal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    given = bounds_of_parts(unknown)
    if given is None:
        bounds = np.array([default_bounds(unknown.leaf, value) for value in nominal])
    else:
        bounds = np.tile(np.stack(given, -1), (len(nominal) // len(given[0]), 1))
    for name, value, (low, high) in zip(names, nominal, bounds, strict=True):
        if not low <= value <= high:
            source = "default bounds" if given is None else "bounds"
            raise InvalidParameterError(f"{name} is {value:.6g} in the given plant, outside of its {source} {low:g} to {high:g}")
    return bounds[:, 0], bounds[:, 1]


def _safe_start(value: float, low: float, high: float, scale: float) -> float:
    """The value, or one a little within the bounds, where the coordinates can move it."""
    if math.isfinite(low) and math.isfinite(high):
        width = high - low
        near_low, near_high = value - low < _NEAR_END * width, high - value < _NEAR_END * width
        return low + _SAFE_FRACTION * width if near_low else high - _SAFE_FRACTION * width if near_high else value
    if math.isfinite(low) and value - low < _NEAR_BOUND * scale:
        return low + _SAFE_START * scale
    if math.isfinite(high) and high - value < _NEAR_BOUND * scale:
        return high - _SAFE_START * scale
    return value
