"""Optimal motions of any number of tasks, on all cores."""

import contextlib
import os
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from kanejax._checkpoint import INTERVAL, Checkpoint, opened
from kanejax._lanes import Listed, Results, Runner, cores, progress_bar, run_lanes
from kanejax._optimal_control.interior_point import first_search, searched
from kanejax._optimal_control.search import Result, Search
from kanejax._optimize.motion import OptimalMotion, motion_of
from kanejax._optimize.optimize import Guess, OptimizationInterrupted, first_path, straight_guess, tolerance_of
from kanejax._optimize.task import MotionTask
from kanejax._optimize.transcription import MotionStages
from kanejax._simulate.checks import check_positive

# So many iterations, then searches that have ended make room for others.
SEGMENT = 8

# One row of the parameters -> the task, and where to start if it is not the straight line.
TaskOf = Callable[[Any], MotionTask | tuple[MotionTask, Guess | OptimalMotion]]


def optimize_batch(
    task: TaskOf,
    parameters: Any,
    *,
    tolerance: float | None = None,
    max_iterations: int = 300,
    batch_size: int = 1,
    threads: int | None = None,
    progress: bool = False,
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_interval: float = INTERVAL,
) -> OptimalMotion:
    """The motions of least cost of many tasks, by one compiled function: goals, starts, limits, payloads, or models differ.

    A search that has ended makes room for the next, so that none waits for one that needs more iterations. One that does not
    converge does not touch the others: its `result` says so.

    Args:
        task: function of one row of the parameters, which returns the task, or the task and a guess. It is traced by JAX.
        parameters: arrays with a leading axis, or a pytree of them.
        tolerance: to which the conditions of optimality hold in the end, by default 1e-8 (float32: 1e-3).
        max_iterations: after which a search ends.
        batch_size: searches that one core makes side by side. They wait for each other in every line search, so that on a CPU
            one is fastest; more fill an accelerator.
        threads: how many of these run side by side; by default one for each core.
        progress: show a progress bar.
        checkpoint: path of a file in which motions are kept as they are found, so that after Ctrl-C or a crash the same call runs
            only what is missing, and ends with the same numbers. It stays at the end, where the same call finds all; remove it
            then.
        checkpoint_interval: time between two writings of the file [s]; it is written at the end in any case.

    Returns:
        The motions, numpy arrays with a leading batch axis.

    Raises:
        ValueError: the leading axes of the parameters differ, or a task does not fit.
        CheckpointError: the checkpoint belongs to other tasks, is none, or cannot be written; remove it, or give another path.
        OptimizationInterrupted: on Ctrl-C, once a motion is finished; its `motion` has those that are.
    """
    check_positive(max_iterations=max_iterations, batch_size=batch_size, threads=threads)
    length = _length(parameters)
    threads = min(cores(), length) if threads is None else threads
    # Also where some are done already: programs of other sizes give numbers that differ by rounding errors.
    size = min(batch_size, max(1, -(-length // threads)))
    run = _runner(task, parameters, size, tolerance, max_iterations)
    inputs = (task, parameters, tolerance, max_iterations, size)
    with opened(checkpoint, checkpoint_interval, "optimize_batch", *inputs) as kept:
        before = _restored(kept, run, size) if kept.has_begun else None
        results = Results(length, before, _flag, Result.NOT_RUN)
        waiting = np.arange(length) if before is None else np.flatnonzero(before.result == Result.NOT_RUN)
        counts = run_lanes(run, Listed(waiting), size, threads, results.store)
        try:
            with progress_bar("optimizing", len(waiting), progress) as advance, contextlib.closing(counts):
                for count in counts:
                    advance(count)
                    kept.keep(lambda: _copied(results))
        except KeyboardInterrupt as error:
            if (done := results.close()) is None:
                raise
            raise OptimizationInterrupted(done, "the attribute `motion` has what is finished") from error
    done = results.close()
    assert done is not None
    return done


def _restored(checkpoint: Checkpoint, run: Runner, size: int) -> OptimalMotion:
    """The motions that a checkpoint has."""
    shapes = eqx.filter_eval_shape(lambda: run(np.zeros(size, int), None, np.ones(size, bool)))
    return checkpoint.restored(shapes[2])


def _copied(results: Results[OptimalMotion]) -> OptimalMotion | None:
    """The motions that are finished, while threads go on."""
    with results.lock:
        return jax.tree.map(np.array, results.whole)


def _flag(motion: OptimalMotion) -> Any:
    return motion.result


def _length(parameters: Any) -> int:
    """Of the leading axis that all have."""
    lengths = {jax.tree_util.keystr(path): jnp.shape(leaf)[:1] for path, leaf in jax.tree_util.tree_leaves_with_path(parameters)}
    if not lengths or len(set(lengths.values())) > 1 or () in lengths.values() or (0,) in lengths.values():
        found = ", ".join(f"{name or 'the array'}: {shape}" for name, shape in lengths.items()) or "no arrays"
        raise ValueError(f"parameters need one leading axis, a row for each task, but have {found}")
    return next(iter(lengths.values()))[0]


def _runner(task: TaskOf, parameters: Any, size: int, tolerance: float | None, max_iterations: int) -> Runner:
    """The function that goes on with searches given by their rows, or starts anew."""
    parameters = jax.tree.map(np.asarray, parameters)
    limits = jnp.asarray(max_iterations if size == 1 else SEGMENT), jnp.asarray(max_iterations)

    def run(rows: np.ndarray, before: Any, fresh: np.ndarray) -> tuple[Search | None, jax.Array, OptimalMotion]:
        chosen = jax.tree.map(lambda x: x[rows], parameters)
        if before is None and size > 1:
            shapes = eqx.filter_eval_shape(_run, task, chosen, None, fresh, limits, tolerance)[0]
            before = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
        return _run(task, chosen, before, fresh, limits, tolerance)

    return run


def _stages(task: TaskOf, row: Any) -> tuple[MotionStages, Any]:
    """Of one row, and the path to start from."""
    given = task(row)
    asked, guess = given if isinstance(given, tuple) else (given, straight_guess(given))
    stages = MotionStages(asked, guess.q)
    return stages, first_path(stages, guess)


@eqx.filter_jit
def _run(
    task: TaskOf, parameters: Any, before: Search | None, fresh: Any, limits: tuple[jax.Array, jax.Array], tolerance: float | None
) -> tuple[Search | None, jax.Array, OptimalMotion]:
    """A segment: what the next one goes on with, which searches are unfinished, and the motions.

    One search alone comes to its end, and nothing goes on.
    """
    length, most = limits

    def one(row: Any, before: Search | None, fresh: jax.Array) -> tuple[Search, jax.Array, OptimalMotion]:
        stages, path = _stages(task, row)
        search = first_search(stages, path)
        if before is not None:
            search = jax.tree.map(lambda new, old: jnp.where(fresh, new, old), search, before)
        left = jnp.minimum(length, most - search.iterations)
        search = searched(stages, search, left, tolerance_of(stages.task, tolerance))
        unfinished = (search.result == Result.RUNNING) & (search.iterations < most)
        return search, unfinished, motion_of(stages, search)

    lanes = parameters, before, jnp.asarray(fresh)
    if len(fresh) > 1:
        return jax.vmap(one)(*lanes)
    # Conditionals and loops of one search take half the time of those of a batch of one.
    _, unfinished, motion = one(*jax.tree.map(lambda x: x[0], lanes))
    return None, *jax.tree.map(lambda x: x[None], (unfinished, motion))
