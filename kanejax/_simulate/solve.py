"""The loops over steps: diffrax's for adaptive steps and events, a plain scan for steps that are known beforehand."""

from collections.abc import Callable
from typing import Any, NamedTuple, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from kanejax._simulate.events import Falling, event_time_finder
from kanejax._simulate.system import System, rates
from kanejax._simulate.trajectory import Status, status_of

STATS = ("num_steps", "num_accepted_steps", "num_rejected_steps")


class Solution(NamedTuple):
    """States at the saved times, and how the integration ended; `event` is an index of the conditions, or -1.

    `interpolation` is diffrax's; of a `Segment`, what it left.
    """

    saved: jax.Array
    t_end: jax.Array
    y_end: jax.Array
    status: jax.Array
    event: jax.Array
    num_events: jax.Array
    stats: dict[str, jax.Array]
    interpolation: Any = None


@final
class Settings(eqx.Module):
    """How diffrax integrates."""

    solver: diffrax.AbstractSolver[Any]
    controller: diffrax.AbstractStepSizeController[Any, Any]
    adjoint: diffrax.AbstractAdjoint
    conditions: tuple[Falling, ...]
    dt0: Any
    max_steps: int | None = eqx.field(static=True)
    dense: bool = eqx.field(static=True)


def solve_fixed(solver: diffrax.AbstractSolver[Any], system: System, y0: jax.Array, ts: jax.Array, substeps: int) -> Solution:
    """Take `substeps` equal steps between one saved time and the next.

    Next to diffrax's loop: nothing is interpolated, forward and reverse mode both work, and reverse mode evaluates no step again,
    because it keeps the state of every stage.
    """
    term = diffrax.ODETerm(rates)
    fractions = jnp.arange(substeps + 1, dtype=ts.dtype) / substeps
    state = solver.init(term, ts[0], ts[0] + (ts[1] - ts[0]) * fractions[1], y0, system)

    def step(carry: tuple, times: tuple[jax.Array, jax.Array]) -> tuple[tuple, None]:
        y, state, solved = carry
        y, _, _, state, result = solver.step(term, *times, y, system, state, made_jump=False)
        return (y, state, solved & (result == diffrax.RESULTS.successful)), None

    def interval(carry: tuple, ends: tuple[jax.Array, jax.Array]) -> tuple[tuple, tuple[jax.Array, jax.Array]]:
        times = ends[0] + (ends[1] - ends[0]) * fractions
        carry, _ = jax.lax.scan(step, carry, (times[:-1], times[1:]))
        return carry, (carry[0], carry[2])

    carry = jax.tree.map(jnp.asarray, (y0, state, True))
    _, (saved, solved) = jax.lax.scan(interval, carry, (ts[:-1], ts[1:]))
    saved = jnp.concatenate((y0[None], saved))
    finite = jnp.all(jnp.isfinite(saved), 1)
    # What follows the first failure counts for nothing. A step is solved no more once its state is not finite: that says more.
    good = jnp.cumprod(jnp.concatenate((finite[:1], finite[1:] & solved))).astype(bool)
    last = jnp.maximum(jnp.sum(good) - 1, 0)
    failure = jnp.where(jnp.all(finite), int(Status.SOLVER_FAILED), int(Status.NON_FINITE))
    status = jnp.where(jnp.all(good), int(Status.SUCCESSFUL), failure).astype(jnp.int32)
    total, none = jnp.asarray(substeps * (len(ts) - 1), jnp.int32), jnp.asarray(0, jnp.int32)
    return Solution(saved, ts[last], saved[last], status, none - 1, none, dict(zip(STATS, (total, total, none), strict=True)))


