"""Energies of a motion over time."""

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from kanejax._dynamics.energy import kinetic_energy, potential_energy
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds, own
from kanejax._model.model import leaf_shapes
from kanejax._plots.arrays import check_one_model, series
from kanejax._plots.style import PAPER, new_figure, on_paper

if TYPE_CHECKING:
    import matplotlib.figure


@on_paper()
def energies(model: AnyModel, path: Any) -> "matplotlib.figure.Figure":
    """Kinetic and potential energy and their sum over time; below, by how much the sum has changed.

    The change is relative to the greatest kinetic energy of the motion, which, unlike the sum, does not depend on where the
    potential energy is zero. Where nothing moves it is in J. Without friction and forces other than gravity and springs it is the
    solver's error.

    Args:
        model: the mechanism.
        path: one motion: what `simulate` or `optimize` returns, or anything else with times ts (n,) [s], coordinates q (n, nq) and
            speeds u (n, nv).

    Raises:
        PlotError: there are several motions, or they are not the model's.
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    check_one_model(model, leaf_shapes(model.tree))
    # Energies are known in chosen speeds too.
    (ts, q), (_, u) = series(model, path, "q", "path"), series(own(model), path, "u", "path")
    kinetic, potential = (np.asarray(each) for each in _energies(model, *(jnp.asarray(x, model.dtype) for x in (ts, q, u))))
    total = kinetic + potential
    figure = new_figure(9.0, 4.6)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for name, values, color in (("kinetic", kinetic, "second"), ("potential", potential, "nominal"), ("total", total, "predicted")):
        upper.plot(ts, values, color=PAPER[color], label=name, linewidth=1.8 if name == "total" else 1.4)
    upper.set_title("energy", loc="left", fontsize="medium", fontweight="bold")
    upper.set_ylabel("J")
    upper.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.0, frameon=False, fontsize="small")
    greatest = float(kinetic[np.isfinite(kinetic)].max(initial=0.0))
    lower.axhline(0.0, color=PAPER["faint"], linewidth=0.8)
    lower.plot(ts, (total - total[0]) / (greatest or 1.0), color=PAPER["predicted"])
    title = "change of the total, relative to the greatest kinetic energy" if greatest else "change of the total"
    lower.set_title(title, loc="left", fontsize="medium", fontweight="bold")
    lower.set_ylabel("" if greatest else "J")
    lower.set_xlabel("time [s]")
    if ts[0] < ts[-1]:
        lower.set_xlim(float(ts[0]), float(ts[-1]))
    figure.align_ylabels()
    return figure


@jax.jit
def _energies(model: AnyModel, ts: jax.Array, q: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
    def at(t: jax.Array, q: jax.Array, u: jax.Array) -> tuple[jax.Array, jax.Array]:
        moving = model.at(t) if isinstance(model, WithSpeeds) else model
        return kinetic_energy(moving, q, u), potential_energy(own(model), q)

    return jax.vmap(at)(ts, q, u)
