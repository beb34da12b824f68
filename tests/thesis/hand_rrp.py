"""The equations of motion of Kane and Levinson 1983 for the arm with three degrees of freedom, as printed or corrected.

An oracle in NumPy, transcribed from the text alone: quantities Z, and X u' = Y, (1.56). Arrays carry any batch axes behind. The
text's X is minus the mass matrix, and its Y is the bias force less the forces at the joints.

`PRINTED` lists the misprints by name; `equations(..., printed={"Z3"})` evaluates with that one left as printed.
"""

from collections.abc import Set
from typing import Any

import numpy as np

# What the names in `printed` bring back; the corrected form is in the code.
PRINTED = {
    "Z3": "(1.11): Z3 = -Z1 u2 instead of -Z2 u2",
    "Z10": "(1.17): Z10 = Z6 + q2 c1 instead of Z6 - q2 c1",
    "Y2 Z42": "(1.56): Y2 has Z42 instead of Z43",
    "Y2 gravity": "(1.56): in Y2, g multiplies [m2 L2 + m3 Z9 + mR Z14] c1 but not mR px s1",
    "Y3 s2": "(1.56): Y3 has s2 = sin q2 instead of s1",
    "c2": "(1.11): the component along k2 has u1 u2 c2, with c2 = cos q2, instead of u1 u2 c1, which is Z4",
    "k2": "(1.15), (1.17), (1.19): before the cross product, -(LB c1 u2 + u3) along k2 instead of -LB s1 u2 + u3 (C2: no u3)",
    "F1": "(1.54): F1 is T12x instead of T01x",
}
NOTHING: Set[str] = frozenset()

L1, L2, LB = 0.3, 0.5, 1.1
PX, PY, PZ = 0.2, 0.4, 0.6
AX = 11.0
BX, BY, BZ = 7.0, 6.0, 2.0
CX, CY, CZ = 5.0, 4.0, 1.0
D11, D22, D33, D12, D13, D23 = 2.0, 2.5, 1.3, 0.6, -1.1, 0.75
D21, D31, D32 = D12, D13, D23
M1, M2, M3, MR = 87.0, 63.0, 42.0, 50.0
G = 9.81


def equations(q: Any, u: Any, tau: Any, printed: Set[str] = NOTHING) -> tuple[np.ndarray, np.ndarray]:
    """X (3, 3, *batch) and Y (3, *batch) of (1.56).

    Args:
        q: the text's q1, q2, q3, (3, *batch).
        u: generalized speeds u1, u2, u3 = q3', q1', q2', (3, *batch).
        tau: T01x, T12y, F23z, (3, *batch).
        printed: names of the misprints to keep.
    """
    assert printed <= PRINTED.keys(), printed - PRINTED.keys()
    c1, s1, z = quantities(q, u, printed)
    x11 = -(AX + c1 * (z[35] + z[41] + z[49]) + s1 * (z[39] + z[44] + z[53]) + M1 * L1**2 + M2 * z[6] ** 2 + M3 * z[10] ** 2)
    x11 -= MR * (z[13] ** 2 + z[15] ** 2 + z[16] ** 2)
    x12 = -(z[51] + MR * (z[13] * z[14] - z[16] * PX))
    x13 = -MR * z[16]
    x22 = -(BY + CY + D22 + M2 * L2**2 + M3 * z[9] ** 2 + MR * (z[14] ** 2 + PX**2))
    x23, x33 = np.full_like(x11, MR * PX), np.full_like(x11, -(M3 + MR))
    y1 = c1 * (z[36] + z[42] + z[50]) + s1 * (z[40] + z[45] + z[54]) + M2 * z[6] * z[23]
    y1 += M3 * z[10] * z[27] + MR * (z[13] * z[32] + z[15] * z[33] + z[16] * z[34]) - tau[0]
    y2 = z[38] + z[42 if "Y2 Z42" in printed else 43] + z[52] + M2 * L2 * z[22] + M3 * z[9] * z[26]
    y2 += MR * (z[14] * z[32] - PX * z[34]) - tau[1]
    y2 += G * (M2 * L2 + M3 * z[9] + MR * z[14]) * c1 - (1.0 if "Y2 gravity" in printed else G) * MR * PX * s1
    y3 = M3 * z[28] + MR * z[34] - tau[2] + G * (M3 + MR) * (np.sin(q[1]) if "Y3 s2" in printed else s1)
    return np.array([[x11, x12, x13], [x12, x22, x23], [x13, x23, x33]]), np.array([y1, y2, y3])


def active_force(q: Any, tau: Any, printed: Set[str] = NOTHING) -> np.ndarray:
    """Generalized active forces (1.54), (3, *batch). Of `tau`, a fourth row is T12x, the component that does no work."""
    c1, s1 = np.cos(q[0]), np.sin(q[0])
    z9 = L2 + q[1]
    f2 = tau[1] - G * ((M2 * L2 + M3 * z9 + MR * (z9 + PZ)) * c1 - MR * PX * s1)
    return np.array([tau[3 if "F1" in printed else 0], f2, tau[2] - G * (M3 + MR) * s1])


