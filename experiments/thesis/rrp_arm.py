"""The arm of Kane and Levinson 1983 under its feedback law: Figure 1.2, its energies, and Lagrange's form of its equations.

Four claims: the closed loop comes to rest where the law sends it; the kinetic energy (1.57) is that of the library along the
motion; the equations of motion that automatic differentiation makes of the Lagrangian are those of the library; and generalized
inertia forces follow from the kinetic energy by (1.60) with a minus that the print lacks.

Coordinates and speeds are the model's, (q3, q1, q2) and (u1, u2, u3). Energies are written from the text alone.
"""

import functools
import math
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
from jaxtyping import Array, Float
from matplotlib.figure import Figure

import kanejax as kj
from experiments.thesis import record
from kanejax.robots import rrp_arm

START = (math.pi / 18, math.pi / 6, 0.1)
TARGET = (7 * math.pi / 18, math.pi / 3, 0.4)
DAMPING, STIFFNESS = (464.0, 216.0, 169.0), (306.0, 285.0, 56.0)
DURATION, STEP = 30.0, 0.01
STATES = 1000
G = 9.81
L1, L2, LB, P = 0.3, 0.5, 1.1, (0.2, 0.4, 0.6)
MASSES = (87.0, 63.0, 42.0, 50.0)
AX, B, C, D = 11.0, (7.0, 6.0, 2.0), (5.0, 4.0, 1.0), ((2.0, 0.6, -1.1), (0.6, 2.5, 0.75), (-1.1, 0.75, 1.3))
# Times [s] of the postures in the picture.
SHOWN = (0.0, 1.0, 2.0, 4.0, 8.0, 30.0)

State = Float[Array, "3"]


def feedback(t: Any, q: State, u: State, *, printed: bool = False) -> State:
    """T01x, T12y, F23z of section 1.4: springs and dampers towards the target, and the weight held.

    The print holds F23z's weight with sin q3 where the link leans by q1: `printed` keeps that.
    """
    del t
    q3, q1, q2 = q
    _, m2, m3, mr = MASSES
    c1, s1 = jnp.cos(q1), jnp.sin(q1)
    turning = G * ((m2 * L2 + m3 * (L2 + q2) + mr * (L2 + q2 + P[2])) * c1 - mr * P[0] * s1)
    sliding = G * (m3 + mr) * (jnp.sin(q3) if printed else s1)
    weight = jnp.stack((jnp.zeros_like(turning), turning, sliding))
    return weight - jnp.asarray(DAMPING, q.dtype) * u - jnp.asarray(STIFFNESS, q.dtype) * (q - jnp.asarray(TARGET, q.dtype))


def kinetic_energy(q: State, u: State) -> Float[Array, ""]:
    """Kinetic energy [J], (1.57) to (1.59), with the velocities (1.9), (1.13), (1.15), (1.17) and (1.19)."""
    (_, q1, q2), (u1, u2, u3) = q, u
    c1, s1, (px, py, pz), zero = jnp.cos(q1), jnp.sin(q1), P, jnp.zeros_like(q1)
    w = jnp.stack((u1 * c1, u2, u1 * s1))
    v1 = jnp.stack((zero, -u1 * L1, zero))
    v2 = jnp.stack((L2 * u2, -(LB + L2 * c1) * u1, zero))
    z9, z10 = L2 + q2, -(LB + (L2 + q2) * c1)
    v3 = jnp.stack((u2 * z9, u1 * z10, u3))
    vr = jnp.stack((-u1 * s1 * py + u2 * (z9 + pz), u1 * (z10 + s1 * px - c1 * pz), u1 * c1 * py - u2 * px + u3))
    linear = sum(m * v @ v for m, v in zip(MASSES, (v1, v2, v3, vr), strict=True))
    inertia = jnp.asarray(np.diag(B) + np.diag(C) + np.array(D), q.dtype)
    return 0.5 * (linear + AX * u1**2 + w @ inertia @ w)


