"""Lanes: so many trajectories or searches run at a time, and a finished one makes room for the next."""

import collections
import contextlib
import os
import queue
import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

# (rows of the trajectories, state that they were left in, which start anew) -> (state they are left in, unfinished, trajectories).
Runner = Callable[[np.ndarray, Any, np.ndarray], tuple[Any, Any, Any]]
# (rows, trajectories) -> None; called by several threads, and maybe twice with the same.
Store = Callable[[np.ndarray, Any], None]


@runtime_checkable
class Waiting(Protocol):
    """Rows that wait for a lane; several threads take from them."""

    def take(self) -> int | None:
        """The next row, or None if there is none at present."""
        ...

    def wait(self) -> bool:
        """Wait a moment for another row; whether there may be one."""
        ...


class Listed:
    """Rows of a list."""

    def __init__(self, rows: np.ndarray) -> None:
        """Take them in this order."""
        self._rows = collections.deque(rows.tolist())

    def take(self) -> int | None:
        """The next row."""
        with contextlib.suppress(IndexError):
            return self._rows.popleft()
        return None

    def wait(self) -> bool:
        """None come later."""
        return False


def run_lanes(run: Runner, waiting: Waiting, size: int, threads: int, store: Store) -> Generator[int]:
    """Run trajectories and store them as they finish, `size` lanes in each of `threads`; yields how many were stored.

    When whoever reads is interrupted, threads end with the segment that they are in, and store what finished in it.
    """
    stop = threading.Event()
    if threads == 1:
        yield from _one_thread(run, waiting, size, stop, store)
        return
    done: queue.SimpleQueue[int | BaseException | None] = queue.SimpleQueue()
    first = _FirstAlone(run)
    # JAX's contexts belong to a thread; this one decides about the data type of the results.
    x64 = bool(jax.config.jax_enable_x64)

    def work() -> None:
        try:
            with jax.enable_x64(x64):
                for count in _one_thread(first, waiting, size, stop, store):
                    done.put(count)
            done.put(None)
        except BaseException as error:
            done.put(error)

    with ThreadPoolExecutor(threads) as pool:
        try:
            for _ in range(threads):
                pool.submit(work)
            running = threads
            while running:
                item = done.get()
                if isinstance(item, BaseException):
                    raise item
                if item is None:
                    running -= 1
                else:
                    yield item
        finally:
            stop.set()


class _FirstAlone:
    """A function whose first call runs alone, so that it is compiled once."""

    def __init__(self, run: Runner) -> None:
        self.run, self.lock = run, threading.Lock()
        self.called = False

    def __call__(self, *args: Any) -> Any:
        """Call."""
        if not self.called:
            with self.lock:
                if not self.called:
                    result = self.run(*args)
                    self.called = True
                    return result
        return self.run(*args)


def _one_thread(run: Runner, waiting: Waiting, size: int, stop: threading.Event, store: Store) -> Iterator[int]:
    """The same for `size` lanes, which take from those who wait."""
    lanes = np.full(size, -1)
    before = None
    while not stop.is_set():
        free = lanes < 0
        for lane in np.flatnonzero(free):
            if (row := waiting.take()) is None:
                break
            lanes[lane] = row
        running = lanes >= 0
        if not np.any(running):
            if waiting.wait():
                continue
            return
        # What is left free repeats another trajectory, so that nothing compiles again.
        before, unfinished, piece = run(np.where(running, lanes, lanes[running][0]), before, free)
        done = _store_finished(store, lanes, unfinished, piece)
        if np.any(done):
            lanes[done] = -1
            yield int(np.sum(done))


def _store_finished(store: Store, lanes: np.ndarray, unfinished: Any, piece: Any) -> np.ndarray:
    """Wait for a segment and store what finished in it, which lanes that was; an interrupt takes effect afterwards."""

    def finish() -> np.ndarray:
        done = (lanes >= 0) & ~np.asarray(unfinished)
        if np.any(done):
            store(lanes[done], jax.tree.map(lambda x: np.asarray(x)[done], piece))
        return done

    try:
        return finish()
    except KeyboardInterrupt:
        finish()
        raise


class Results[T]:
    """Results of all rows, which threads fill until it is closed; None before the first."""

    def __init__(self, length: int, whole: T | None, flag: Callable[[T], Any], missing: int) -> None:
        """Start with what there is.

        Args:
            length: number of rows.
            whole: results of some, arrays that are written to.
            flag: the leaf of the results that says how a row ended.
            missing: its value where there is none.
        """
        self.length, self.whole, self.flag, self.missing = length, whole, flag, missing
        self.lock, self.closed = threading.Lock(), False

    def store(self, rows: np.ndarray, piece: T) -> None:
        """Write results to their rows; the flag, which says that they are done, last."""
        with self.lock:
            if self.closed:
                return
            if self.whole is None:
                self.whole = self._empty(piece)
            flag = self.flag(self.whole)
            for part, new in zip(jax.tree.leaves(self.whole), jax.tree.leaves(piece), strict=True):
                if part is not flag:
                    part[rows] = new
            flag[rows] = self.flag(piece)

    def close(self) -> T | None:
        """What there is; from now on nothing is written, though a second interrupt may have left threads running."""
        with self.lock:
            self.closed = True
            return self.whole

    def _empty(self, piece: T) -> T:
        """Results for all that were not run, in the form of those of a piece."""

        def blank(part: np.ndarray) -> np.ndarray:
            return np.full((self.length, *part.shape[1:]), np.nan if np.issubdtype(part.dtype, np.floating) else -1, part.dtype)

        none = np.full(self.length, int(self.missing), self.flag(piece).dtype)
        return eqx.tree_at(self.flag, jax.tree.map(blank, piece), none)


def cores() -> int:
    """Threads that are worth starting: XLA runs one call on one core of a CPU."""
    return (getattr(os, "process_cpu_count", os.cpu_count)() or 1) if jax.default_backend() == "cpu" else 1


@contextlib.contextmanager
def progress_bar(what: str, total: int, show: bool) -> Iterator[Any]:
    """A function that advances a progress bar."""
    if not show:
        yield lambda count: None
        return
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns) as bar:
        task = bar.add_task("", total=total)
        yield lambda count: bar.advance(task, count)
