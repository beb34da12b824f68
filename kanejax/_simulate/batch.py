"""Simulation of any number of trajectories, as many at a time as fit the memory."""

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from kanejax._lanes import Listed, Results, Runner, cores, progress_bar, run_lanes
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds, own
from kanejax._model.model import leaf_shapes
from kanejax._model.specialized import Specialized
from kanejax._simulate.checks import check_batch, check_positive, compilable
from kanejax._simulate.segment import Segment
from kanejax._simulate.simulate import simulate
from kanejax._simulate.trajectory import Array, Status, Trajectory

# So many adaptive steps, then finished trajectories make room for others. Fewer cost more calls, more wait longer.
SEGMENT = 16
FEWEST = 64


class SimulationInterrupted(KeyboardInterrupt):
    """`simulate_batch` was interrupted; `trajectory` has what was done, and Status.NOT_RUN for the rest."""

    def __init__(self, trajectory: Trajectory) -> None:
        """Keep the trajectory."""
        self.trajectory = trajectory
        missing = int(np.sum(np.asarray(trajectory.status) == Status.NOT_RUN))
        super().__init__(f"{missing} of {len(trajectory.status)} trajectories were not run; go on with resume=error.trajectory")


def simulate_batch(
    model: AnyModel,
    q0: Any,
    u0: Any,
    ts: Any,
    *,
    control: Any = None,
    control_axis: int | None = None,
    batch_size: int = 128,
    threads: int | None = None,
    progress: bool = False,
    resume: Trajectory | None = None,
    **options: Any,
) -> Trajectory:
    """Simulate many initial states, `batch_size` of them at a time, by one compiled function.

    The memory of the device holds those; the results are numpy arrays. With adaptive steps a trajectory that is finished makes room
    for the next, so that none waits for one that needs more steps. A trajectory that fails does not touch the others: its `status`
    says so. After Ctrl-C the segments that are under way come to their end, SimulationInterrupted has all trajectories that were
    finished, and `resume` runs only what is missing.

    Args:
        model: the mechanism. Leaves with a leading axis of the batch's length are taken one by one: domain randomisation.
        q0: generalized coordinates, (batch, nq).
        u0: generalized speeds, (batch, nv).
        ts: times [s] to save, the same for all.
        control: as for `simulate`.
        control_axis: 0 if the arrays in the control or its parameters have a leading batch axis, None if all share them.
        batch_size: trajectories at a time. Best a small part of all: the room that the last ones leave stays empty. With `on_event`
            there is no making room, and all of them wait for the one that needs most steps.
        threads: how many of these run side by side, each with `batch_size` of its own. By default one for each processor core that
            gets 64 trajectories, and one where an accelerator computes. Of JAX's contexts only `enable_x64` holds in threads:
            with `threads=1` all do.
        progress: show a progress bar.
        resume: the result of an interrupted call with the same arguments.
        options: as for `simulate`, without `throw` and `dense`; `adjoint` does not matter.

    Returns:
        The trajectories, numpy arrays with a leading batch axis.

    Raises:
        ValueError: as for `simulate`, or the batch axes differ.
        SimulationInterrupted: on Ctrl-C, once a trajectory is finished.
    """
    refused = {"throw", "dense"} & set(options)
    if refused:
        raise ValueError(f"simulate_batch does not take {', '.join(sorted(refused))}: look at the status, and save more times")
    check_positive(batch_size=batch_size, threads=threads)
    batch_size, options = int(batch_size), compilable(options, model.dtype)
    q0, u0 = check_batch(own(model), q0, u0)
    axes = model_axes(model, len(q0))
    batched = [leaf if axis == 0 else None for leaf, axis in zip(jax.tree.leaves(model), axes, strict=True)]
    parameters, rest = eqx.partition(control, eqx.is_array)

    def inputs(rows: np.ndarray) -> LaneInputs:
        leaves = [None if leaf is None else leaf[rows] for leaf in batched]
        return LaneInputs(leaves, q0[rows], u0[rows], jax.tree.map(lambda x: x[rows] if control_axis == 0 else x, parameters))

    run = lane_runner(model, ts, rest, control_axis, options, inputs)
    if resume is not None and len(resume.status) != len(q0):
        raise ValueError(f"resume has {len(resume.status)} trajectories, but q0 has {len(q0)}; give those of the interrupted call")
    before = None if resume is None else jax.tree.map(np.array, resume)
    results = Results(len(q0), before, lambda found: found.status, Status.NOT_RUN)
    waiting = np.arange(len(q0)) if resume is None else np.flatnonzero(np.asarray(resume.status) == Status.NOT_RUN)
    # Fewer lanes than these would not fill the vector instructions of one core.
    threads = min(cores(), max(1, len(waiting) // FEWEST)) if threads is None else int(threads)
    size = min(batch_size, max(1, -(-len(waiting) // threads)))
    counts = run_lanes(run, Listed(waiting), size, threads, results.store)
    try:
        with progress_bar("simulating", len(waiting), progress) as advance, contextlib.closing(counts):
            for count in counts:
                advance(count)
    except KeyboardInterrupt as error:
        if (done := results.close()) is None:
            raise
        raise SimulationInterrupted(done) from error
    done = results.close()
    assert done is not None
    return done


class LaneInputs(NamedTuple):
    """What belongs to the trajectories in the lanes, each array with a leading axis for them.

    Attributes:
        leaves: of the model, None for those that all trajectories share.
        q0: generalized coordinates at the first time.
        u0: generalized speeds at the first time.
        control: arrays in the control; without the axis if all trajectories share them.
    """

    leaves: list
    q0: np.ndarray
    u0: np.ndarray
    control: Any


def lane_runner(
    model: AnyModel,
    ts: Any,
    control_rest: Any,
    control_axis: int | None,
    options: dict[str, Any],
    inputs: Callable[[np.ndarray], LaneInputs],
) -> Runner:
    """The function that runs trajectories given by their rows, from the state that it left them in or, if fresh, from the first.

    Args:
        model: the mechanism.
        ts: times to save.
        control_rest: the control without its arrays.
        control_axis: 0 if those differ from trajectory to trajectory, None if all share them.
        options: of `simulate`.
        inputs: what belongs to the trajectories of some rows.
    """
    times = _Times(np.asarray(ts, model.dtype))
    length = SEGMENT if _in_segments(options) else None

    def run(rows: np.ndarray, before: Any, fresh: np.ndarray) -> tuple[Any, jax.Array, Trajectory]:
        own = inputs(rows)
        arguments = (model, own.leaves, own.q0, own.u0, times, own.control, control_rest, control_axis, options, length)
        if before is None and length is not None:
            shapes = eqx.filter_eval_shape(_run, *arguments, None, fresh)[0]
            before = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
        return _run(*arguments, before, fresh)

    return run


@jax.tree_util.register_static
class _Times:
    """Saved times, which must be known while tracing for equal steps: a static argument, hashed once for all calls."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values
        self._hash = hash((values.dtype.str, values.tobytes()))

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Times) and np.array_equal(self.values, other.values) and self.values.dtype == other.values.dtype


@eqx.filter_jit
def _run(
    model: AnyModel,
    batched: list,
    q0: Array,
    u0: Array,
    ts: "_Times",
    parameters: Any,
    rest: Any,
    control_axis: int | None,
    options: dict[str, Any],
    length: int | None,
    before: Any,
    fresh: Array,
) -> tuple[Any, jax.Array, Trajectory]:
    """Simulate one piece, to the end or a segment of some steps; of the model's leaves those in `batched` go with the trajectories.

    Returns:
        What the next segment goes on with, which trajectories are unfinished, and the trajectories.
    """
    leaves, structure = jax.tree.flatten(model)

    def one(own: list, q: Array, u: Array, parameters: Any, before: Any, fresh: Array) -> Any:
        here = jax.tree.unflatten(structure, [x if y is None else y for x, y in zip(leaves, own, strict=True)])
        given = options if length is None else {**options, "adjoint": Segment(before, fresh, length)}
        trajectory = simulate(here, q, u, ts.values, control=eqx.combine(parameters, rest), **given)
        left, unfinished = (None, jnp.asarray(False)) if length is None else trajectory.interpolation
        return left, unfinished, dataclasses.replace(trajectory, interpolation=None)

    return jax.vmap(one, in_axes=(0, 0, 0, control_axis, 0, 0))(batched, q0, u0, parameters, before, fresh)


def _in_segments(options: dict[str, Any]) -> bool:
    """Whether trajectories take different numbers of steps, and can be left after some; restarts after events cannot."""
    adaptive = options.get("dt0") is None or options.get("stepsize_controller") is not None
    return adaptive and options.get("on_event") is None and options.get("max_steps", 0) is not None


def model_axes(model: AnyModel, length: int) -> list[int | None]:
    """0 for leaves of the model that have a leading batch axis, None for the others.

    Raises:
        ValueError: a leaf has neither the shape that the tree asks for, nor this shape behind the batch axis.
    """
    if isinstance(model, WithSpeeds):
        of_model = model_axes(model.model, length)
        return of_model + [None] * (len(jax.tree.leaves(model)) - len(of_model))
    axes: list[int | None] = []
    shapes = leaf_shapes(model.tree)
    leaves = dict(sorted(model.kept.items())) if isinstance(model, Specialized) else {name: getattr(model, name) for name in shapes}
    for name, leaf in leaves.items():
        found, shape = jnp.shape(leaf), shapes[name]
        if found not in (shape, (length, *shape)):
            raise ValueError(f"model.{name} has shape {found}, but this batch needs {shape} or {(length, *shape)}")
        axes.append(None if found == shape else 0)
    return axes
