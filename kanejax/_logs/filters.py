"""Signals of a log: filters without phase, differences, uniform times, and how fast a motion is."""

import numpy as np
import scipy.signal
from jaxtyping import Float
from scipy.interpolate import CubicSpline

Samples = Float[np.ndarray, "n k"]
Times = Float[np.ndarray, " n"]
OtherTimes = Float[np.ndarray, " m"]

# Weights of the neighbours at distance 1, 2, ... in central differences, by order of accuracy (Fornberg 1988).
_CENTRAL = {
    2: (1 / 2,),
    4: (2 / 3, -1 / 12),
    6: (3 / 4, -3 / 20, 1 / 60),
    8: (4 / 5, -1 / 5, 4 / 105, -1 / 280),
}
# A filter's start is forgotten when its slowest mode has decayed to this fraction.
_FORGOTTEN = 0.01
# Stamps that differ from a uniform grid by less than this fraction of a period are taken for the grid.
_REGULAR = 0.01
# The motion is what stands out of the noise by this factor, and has this part of the energy of the speeds.
_STANDS_OUT, _ENERGY = 4.0, 0.99
# The cutoff that leaves a motion and its derivatives as they are, over the motion's greatest frequency.
_CUTOFF_OVER_MOTION = 10.0


def lowpassed(samples: Samples, cutoff: float, rate: float, order: int) -> Samples:
    """Pass frequencies below `cutoff` [Hz] by a Butterworth filter, forth and back, which leaves no phase.

    Each of the two passes has half the power at the cutoff, so together they halve the amplitude there. Beyond both ends the
    samples are mirrored through the first and the last, far enough for the filter to settle.
    """
    sections = scipy.signal.butter(order, cutoff, fs=rate, output="sos")
    padding = max(3 * (order + 1), int(np.ceil(2.0 * settling_time(cutoff, order) * rate)))
    return scipy.signal.sosfiltfilt(sections, samples, axis=0, padlen=min(padding, len(samples) - 1))


def settling_time(cutoff: float, order: int) -> float:
    """Time [s] in which the slowest mode of a Butterworth filter decays to a hundredth."""
    return -np.log(_FORGOTTEN) / (2.0 * np.pi * cutoff * np.sin(np.pi / (2 * order)))


def differentiated(samples: Samples, ts: Times, accuracy: int) -> Samples:
    """Central differences over time.

    Args:
        samples: to differentiate.
        ts: their times; for an `accuracy` over 2 they must be uniform.
        accuracy: order of the error in the period: 2 (neighbours' difference over the time between them), 4, 6 or 8.
    """
    rates = np.gradient(samples, ts, axis=0)
    weights = _CENTRAL[accuracy]
    reach = len(weights)
    if len(samples) <= 2 * reach:
        return rates
    if accuracy == 2:
        rates[1:-1] = (samples[2:] - samples[:-2]) / (ts[2:] - ts[:-2])[:, None]
        return rates
    period = (ts[-1] - ts[0]) / (len(ts) - 1)
    end = len(samples) - reach
    steps = (w * (samples[reach + i : end + i] - samples[reach - i : end - i]) for i, w in enumerate(weights, 1))
    rates[reach:-reach] = sum(steps) / period
    return rates


def uniform_times(ts: Times) -> tuple[OtherTimes, bool]:
    """A uniform grid for samples, and whether the stamps are on it already.

    Regular stamps, which keep within a hundredth of a period to a uniform grid, are replaced by the grid. Otherwise the grid goes
    from the first stamp in steps of the median period.
    """
    even = np.linspace(ts[0], ts[-1], len(ts))
    period = even[1] - even[0]
    if np.max(np.abs(ts - even)) <= _REGULAR * period:
        return even, True
    period = np.median(np.diff(ts))
    return ts[0] + period * np.arange(int((ts[-1] - ts[0]) / period * (1 + 1e-12)) + 1), False


def interpolated(samples: Samples, ts: Times, times: OtherTimes, kind: str) -> Float[np.ndarray, "m k"]:
    """Values at other times, by a cubic spline ("cubic") or straight lines ("linear")."""
    if kind == "cubic" and len(ts) > 3:
        return CubicSpline(ts, samples, axis=0)(times)
    return np.column_stack([np.interp(times, ts, column) for column in samples.T])


def automatic_cutoff(samples: Samples, rate: float, *, speeds: bool) -> float | None:
    """A cutoff [Hz] well above what moves: ten times the frequency below which 99 % of the energy of the speeds is.

    Noise is told by the upper quarter of the spectrum: what does not stand out of it by a factor of 4 is not counted. None if
    nothing moves.

    Args:
        samples: positions or speeds of the joints.
        rate: samples a second.
        speeds: whether they are speeds.
    """
    n = len(samples)
    length = min(n, max(n // 4, 256))
    frequency, power = scipy.signal.welch(samples, rate, nperseg=length, detrend="linear", axis=0)
    noise = np.median(power[frequency > 0.375 * rate], axis=0)
    motion = np.where(power > _STANDS_OUT * noise, power, 0.0)
    energy = np.cumsum(motion if speeds else motion * (frequency**2)[:, None], axis=0)
    # A joint that is held still has but noise.
    moves = motion.sum(axis=0) > 10.0 * noise * len(frequency)
    fastest = [frequency[np.searchsorted(column, _ENERGY * column[-1])] for column in energy[:, moves].T]
    return float(_CUTOFF_OVER_MOTION * max(fastest)) if fastest else None
