"""Tasks that cannot be fulfilled, and searches that did not fulfil them, in words."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from kanejax._errors import KanejaxError
from kanejax._optimal_control import barrier
from kanejax._optimal_control.search import Result, Search
from kanejax._optimal_control.stages import Path, bounded, values
from kanejax._optimize.task import MotionTask
from kanejax._optimize.transcription import MotionStages

# Rounding of boundary values that lie on a limit.
_ROUNDING = 1e-6


class InfeasibleTaskError(KanejaxError, ValueError):
    """No motion within the limits fulfils a task; the message names the limit."""


class NonFiniteTaskError(KanejaxError, ValueError):
    """A cost, a constraint or the motion is infinite or not a number at the first guess; the message names it."""


def check_task(task: MotionTask) -> None:
    """Compare the boundary values with the limits, and the way between them with the speeds and the duration.

    Raises:
        InfeasibleTaskError: one is out of bounds, or the way is too long.
    """
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(task)):
        return
    tree, limits = task.model.tree, task.limits
    (rows_v, rows_q), ends = tree.plain_speeds, (("start", task.start), ("goal", task.goal))
    names = tree.speed_names
    for where, state in ends:
        for what, values_, pair in (
            ("coordinate", None if state.q is None else np.asarray(state.q)[rows_q], np.asarray(limits.q)[:, rows_v]),
            ("speed", None if state.u is None or limits.u is None else np.asarray(state.u), _array(limits.u)),
        ):
            if values_ is not None and pair is not None:
                _check_within(where, what, values_, pair, [names[v] for v in rows_v] if what == "coordinate" else names)
    if task.start.q is not None and task.goal.q is not None and limits.u is not None:
        way = np.asarray(task.goal.q - task.start.q)[rows_q]
        pair, longest = np.asarray(limits.u)[:, rows_v], float(task.duration[1])
        reach = np.where(way > 0, pair[1], -pair[0]) * longest
        if np.any(np.abs(way) > reach * (1.0 + _ROUNDING)):
            i = int(np.argmax(np.abs(way) / np.maximum(reach, np.finfo(float).tiny)))
            least = abs(way[i]) * longest / max(reach[i], np.finfo(float).tiny)
            raise InfeasibleTaskError(
                f"from start to goal joint {names[rows_v[i]]!r} moves by {way[i]:g}, which takes at least {least:g} s at its "
                f"greatest speed, but the duration is at most {longest:g} s"
            )


def _check_within(where: str, what: str, values_: np.ndarray, pair: np.ndarray, names: Sequence[str]) -> None:
    room = _ROUNDING * np.maximum(1.0, np.abs(values_))
    bad = (values_ < pair[0] - room) | (values_ > pair[1] + room)
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        raise InfeasibleTaskError(
            f"the {what} of joint {names[i]!r} at the {where} is {values_[i]:g}, beyond its limits {pair[0, i]:g} and "
            f"{pair[1, i]:g}"
        )


def _array(limits: Any) -> np.ndarray | None:
    return None if limits is None else np.asarray(limits)


def check_finite(stages: MotionStages, path: Path) -> None:
    """Look for what is not finite at the first guess.

    Raises:
        NonFiniteTaskError: something is not.
    """
    found, final = values(stages, path)
    for name, each in stages.costs(path).items():
        if not np.isfinite(each):
            raise NonFiniteTaskError(f"the cost {name!r} is {float(each)} at the first guess")
    (of_stage, of_final), nx = stages.row_names(), path.x.shape[1]
    own = nx + path.w.shape[1]
    for names, rows in ((of_stage[own:], np.atleast_2d(found.rows)), (of_final[nx:], np.asarray(final.rows)[None])):
        for k, i in zip(*np.nonzero(~np.isfinite(rows)), strict=True):
            raise NonFiniteTaskError(f"{names[i]} is {rows[k, i]} at node {k} of the first guess")
    if not np.all(np.isfinite(found.next)):
        k = int(np.flatnonzero(~np.isfinite(np.asarray(found.next)).all(1))[0])
        raise NonFiniteTaskError(f"the motion from node {k} of the first guess is not finite")
    raise NonFiniteTaskError("a derivative of the cost is not finite at the first guess")


def verdict(stages: MotionStages, search: Search, tolerance: float) -> str:
    """How a search ended, and what stands in the way of the tolerance."""
    result, errors = Result(int(search.result)), search.errors
    if result == Result.CONVERGED:
        return f"optimal to {float(errors.greatest):.1e} after {int(search.iterations)} iterations"
    if result == Result.STALLED:
        return f"no step lowers the cost, but its slope is {float(errors.slope):.1e}: the cost or a constraint may not be smooth"
    end = "no step brings it nearer to all limits" if result == Result.INFEASIBLE else "the iterations are used up"
    if float(errors.violation) <= tolerance:
        return f"{end}; all limits hold, but the slope of the cost is {float(errors.slope):.1e}"
    return f"{end}; {_worst(stages, search)}"


def _worst(stages: MotionStages, search: Search) -> str:
    """The greatest violation in words."""
    path, bounds = search.point.path, stages.bounds()
    found, final = values(stages, path)
    y, final_y = bounded(path, found.rows, final.rows)
    beyond = [np.asarray(_beyond(each, pair)) for each, pair in ((y, bounds.stage), (final_y, bounds.final))]
    jumps = np.abs(np.asarray(found.next - path.x[1:]))
    steps = stages.task.steps
    duration = float(stages.state(jnp.asarray(steps), path.x[-1]).duration)
    if max(jumps.max(), beyond[0].max(), beyond[1].max()) == jumps.max():
        k = int(np.unravel_index(jumps.argmax(), jumps.shape)[0])
        which, k_most, i = _greatest(*(np.abs(barrier.multiplier(each)) for each in (search.point.stage, search.point.final)))
        jump = f"the motion jumps by {jumps.max():.2g} at t = {(k + 1) * duration / steps:.3g} s"
        time = duration if which else k_most * duration / steps
        return f"{jump}, and of all limits the {stages.row_names()[which][i]} at t = {time:.3g} s presses most"
    which, k, i = _greatest(*beyond)
    low, high = np.asarray(bounds.final[:, None] if which else bounds.stage)[:, k, i]
    # Coordinates are counted from those of the guess.
    offset = float(stages.offset()[stages.task.steps if which else k, i]) if i < stages.task.model.nv else 0.0
    value = float(np.atleast_2d(np.asarray(final_y if which else y))[k, i]) + offset
    time = duration if which else k * duration / steps
    low, high = low + offset, high + offset
    wanted = f"{low:g}" if low == high else f"between {low:g} and {high:g}"
    return f"the {stages.row_names()[which][i]} at t = {time:.3g} s is {value:.6g}, but has to be {wanted}"


def _greatest(stage: np.ndarray, final: np.ndarray) -> tuple[int, int, int]:
    """Whether the greatest number is the last node's (1) or a stage's (0), and its node and place there."""
    which = int(final.max() >= stage.max())
    table = np.atleast_2d(np.asarray(final if which else stage))
    k, i = np.unravel_index(table.argmax(), table.shape)
    return which, int(k), int(i)


def _beyond(y: jax.Array, bounds: jax.Array) -> jax.Array:
    """By how much bounds are violated."""
    over = jnp.maximum(jnp.max(-barrier.room(y, bounds), 0), 0.0)
    return jnp.maximum(over, jnp.abs(barrier.excess(y, bounds)))
