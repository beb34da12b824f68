"""Simulation of any number of trajectories, in pieces that fit the memory."""

import contextlib
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from kanejax._model.model import Model, leaf_shapes
from kanejax._simulate.checks import check_batch, check_positive
from kanejax._simulate.simulate import simulate
from kanejax._simulate.trajectory import Status, Trajectory


class SimulationInterrupted(KeyboardInterrupt):
    """`simulate_batch` was interrupted; `trajectory` has what was done, and Status.NOT_RUN for the rest."""

    def __init__(self, trajectory: Trajectory) -> None:
        """Keep the trajectory."""
        self.trajectory = trajectory
        missing = int(np.sum(np.asarray(trajectory.status) == Status.NOT_RUN))
        super().__init__(f"{missing} of {len(trajectory.status)} trajectories were not run; go on with resume=error.trajectory")


def simulate_batch(
    model: Model,
    q0: Any,
    u0: Any,
    ts: Any,
    *,
    control: Any = None,
    control_axis: int | None = None,
    batch_size: int = 256,
    progress: bool = False,
    resume: Trajectory | None = None,
    **options: Any,
) -> Trajectory:
    """Simulate many initial states, `batch_size` of them at a time, by one compiled function.

    The memory of the device holds one piece; the results are numpy arrays. A trajectory that fails does not touch the others: its
    `status` says so. After Ctrl-C, SimulationInterrupted has the results so far, and `resume` runs what is missing.

    Args:
        model: the mechanism. Leaves with a leading axis of the batch's length are taken one by one: domain randomisation.
        q0: generalized coordinates, (batch, nq).
        u0: generalized speeds, (batch, nv).
        ts: times [s] to save, the same for all.
        control: as for `simulate`.
        control_axis: 0 if the arrays in the control or its parameters have a leading batch axis, None if all share them.
        batch_size: trajectories at a time. With adaptive steps, those of one piece take as many steps as the one that needs most.
        progress: show a progress bar.
        resume: the result of an interrupted call with the same arguments.
        options: as for `simulate`, without `throw` and `dense`.

    Returns:
        The trajectories, numpy arrays with a leading batch axis.

    Raises:
        ValueError: as for `simulate`, or the batch axes differ.
        SimulationInterrupted: on Ctrl-C.
    """
    refused = {"throw", "dense"} & set(options)
    if refused:
        raise ValueError(f"simulate_batch does not take {', '.join(sorted(refused))}: look at the status, and save more times")
    check_positive(batch_size=batch_size)
    q0, u0 = check_batch(model, q0, u0)
    axes = model_axes(model, len(q0))
    # Times must be known while tracing, for equal steps, so they are a static argument.
    times = tuple(np.asarray(ts, model.dtype).tolist())
    results = None if resume is None else jax.tree.map(np.array, resume)
    waiting = np.arange(len(q0)) if results is None else np.flatnonzero(results.status == Status.NOT_RUN)
    parameters, rest = eqx.partition(control, eqx.is_array)
    batched = [leaf if axis == 0 else None for leaf, axis in zip(jax.tree.leaves(model), axes, strict=True)]
    size = min(batch_size, len(q0))
    with _bar(len(waiting), progress) as advance:
        try:
            for start in range(0, len(waiting), size):
                rows = waiting[start : start + size]
                # The last piece is filled up with copies, so that it needs no compiling.
                padded = np.concatenate((rows, np.full(size - len(rows), rows[0])))
                leaves = [None if leaf is None else leaf[padded] for leaf in batched]
                chosen = jax.tree.map(lambda x: x[padded] if control_axis == 0 else x, parameters)  # noqa: B023
                piece = _run(model, leaves, q0[padded], u0[padded], times, chosen, rest, control_axis, options)
                piece = jax.tree.map(lambda x: np.asarray(x)[: len(rows)], piece)  # noqa: B023
                results = _empty(piece, len(q0)) if results is None else results
                jax.tree.map(lambda whole, part: whole.__setitem__(rows, part), results, piece)  # noqa: B023
                advance(len(rows))
        except KeyboardInterrupt as error:
            if results is None:
                raise
            raise SimulationInterrupted(results) from error
    assert results is not None
    return results


@eqx.filter_jit
def _run(
    model: Model,
    batched: list,
    q0: jax.Array,
    u0: jax.Array,
    ts: tuple[float, ...],
    parameters: Any,
    rest: Any,
    control_axis: int | None,
    options: dict[str, Any],
) -> Trajectory:
    """Simulate one piece; of the model's leaves those in `batched` go with the trajectories."""
    leaves, structure = jax.tree.flatten(model)

    def one(own: list, q: jax.Array, u: jax.Array, parameters: Any) -> Trajectory:
        here = jax.tree.unflatten(structure, [x if y is None else y for x, y in zip(leaves, own, strict=True)])
        return simulate(here, q, u, np.array(ts), control=eqx.combine(parameters, rest), **options)

    return jax.vmap(one, in_axes=(0, 0, 0, control_axis))(batched, q0, u0, parameters)


def model_axes(model: Model, length: int) -> list[int | None]:
    """0 for leaves of the model that have a leading batch axis, None for the others.

    Raises:
        ValueError: a leaf has neither the shape that the tree asks for, nor this shape behind the batch axis.
    """
    axes: list[int | None] = []
    for name, shape in leaf_shapes(model.tree).items():
        found = jnp.shape(getattr(model, name))
        if found not in (shape, (length, *shape)):
            raise ValueError(f"model.{name} has shape {found}, but this batch needs {shape} or {(length, *shape)}")
        axes.append(None if found == shape else 0)
    return axes


def _empty(piece: Trajectory, length: int) -> Trajectory:
    """Results for all that were not run, in the form of those of a piece."""

    def blank(part: np.ndarray) -> np.ndarray:
        return np.full((length, *part.shape[1:]), np.nan if np.issubdtype(part.dtype, np.floating) else -1, part.dtype)

    empty = jax.tree.map(blank, piece)
    return eqx.tree_at(lambda t: t.status, empty, np.full(length, int(Status.NOT_RUN), piece.status.dtype))


@contextlib.contextmanager
def _bar(total: int, show: bool) -> Iterator[Any]:
    """A function that advances a progress bar."""
    if not show:
        yield lambda count: None
        return
    columns = (TextColumn("simulating"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns) as bar:
        task = bar.add_task("", total=total)
        yield lambda count: bar.advance(task, count)
