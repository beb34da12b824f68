"""The pictures of a report: fits, residuals, their spectra, and correlations."""

from typing import Any

import numpy as np
from jaxtyping import Float

from kanejax._identify.report.signals import signal_lines
from kanejax._identify.report.svg import COLORS, report_package, svg
from kanejax._identify.result import Comparison
from kanejax._plots.fit import draw_fit, draw_residuals, draw_spectrum
from kanejax._regression.information import Spectrum


def fit_picture(comparison: Comparison, index: int, name: str, unit: str, bins: int, key: str) -> str:
    """One signal of one run over time: measured, and predicted by both plants; below the residuals of both."""
    figure = _figure(5.6, 3.3)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))

    def few(ts: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return thinned(ts, values, bins)

    lines = signal_lines(comparison, index)
    draw_fit(upper, comparison.ts, *lines, COLORS, few)
    draw_residuals(lower, comparison.ts, *lines, COLORS, few)
    upper.set_ylabel(unit)
    lower.set_ylabel("residual")
    lower.set_xlabel("time [s]")
    figure.align_ylabels()
    return svg(figure, f"{name} in {comparison.name}: measured and predicted signals over time, and residuals", key)


def spectrum_picture(noise: Spectrum, index: int, name: str, unit: str, key: str) -> str:
    """Amplitude density of one signal's residuals over frequency."""
    figure = _figure(3.7, 2.4)
    axes = figure.subplots()
    draw_spectrum(axes, noise.frequency, noise.density[:, index], unit, COLORS)
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
