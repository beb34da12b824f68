"""The pictures of a report: fits, residuals, their spectra, and correlations."""

from typing import Any

import numpy as np
from jaxtyping import Float

from kanejax._identify.report.svg import COLORS, report_package, svg
from kanejax._identify.result import Comparison
from kanejax._regression.information import Spectrum


def fit_picture(comparison: Comparison, index: int, name: str, unit: str, bins: int, key: str) -> str:
    """One signal of one run over time: measured, and predicted by both plants; below the residuals of both."""
    figure = _figure(5.6, 3.3)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    counts = comparison.weight[:, index] > 0
    measured = np.where(counts, comparison.measured[:, index], np.nan)
    predicted, nominal = comparison.predicted[:, index], comparison.nominal[:, index]
    ts = comparison.ts

    def draw(axes: Any, values: np.ndarray, kind: str, **style: Any) -> None:
        axes.plot(*thinned(ts, values, bins), color=COLORS[kind], **style)

    draw(upper, measured, "measured", linewidth=1.6)
    draw(upper, nominal, "nominal", linewidth=1.0, dashes=(3, 1.5))
    draw(upper, predicted, "predicted")
    draw(lower, measured - nominal, "nominal", linewidth=0.8)
    draw(lower, measured - predicted, "predicted", linewidth=1.0)
    lower.axhline(0.0, color=COLORS["faint"], linewidth=0.8)
    upper.set_ylabel(unit)
    lower.set_ylabel("residual")
    lower.set_xlabel("time [s]")
    for axes in (upper, lower):
        axes.margins(x=0.01)
        axes.locator_params(axis="y", nbins=5 if axes is upper else 3)
    figure.align_ylabels()
    return svg(figure, f"{name} in {comparison.name}: measured and predicted signals over time, and residuals", key)


def spectrum_picture(noise: Spectrum, index: int, name: str, unit: str, key: str) -> str:
    """Amplitude density of one signal's residuals over frequency."""
    figure = _figure(3.7, 2.4)
    axes = figure.subplots()
    density = np.sqrt(np.maximum(noise.density[:, index], 0.0))
    drawn = (noise.frequency > 0) & (density > 0)
    if drawn.any():
        axes.loglog(noise.frequency[drawn], density[drawn], color=COLORS["predicted"], linewidth=1.1)
        # Whole decades, and at most six: what is further down is rounding.
        top = np.ceil(np.log10(density[drawn].max()))
        axes.set_ylim(10.0 ** max(np.floor(np.log10(density[drawn].min())), top - 6), 10.0**top)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"{unit} / sqrt(Hz)")
    axes.minorticks_off()
    return svg(figure, f"{name}: amplitude density of the residuals over frequency", key)


def correlation_picture(correlation: Float[np.ndarray, "n n"], key: str) -> str:
    """Correlations as coloured squares: blue for negative, red for positive, and the stronger the more opaque."""
    figure = _figure(5.6, 5.4)
    axes = figure.subplots()
    size = np.clip(np.abs(np.nan_to_num(correlation)), 0.0, 1.0)
    red, blue = np.array((0.80, 0.22, 0.16)), np.array((0.10, 0.42, 0.76))
    color = np.where(correlation[..., None] > 0, red, blue)
    axes.imshow(
        np.concatenate((color, size[..., None]), axis=-1), interpolation="none", extent=(0.5, len(size) + 0.5, len(size) + 0.5, 0.5)
    )
    axes.grid(False)
    locator = report_package("matplotlib.ticker").MaxNLocator(nbins=10, integer=True, min_n_ticks=1)
    axes.xaxis.set_major_locator(locator)
    axes.yaxis.set_major_locator(locator)
    axes.set_xlabel("number of the base parameter")
    return svg(figure, "correlation of each base parameter's error with each other's", key)


def thinned(ts: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"], bins: int) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest value of each of so many stretches of time, which draw the same line as all values."""
    block = -(-len(ts) // bins)
    if block <= 2:
        return ts, values
    rows = np.pad(values, (0, -len(values) % block), constant_values=np.nan).reshape(-1, block)
    missing = np.isnan(rows)
    least, greatest = np.where(missing, np.inf, rows).argmin(axis=1), np.where(missing, -np.inf, rows).argmax(axis=1)
    within = np.sort(np.stack((least, greatest), axis=1), axis=1)
    chosen = np.minimum(within + block * np.arange(len(rows))[:, None], len(ts) - 1)
    return ts[chosen].ravel(), np.where(missing.all(axis=1)[:, None], np.nan, values[chosen]).ravel()


def _figure(width: float, height: float) -> Any:
    return report_package("matplotlib.figure").Figure(figsize=(width, height), layout="constrained")