def potential_energy(q: State) -> Float[Array, ""]:
    """Energy [J] of gravity, zero at the height of A: the components of (1.12), (1.14), (1.16) and (1.18) along i0."""
    _, q1, q2 = q
    _, m2, m3, mr = MASSES
    c1, s1 = jnp.cos(q1), jnp.sin(q1)
    return G * (m2 * L2 * s1 + m3 * (L2 + q2) * s1 + mr * (P[0] * c1 + (L2 + q2 + P[2]) * s1))


def lagrange_force(energy: Callable[[State, State], Array], q: State, u: State, u_dot: State) -> State:
    """d/dt (dE/du) - dE/dq along a motion with q' = u, by automatic differentiation."""
    along = jax.jvp(jax.grad(energy, argnums=1), (q, u), (u, u_dot))[1]
    return along - jax.grad(energy)(q, u)


def lagrange_accelerations(q: State, u: State, tau: State) -> State:
    """Rates u' from the Lagrangian T - V: `lagrange_force` is linear in u', with the mass matrix as its derivative."""

    def force(u_dot: State) -> State:
        return lagrange_force(lambda q, u: kinetic_energy(q, u) - potential_energy(q), q, u, u_dot)

    rest = jnp.zeros_like(u)
    return jnp.linalg.solve(jax.jacfwd(force)(rest), tau - force(rest))


def closed_loop(model: kj.Model, *, solver: diffrax.AbstractSolver | None = None, printed: bool = False) -> kj.Trajectory:
    """30 s of the feedback law from rest in equal steps, ten frames a second."""
    law = functools.partial(feedback, printed=printed)
    ts, start = np.linspace(0.0, DURATION, 301), jnp.asarray(START, model.dtype)
    return kj.simulate(model, start, jnp.zeros_like(start), ts, control=law, solver=solver, dt0=STEP, throw=True)


def compare_energies(model: kj.Model, path: kj.Trajectory) -> float:
    """Largest difference of the kinetic energy (1.57) and the library's along a motion, relative to its largest value."""
    ours = jax.jit(jax.vmap(functools.partial(kj.kinetic_energy, model)))(path.q, path.u)
    return relative(jax.jit(jax.vmap(kinetic_energy))(path.q, path.u), ours)


def compare_lagrange(model: kj.Model) -> dict[str, float]:
    """Largest relative differences over random states between Lagrange's form and the library.

    Returns:
        Of the accelerations, and of the generalized inertia forces by (1.60), with its minus and as printed.
    """
    random = np.random.default_rng(record.SEED)
    # q3, q1 and their rates, q2 and its rate; torques and the force as large as the weights.
    q = jnp.asarray(random.uniform((-math.pi, -math.pi, 0.0), (math.pi, math.pi, 1.0), (STATES, 3)))
    u, u_dot = jnp.asarray(random.uniform(-2.0, 2.0, (2, STATES, 3)))
    tau = jnp.asarray(random.uniform(-2000.0, 2000.0, (STATES, 3)))
    ours = jax.jit(jax.vmap(functools.partial(kj.forward_dynamics, model)))(q, u, tau)
    inertia = jax.jit(jax.vmap(functools.partial(kj.generalized_inertia_force, model)))(q, u, u_dot)
    theirs = jax.jit(jax.vmap(functools.partial(lagrange_force, kinetic_energy)))(q, u, u_dot)
    return {
        "lagrange_accelerations": relative(jax.jit(jax.vmap(lagrange_accelerations))(q, u, tau), ours),
        "lagrange_inertia_forces": relative(-theirs, inertia),
        "lagrange_inertia_forces_as_printed": relative(theirs, inertia),
    }


def relative(actual: Array, expected: Array) -> float:
    """Largest difference as a fraction of the largest expected value."""
    return float(jnp.max(jnp.abs(actual - expected)) / jnp.max(jnp.abs(expected)))


