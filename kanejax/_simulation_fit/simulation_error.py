"""The simulation stage: parameters with which simulated motion is measured motion.

Output error: unlike in the inverse-dynamics stage no acceleration is needed, and errors of the positions do not bias the
parameters. Windows with first states of their own converge from afar; whole runs use all that the data say. See shooting for how
long windows are simulated in pieces, and levenberg_marquardt for the steps.
"""

import functools
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._checkpoint import INTERVAL, Checkpoint, opened
from kanejax._errors import UnsupportedModelError
from kanejax._logs.motion import Motion
from kanejax._parameters.parameterization import Parameterization
from kanejax._regression.one_thread import one_thread
from kanejax._simulate.checks import check_positive
from kanejax._simulate.control import as_control
from kanejax._simulate.runge_kutta import ExplicitRungeKutta
from kanejax._simulation_fit.recorded import Recorded, recorded
from kanejax._simulation_fit.runge_kutta import RungeKutta4
from kanejax._simulation_fit.search import Search
from kanejax._simulation_fit.shooting import Shooting
from kanejax._simulation_fit.simulation_fit import FitInterrupted, Iteration, SimulationFit
from kanejax._simulation_fit.windows import cut

OUTPUTS = ("q", "u", "effort")


def fit_simulation(
    parameterization: Parameterization,
    motions: Sequence[Motion],
    *,
    starts: Float[Array, "starts m"] | None = None,
    windows: Sequence[float | None] = (None,),
    piece: float | None = 0.1,
    initial_state: str = "estimated",
    control: Any = None,
    outputs: Sequence[str] | None = None,
    sigma: Mapping[str, Any] | None = None,
    solver: diffrax.AbstractSolver[Any] | None = None,
    substeps: int = 1,
    interpolation: str = "linear",
    robust: bool = False,
    max_iterations: int = 50,
    progress: Callable[[Iteration], None] | None = None,
    checkpoint: str | os.PathLike[str] | Checkpoint | None = None,
    checkpoint_interval: float = INTERVAL,
) -> SimulationFit:
    """Fit all that is sought so that simulated motion is measured motion.

    A step to parameters with which the simulation fails is not taken, and a fit that fails is a value in the result.

    Args:
        parameterization: what is sought.
        motions: of the runs: times, coordinates, speeds to start from, effort, and the weight of each sample's channels.
        starts: of theta, one a row; all are tried side by side and the best is kept. One, `theta0`, by default.
        windows: lengths [s] into which the runs are cut one after another, None for whole runs: (0.1, 0.5, None) starts with
            windows of 0.1 s. Each window starts from a state of its own.
        piece: windows longer than this [s] are simulated in pieces side by side, whose ends come to meet as the fit converges
            (multiple shooting): faster, and far less apt to diverge; the result is the same. None: in one piece.
        initial_state: "estimated", or "given": the first q and u of each motion are exact. Those of windows within are estimated.
        control: motor signals as a function of (t, q, u), or a pair of a function of (t, q, u, params) and params, in place of the
            motion's effort, such as a controller in closed loop. The effort is then a measured output.
        outputs: what is compared, of "q", "u" and "effort"; by default the coordinates, and with a control the effort.
        sigma: standard deviation of errors for some of the outputs, a number or (nv,) each; that of the others is estimated from
            the residuals.
        solver: of diffrax; by default the classical Runge-Kutta method of order four.
        substeps: equal steps from sample to sample.
        interpolation: of the effort between samples: "linear", or "hold" until the next sample.
        robust: let residuals far out count less, by Huber's function (Huber 1964), also where standard deviations are estimated.
        max_iterations: for each length of the windows.
        progress: called after every iteration.
        checkpoint: path of a file in which the search is kept, so that the same call goes on where it was after Ctrl-C or a crash,
            and ends with the same numbers. It stays at the end, where the same call finds what was found; remove it then.
        checkpoint_interval: time between two writings of the file [s]; it is written at the end in any case.

    Returns:
        The best fit of all starts, and whether it converged.

    Raises:
        ValueError: an argument has a wrong shape or value.
        UnsupportedModelError: a joint has other speeds than rates of its coordinates.
        CheckpointError: the checkpoint belongs to other inputs, is none, or cannot be written; remove it, or give another path.
        FitInterrupted: on Ctrl-C, with the best fit until then.
    """
    check_positive(substeps=substeps, max_iterations=max_iterations, piece=piece)
    outputs = (("q",) if control is None else ("q", "effort")) if outputs is None else tuple(outputs)
    _check(parameterization, windows, control, outputs, initial_state, interpolation)
    thetas = _checked_starts(parameterization, starts)
    data = recorded(parameterization.tree, motions, outputs, sigma or {}, thetas.dtype)
    solver = RungeKutta4() if solver is None else ExplicitRungeKutta(solver) if isinstance(solver, diffrax.AbstractERK) else solver
    simulated = functools.partial(
        Shooting,
        parameterization=parameterization,
        measured=data.measured,
        control=None if control is None else as_control(control),
        solver=solver,
        run_lengths=data.lengths,
        outputs=outputs,
        substeps=int(substeps),
        interpolation=interpolation,
        robust=robust,
        **_what_counts(parameterization),
    )
    inputs = (simulated.keywords, thetas, data, windows, piece, initial_state, max_iterations)
    with opened(checkpoint, checkpoint_interval, "fit_simulation", *inputs) as kept:
        search = Search(parameterization, thetas, data, progress, kept)
        try:
            with one_thread():
                _run_stages(search, simulated, data, windows, piece, initial_state, max_iterations)
        except KeyboardInterrupt as error:
            if not search.has_point or not len(search.state.history):
                raise
            raise FitInterrupted(search.fit(interrupted=True)) from error
    return search.fit()


