"""The arm's parameters and the sines and cosines of its configuration, under the names of the equations."""

from typing import Any

import numpy as np

Symbols = dict[str, Any]

LINKS = "ABCDEF"
# Nie 1988, Table 3: masses [kg], lengths [m] and central principal moments of inertia [kg m^2].
MASS = (18.1440, 12.2472, 8.6184, 4.9896, 1.3608, 0.9072)
LENGTH = {"L1": 0.2794, "L2": 0.3226, "L12": 0.1397, "L13": 0.1588, "L22": 0.0127, "L31": 0.1880, "L41": 0.1727}
INERTIA = (
    (0.1800, 0.0450, 0.1350),
    (0.0300, 0.0300, 0.0232),
    (0.1041, 0.1041, 0.0260),
    (0.0605, 0.0605, 0.0260),
    (0.0048, 0.0048, 0.0035),
    (0.0040, 0.0040, 0.0030),
)
# The four lengths of the equations that Table 3 leaves out.
OMITTED = ("L33", "L43", "L52", "L63")


def parameters(omitted: Any = (0.0, 0.0, 0.0, 0.0), mass: Any = MASS, inertia: Any = INERTIA) -> Symbols:
    """Parameters by name, those of Table 3 unless given.

    Args:
        omitted: L33, L43, L52, L63 in m.
        mass: of links A to F in kg, (6,).
        inertia: central principal moments of inertia of links A to F in kg m^2, (6, 3).
    """
    masses = {f"m{link}": float(m) for link, m in zip(LINKS, mass, strict=True)}
    moments = {f"{link}{axis + 1}": float(inertia[k][axis]) for k, link in enumerate(LINKS) for axis in range(3)}
    return {**LENGTH, **dict(zip(OMITTED, map(float, omitted), strict=True)), **masses, **moments, "g": 9.81}


def configuration(q: np.ndarray) -> Symbols:
    """Sines and cosines of the coordinates in rad, (..., 6), and of the sums of them that the equations have."""
    angles = {str(k + 1): q[..., k] for k in range(6)}
    for several in ("34", "45", "345"):
        angles[several] = q[..., [int(k) - 1 for k in several]].sum(-1)
    sines = {f"s{name}": np.sin(angle) for name, angle in angles.items()}
    return sines | {f"c{name}": np.cos(angle) for name, angle in angles.items()}


def named(pattern: str, values: np.ndarray) -> Symbols:
    """The six columns of an array by name, `pattern` with 1 to 6 in place of the asterisk."""
    return {pattern.replace("*", str(k + 1)): values[..., k] for k in range(6)}
