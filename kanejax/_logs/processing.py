"""From a log to motions of a model: uniform times, filters, derivatives, decimation."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np

from kanejax._errors import LogError, UnsupportedModelError
from kanejax._logs.filters import automatic_cutoff, differentiated, lowpassed, settling_time, uniform_times
from kanejax._logs.log import Log, Run
from kanejax._logs.motion import Motion
from kanejax._logs.uniform import Resampling, uniform_runs
from kanejax._model.model import Model

# What is not filtered for itself is, before decimation, with this order at this part of the Nyquist frequency that is left: of what
# would fold into the lower half of the band 5e-6 remain.
_DECIMATION_ORDER, _DECIMATION_CUTOFF = 8, 0.7
# Cutoffs that are asked for may be this part of it, automatic ones that of the Nyquist frequency before.
_GREATEST_CUTOFF, _GREATEST_AUTOMATIC = 0.8, 0.4
# Measured speeds and the slopes of positions must agree within this factor, where they are of one shape at all.
_LEAST_CORRELATION, _LEAST_FACTOR = 0.9, 0.8


class _Options(NamedTuple):
    """Those of `motions`, and the automatic cutoff [Hz] if it is asked for and something moves."""

    cutoff: float | str | None
    effort_cutoff: float | None
    cutoff_unit: str
    order: int
    accuracy: int
    resampling: str | None
    longest_gap: float
    decimation: int
    rate: float | None
    trim: float | None
    automatic: float | None = None


class _Band(NamedTuple):
    """Sampling rate and cutoffs [Hz] of a run, the last for what has none else; the factor, and the samples to trim at each end."""

    rate: float
    cutoff: float | None
    effort_cutoff: float | None
    decimation_cutoff: float | None
    factor: int
    trim: int


def motions(
    log: Log,
    model: Model,
    *,
    cutoff: float | Literal["automatic"] | None = "automatic",
    effort_cutoff: float | None = None,
    cutoff_unit: Literal["Hz", "Nyquist"] = "Hz",
    order: int = 5,
    accuracy: Literal[2, 4, 6, 8] = 6,
    resampling: Resampling | None = "cubic",
    longest_gap: float = 3.5,
    decimation: int = 1,
    rate: float | None = None,
    trim: float | None = None,
    locked: Mapping[str, float] | None = None,
) -> tuple[Motion, ...]:
    """Filter and differentiate the runs of a log, and bring them to a model's coordinates.

    In this order: runs are parted where samples are missing, and resampled at uniform times if their stamps are irregular. Speeds
    that were measured are low-passed, and the positions stay as they are; otherwise the positions are low-passed, and speeds are
    their central differences. Accelerations are low-passed, measured ones or the central differences of the speeds. The filter is
    Butterworth's, forth and back, so without phase; together the two passes halve the amplitude at the cutoff. The ends, where it
    settles, are cut off. Last, samples are decimated.

    The automatic cutoff is ten times the frequency below which 99 % of the energy of the joints' speeds is, of that joint
    where it is greatest, but no more than 0.4 of the Nyquist frequency; one for all runs.

    Args:
        log: of joints with one coordinate each.
        model: whose joints they are.
        cutoff: of the low-pass for positions, speeds and accelerations; None: no filter.
        effort_cutoff: of that for efforts; None: no filter.
        cutoff_unit: "Hz", or "Nyquist": fractions of half the sampling rate, before decimation.
        order: of the filter.
        accuracy: order of accuracy of the central differences; 2 is (x[k+1] - x[k-1]) / (t[k+1] - t[k-1]).
        resampling: "cubic" splines or "linear" interpolation at the median period; None: filter irregular samples as they are,
            which needs an accuracy of 2.
        longest_gap: longer steps, in median steps, part a run in two motions.
        decimation: keep one of so many samples. What else is not low-passed is, at 0.7 of the Nyquist frequency that is left.
        rate: instead of `decimation`, samples a second to keep, about: the factor is rounded.
        trim: time [s] cut off at both ends; None: until the filter has settled to a hundredth.
        locked: joints of the model that the log lacks, held at these coordinates: without speed, and with weight 0.

    Returns:
        A motion for each run, or part of a run, in the model's data type, with times from the run's first sample; its `notes` say
        what was done to it.

    Raises:
        LogError: joints of the log and the model do not match, a run is too short, a cutoff does not suit its rate, or measured
            speeds contradict the positions.
        UnsupportedModelError: a joint of the model has several coordinates.
        ValueError: an option has no meaning.
    """
    options = _Options(cutoff, effort_cutoff, cutoff_unit, order, accuracy, resampling, longest_gap, decimation, rate, trim)
    _check(options)
    columns, base = _placement(log, model, dict(locked or {}))
    runs = [uniform_runs(run, resampling, longest_gap) for run in log.runs]
    if cutoff == "automatic":
        found = [_automatic(max(parts, key=len)) for parts in runs]
        options = options._replace(automatic=max((each for each in found if each is not None), default=None))
    starts = [run.ts[0] for run in log.runs]
    return tuple(
        _on_model(run, start, model, columns, base)
        for start, parts in zip(starts, runs, strict=True)
        for run in _processed(parts, options)
    )


def _check(options: _Options) -> None:
    for name in ("cutoff", "effort_cutoff", "order", "longest_gap", "decimation", "rate"):
        value = getattr(options, name)
        if isinstance(value, int | float) and not (math.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value}; it must be positive and finite")
    if isinstance(options.cutoff, str) and options.cutoff != "automatic":
        raise ValueError(f"cutoff is {options.cutoff!r}; use a number, 'automatic', or None")
    allowed = {"cutoff_unit": ("Hz", "Nyquist"), "accuracy": (2, 4, 6, 8), "resampling": ("cubic", "linear", None)}
    for name, values in allowed.items():
        if (value := getattr(options, name)) not in values:
            raise ValueError(f"{name} is {value!r}; use one of {', '.join(map(repr, values))}")
    if options.rate is not None and options.decimation != 1:
        raise ValueError(f"give decimation ({options.decimation}) or rate ({options.rate}), not both")
    if options.trim is not None and not (math.isfinite(options.trim) and options.trim >= 0):
        raise ValueError(f"trim is {options.trim}; it must be finite and not negative")


def _placement(log: Log, model: Model, locked: dict[str, float]) -> tuple[list[int], np.ndarray]:
    """The place in u of each of the log's joints, and coordinates with those of the locked joints."""
    tree = model.tree
    for name, kind in zip(tree.joint_names, tree.joint_types, strict=True):
        if kind not in ("revolute", "prismatic"):
            raise UnsupportedModelError(f"joint {name!r} is {kind}; logs are of revolute and prismatic joints, one coordinate each")
    names = ", ".join(tree.joint_names)
    for kind, joints in (("log", log.joints), ("argument locked", locked)):
        if unknown := [name for name in joints if name not in tree.joint_names]:
            raise LogError(f"the {kind} has joints that the model has not: {', '.join(unknown)}; the model's joints are: {names}")
    if both := [name for name in log.joints if name in locked]:
        raise LogError(f"joints {', '.join(both)} are in the log, and cannot be locked too")
    if lacking := [name for name in tree.joint_names if name not in log.joints and name not in locked]:
        example = f"locked={{{lacking[0]!r}: 0.0}}"
        raise LogError(f"the log lacks joints of the model: {', '.join(lacking)}; if they were held still, say where: {example}")
    base = np.zeros(tree.nq)
    for name, coordinate in locked.items():
        if not math.isfinite(coordinate):
            raise LogError(f"locked joint {name!r} is at {coordinate}; it must be finite")
        base[tree.joint(name)] = coordinate
    return [tree.joint(name) for name in log.joints], base


