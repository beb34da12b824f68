"""The time by which measured efforts lag those that a model predicts."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from kanejax._errors import LogError
from kanejax._logs.motion import Motion

# Delays on each side of zero that are tried first.
_TRIED = 50
# Of several minima, as periodic motions have them, the one nearest to zero counts if it is so good, in parts of the whole variance.
_AS_GOOD = 0.05
# A channel that follows the prediction with less than this correlation tells no delay.
_LEAST_CORRELATION = 0.3


class Delay(NamedTuple):
    """Times by which efforts lag the motion.

    Attributes:
        common: one time [s] for all channels.
        channels: the time [s] of each channel alone, NaN where it tells none.
    """

    common: float
    channels: Float[np.ndarray, " nv"]


def estimated_delay(motion: Motion, predicted: Float[ArrayLike, "n nv"], *, longest: float = 0.1) -> Delay:
    """Estimate by how much the measured effort lags a predicted one, to a fraction of a sample.

    The prediction, moved by a delay along a cubic spline, is fitted to the measured effort by a positive factor and an offset for
    each channel; the best delay leaves the least squares. For all channels together, each counts by what its own delay leaves.

    Args:
        motion: with the measured effort; samples of weight 0 do not count.
        predicted: efforts at the times of the motion without delay, such as a fitted model's. Errors of scale do not matter.
        longest: greatest delay [s] to look for, and least, with a minus. Of those as good as each other the one nearest to
            zero is taken.

    Returns:
        The delays; negative where the prediction lags.

    Raises:
        LogError: the motion is too short, the prediction does not fit it, no channel tells a delay, or it is at an end.
    """
    ts, measured, weight = (np.asarray(x, np.float64) for x in (motion.ts, motion.effort, motion.weight))
    predictions = np.asarray(predicted, np.float64)
    if predictions.shape != measured.shape or not np.all(np.isfinite(predictions)):
        shape = f"{predictions.shape}" if predictions.shape != measured.shape else "numbers that are not finite"
        raise LogError(f"motion {motion.name!r}: predicted has {shape}, but needs the shape of the effort, {measured.shape}")
    inner = (ts >= ts[0] + longest) & (ts <= ts[-1] - longest)
    if not longest > 0 or ts[-1] - ts[0] < 4.0 * longest or inner.sum() < 4:
        duration = f"{ts[-1] - ts[0]:.4g} s"
        raise LogError(f"motion {motion.name!r} of {duration} is too short for delays of up to {longest} s; four times is needed")
    fit = _Fit(CubicSpline(ts, predictions, axis=0), ts[inner], measured[inner], weight[inner])
    delays = np.linspace(-longest, longest, 2 * _TRIED + 1)
    table = np.array([fit.left_over(delay) for delay in delays])
    channels, least = np.full(measured.shape[1], np.nan), np.ones(measured.shape[1])
    for j, column in enumerate(table.T):
        place = _nearest_minimum(column)
        if place is None or 1.0 - column[place] < _LEAST_CORRELATION**2:
            continue
        channels[j] = _refined(lambda delay, j=j: fit.left_over(delay)[j], delays, place)
        least[j] = fit.left_over(channels[j])[j]
    return Delay(_common(fit, motion.name, delays, table, np.isfinite(channels), least), channels)


class _Fit(NamedTuple):
    """The prediction as a function of time, and what was measured at some times."""

    prediction: CubicSpline
    ts: np.ndarray
    measured: np.ndarray
    weight: np.ndarray

    def left_over(self, delay: float) -> np.ndarray:
        """The part of each channel's variance that the prediction leaves; 1 where the best factor is not positive."""
        predicted = _centred(self.prediction(self.ts - delay), self.weight)
        measured = _centred(np.where(self.weight > 0, self.measured, 0.0), self.weight)
        product = np.sum(predicted * measured, axis=0)
        size = np.sqrt(np.sum(predicted**2, axis=0) * np.sum(measured**2, axis=0))
        correlation = np.divide(product, size, out=np.zeros_like(product), where=size > 0)
        return 1.0 - np.maximum(correlation, 0.0) ** 2


def _centred(samples: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted samples less their mean."""
    mean = np.sum(weight * samples, axis=0) / np.maximum(np.sum(weight, axis=0), 1e-300)
    return np.sqrt(weight) * (samples - mean)


def _common(fit: _Fit, name: str, delays: np.ndarray, table: np.ndarray, told: np.ndarray, least: np.ndarray) -> float:
    # A channel counts by the inverse variance of its residuals, which for an exact prediction are rounding errors.
    shares = told / np.maximum(least, 1e-9)
    shares = shares / max(shares.sum(), 1.0)
    place = _nearest_minimum(table @ shares) if np.any(told) else None
    if place is None:
        raise LogError(
            f"motion {name!r}: no channel follows its prediction closely enough to tell a delay within {delays[-1]} s; "
            "try a greater `longest`, or compare with a better prediction"
        )
    return _refined(lambda delay: float(fit.left_over(delay) @ shares), delays, place)


def _nearest_minimum(values: np.ndarray) -> int | None:
    """The minimum nearest to the middle among those as good as the least, None if that is at an end."""
    middle = len(values) // 2
    inner = np.arange(1, len(values) - 1)
    minima = inner[(values[1:-1] <= values[:-2]) & (values[1:-1] <= values[2:]) & (values[1:-1] < 1.0)]
    good = minima[values[minima] <= values.min() + _AS_GOOD * (values.max() - values.min())]
    return int(good[np.argmin(np.abs(good - middle))]) if len(good) else None


def _refined(function: Callable[[float], float], delays: np.ndarray, place: int) -> float:
    bounds = (delays[place - 1], delays[place + 1])
    found: Any = minimize_scalar(function, bounds=bounds, method="bounded", options={"xatol": 1e-7 * delays[-1]})
    return float(found.x)
