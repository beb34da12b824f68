"""Lanes: so many trajectories run at a time, and a finished one makes room for the next."""

import collections
import contextlib
import queue
import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from kanejax._simulate.trajectory import Trajectory

# (rows of the trajectories, state that they were left in, which start anew) -> (state they are left in, unfinished, trajectories).
Runner = Callable[[np.ndarray, Any, np.ndarray], tuple[Any, Any, Any]]
# (rows, trajectories) -> None; called by several threads, and maybe twice with the same.
Store = Callable[[np.ndarray, Trajectory], None]


def run_lanes(run: Runner, rows: np.ndarray, size: int, threads: int, store: Store) -> Generator[int]:
    """Run trajectories and store them as they finish, `size` lanes in each of `threads`; yields how many were stored.

    When whoever reads is interrupted, threads end with the segment that they are in, and store what finished in it.
    """
    waiting = collections.deque(rows.tolist())
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


def _one_thread(run: Runner, waiting: collections.deque[int], size: int, stop: threading.Event, store: Store) -> Iterator[int]:
    """The same for `size` lanes, which take from those who wait."""
    lanes = np.full(size, -1)
    before = None
    while not stop.is_set():
        free = lanes < 0
        for lane in np.flatnonzero(free):
            # Others may take from them at the same time.
            with contextlib.suppress(IndexError):
                lanes[lane] = waiting.popleft()
        running = lanes >= 0
        if not np.any(running):
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
