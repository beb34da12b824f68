"""The recursion of Nie 1988, chapter III, written as printed with sums over components, for serial chains of any joints.

Arrays with k, r, j have the link first, then the generalized speed, then the component in the link's own frame. `printed` names
misprints to keep, from `PRINTED` or `PRINTED_MATRIX`.
"""

from collections.abc import Set
from typing import NamedTuple

import numpy as np

PRINTED = {
    "A_ij": "before (3.1): A^k_ij is the product of n_i^k and n_j^(k-1)",
    "(3.7)": "(3.5), (3.7): A^(k-1) instead of A^k",
    "(3.33)": "(3.33): the first bracket of each row is subtracted",
    "(3.34)": "(3.34): the same",
    "(3.42)": "(3.42): E^k_j is under the sum over r",
    "(3.53)": "(3.53): y^(k-1) instead of y^k",
    "F_rm": "(3.59) and steps (6): F_rm is summed over m",
    "step (7)": "second procedure, step (7): K*_r has no minus",
    "PS(K+1,1,R)": "Appendices 4 and 5: DL(K,2) instead of LL(K,2) for a prismatic joint",
    "PS(K+1,3,R)": "Appendix 4: MI(K,2,R) instead of MI(K,3,R) for a prismatic joint",
}
# Of the Intelledex's matrices in AUTOTF.
PRINTED_MATRIX = "A(2,1,3)"
NOTHING: Set[str] = frozenset()


class Chain(NamedTuple):
    """A serial chain of N links with principal inertias.

    Attributes:
        revolute: whether joint k is, otherwise prismatic.
        rotation: what follows the turn about n_3^(k-1) in A^k, (N, 3, 3).
        D: from the k-th origin to the mass centre of link k, (N, 3) in m.
        L: to the next origin, (N, 3) in m.
        mass: in kg, (N,).
        inertia: principal moments, (N, 3) in kg m^2.
        weight: acceleration of gravity in the base frame, (3,).
    """

    revolute: tuple[bool, ...]
    rotation: np.ndarray
    D: np.ndarray
    L: np.ndarray
    mass: np.ndarray
    inertia: np.ndarray
    weight: np.ndarray


class Frames(NamedTuple):
    """The matrices A^k with their rates, (N, 3, 3) each."""

    A: np.ndarray
    A_dot: np.ndarray


class Partials(NamedTuple):
    """Partial (angular) velocities of mass centres with their rates in the link's frame, (N, N, 3) each."""

    w: np.ndarray
    w_dot: np.ndarray
    v: np.ndarray
    v_dot: np.ndarray


def frames(chain: Chain, q: np.ndarray, u: np.ndarray, printed: Set[str] = NOTHING) -> Frames:
    """A^k_ij = n_i^(k-1) . n_j^k."""
    A, A_dot = chain.rotation.copy(), np.zeros_like(chain.rotation)
    for k in np.flatnonzero(chain.revolute):
        c, s = np.cos(q[k]), np.sin(q[k])
        A[k] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ chain.rotation[k]
        A_dot[k] = u[k] * np.array([[-s, -c, 0], [c, -s, 0], [0, 0, 0]]) @ chain.rotation[k]
    if PRINTED_MATRIX in printed:
        A[1, 0, 2] *= -1
    if "A_ij" in printed:
        A, A_dot = np.swapaxes(A, 1, 2), np.swapaxes(A_dot, 1, 2)
    return Frames(A, A_dot)


