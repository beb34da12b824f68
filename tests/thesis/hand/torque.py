"""The program TORQUE, Nie 1988, Appendix 2: the torques of a given motion."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tests.thesis.hand import accelerations, active_forces, inertia_coefficients, inertia_forces, velocities
from tests.thesis.hand.arm import configuration, named
from tests.thesis.hand.equations import Equations, evaluate, instead, parse

# Generalized speeds, (2.18), and their rates, from the rates QP and QDP of the coordinates.
SPEEDS = """
u1 = QP1 * s2 * c3 - QP2 * s3
u2 = -QP1 * s2 * s3 - QP2 * c3
u3 = QP1 * c2 + QP3
u4 = QP4
u5 = QP5
u6 = QP6
UP1 = QDP1 * s2 * c3 + QP1 * QP2 * c2 * c3 - QP1 * QP3 * s2 * s3 - QDP2 * s3 - QP2 * QP3 * c3
UP2 = -(QDP1 * s2 * s3 + QP1 * QP2 * c2 * s3 + QP1 * QP3 * s2 * c3 + QDP2 * c3 - QP2 * QP3 * s3)
UP3 = QDP1 * c2 - QP1 * QP2 * s2 + QDP3
UP4 = QDP4
UP5 = QDP5
UP6 = QDP6
"""

# Appendix 1, the list of intermediate variables, with the X of the programs.
APPENDIX_1 = parse(
    velocities.ANGULAR,
    velocities.LINEAR,
    accelerations.ANGULAR,
    accelerations.LINEAR,
    inertia_forces.LINKS,
    inertia_forces.REMAINDERS,
    inertia_coefficients.PROGRAMS,
    active_forces.GRAVITY,
)

# Generalized inertia forces, (2.51), and the equations of motion, (2.58), solved for the torques.
TORQUES = """
KI1 = X11 * UP1 + X12 * UP2 + X13 * UP3 + X14 * UP4 + X15 * UP5 + X16 * UP6 + Z243
KI2 = X21 * UP1 + X22 * UP2 + X23 * UP3 + X24 * UP4 + X25 * UP5 + X26 * UP6 + Z244
KI3 = X31 * UP1 + X32 * UP2 + X33 * UP3 + X34 * UP4 + X35 * UP5 + X36 * UP6 + Z245
KI4 = X41 * UP1 + X42 * UP2 + X43 * UP3 + X44 * UP4 + X45 * UP5 + X46 * UP6 + Z246
KI5 = X51 * UP1 + X52 * UP2 + X53 * UP3 + X54 * UP4 + X55 * UP5 + X56 * UP6 + Z247
KI6 = X61 * UP1 + X62 * UP2 + X63 * UP3 + X64 * UP4 + X65 * UP5 + X66 * UP6 + Z248
T3 = -(KI3 + Z283)
T4 = -(KI4 + Z284)
T5 = -(KI5 + Z285)
T6 = -KI6
V1 = -KI1 - Z281 + T3 * Z8
V2 = -KI2 - Z282 + T3 * Z9
DET = -1.0 / s2
T1 = (V2 * s3 - V1 * c3) / DET
T2 = (Z4 * V2 - Z5 * V1) / DET
"""

TORQUE: Equations = parse(SPEEDS) | APPENDIX_1 | parse(TORQUES)


def variables(
    arm: Mapping[str, Any], q: np.ndarray, q_dot: np.ndarray, q_ddot: np.ndarray, printed: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """All variables of the program at given states, (n, 6) each; `printed` has equations to take in another form."""
    known = {**arm, **configuration(q), **named("QP*", q_dot), **named("QDP*", q_ddot)}
    return evaluate(instead(TORQUE, printed or {}), known)


def torque(
    arm: Mapping[str, Any], q: np.ndarray, q_dot: np.ndarray, q_ddot: np.ndarray, printed: Mapping[str, str] | None = None
) -> np.ndarray:
    """Torques [N m] at the six joints, (n, 6)."""
    values = variables(arm, q, q_dot, q_ddot, printed)
    return np.stack([values[f"T{joint}"] for joint in range(1, 7)], axis=-1)


def speed_matrix(q: np.ndarray) -> np.ndarray:
    """U of u = U q', (2.18), (..., 6, 6)."""
    at = configuration(q)
    U = np.zeros((*q.shape[:-1], 6, 6))
    U[..., 0, 0], U[..., 0, 1] = at["s2"] * at["c3"], -at["s3"]
    U[..., 1, 0], U[..., 1, 1] = -at["s2"] * at["s3"], -at["c3"]
    U[..., 2, 0], U[..., 2, 2] = at["c2"], 1
    U[..., [3, 4, 5], [3, 4, 5]] = 1
    return U


def motion(t: np.ndarray, span: float = 2.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates of the thesis's motion, II.5, and their first and second derivatives at times t [s], (n, 6) each."""
    phase, share = 2 * np.pi * t / span, np.array([1, -0.5, 1, 1, 1, 1]) / (3 * span)
    q = np.pi * (t - span / (2 * np.pi) * np.sin(phase))
    start = np.array([0, np.pi / 2, 0, 0, 0, 0])
    rate, second = np.pi * (1 - np.cos(phase)), 2 * np.pi**2 / span * np.sin(phase)
    return start + q[..., None] * share, rate[..., None] * share, second[..., None] * share