def _automatic(run: Run) -> float | None:
    samples = run.q if run.u is None else run.u
    return automatic_cutoff(samples, _rate(run), speeds=run.u is not None)


def _rate(run: Run) -> float:
    return (len(run) - 1) / run.duration


def _processed(parts: list[Run], options: _Options) -> list[Run]:
    """The parts of a run that are long enough, processed; the notes tell of those that are not."""
    bands = [_band(part, options) for part in parts]
    enough = [len(part) >= 2 * (band.trim + band.factor + 1) for part, band in zip(parts, bands, strict=True)]
    if not any(enough):
        part, band = max(zip(parts, bands, strict=True), key=lambda pair: len(pair[0]))
        raise LogError(
            f"run {part.name!r} is too short: of {part.duration:.4g} s, {band.trim / band.rate:.4g} s are cut off at each end, "
            "where the filter settles; choose a greater cutoff or a lesser trim"
        )
    short = [f"{part.name} of {part.duration:.4g} s" for part, fits in zip(parts, enough, strict=True) if not fits]
    notes = (f"too short for the filter, and left out: {'; '.join(short)}",) if short else ()
    return [_filtered(part, band, options, notes) for part, band, fits in zip(parts, bands, enough, strict=True) if fits]


def _band(run: Run, options: _Options) -> _Band:
    rate = _rate(run)
    factor = options.decimation if options.rate is None else max(1, round(rate / options.rate))
    decimation_cutoff = _DECIMATION_CUTOFF * 0.5 * rate / factor if factor > 1 else None
    effort_cutoff = _in_hertz(run, "effort_cutoff", options.effort_cutoff, options.cutoff_unit, factor)
    if isinstance(options.cutoff, str):
        cutoff = min(c for c in (options.automatic, _GREATEST_AUTOMATIC * 0.5 * rate, decimation_cutoff) if c is not None)
    else:
        cutoff = _in_hertz(run, "cutoff", options.cutoff, options.cutoff_unit, factor)
    filters = ((cutoff, options.order), (effort_cutoff, options.order), (decimation_cutoff, _DECIMATION_ORDER))
    settling = max((settling_time(c, order) for c, order in filters if c is not None), default=0.0)
    trim = math.ceil((settling if options.trim is None else options.trim) * rate - 1e-9)
    return _Band(rate, cutoff, effort_cutoff, decimation_cutoff, factor, trim)


