"""AUTOTF: the torques at the six joints of the Intelledex 605 along the specified motion, Nie's Figures 3.3-3.8.

The torques come from the recursion, `inverse_dynamics`, and once more from Kane's equations written out body by body,
F u_dot + Z = K + tau, Nie (3.56). The reference torques are those of the equations printed in the thesis, once their misprints
are corrected.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import kanejax as kj
from experiments.thesis import record
from experiments.thesis.motion import DURATION, motion, motions
from kanejax.robots import intelledex_605

REFERENCE_TIMES = (0.0, 1.0, 2.0)
REFERENCE = (
    (0.0, 0.0, -51.41806886, -15.63086866, 0.0, 0.0),
    (-3.65240562, 23.80108726, -29.90338861, -4.44952941, 0.00752381, -0.00450906),
    (10.24418406, 7.55862433, 14.24269294, 9.76929291, 0.0, 0.0),
)
"""Torques [N m] at these times [s], to the eight decimals that are known."""


def torques(ts: Float[Array, " n"]) -> Float[Array, "n 6"]:
    """Torques [N m] along the motion, at times [s]."""
    batched = jax.jit(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0)))
    return batched(intelledex_605(), *motions(ts))


def explicit_torques(ts: Float[Array, " n"]) -> Float[Array, "n 6"]:
    """The same from partial velocities, body by body."""
    model = intelledex_605()

    def at(t: Float[Array, ""]) -> Float[Array, " 6"]:
        q, u, u_dot = motion(t)
        terms = kj.kane_equations(model, q, u)
        return terms.mass_matrix @ u_dot + terms.inertia_remainder - terms.gravity_force

    return jax.jit(jax.vmap(at))(ts)


def run(directory: Path) -> dict:
    """Compute and draw the torques, and compare them; fails where they differ from the reference by more than its last digit."""
    ts = jnp.linspace(0.0, DURATION, 401)
    tau = torques(ts)
    at_reference = np.abs(np.asarray(torques(jnp.array(REFERENCE_TIMES))) - np.array(REFERENCE))
    numbers = {
        "largest_deviation_from_reference_Nm": float(at_reference.max()),
        "largest_deviation_from_explicit_equations_Nm": float(jnp.max(jnp.abs(tau - explicit_torques(ts)))),
        "largest_torque_Nm": float(jnp.max(jnp.abs(tau))),
        "deviation_from_reference_Nm": at_reference.tolist(),
        "least_torques_Nm": jnp.min(tau, axis=0).tolist(),
        "greatest_torques_Nm": jnp.max(tau, axis=0).tolist(),
    }
    record.save(directory, "autotf", _picture(np.asarray(ts), np.asarray(tau)))
    record.write(directory, "autotf", numbers)
    record.require(numbers["largest_deviation_from_reference_Nm"] <= 6e-9, "the torques are the reference ones to 8 decimals")
    return numbers


def _picture(ts: np.ndarray, tau: np.ndarray) -> record.Figure:
    title = "AUTOTF: torques of the Intelledex 605 along the specified motion (Nie 1988, Figures 3.3-3.8)"
    figure, axes = record.figure_of(2, 3, size=(11, 5.6), title=title)
    for joint, (each, color) in enumerate(zip(axes, record.COLORS, strict=True)):
        each.plot(ts, tau[:, joint], color=color, linewidth=2)
        each.plot(
            REFERENCE_TIMES, np.array(REFERENCE)[:, joint], "o", color="black", markersize=5, label="printed equations, corrected"
        )
        each.axhline(0, color="#999999", linewidth=0.8)
        each.set_ylabel(rf"$\tau_{joint + 1}$ [N m]")
        each.set_title(f"Figure 3.{3 + joint}", fontsize=9, color="#666666", loc="left")
        each.set_xlim(-0.03 * DURATION, 1.03 * DURATION)
    for each in axes[3:]:
        each.set_xlabel("t [s]")
    axes[0].legend(frameon=False, fontsize=8)
    return figure