def partials(chain: Chain, at: Frames, q: np.ndarray, u: np.ndarray, printed: Set[str] = NOTHING) -> Partials:
    """(3.12)-(3.13), and (3.26)-(3.34) with the displacement along A^k_3j of a prismatic joint."""
    n = len(q)
    w, w_dot, v, v_dot = np.zeros((4, n, n, 3))
    # Of the origins; row 0 is that of the base.
    s, s_dot = np.zeros((2, n + 1, n, 3))
    for k in range(n):
        A, A_dot, turns, slides = at.A[k], at.A_dot[k], chain.revolute[k], not chain.revolute[k]
        axis = A[2]
        for r in range(k):
            w[k, r] = w[k - 1, r] @ A
            w_dot[k, r] = w_dot[k - 1, r] @ A + w[k - 1, r] @ A_dot
        if turns:
            w[k, k], w_dot[k, k] = A[2], A_dot[2]
        # Distances, which change where the joint slides, (3.22)-(3.23).
        D, L, rate = chain.D[k] + slides * q[k] * axis, chain.L[k] + slides * q[k] * axis, slides * u[k] * axis
        for r in range(k + 1):
            carried, P = s[k, r] @ A, s_dot[k, r] @ A + s[k, r] @ A_dot
            v[k, r], s[k + 1, r] = carried + np.cross(w[k, r], D), carried + np.cross(w[k, r], L)
            v_dot[k, r] = P + np.cross(w_dot[k, r], D) + sliding(w[k, r], rate, "(3.33)" in printed)
            s_dot[k + 1, r] = P + np.cross(w_dot[k, r], L) + sliding(w[k, r], rate, "(3.34)" in printed)
            if slides and "PS(K+1,1,R)" in printed:
                s[k + 1, r, 0] += w[k, r, 2] * (chain.L[k, 1] - chain.D[k, 1])
            if slides and "PS(K+1,3,R)" in printed:
                s[k + 1, r, 2] += carried[1] - carried[2]
        if slides:
            v[k, k] = s[k + 1, k] = axis
            v_dot[k, k] = s_dot[k + 1, k] = A_dot[2]
    return Partials(w, w_dot, v, v_dot)


def sliding(w: np.ndarray, rate: np.ndarray, minus: bool) -> np.ndarray:
    """What the changing distance adds in (3.33), (3.34): the product of w and its rate; with the misprint, minus at first."""
    first, second = np.roll(w, -1) * np.roll(rate, -2), np.roll(w, -2) * np.roll(rate, -1)
    return (-first if minus else first) - second


def angular_velocities(at: Frames, chain: Chain, u: np.ndarray, printed: Set[str] = NOTHING) -> np.ndarray:
    """(3.7) and (3.9), (N, 3)."""
    w = np.zeros((len(u), 3))
    for k in range(len(u)):
        if k:
            w[k] = w[k - 1] @ at.A[k - 1 if "(3.7)" in printed else k]
        if chain.revolute[k]:
            w[k] += u[k] * at.A[k, 2]
    return w


def forces(chain: Chain, q: np.ndarray, u: np.ndarray, u_dot: np.ndarray, printed: Set[str] = NOTHING) -> np.ndarray:
    """Torques or forces f_r at the joints, (3.62), (N,)."""
    at = frames(chain, q, u, printed)
    p = partials(chain, at, q, u, printed)
    w = angular_velocities(at, chain, u, printed)
    v = np.einsum("krj,r->kj", p.v, u)
    D = np.einsum("krj,r->kj", p.v_dot, u) + np.cross(w, v)
    E = np.einsum("krj,r->kj", p.w_dot, u)
    if "(3.42)" in printed:
        E *= np.arange(1, len(u) + 1)[:, None]
    inertia = chain.inertia
    H = inertia * E + np.cross(w, inertia * w)
    F = np.einsum("kj,kjm,kjr->rm", inertia, p.w.swapaxes(1, 2), p.w.swapaxes(1, 2))
    F += np.einsum("k,kmj,krj->rm", chain.mass, p.v, p.v)
    if "F_rm" in printed:
        F = np.tile(F.sum(1, keepdims=True), (1, len(u)))
    Z = np.einsum("krj,kj->r", p.w, H) + np.einsum("k,krj,kj->r", chain.mass, p.v, D)
    y = [chain.weight @ at.A[0]]
    for k in range(1, len(u)):
        y.append(y[-1] @ at.A[k])
    if "(3.53)" in printed:
        y = [chain.weight, *y[:-1]]
    K_prime = np.einsum("k,krj,kj->r", chain.mass, p.v, np.array(y))
    K_star = F @ u_dot + Z
    return -(K_star if "step (7)" in printed else -K_star) - K_prime