def _run_stages(
    search: Search,
    simulated: Callable[..., Shooting],
    data: Recorded,
    windows: Sequence[float | None],
    piece: float | None,
    initial_state: str,
    max_iterations: int,
) -> None:
    """One length of the windows after the other."""
    for number, window in enumerate(windows):
        pieces = cut(data.times, window, piece)
        given = jnp.asarray(pieces.opening & (initial_state == "given"))
        on_device = jax.tree.map(jnp.asarray, pieces._replace(ts=pieces.ts.astype(data.sigma.dtype)))
        shooting = simulated(pieces=on_device, inside=jnp.asarray(pieces.counts), given=given)
        search.run(number, shooting, window, max_iterations, is_last=number + 1 == len(windows))


def _check(
    parameterization: Parameterization,
    windows: Sequence[float | None],
    control: Any,
    outputs: tuple[str, ...],
    initial_state: str,
    interpolation: str,
) -> None:
    tree = parameterization.tree
    for name, kind in zip(tree.joint_names, tree.joint_types, strict=True):
        if kind not in ("revolute", "prismatic"):
            raise UnsupportedModelError(
                f"joint {name!r} is of type {kind!r}; a simulation is fitted to revolute and prismatic joints"
            )
    if not windows:
        raise ValueError("windows is empty; give at least one length, or None for whole runs")
    for window in windows:
        check_positive(window=window)
    if not outputs or len(set(outputs)) < len(outputs) or set(outputs) - set(OUTPUTS):
        raise ValueError(f"outputs is {outputs}; give each of {', '.join(OUTPUTS)} at most once")
    if "effort" in outputs and control is None:
        raise ValueError("the effort drives the simulation, so it is no output; give a control that takes its place")
    if initial_state not in ("estimated", "given"):
        raise ValueError(f"initial_state is {initial_state!r}; use 'estimated' or 'given'")
    if interpolation not in ("linear", "hold"):
        raise ValueError(f"interpolation is {interpolation!r}; use 'linear' or 'hold'")


def _checked_starts(parameterization: Parameterization, starts: Any) -> Float[Array, "starts m"]:
    theta0 = parameterization.theta0
    if starts is None:
        return theta0[None]
    starts = jnp.asarray(starts, theta0.dtype)
    if starts.ndim != 2 or not len(starts) or starts.shape[1] != len(theta0):
        raise ValueError(f"starts has shape {starts.shape}, but needs (starts, {len(theta0)}): a theta in each row")
    return starts


def _what_counts(parameterization: Parameterization) -> dict[str, bool]:
    """What of the drives takes time in the simulation."""
    drives, names = parameterization.given.drives, parameterization.names
    sought = {name: any(one.endswith(name) for one in names) for name in ("delay", "load_friction")}
    return {f"has_{name}": found or bool(np.any(getattr(drives, name))) for name, found in sought.items()}
