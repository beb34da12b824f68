"""Simulation of one trajectory."""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.core import Tracer

from kanejax._kinematics.coordinate_rates import unit_quaternions
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds, own
from kanejax._simulate.checks import check_positive, check_step, checked_state, checked_times
from kanejax._simulate.control import Controlled, TorqueTable, as_control, check_control
from kanejax._simulate.events import as_conditions
from kanejax._simulate.runge_kutta import ExplicitRungeKutta
from kanejax._simulate.singular_speeds import add_singularity, check_bounce
from kanejax._simulate.solve import Settings, solve, solve_fixed, solve_restarting
from kanejax._simulate.step_size import FiniteSteps
from kanejax._simulate.system import system
from kanejax._simulate.trajectory import Status, Trajectory, raise_unless_ok

# What diffrax's implicit solvers have for a tolerance that nobody gave.
_UNSET = diffrax.with_stepsize_controller_tols(optx.Chord)().rtol


def simulate(
    model: AnyModel,
    q0: Any,
    u0: Any,
    ts: Any,
    *,
    control: Any = None,
    solver: diffrax.AbstractSolver[Any] | None = None,
    dt0: Any = None,
    rtol: Any = None,
    atol: Any = None,
    stepsize_controller: diffrax.AbstractStepSizeController[Any, Any] | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    events: Any = None,
    joint_limits: bool = False,
    on_event: Callable[..., Any] | None = None,
    max_events: int = 16,
    dense: bool = False,
    max_steps: int | None = 4096,
    throw: bool = False,
) -> Trajectory:
    """Move a mechanism from an initial state through time.

    Steps adapt to the tolerances, unless `dt0` asks for equal steps. The model's leaves, the initial state, the control's
    parameters and the events can be differentiated, and failing is a value in the result, so that in a batch one bad trajectory
    harms no other.

    Batches: `jax.vmap` over any of the arguments, where all trajectories take as many adaptive steps as the one that needs most;
    or `simulate_batch`, without derivatives, for any number in constant memory, where none waits for another.

    Gradients: reverse mode works with the defaults. With equal steps it keeps the states of all stages, about 1 kB a step for an
    arm with seven joints; for long simulations `adjoint=diffrax.RecursiveCheckpointAdjoint()` keeps few and evaluates the others
    again. Forward mode, faster for few parameters, works with equal steps, and with adaptive ones through
    `adjoint=diffrax.ForwardMode()`. `diffrax.DirectAdjoint()` has both modes for adaptive steps, but pays for `max_steps` steps.

    Args:
        model: the mechanism; a specialized one has no joint limits. With what `with_speeds` returns, u0, the u of control and of
            events, and `Trajectory.u` are the chosen speeds, and Status.SINGULAR_SPEEDS says that a trajectory has come to where
            `speed_conditioning` is a thousandth of what it was at first, or has changed its sign.
        q0: generalized coordinates at the first time; quaternions (w, x, y, z) are normalised.
        u0: generalized speeds at the first time.
        ts: times [s] to save, strictly increasing; the simulation starts at the first and ends at the last.
        control: forces at the joints: a function of (t, q, u), which may be an `equinox.Module` with parameters; a pair of a
            function of (t, q, u, params) and params; a `TorqueTable`; or None for zero. A new function object compiles again.
        solver: of diffrax, or a `BetaScheme`; by default `diffrax.Tsit5()`. Stiff mechanisms need an implicit one such as
            `diffrax.Kvaerno5()`.
        dt0: with it, equal steps no longer than this [s]. Each interval between saved times is divided alike if `ts` and `dt0` are
            known while tracing (numpy arrays, not `jnp.linspace` inside `jax.jit`) and there is nothing to interpolate: no events,
            chosen speeds, `dense` or `adjoint`. Otherwise steps of this length from the first time on. With an adaptive
            `stepsize_controller`, the first step.
        rtol: relative tolerance for adaptive and implicit steps, by default 1e-6 (float32: 1e-4).
        atol: absolute tolerance, by default 1e-8 (float32: 1e-6).
        stepsize_controller: of diffrax, instead of what `dt0`, `rtol` and `atol` describe.
        adjoint: of diffrax: how to differentiate.
        events: what stops the simulation: a scalar function of (t, q, u), whose zero crossings do, a `StateEvent`, or a mapping
            of names to those. Of two events in one step the first in this order counts.
        joint_limits: also stop where a joint leaves `model.joint_range`, an event called "joint limit".
        on_event: function (t, q, u) -> (q, u): go on with this state after an event instead of stopping, such as
            `JointLimitBounce`. An `equinox.Module` can have parameters. Events need a direction then.
        max_events: how many events are passed on to `on_event`; the next one stops.
        dense: keep what `Trajectory.evaluate` needs for any time, for `max_steps` steps.
        max_steps: stop after this many adaptive steps, between one event and the next; None never does, without reverse mode.
        throw: raise SimulationError if the simulation does not reach its end; for single trajectories.

    Returns:
        The trajectory, with its status.

    Raises:
        ValueError: an argument has a wrong shape, data type or value; values are looked at outside of jit and vmap only.
        SimulationError: with `throw`.
    """
    q0, u0 = checked_state(own(model), q0, u0)
    ts = checked_times(ts, model.dtype)
    check_positive(dt0=dt0, rtol=rtol, atol=atol, max_steps=max_steps, max_events=max_events)
    check_step(dt0, ts)
    # NumPy's integers would be traced, but a compiled program must know these.
    max_steps, max_events = max_steps if max_steps is None else int(max_steps), int(max_events)
    control = as_control(control)
    check_control(control, jnp.asarray(ts[0]), q0, u0)
    if on_event is not None and (dense or not (joint_limits or events)):
        raise ValueError("on_event needs events or joint_limits, and cannot be combined with dense")
    conditions, names = as_conditions(own(model), q0, events, joint_limits, need_direction=on_event is not None)
    conditions, names = add_singularity(model, jnp.asarray(ts[0]), q0, conditions, names)
    check_bounce(model, on_event)
    plain = stepsize_controller is None and adjoint is None and not conditions and not dense
    substeps = _substeps(ts, dt0) if plain else None
    rtol, atol = _tolerance(rtol, 1e-6, 1e-4, model.dtype), _tolerance(atol, 1e-8, 1e-6, model.dtype)
    if stepsize_controller is None:
        stepsize_controller = _controller(control, dt0, rtol, atol, ts)
    solver = _prepared_solver(diffrax.Tsit5() if solver is None else solver, stepsize_controller, rtol, atol)
    adjoint = diffrax.RecursiveCheckpointAdjoint() if adjoint is None else adjoint
    settings = Settings(solver, stepsize_controller, adjoint, conditions, dt0, max_steps, dense)
    trajectory = _simulate(model, q0, u0, jnp.asarray(ts), control, settings, substeps, on_event, max_events, names)
    return raise_unless_ok(trajectory) if throw else trajectory


