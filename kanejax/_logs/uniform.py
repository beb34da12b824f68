"""Runs with holes and irregular stamps as runs at uniform times, which filters need."""

import dataclasses
from typing import Literal

import numpy as np

from kanejax._logs.filters import interpolated, uniform_times
from kanejax._logs.log import Run

Resampling = Literal["cubic", "linear"]


def uniform_runs(run: Run, resampling: Resampling | None, longest_gap: float) -> list[Run]:
    """Part a run where samples are missing, and bring each part to uniform times.

    Efforts without weight are replaced by straight lines between those around them. A value between two samples has the lesser of
    their weights.

    Args:
        run: of a log.
        resampling: how to interpolate if the stamps are irregular; None: leave them.
        longest_gap: greatest step between two samples that is interpolated, in median steps.

    Returns:
        The parts, with all efforts finite, weights given, and notes on what was done.
    """
    steps = np.diff(run.ts)
    ends = np.flatnonzero(steps > longest_gap * run.period) + 1
    notes = list(run.notes)
    if len(ends):
        notes.append(f"parted at {len(ends)} gaps of up to {steps.max():.4g} s, where the median step is {run.period:.4g} s")
    pieces = [slice(*bounds) for bounds in zip((0, *ends), (*ends, len(run)), strict=True)]
    if lone := sum(piece.stop - piece.start == 1 for piece in pieces):
        notes.append(f"{lone} single samples between two gaps were left out")
    pieces = [piece for piece in pieces if piece.stop - piece.start > 1]
    names = [run.name] if len(pieces) == 1 else [f"{run.name}, part {k}" for k in range(1, len(pieces) + 1)]
    return [_uniform(run, piece, name, notes, resampling) for piece, name in zip(pieces, names, strict=True)]


def _uniform(run: Run, piece: slice, name: str, notes: list[str], resampling: Resampling | None) -> Run:
    ts = run.ts[piece]
    weight = np.ones_like(run.q[piece]) if run.weight is None else run.weight[piece]
    arrays = {key: x[piece] for key in ("q", "u", "u_dot") if (x := getattr(run, key)) is not None}
    arrays["effort"] = _bridged(ts, run.effort[piece], weight)
    grid, regular = uniform_times(ts)
    note = ()
    if resampling is None:
        grid, note = ts, () if regular else ("the stamps are irregular, and filtered as if they were uniform",)
    elif not regular:
        steps = np.diff(ts)
        arrays = {key: interpolated(x, ts, grid, resampling) for key, x in arrays.items()}
        weight = _lesser(ts, weight, grid)
        note = (f"steps of {steps.min():.4g} to {steps.max():.4g} s, resampled ({resampling}) every {grid[1] - grid[0]:.4g} s",)
    return dataclasses.replace(run, name=name, ts=grid, **arrays, weight=weight, notes=(*notes, *note))


def _bridged(ts: np.ndarray, effort: np.ndarray, weight: np.ndarray) -> np.ndarray:
    bridged = np.zeros_like(effort)
    for j, counts in enumerate((weight > 0).T):
        if np.any(counts):
            bridged[:, j] = np.where(counts, effort[:, j], np.interp(ts, ts[counts], effort[counts, j]))
    return bridged


def _lesser(ts: np.ndarray, weight: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The lesser of the weights of the samples before and after."""
    after = np.minimum(np.searchsorted(ts, times), len(ts) - 1)
    before = np.where(ts[after] == times, after, np.maximum(after - 1, 0))
    return np.minimum(weight[before], weight[after])