def _in_hertz(run: Run, name: str, value: float | None, unit: str, factor: int) -> float | None:
    if value is None:
        return None
    nyquist = 0.5 * _rate(run)
    cutoff, greatest = value * nyquist if unit == "Nyquist" else value, _GREATEST_CUTOFF * nyquist / factor
    if cutoff >= nyquist:
        raise LogError(f"run {run.name!r}: {name} is {cutoff:.4g} Hz, but must be below {nyquist:.4g} Hz, half the sampling rate")
    if factor > 1 and cutoff > greatest:
        raise LogError(
            f"run {run.name!r}: {name} is {cutoff:.4g} Hz, but the {2.0 * nyquist / factor:.4g} samples a second to be kept "
            f"can follow {greatest:.4g} Hz; lower it, or keep more"
        )
    return cutoff


def _filtered(run: Run, band: _Band, options: _Options, notes: tuple[str, ...]) -> Run:
    def lowpass(samples: np.ndarray, cutoff: float | None) -> np.ndarray:
        if cutoff is not None:
            return lowpassed(samples, cutoff, band.rate, options.order)
        if band.decimation_cutoff is not None:
            return lowpassed(samples, band.decimation_cutoff, band.rate, _DECIMATION_ORDER)
        return samples

    if options.accuracy != 2 and not uniform_times(run.ts)[1]:
        raise LogError(f"run {run.name!r}: irregular samples that are not resampled need accuracy=2, not {options.accuracy}")
    q = lowpass(run.q, band.cutoff if run.u is None else None)
    slopes = differentiated(q, run.ts, options.accuracy)
    u = slopes if run.u is None else lowpass(run.u, band.cutoff)
    u_dot = lowpass(differentiated(u, run.ts, options.accuracy) if run.u_dot is None else run.u_dot, band.cutoff)
    if run.u is not None:
        inner = slice(band.trim, len(run) - band.trim)
        _check_speeds(run, lowpass(slopes, band.cutoff)[inner], u[inner])
    kept = slice(band.trim, len(run) - band.trim, band.factor)
    effort = lowpass(run.effort, band.effort_cutoff)
    arrays = {"ts": run.ts, "q": q, "u": u, "u_dot": u_dot, "effort": effort, "weight": run.weight}
    arrays = {key: array[kept] for key, array in arrays.items() if array is not None}
    return dataclasses.replace(run, **arrays, notes=(*run.notes, *notes, *_band_notes(band, options)))


def _band_notes(band: _Band, options: _Options) -> list[str]:
    notes = []
    if band.cutoff is not None:
        notes.append(f"motion low-passed at {band.cutoff:.4g} Hz{' (automatic)' if options.cutoff == 'automatic' else ''}")
    if band.effort_cutoff is not None:
        notes.append(f"effort low-passed at {band.effort_cutoff:.4g} Hz")
    if band.decimation_cutoff is not None:
        notes.append(f"one of {band.factor} samples kept, {band.rate / band.factor:.4g} a second")
        notes.append(f"what else was not low-passed was at {band.decimation_cutoff:.4g} Hz, for the decimation")
    if band.trim:
        notes.append(f"{band.trim / band.rate:.4g} s cut off at both ends")
    return notes


def _check_speeds(run: Run, slopes: np.ndarray, u: np.ndarray) -> None:
    """Compare measured speeds with the positions' slopes: a wrong unit or sign shows as a factor between two alike signals."""
    products, squares = np.sum(slopes * u, axis=0), np.sum(slopes**2, axis=0)
    alike = np.abs(products) > _LEAST_CORRELATION * np.sqrt(squares * np.sum(u**2, axis=0))
    factors = np.divide(products, squares, out=np.ones_like(products), where=(squares > 0) & alike)
    for column, factor in enumerate(factors):
        if not _LEAST_FACTOR < factor < 1.0 / _LEAST_FACTOR:
            raise LogError(
                f"run {run.name!r}: the speeds of column {column} are {factor:.4g} times the slopes of its positions; check units, "
                "signs and columns, or leave the speeds out"
            )


def _on_model(run: Run, start: float, model: Model, columns: list[int], base: np.ndarray) -> Motion:
    def placed(array: np.ndarray | None, rest: np.ndarray) -> np.ndarray:
        full = np.tile(rest, (len(run), 1))
        full[:, columns] = array
        return full

    none = np.zeros_like(base)
    arrays = (placed(run.q, base), *(placed(x, none) for x in (run.u, run.u_dot, run.effort, run.weight)))
    return Motion(*(jnp.asarray(x, model.dtype) for x in (run.ts - start, *arrays)), name=run.name, notes=run.notes)