@eqx.filter_jit
def _simulate(
    model: AnyModel,
    q0: jax.Array,
    u0: jax.Array,
    ts: jax.Array,
    control: Controlled,
    settings: Settings,
    substeps: int | None,
    on_event: Callable[..., Any] | None,
    max_events: int,
    names: tuple[str, ...],
) -> Trajectory:
    moving = system(model, control)
    y0 = jnp.concatenate((unit_quaternions(model.tree, q0), u0))
    if substeps is not None:
        solution = solve_fixed(settings.solver, moving, y0, ts, substeps)
    elif on_event is None:
        solution = solve(settings, moving, y0, ts[0], ts)
    else:
        solution = solve_restarting(settings, moving, y0, ts, on_event, max_events)
    status = solution.status
    if isinstance(model, WithSpeeds):
        # The last condition, see add_singularity.
        status = jnp.where(solution.event == len(names) - 1, int(Status.SINGULAR_SPEEDS), status).astype(jnp.int32)
    q_end, u_end = moving.split(solution.y_end)
    reached = (ts <= solution.t_end)[:, None]
    # Times that were not reached get a harmless state first, whose derivatives are finite.
    q, u = (jnp.where(reached, x, jnp.nan) for x in moving.split(jnp.where(reached, solution.saved, y0)))
    return Trajectory(
        ts=ts,
        q=q,
        u=u,
        t_end=solution.t_end,
        q_end=q_end,
        u_end=u_end,
        status=status,
        event=solution.event,
        num_events=solution.num_events,
        stats=solution.stats,
        interpolation=solution.interpolation,
        tree=model.tree,
        event_names=names,
    )


def _tolerance(given: Any, double: float, single: float, dtype: Any) -> Any:
    if given is None:
        given = double if dtype == jnp.float64 else single
    return given if isinstance(given, float | int) else jnp.asarray(given, dtype)


def _substeps(ts: Any, dt0: Any) -> int | None:
    """Equal steps between saved times, if they are known."""
    if dt0 is None or not isinstance(ts, np.ndarray) or isinstance(dt0, Tracer):
        return None
    # A step that fits but for rounding errors, also those of the times, fits.
    longest = np.max(np.diff(ts.astype(float))) - 2.0 * float(np.spacing(np.max(np.abs(ts))))
    return max(1, int(np.ceil(longest / float(dt0) * (1 - 1e-6))))


def _controller(control: Controlled, dt0: Any, rtol: Any, atol: Any, ts: Any) -> diffrax.AbstractStepSizeController[Any, Any]:
    if dt0 is not None:
        return diffrax.ConstantStepSize()
    if isinstance(control.function, TorqueTable) and control.function.interpolation == "hold":
        jumps = jax.lax.stop_gradient(control.function.ts).astype(ts.dtype)
        return diffrax.ClipStepSizeController(FiniteSteps(rtol=rtol, atol=atol), jump_ts=jumps)
    # Shorter steps would not advance the time.
    shortest = 16 * jnp.finfo(ts.dtype).eps * jnp.maximum(jnp.abs(ts[0]), jnp.abs(ts[-1]))
    return FiniteSteps(rtol=rtol, atol=atol, dtmin=shortest, force_dtmin=False)


def _prepared_solver(
    solver: diffrax.AbstractSolver[Any], controller: diffrax.AbstractStepSizeController[Any, Any], rtol: Any, atol: Any
) -> diffrax.AbstractSolver[Any]:
    """Loop over the stages so that forward and reverse mode both work, and give an implicit solver the tolerances it lacks."""
    if isinstance(solver, diffrax.AbstractERK):
        return ExplicitRungeKutta(solver)
    if getattr(solver, "scan_kind", "") is None:
        solver = eqx.tree_at(lambda s: s.scan_kind, solver, "bounded", is_leaf=lambda x: x is None)
    adaptive = isinstance(controller, diffrax.AbstractAdaptiveStepSizeController)
    if isinstance(solver, diffrax.AbstractImplicitSolver) and not adaptive:
        root_finder = solver.root_finder
        for name, value in (("rtol", rtol), ("atol", atol), ("norm", optx.rms_norm)):
            if getattr(root_finder, name) is _UNSET:
                root_finder = eqx.tree_at(lambda finder: getattr(finder, name), root_finder, value)  # noqa: B023
        solver = eqx.tree_at(lambda s: s.root_finder, solver, root_finder)
    return solver
