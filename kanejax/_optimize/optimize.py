"""Optimal motions, by the interior-point method or by IPOPT."""

import importlib.util
import os
from collections.abc import Callable, Mapping
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._checkpoint import INTERVAL, Checkpoint, opened
from kanejax._errors import KanejaxError
from kanejax._optimal_control.interior_point import first_search, searched
from kanejax._optimal_control.ipopt import SearchInterrupted, searched_by_ipopt
from kanejax._optimal_control.search import Result, Search
from kanejax._optimal_control.sensitivity import optimum
from kanejax._optimal_control.stages import Path
from kanejax._optimize.displacement import displaced, displacement
from kanejax._optimize.feasibility import check_finite, check_task, verdict
from kanejax._optimize.motion import OptimalMotion, motion_of
from kanejax._optimize.state import State
from kanejax._optimize.task import MotionTask
from kanejax._optimize.transcription import MotionStages


@final
class Guess(eqx.Module):
    """A first guess, which need not be a motion: an `OptimalMotion` has the same fields, for warm starts.

    Attributes:
        q: coordinates at the nodes.
        u: speeds at the nodes.
        u_dot: accelerations of the steps.
        tau: forces of the steps.
        duration: [s].
    """

    q: Float[Array, "nodes nq"]
    u: Float[Array, "nodes nv"]
    u_dot: Float[Array, "steps nv"]
    tau: Float[Array, "steps nv"]
    duration: Float[Array, ""]


def straight_guess(task: MotionTask) -> Guess:
    """Straight from the start to the goal: states between theirs, no accelerations, no forces.

    Args:
        task: whose start and goal it joins.

    Returns:
        The guess, for `optimize`.
    """
    model, steps = task.model, task.steps
    known = [each for each in (task.start.q, task.goal.q) if each is not None] or [model.coordinate_reference]
    start, goal = known[0], known[-1]
    share = jnp.linspace(0.0, 1.0, steps + 1, dtype=model.dtype)[:, None]
    whole = displacement(model.tree, start, goal)
    q = jax.vmap(lambda part: displaced(model.tree, start, part * whole))(share[:, 0])
    rest = jnp.zeros(model.nv, model.dtype)
    first, last = (rest if each.u is None else each.u for each in (task.start, task.goal))
    u = (1.0 - share) * first[None] + share * last[None]
    none = jnp.zeros((steps, model.nv), model.dtype)
    return Guess(q, u, none, none, 0.5 * (task.duration[0] + task.duration[1]))


def first_path(stages: MotionStages, guess: Guess | OptimalMotion) -> Path:
    """A guess as states and controls.

    Raises:
        ValueError: the guess does not fit the task.
    """
    task = stages.task
    model, nodes = task.model, task.steps + 1
    for name, count, size in (("q", nodes, model.nq), ("u", nodes, model.nv), ("tau", task.steps, model.nv)):
        if getattr(guess, name).shape != (count, size):
            raise ValueError(f"guess.{name} has shape {getattr(guess, name).shape}, but this task needs ({count}, {size})")

    def numbers(k: jax.Array, q: jax.Array, u: jax.Array, tau: jax.Array, u_dot: jax.Array) -> jax.Array:
        return stages.numbers(k, State(q, u, tau, u_dot, guess.duration))

    before = [jnp.concatenate((each[:1], each)) for each in (guess.tau, guess.u_dot)]
    x = jax.vmap(numbers)(jnp.arange(task.steps + 1), guess.q, guess.u, *before)
    return Path(x, guess.u_dot if task.dynamics == "inverse" else guess.tau)


def tolerance_of(task: MotionTask, given: float | None) -> jax.Array:
    """The tolerance that is given, or that of the data type."""
    dtype = task.model.dtype
    default = 1e-8 if dtype == jnp.float64 else 1e-3
    return jnp.asarray(default if given is None else given, dtype)


def optimal_motion(
    task: MotionTask, guess: Guess | OptimalMotion | None = None, *, tolerance: float | None = None, max_iterations: int = 300
) -> OptimalMotion:
    """The motion of least cost near a guess, as a pure function: for `jax.jit`, `jax.vmap` over tasks, models and guesses.

    Gradients of the motion, its duration and its cost with respect to all that is in the task, such as masses, link lengths, goals
    and limits, are those of the implicit function theorem, in forward and in reverse mode; of the first order, and where the search
    converged.

    Args:
        task: what is asked for.
        guess: where to start, `straight_guess(task)` by default. States need not follow from each other.
        tolerance: to which the conditions of optimality hold in the end, by default 1e-8 (float32: 1e-3).
        max_iterations: after which the search ends.

    Returns:
        The motion, and whether it is optimal.
    """
    guess = straight_guess(task) if guess is None else guess
    # The optimum does not depend on where the search began.
    guess = jax.lax.stop_gradient(guess)
    stages = MotionStages(task, guess.q)
    return motion_of(stages, optimum(stages, first_path(stages, guess), max_iterations, tolerance_of(task, tolerance)))


class OptimizationError(KanejaxError, RuntimeError):
    """A motion was not found; the message says what stands in the way, and `motion` is where the search ended."""

    def __init__(self, message: str, motion: OptimalMotion) -> None:
        """Keep the motion."""
        super().__init__(message)
        self.motion = motion


