"""Runs cut into windows, which start anew from a state of their own, and these into pieces that are integrated side by side."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


class Pieces(NamedTuple):
    """Pieces of all windows of all runs one after another; what a shorter one lacks is filled with what does not count.

    Attributes:
        index: of each sample and of the one after the last, among those of all runs one after another.
        ts: times [s] of those; they go on where a run has ended.
        count: number of samples.
        joined: whether the next piece goes on from the end of this one: both are of one window.
        opening: whether it is the first of its run.
    """

    index: Int[np.ndarray, "pieces length1"]
    ts: Float[np.ndarray, "pieces length1"]
    count: Int[np.ndarray, " pieces"]
    joined: Bool[np.ndarray, " pieces"]
    opening: Bool[np.ndarray, " pieces"]

    @property
    def counts(self) -> Bool[np.ndarray, "pieces length"]:
        """Which samples count: each sample of the runs does once."""
        return np.arange(self.index.shape[1] - 1) < self.count[:, None]


def cut(runs: Sequence[Float[np.ndarray, " _"]], window: float | None, piece: float | None) -> Pieces:
    """Cut runs into pieces, which do not depend on the windows unless these are shorter, and join them into windows.

    Args:
        runs: times [s] of the samples of each run.
        window: length [s] of the windows, about; None for whole runs.
        piece: length [s] of the pieces, at least; None for whole windows.
    """
    parts, joined, opening = [], [], []
    first = 0
    for ts in runs:
        period = float(np.median(np.diff(ts)))
        lengths = [length for length in (window, piece) if length is not None]
        pieces = _split(len(ts), max(2, round(min(lengths) / period)) if lengths else len(ts))
        together = len(pieces) if window is None else max(1, round(window / min(lengths)))
        for start, end in _split(len(pieces), together):
            opening += [start + k == 0 for k in range(end - start)]
            joined += [*(True for _ in range(end - start - 1)), False]
        parts += [(first, ts, period, *edges) for edges in pieces]
        first += len(ts)
    length = max(end - start for *_, start, end in parts)
    index, times = np.zeros((len(parts), length + 1), np.int32), np.zeros((len(parts), length + 1))
    for k, (first, ts, period, start, _) in enumerate(parts):
        wanted = start + np.arange(length + 1)
        beyond = np.maximum(wanted - (len(ts) - 1), 0)
        index[k], times[k] = first + wanted - beyond, ts[wanted - beyond] + period * beyond
    count = np.array([end - start for *_, start, end in parts], np.int32)
    return Pieces(index, times, count, np.array(joined), np.array(opening))


def _split(count: int, length: int) -> list[tuple[int, int]]:
    """Cut a count into parts of at least a length, equal but for one."""
    parts = max(1, count // length)
    return [(int(a), int(b)) for a, b in itertools.pairwise(count * np.arange(parts + 1) // parts)]
