"""The twelve first-order equations of the program ANGLE, Nie 1988, (2.59) and Appendix 3."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tests.thesis.hand.arm import configuration, named
from tests.thesis.hand.equations import evaluate, parse
from tests.thesis.hand.torque import APPENDIX_1

# FN(1) to FN(6) of the program, (2.19), for the rates of the coordinates.
KINEMATICS = """
QP1 = (u1 * c3 - u2 * s3) / s2
QP2 = -u1 * s3 - u2 * c3
QP3 = u3 + (u2 * s3 - u1 * c3) * c2 / s2
QP4 = u4
QP5 = u5
QP6 = u6
"""

# Generalized active forces, (2.56).
ACTIVE_FORCES = """
KA1 = TQ1 * Z4 - TQ2 * s3 - TQ3 * Z8 + Z281
KA2 = TQ1 * Z5 - TQ2 * c3 - TQ3 * Z9 + Z282
KA3 = TQ3 + Z283
KA4 = TQ4 + Z284
KA5 = TQ5 + Z285
KA6 = TQ6
"""

ANGLE = parse(KINEMATICS) | APPENDIX_1 | parse(ACTIVE_FORCES)
_SIX = range(1, 7)


def coefficients(values: Mapping[str, Any]) -> np.ndarray:
    """X_rs, (..., 6, 6)."""
    like = np.zeros_like(values["u1"])
    return np.stack([np.stack([values[f"X{r}{s}"] + like for s in _SIX], -1) for r in _SIX], -2)


def rates(arm: Mapping[str, Any], q: np.ndarray, u: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rates of q and of the generalized speeds u of (2.18), under torques [N m]; (..., 6) each.

    FN(7) to FN(12) set the sums of generalized inertia forces, X u' + Z243 to Z248, and active forces to zero.
    """
    known = {**arm, **configuration(q), **named("u*", u), **named("TQ*", tau)}
    values = evaluate(ANGLE, known)
    right = -np.stack([values[f"Z{242 + r}"] + values[f"KA{r}"] for r in _SIX], -1)
    u_dot = np.linalg.solve(coefficients(values), right[..., None])[..., 0]
    return np.stack([values[f"QP{r}"] for r in _SIX], -1), u_dot
