"""Lanes: so many trajectories run at a time, and a finished one makes room for the next."""

import collections
import contextlib
import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from kanejax._simulate.trajectory import Trajectory

# (rows of the trajectories, state that they were left in, which start anew) -> (state they are left in, unfinished, trajectories).
Runner = Callable[[np.ndarray, Any, np.ndarray], tuple[Any, Any, Any]]
Finished = tuple[np.ndarray, Trajectory]


def finished(run: Runner, rows: np.ndarray, size: int, threads: int) -> Iterator[Finished]:
    """Rows of trajectories and the trajectories, as they finish; `size` lanes in each of `threads`.

    When whoever reads is interrupted, threads end with the segment that they are in.
    """
    waiting = collections.deque(rows.tolist())
    stop = threading.Event()
    if threads == 1:
        yield from _one_thread(run, waiting, size, stop)
        return
    done: queue.SimpleQueue[Finished | BaseException | None] = queue.SimpleQueue()
    first = _FirstAlone(run)
    # JAX's contexts belong to a thread; this one decides about the data type of the results.
    x64 = bool(jax.config.jax_enable_x64)

    def work() -> None:
        try:
            with jax.enable_x64(x64):
                for item in _one_thread(first, waiting, size, stop):
                    done.put(item)
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


def _one_thread(run: Runner, waiting: collections.deque[int], size: int, stop: threading.Event) -> Iterator[Finished]:
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
        done = running & ~np.asarray(unfinished)
        if np.any(done):
            yield lanes[done], jax.tree.map(lambda x: np.asarray(x)[done], piece)  # noqa: B023
            lanes[done] = -1