def run(directory: Path) -> dict[str, Any]:
    """Write rrp_arm.png and rrp_arm.json to `directory`; returns the numbers."""
    with warnings.catch_warnings():
        # RB's printed inertia breaks the triangle inequality.
        warnings.simplefilter("ignore", kj.UnphysicalInertiaWarning)
        model = rrp_arm()
    path, printed = closed_loop(model), closed_loop(model, printed=True)
    other = closed_loop(model, solver=diffrax.Dopri8())
    numbers = {
        "largest_difference_from_target": float(jnp.max(jnp.abs(path.q[-1] - jnp.asarray(TARGET)))),
        "kinetic_energy": compare_energies(model, path),
        **compare_lagrange(model),
        "two_integrators": float(jnp.max(jnp.abs(path.q - other.q))),
        "coordinates": ["q1 [rad]", "q2 [m]", "q3 [rad]"],
        "target": text_order(TARGET),
        "at_10_s": text_order(path.q[100]),
        "at_30_s": text_order(path.q[-1]),
        "at_10_s_force_law_as_printed": text_order(printed.q[100]),
        "at_30_s_force_law_as_printed": text_order(printed.q[-1]),
        "states": STATES,
    }
    record.save(directory, "rrp_arm", draw(model, path, printed))
    record.write(directory, "rrp_arm", numbers)
    record.require(numbers["largest_difference_from_target"] < 1e-5, "the arm reaches the target")
    record.require(numbers["kinetic_energy"] < 1e-12, "the kinetic energy (1.57) is the library's")
    record.require(numbers["lagrange_accelerations"] < 1e-11, "Lagrange's equations of motion are the library's")
    record.require(numbers["lagrange_inertia_forces"] < 1e-11, "(1.60) with a minus gives the generalized inertia forces")
    return numbers


def text_order(q: Any) -> list[float]:
    """Coordinates as q1, q2, q3."""
    return [float(q[i]) for i in (1, 2, 0)]


def draw(model: kj.Model, path: kj.Trajectory, printed: kj.Trajectory) -> Figure:
    """Figure 1.2, coordinates against time, and beside it the arm in its postures."""
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    figure.suptitle("Arm of Kane and Levinson 1983 under its feedback law")
    grid = figure.add_gridspec(3, 2)
    for row, (name, unit, index) in enumerate((("q_1", "rad", 1), ("q_2", "m", 2), ("q_3", "rad", 0))):
        axes = figure.add_subplot(grid[row, 0])
        axes.axhline(TARGET[index], color="0.6", linewidth=0.8, label="target")
        red, blue = record.COLORS[1], record.COLORS[0]
        axes.plot(printed.ts, printed.q[:, index], "--", color=red, linewidth=1, label="force law as printed (sin $q_3$)")
        axes.plot(path.ts, path.q[:, index], color=blue, label="force law corrected (sin $q_1$)")
        axes.set(ylabel=f"${name}$ [{unit}]", xlim=(0, DURATION))
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelbottom=row == 2)
    axes.set_xlabel("time [s]")
    axes.legend(fontsize="small", loc="lower right")
    _draw_arm(model, path, figure.add_subplot(grid[:, 1], projection="3d"))
    return figure


def _draw_arm(model: kj.Model, path: kj.Trajectory, axes: Any) -> None:
    """From A by B and C3 to the mass centre of the load, from dark to light as time passes, and the load's path."""
    poses = jax.jit(jax.vmap(functools.partial(kj.poses, model)))(path.q)
    points = np.concatenate((np.asarray(poses.origin)[:, :3], np.asarray(poses.com)[:, 3:]), axis=1)
    axes.plot(*points[:, -1].T, color="0.5", linewidth=1)
    for number, t in enumerate(SHOWN):
        frame = points[int(np.argmin(np.abs(np.asarray(path.ts) - t)))]
        color = mpl.colormaps["viridis"](number / len(SHOWN))
        axes.plot(*frame.T, "o-", color=color, linewidth=2.5, markersize=4, label=f"{t:g} s")
    axes.set(xlabel="$j_0$ [m]", ylabel="$k_0$ [m]", zlabel="$i_0$ (up) [m]")
    axes.locator_params(nbins=5)
    # Equal scales, and room for the labels.
    axes.set_box_aspect([np.ptp(limits) for limits in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim())], zoom=0.78)
    axes.view_init(elev=22, azim=-35)
    axes.legend(fontsize="small", title="A, B, $C_3$, $C_R$", loc="upper left")
