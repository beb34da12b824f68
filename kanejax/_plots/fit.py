"""Signals that were measured beside those that are predicted, what is left of them, and its spectrum."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from kanejax._plots.style import Colors

if TYPE_CHECKING:
    import matplotlib.axes

Vector = Float[np.ndarray, " n"]
# From times and values to those that are drawn.
Thinned = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
FIT_LINES = {"measured": {"linewidth": 1.6}, "nominal": {"linewidth": 1.0, "dashes": (3, 1.5)}, "predicted": {}}
"""How each is drawn."""


def all_of(ts: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draw everything."""
    return ts, values


def draw_fit(
    axes: "matplotlib.axes.Axes",
    ts: Vector,
    measured: Vector,
    predicted: Vector,
    nominal: Vector,
    colors: Colors,
    thinned: Thinned = all_of,
) -> None:
    """A measured signal, and what two plants predict; nan is not drawn."""
    for (kind, style), values in zip(FIT_LINES.items(), (measured, nominal, predicted), strict=True):
        axes.plot(*thinned(ts, values), color=colors[kind], **style)
    axes.margins(x=0.01)
    axes.locator_params(axis="y", nbins=5)


def draw_residuals(
    axes: "matplotlib.axes.Axes",
    ts: Vector,
    measured: Vector,
    predicted: Vector,
    nominal: Vector,
    colors: Colors,
    thinned: Thinned = all_of,
) -> None:
    """What is left of a measured signal less what two plants predict."""
    axes.plot(*thinned(ts, measured - nominal), color=colors["nominal"], linewidth=0.8)
    axes.plot(*thinned(ts, measured - predicted), color=colors["predicted"], linewidth=1.0)
    axes.axhline(0.0, color=colors["faint"], linewidth=0.8)
    axes.margins(x=0.01)
    axes.locator_params(axis="y", nbins=3)


def draw_spectrum(axes: "matplotlib.axes.Axes", frequency: Vector, density: Vector, unit: str, colors: Colors) -> None:
    """Amplitude density over frequency, of a power spectral density."""
    amplitude = np.sqrt(np.maximum(density, 0.0))
    drawn = (frequency > 0) & (amplitude > 0)
    if drawn.any():
        axes.loglog(frequency[drawn], amplitude[drawn], color=colors["predicted"], linewidth=1.1)
        # Whole decades, and at most six: what is further down is rounding.
        top = np.ceil(np.log10(amplitude[drawn].max()))
        axes.set_ylim(10.0 ** max(np.floor(np.log10(amplitude[drawn].min())), top - 6), 10.0**top)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"{unit} / sqrt(Hz)")
    axes.minorticks_off()