def velocities(q: Any, u: Any, printed: Set[str] = NOTHING) -> np.ndarray:
    """Velocities of C2, C3 and C_R along i2, j2, k2, (3, 3, *batch), as (1.15), (1.17) and (1.19) derive them.

    Each is a partial derivative in link 2 of (1.14), (1.16) or (1.18), plus the angular velocity times that.
    """
    c1, s1, zero = np.cos(q[0]), np.sin(q[0]), np.zeros_like(q[0])
    w = np.array([u[0] * c1, u[1], u[0] * s1])
    result = []
    for x, y, z, rate in ((0, 0, L2, zero), (0, 0, L2 + q[1], u[2]), (PX, PY, L2 + q[1] + PZ, u[2])):
        place = np.array([x - LB * s1, y + zero, LB * c1 + z])
        along = -(LB * c1 * u[1] + rate) if "k2" in printed else -LB * s1 * u[1] + rate
        result.append(np.array([-LB * c1 * u[1], zero, along]) + np.cross(w, place, axis=0))
    return np.array(result)


def quantities(q: Any, u: Any, printed: Set[str] = NOTHING) -> tuple[np.ndarray, np.ndarray, dict[int, Any]]:
    """cos q1, sin q1, and Z1 to Z54 by number."""
    c1, s1 = np.cos(q[0]), np.sin(q[0])
    z: dict[int, Any] = {}
    _velocities(z, q[1], u, c1, s1, printed)
    _accelerations(z, q[1], u, c1, s1)
    if "c2" in printed:
        z[4] = u[0] * u[1] * np.cos(q[1])
    _inertia_torques(z, u, c1, s1)
    return c1, s1, z


def _velocities(z: dict[int, Any], q2: Any, u: Any, c1: Any, s1: Any, printed: Set[str]) -> None:
    """Z1 to Z19, (1.9) to (1.19)."""
    u1, u2, u3 = u
    z[1], z[2] = u1 * c1, u1 * s1
    z[3] = -z[1] * u2 if "Z3" in printed else -z[2] * u2
    z[4] = z[1] * u2
    z[5] = -u1 * L1
    z[6] = -(LB + L2 * c1)
    z[7], z[8] = L2 * u2, z[6] * u1
    z[9] = L2 + q2
    z[10] = z[6] + q2 * c1 if "Z10" in printed else z[6] - q2 * c1
    z[11], z[12] = u2 * z[9], z[10] * u1
    z[13], z[14] = -s1 * PY, z[9] + PZ
    z[15], z[16] = z[10] + s1 * PX - c1 * PZ, c1 * PY
    z[17], z[18], z[19] = u1 * z[13] + u2 * z[14], u1 * z[15], z[16] * u1 - u2 * PX + u3


def _accelerations(z: dict[int, Any], q2: Any, u: Any, c1: Any, s1: Any) -> None:
    """Z20 to Z34, (1.20) to (1.23)."""
    u1, u2, u3 = u
    z[20] = u1 * z[5]
    z[21], z[22] = L2 * s1 * u2, -z[2] * z[8]
    z[23], z[24] = z[21] * u1 + z[2] * z[7], z[1] * z[8] - u2 * z[7]
    z[25] = z[21] - u3 * c1 + q2 * s1 * u2
    z[26] = 2.0 * u2 * u3 - z[2] * z[12]
    z[27], z[28] = z[25] * u1 + z[2] * z[11] - z[1] * u3, z[1] * z[12] - u2 * z[11]
    z[29], z[30], z[31] = -z[16] * u2, z[25] + u2 * (c1 * PX + s1 * PZ), z[13] * u2
    z[32] = z[29] * u1 + u2 * (u3 + z[19]) - z[2] * z[18]
    z[33] = z[30] * u1 + z[2] * z[17] - z[1] * z[19]
    z[34] = z[31] * u1 + z[1] * z[18] - u2 * z[17]


def _inertia_torques(z: dict[int, Any], u: Any, c1: Any, s1: Any) -> None:
    """Z35 to Z54, (1.37) to (1.39), and the constants k above (1.36)."""
    k1, k2, k3, k4, k5, k6 = BY - BZ, BZ - BX, BX - BY, CY - CZ, CZ - CX, CX - CY
    k7, k8, k9 = D33 - D22, D11 - D33, D22 - D11
    k10, k11, k12, k13, k14, k15, k16 = BX + k1, BZ - k3, CX + k4, CZ - k6, D11 - k7, D31 + D13, D33 + k9
    z[35], z[36], z[37] = c1 * BX, z[3] * k10, z[2] * z[1]
    z[38], z[39], z[40] = -z[37] * k2, s1 * BZ, z[4] * k11
    z[41], z[42], z[43] = c1 * CX, z[3] * k12, -z[37] * k5
    z[44], z[45] = s1 * CZ, z[4] * k13
    z[46], z[47], z[48] = z[1] ** 2, u[1] ** 2, z[2] ** 2
    z[49] = D11 * c1 + D13 * s1
    z[50] = k14 * z[3] + k15 * z[4] - D12 * z[37] + D23 * (z[47] - z[48])
    z[51] = D23 * s1 + D21 * c1
    z[52] = D31 * (z[48] - z[46]) + k8 * z[37]
    z[53] = D33 * s1 + D31 * c1
    z[54] = k15 * z[3] + k16 * z[4] + D23 * z[37] + D12 * (z[46] - z[47])