class OptimizationInterrupted(KeyboardInterrupt):
    """Ctrl-C; `motion` is where the search was, from which `optimize(task, motion)` goes on."""

    def __init__(self, motion: OptimalMotion, advice: str = "the attribute `motion` is where the search was") -> None:
        """Keep the motion."""
        super().__init__(f"interrupted; {advice}")
        self.motion = motion


class SolverNotInstalledError(KanejaxError, ImportError):
    """A solver is not part of the library and not installed; the message says how to install it."""


def optimize(
    task: MotionTask,
    guess: Guess | OptimalMotion | None = None,
    *,
    tolerance: float | None = None,
    max_iterations: int = 300,
    progress: Callable[[OptimalMotion], None] | None = None,
    checkpoint: str | os.PathLike[str] | Checkpoint | None = None,
    checkpoint_interval: float = INTERVAL,
    throw: bool = True,
    solver: str = "interior_point",
    ipopt_options: Mapping[str, Any] | None = None,
) -> OptimalMotion:
    """The motion of least cost near a guess, with a verdict where there is none; see `optimize_batch` for many at once.

    Args:
        task: what is asked for.
        guess: where to start, `straight_guess(task)` by default; another task's optimal motion is a warm start.
        tolerance: to which the conditions of optimality hold in the end, by default 1e-8 (float32: 1e-3).
        max_iterations: after which the search ends.
        progress: called with the motion so far after every ten iterations.
        checkpoint: path of a file in which the search is kept, so that the same call, maybe with more iterations, goes on where it
            was after Ctrl-C or a crash, and ends with the same numbers; IPOPT, which tells less of its state, with an optimum near
            to them. It stays at the end, where the same call finds what was found; remove it then.
        checkpoint_interval: time between two writings of the file [s]; it is written at the end in any case.
        throw: raise where the search does not converge, instead of returning a motion that says so.
        solver: "interior_point", that of `optimal_motion`, or "ipopt", which `pip install 'kanejax[ipopt]'` brings.
        ipopt_options: IPOPT's own, such as {"mu_strategy": "adaptive", "print_level": 5}.

    Returns:
        The motion.

    Raises:
        InfeasibleTaskError: boundary values are beyond limits, or too far from each other.
        NonFiniteTaskError: something is infinite or not a number at the first guess.
        OptimizationError: the search did not converge.
        OptimizationInterrupted: on Ctrl-C.
        CheckpointError: the checkpoint belongs to another task, is none, or cannot be written; remove it, or give another path.
        SolverNotInstalledError: IPOPT is not.
        ValueError: an option of a solver does not exist.
    """
    _check_solver(solver, ipopt_options)
    check_task(task)
    guess = straight_guess(task) if guess is None else guess
    stages = MotionStages(task, guess.q)
    inputs = (task, guess, tolerance, solver, ipopt_options)
    with opened(checkpoint, checkpoint_interval, "optimize", *inputs) as kept:
        search = kept.restored(_first(stages, guess))

        def watch(now: Search) -> None:
            nonlocal search
            search = now
            kept.keep(search)
            if progress is not None:
                progress(_motion(stages, search))

        try:
            search = _ended(stages, search, tolerance_of(task, tolerance), max_iterations, watch, solver, ipopt_options)
        except SearchInterrupted as error:
            raise OptimizationInterrupted(_motion(stages, error.search)) from error
        except KeyboardInterrupt as error:
            raise OptimizationInterrupted(_motion(stages, search)) from error
    if int(search.result) == Result.NON_FINITE:
        check_finite(stages, search.point.path)
    motion = _motion(stages, search)
    if throw and int(search.result) != Result.CONVERGED:
        raise OptimizationError(verdict(stages, search, float(tolerance_of(task, tolerance))), motion)
    return motion


def _ended(
    stages: MotionStages,
    search: Search,
    tolerance: jax.Array,
    max_iterations: int,
    watch: Callable[[Search], None],
    solver: str,
    ipopt_options: Mapping[str, Any] | None,
) -> Search:
    """A search at its end; watched after every segment."""
    left = max_iterations - int(search.iterations)
    if solver == "ipopt" and int(search.result) == Result.RUNNING and left > 0:
        search = searched_by_ipopt(stages, search, left, tolerance, options=ipopt_options, watch=watch, every=_SEGMENT)
        watch(search)
        return search
    while int(search.result) == Result.RUNNING and int(search.iterations) < max_iterations:
        count = min(_SEGMENT, max_iterations - int(search.iterations))
        search = _next(stages, search, jnp.asarray(count), tolerance)
        watch(search)
    return search


def _check_solver(solver: str, ipopt_options: Mapping[str, Any] | None) -> None:
    if solver not in ("interior_point", "ipopt"):
        raise ValueError(f"solver is {solver!r}; use 'interior_point' or 'ipopt'")
    if ipopt_options and solver != "ipopt":
        raise ValueError(f"ipopt_options are given, but solver is {solver!r}; use solver='ipopt'")
    if solver == "ipopt" and importlib.util.find_spec("cyipopt") is None:
        wheels = "pip install 'kanejax[ipopt]', or conda install -c conda-forge cyipopt where PyPI has no wheel"
        raise SolverNotInstalledError(f"solver='ipopt' needs the package cyipopt: {wheels}")


_SEGMENT = 10
_first = eqx.filter_jit(lambda stages, guess: first_search(stages, first_path(stages, guess)))
_next = eqx.filter_jit(searched)
_motion = eqx.filter_jit(motion_of)
