"""Chunks of a data set that are being simulated: their trajectories wait for lanes, and a chunk that is complete is written."""

import collections
import contextlib
import threading
from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import numpy as np

from kanejax._dataset.store import LAST
from kanejax._dataset.study import Rows, Study
from kanejax._lanes import cores, progress_bar, run_lanes
from kanejax._model.model import leaf_shapes
from kanejax._simulate.batch import FEWEST, LaneInputs, lane_runner
from kanejax._simulate.control import TorqueTable
from kanejax._simulate.trajectory import Trajectory

# Chunks in memory beside those that the lanes need at least.
_SPARE = 2


@runtime_checkable
class Destination(Protocol):
    """Where complete chunks go."""

    def rows(self, chunk: int) -> range:
        """Numbers of the trajectories of a chunk."""
        ...

    def write(self, chunk: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Take a complete chunk."""
        ...


def run_chunks(
    study: Study, store: Destination, chunks: np.ndarray, *, batch_size: int, threads: int | None, progress: bool
) -> None:
    """Simulate some chunks of a study on all cores.

    Args:
        study: what is simulated.
        store: where complete chunks go.
        chunks: numbers of those to simulate.
        batch_size: trajectories that a thread simulates side by side.
        threads: how many run side by side, by default one for each core.
        progress: show a progress bar.
    """
    trajectories = sum(len(store.rows(chunk)) for chunk in chunks.tolist())
    threads = min(cores(), max(1, trajectories // FEWEST)) if threads is None else int(threads)
    waiting = _OpenChunks(study, store, chunks, batch_size * threads)
    parameters, rest = eqx.partition(_table(study), eqx.is_array)
    structure = jax.tree.structure(parameters)
    run = lane_runner(study.model, study.ts, rest, 0, dict(study.options), lambda rows: waiting.inputs(rows, structure))
    counts = run_lanes(run, waiting, batch_size, threads, waiting.store)
    with progress_bar("simulating", trajectories, progress) as advance, contextlib.closing(counts):
        for count in counts:
            advance(count)


def _table(study: Study) -> TorqueTable | None:
    """A table of forces of one trajectory."""
    ts = study.force_times
    if ts is None or study.control is None:
        return None
    return TorqueTable(ts, np.zeros((len(ts), study.model.nv), ts.dtype), study.control.interpolation)


class _OpenChunks:
    """What threads take trajectories from and store them to; only some chunks are in memory at a time.

    A thread that completes a chunk writes it while the others go on.
    """

    def __init__(self, study: Study, store: Destination, chunks: np.ndarray, lanes: int) -> None:
        """Begin with the first of the chunks.

        Args:
            study: what is simulated.
            store: where complete chunks go.
            chunks: numbers of those to simulate.
            lanes: of all threads together.
        """
        self._study, self._store = study, store
        self._missing = collections.deque(chunks.tolist())
        self._size = max(len(store.rows(0)), 1)
        self._most = -(-lanes // self._size) + _SPARE
        self._open: dict[int, _OpenChunk] = {}
        self._rows = iter(range(0))
        self._changed = threading.Condition()

    def take(self) -> int | None:
        """The next trajectory, or None as long as too many chunks are open."""
        with self._changed:
            if (row := next(self._rows, None)) is None and self._missing and len(self._open) < self._most:
                chunk = self._missing.popleft()
                rows = self._store.rows(chunk)
                self._open[chunk] = _OpenChunk(self._study.rows(rows.start, len(rows)), rows.start)
                self._rows = iter(rows)
                row = next(self._rows)
            return row

    def wait(self) -> bool:
        """Wait a moment for a chunk to be written; whether there are more trajectories."""
        with self._changed:
            if self._missing:
                self._changed.wait(0.1)
            return bool(self._missing)

    def inputs(self, rows: np.ndarray, control: Any) -> LaneInputs:
        """What belongs to trajectories in the lanes; `control` is the structure of the tables of forces."""
        with self._changed:
            parts = [(self._open[chunk], rows // self._size == chunk) for chunk in np.unique(rows // self._size)]
        first = parts[0][0].given
        found = jax.tree.map(lambda x: np.empty((len(rows), *x.shape[1:]), x.dtype), first)
        for chunk, here in parts:
            for whole, part in zip(jax.tree.leaves(found), jax.tree.leaves(chunk.given), strict=True):
                whole[here] = part[rows[here] - chunk.start]
        ts = self._study.force_times
        tables = [] if ts is None else [np.broadcast_to(ts, (len(rows), len(ts))), found.forces]
        leaves = [found.leaves.get(name) for name in leaf_shapes(self._study.model.tree)]
        return LaneInputs(leaves, found.q0, found.u0, jax.tree.unflatten(control, tables))

    def store(self, rows: np.ndarray, piece: Trajectory) -> None:
        """Keep trajectories that have ended, and write the chunks that they complete."""
        complete = []
        with self._changed:
            for number in np.unique(rows // self._size):
                if (chunk := self._open.get(int(number))) is None:
                    continue
                here = rows // self._size == number
                if chunk.keep(rows[here], jax.tree.map(lambda x, here=here: x[here], piece)):
                    complete.append((int(number), chunk))
        for number, chunk in complete:
            self._store.write(number, chunk.arrays())
            with self._changed:
                del self._open[number]
                self._changed.notify_all()


class _OpenChunk:
    """What was drawn for the trajectories of a chunk, and those that have ended."""

    def __init__(self, given: Rows, start: int) -> None:
        self.given, self.start = given, start
        self._kept: dict[str, np.ndarray] = {}
        self._ended = np.zeros(len(given.q0), bool)

    def keep(self, rows: np.ndarray, piece: Trajectory) -> bool:
        """Keep trajectories; whether these are the last ones."""
        own = rows - self.start
        before = bool(self._ended.all())
        found = {"q": piece.q, "u": piece.u, "t_end": piece.t_end, "num_steps": piece.stats["num_steps"], LAST: piece.status}
        for name, values in found.items():
            if name not in self._kept:
                self._kept[name] = np.empty((len(self._ended), *values.shape[1:]), values.dtype)
            self._kept[name][own] = values
        self._ended[own] = True
        return not before and bool(self._ended.all())

    def arrays(self) -> dict[str, np.ndarray]:
        """All that is stored."""
        forces = {} if self.given.forces is None else {"tau": self.given.forces}
        return {**self._kept, **self.given.leaves, **forces}