def solve(settings: Settings, system: System, y0: jax.Array, t0: jax.Array, ts: jax.Array) -> Solution:
    """Integrate from t0 to the last of ts with diffrax; times up to t0 get its state, those not reached infinity.

    From a state that is not finite there is nothing to integrate.
    """
    finite = jnp.all(jnp.isfinite(y0))
    begin = jnp.where(finite, t0, ts[-1])
    event = diffrax.Event(settings.conditions, event_time_finder(y0.dtype), direction=False) if settings.conditions else None
    saveat = diffrax.SaveAt(subs=(diffrax.SubSaveAt(ts=jnp.maximum(ts, begin)), diffrax.SubSaveAt(t1=True)), dense=settings.dense)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates),
        settings.solver,
        begin,
        ts[-1],
        settings.dt0,
        y0,
        system,
        saveat=saveat,
        stepsize_controller=settings.controller,
        adjoint=settings.adjoint,
        event=event,
        max_steps=settings.max_steps,
        throw=False,
    )
    assert solution.ts is not None
    assert solution.ys is not None
    happened = jnp.array([False] if event is None else jax.tree.leaves(solution.event_mask))
    which = jnp.where(jnp.any(happened), jnp.argmax(happened), -1).astype(jnp.int32)
    status = status_of(solution.result, jnp.all(jnp.isfinite(solution.ys[1])))
    stats = {name: jnp.asarray(solution.stats[name], jnp.int32) for name in STATS}
    none = jnp.asarray(0, jnp.int32)
    rest = solution.stats.get("segment", solution.interpolation)
    # diffrax saves the state at t0 with the first step that it keeps.
    saved = jnp.where((ts <= t0)[:, None], y0, solution.ys[0])
    # Where an event ended another trajectory of the batch, diffrax interpolates the last state of this one too, at the end of its
    # step, which is another rounding. Its row at that time is always interpolated, and the loop's own state never.
    left = rest[0].y if "segment" in solution.stats else solution.ys[1][0]
    y_last = jnp.where(solution.ts[1][0] == ts[-1], saved[-1], left)
    y_end = jnp.where(jnp.any(happened), solution.ys[1][0], y_last)
    return Solution(saved, jnp.where(finite, solution.ts[1][0], t0), y_end, status, which, none, stats, rest)


def solve_restarting(
    settings: Settings, system: System, y0: jax.Array, ts: jax.Array, on_event: Callable[..., Any], max_events: int
) -> Solution:
    """Integrate, and after each of the first `max_events` events go on from the state that `on_event` makes of the present one.

    One loop over the pieces between events, so that the program has the integration once.
    """
    # The last condition of chosen speeds, where they are singular, is none of the user's.
    passed_on = len(settings.conditions) - (system.chosen is not None)

    def piece(carry: tuple[jax.Array, jax.Array, jax.Array, Solution], last: jax.Array) -> tuple[tuple, None]:
        t, y, done, before = carry
        now = solve(settings, system, y, jnp.where(done, ts[-1], t), ts)
        restarts = ~done & (now.event >= 0) & (now.event < passed_on) & ~last
        saved = jnp.where((~done & (ts >= t))[:, None], now.saved, before.saved)
        t_end, y_end, status, event = (
            jnp.where(done, old, new)
            for old, new in (
                (before.t_end, now.t_end),
                (before.y_end, now.y_end),
                (before.status, now.status),
                (before.event, now.event),
            )
        )
        stats = {name: before.stats[name] + now.stats[name] for name in STATS}
        after = jnp.concatenate(on_event(t_end, *system.split(y_end))).astype(y.dtype)
        y = jnp.where(restarts, after, y_end)
        total = Solution(saved, t_end, y_end, status, event, before.num_events + restarts.astype(jnp.int32), stats)
        return (t_end, y, ~restarts, total), None

    none = jnp.asarray(0, jnp.int32)
    empty = Solution(jnp.full((len(ts), *y0.shape), jnp.inf, y0.dtype), ts[0], y0, none, none - 1, none, dict.fromkeys(STATS, none))
    carry = (ts[0], y0, jnp.asarray(False), empty)
    (_, _, _, total), _ = jax.lax.scan(piece, carry, jnp.arange(max_events + 1) == max_events)
    return total
