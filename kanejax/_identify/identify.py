"""Identification: from logs of a robot to the plant that made them, with what is known of it, in one call."""

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._checkpoint import INTERVAL, Checkpoint, opened
from kanejax._errors import LogError
from kanejax._identify.conclusions import conclusions
from kanejax._identify.result import Identification, Stage
from kanejax._logs.delay import estimated_delay
from kanejax._logs.log import Log
from kanejax._logs.motion import Motion, split
from kanejax._logs.processing import motions
from kanejax._model.model import Model
from kanejax._parameters.parameterization import Parameterization, parameterization
from kanejax._parameters.plant import Drives, Plant
from kanejax._parameters.priors import Entropic
from kanejax._parameters.unknowns import Unknown
from kanejax._regression.compress import residuals
from kanejax._regression.fit import Fit, fit_inverse_dynamics
from kanejax._regression.linear_estimate import identifiable, linear_estimate
from kanejax._regression.linearization import Samples
from kanejax._regression.samples import check_motions, samples_of
from kanejax._simulation_fit.simulation_error import fit_simulation
from kanejax._simulation_fit.simulation_fit import SimulationFit

INVERSE_DYNAMICS, SIMULATION = "inverse dynamics", "simulation"
STAGES = (INVERSE_DYNAMICS, SIMULATION)
UNKNOWNS = ("inertia", "damping", "coulomb_friction", "offset")
# What "inertia" stands for: bodies known to a factor of some ten, which decides only about what the data say next to nothing of.
_PRIOR = Entropic(3.0)
_WIDTH_FOR_DELAY = 0.01


class _Problem(NamedTuple):
    """What is sought, and the runs to fit and to validate with."""

    parameterization: Parameterization
    nominal: Parameterization
    training: tuple[Motion, ...]
    validation: tuple[Motion, ...]


class _Course(NamedTuple):
    """How to fit: options of `identify` by the same names."""

    stages: Sequence[str]
    simulation_options: dict[str, Any]
    robust: bool
    anneal: tuple[float, ...]
    starts: int
    seed: int
    progress: Callable[[str, Any], None] | None


def identify(
    model: Model | Plant,
    log: Log | Motion | Sequence[Motion],
    unknowns: Sequence[Unknown | str] = UNKNOWNS,
    *,
    validation: Log | Motion | Sequence[Motion] | float | None = None,
    motion_options: Mapping[str, Any] | None = None,
    stages: Sequence[str] = (INVERSE_DYNAMICS,),
    simulation_options: Mapping[str, Any] | None = None,
    robust: bool = False,
    friction_width: float | None = 1e-4,
    anneal: Sequence[float] = (),
    starts: int = 1,
    seed: int = 0,
    progress: Callable[[str, Any], None] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    checkpoint_interval: float = INTERVAL,
) -> Identification:
    """Find the numbers of a plant from recorded motions and motor signals.

    First the base parameters are estimated by linear least squares, where the signals are linear in what is sought. The stage
    "inverse dynamics" then fits the signals that the recorded motion needs, among bodies and drives that can exist. The stage
    "simulation" goes on from there and fits the motion that the recorded signals cause. All is computed in float64, whatever JAX's
    settings.

    Args:
        model: the nominal model, or a plant with what is known of its drives.
        log: of the robot, or motions that were made of one.
        unknowns: what is sought: leaves by name, or `Unknown` for a part of one, with bounds and priors. "inertia" stands for that
            of all moving bodies with the prior `Entropic(3.0)`.
        validation: a log or motions to compare with that are not fitted; or the fraction of each run, at its end, to hold out.
        motion_options: of `motions`, which filters and differentiates logs. The signals to validate with are not filtered, but at
            irregular times they are resampled like the others.
        stages: which, in order.
        simulation_options: of the stage "simulation": such as `windows`, `control` and `substeps` of `fit_simulation`.
        robust: let errors far out count less in both stages, by Huber's function (Huber 1964). The linear estimate, where they
            start, takes all alike.
        friction_width: where Coulomb friction is sought and its width is not: the width in the stage "inverse dynamics", relative
            to each joint's greatest recorded speed. Inverse dynamics is no harder for friction that sets in at once, but a
            simulation is: it takes the model's widths, and so does the first stage with None. Where the delay is sought it is at
            least 0.01, for sharp steps of friction tell a delay only from nearby.
        anneal: factors on the widths of friction that the stage "simulation" goes through before it takes them as they are, such
            as (10.0, 3.0): friction that sets in gently has gradients also from afar.
        starts: how many random starts to try; the first is the nominal plant.
        seed: of the random starts.
        progress: called with the name of the stage and what it has reached, after every round.
        checkpoint: path of a file in which the stages are kept, round by round, so that the same call goes on where it was after
            Ctrl-C or a crash, and ends with the same numbers. It stays at the end, where the same call goes through no stage
            again; remove it then.
        checkpoint_interval: time between two writings of the file [s]; it is written at the end in any case.

    Returns:
        The plant, its parameters with what the data say of each, and the fits.

    Raises:
        LogError: log and model do not match, or there is too little data.
        CheckpointError: the checkpoint belongs to other inputs, is none, or cannot be written; remove it, or give another path.
        ValueError: an option has no meaning.
        UnknownNameError: an unknown, a body or a joint is not there; the message lists what is.
    """
    _check(stages, starts, anneal, friction_width)
    with jax.enable_x64(True):
        nominal = _in_double(model if isinstance(model, Plant) else Plant(model, Drives.ideal(model)))
        problem = _problem(nominal, log, unknowns, validation, dict(motion_options or {}), friction_width)
        course = _Course(stages, dict(simulation_options or {}), robust, tuple(anneal), starts, seed, progress)
        inputs = (problem.parameterization, problem.nominal, problem.training, course._replace(progress=None))
        with opened(checkpoint, checkpoint_interval, "identify", *inputs) as kept:
            found = _staged(problem, course, kept)
        dtype = (model.model if isinstance(model, Plant) else model).dtype
        plants = (jax.tree.map(lambda x: x.astype(dtype), plant) for plant in (found.plant, found.nominal))
        return dataclasses.replace(found, **dict(zip(("plant", "nominal"), plants, strict=True)))


def _staged(problem: _Problem, course: _Course, checkpoint: Checkpoint) -> Identification:
    """Go through the stages."""
    sought, training = problem.parameterization, problem.training
    base = identifiable(sought)
    theta, ended = sought.theta0, []
    if sought.linear:
        delay = sought.given.drives.delay
        linear = linear_estimate(sought, samples_of(training, delay if float(delay) else None), base=base)
        message = "solved" if linear.converged else "the weights of the signals do not settle"
        ended.append(Stage("linear", linear.converged, message, 1, float("nan"), np.asarray(linear.sigma, float)))
    factor = None
    for stage in course.stages:
        if stage == SIMULATION and "friction_width" not in {unknown.leaf for unknown in sought.unknowns}:
            sought = _with_widths(sought, problem.nominal.given.model.friction_width)
        starts = sought.starts(jax.random.key(course.seed), course.starts).at[0].set(theta)
        if stage == INVERSE_DYNAMICS:
            fit = _fit_inverse_dynamics(sought, training, starts, course, checkpoint.part(stage))
            theta = fit.theta
            cost = fit.history[-1].cost if fit.history else float("nan")
            ended.append(Stage(stage, fit.converged, fit.message, len(fit.history), cost, np.asarray(fit.sigma, float)))
        else:
            found = _fit_simulation(sought, training, starts, course, checkpoint.part(stage))
            theta, factor = found.theta, np.asarray(found.factor, float)
            ended.append(Stage(stage, found.converged, found.message, found.iterations, found.cost, next(iter(found.rms.values()))))
    robust = course.robust and INVERSE_DYNAMICS in course.stages
    return conclusions(problem.nominal, sought, theta, base, training, problem.validation, ended, factor, robust)


def _fit_simulation(
    sought: Parameterization, training: Sequence[Motion], starts: jax.Array, course: _Course, checkpoint: Checkpoint
) -> SimulationFit:
    """Fit with friction that sets in more and more at once."""
    tell, width = course.progress, sought.given.model.friction_width
    told = None if tell is None else lambda it: tell(SIMULATION, it)
    options = {"progress": told, "robust": course.robust, **course.simulation_options}
    for number, factor in enumerate(course.anneal):
        wide, kept = _with_widths(sought, factor * width), checkpoint.part(f"width {number}")
        starts = fit_simulation(wide, training, starts=starts, checkpoint=kept, **options).theta[None]
    return fit_simulation(sought, training, starts=starts, checkpoint=checkpoint.part("given width"), **options)


def _with_widths(sought: Parameterization, width: Float[Array, " nv"]) -> Parameterization:
    return eqx.tree_at(lambda s: s.given.model.friction_width, sought, width)


def _check(stages: Sequence[str], starts: int, anneal: Sequence[float], friction_width: float | None) -> None:
    if not stages or list(stages) != [stage for stage in STAGES if stage in stages]:
        raise ValueError(f"stages is {tuple(stages)!r}; give one or both of {STAGES}, in this order")
    if not all(factor > 0 for factor in anneal):
        raise ValueError(f"anneal is {tuple(anneal)}; give positive factors on the widths of friction, such as (10.0, 3.0)")
    if friction_width is not None and not friction_width > 0:
        raise ValueError(f"friction_width is {friction_width}; give a positive fraction of the greatest speed, or None")
    if starts < 1:
        raise ValueError(f"starts is {starts}; give 1 or more")


def _in_double[T](tree: T) -> T:
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), tree)


def _problem(
    nominal: Plant,
    log: Log | Motion | Sequence[Motion],
    unknowns: Sequence[Unknown | str],
    validation: Log | Motion | Sequence[Motion] | float | None,
    options: dict[str, Any],
    friction_width: float | None,
) -> _Problem:
    training = motions(log, nominal.model, **options) if isinstance(log, Log) else _in_double(_listed(log))
    if not training:
        raise LogError("there is no motion to fit; give a log, or at least one motion")
    if isinstance(validation, int | float):
        training, held_out = split(training, validation)
    elif isinstance(validation, Log):
        unfiltered: dict[str, Any] = {**options, "effort_cutoff": None}
        held_out = motions(validation, nominal.model, **unfiltered)
    else:
        held_out = _in_double(() if validation is None else _listed(validation))
    check_motions(training)
    check_motions(held_out)
    specified = [Unknown("inertia", prior=_PRIOR) if unknown == "inertia" else unknown for unknown in unknowns]
    leaves = {unknown if isinstance(unknown, str) else unknown.leaf for unknown in specified}
    plant = nominal
    if friction_width is not None and "coulomb_friction" in leaves and "friction_width" not in leaves:
        greatest = jnp.max(jnp.stack([jnp.max(jnp.abs(motion.u), 0) for motion in training]), 0)
        relative = max(friction_width, _WIDTH_FOR_DELAY) if "delay" in leaves else friction_width
        width = jnp.where(greatest > 0, relative * greatest, plant.model.friction_width)
        plant = eqx.tree_at(lambda p: p.model, plant, plant.model.replace(friction_width=width))
    known = parameterization(nominal, specified)
    if "delay" in leaves:
        plant = eqx.tree_at(lambda p: p.drives, plant, plant.drives.replace(delay=_delay(plant, specified, training)))
    return _Problem(parameterization(plant, specified), known, training, held_out)


def _listed(motions: Motion | Sequence[Motion]) -> tuple[Motion, ...]:
    return (motions,) if isinstance(motions, Motion) else tuple(motions)


def _delay(plant: Plant, unknowns: Sequence[Unknown | str], training: Sequence[Motion]) -> float:
    """Delay to start from: that of the signals against those of the best fit without one, or the given one if there is none."""
    given = float(plant.drives.delay)
    others = [unknown for unknown in unknowns if unknown != "delay" and getattr(unknown, "leaf", "") != "delay"]
    sought = parameterization(plant, others or ["offset"])
    phi = linear_estimate(sought, samples_of(training)).phi if sought.linear else sought.phi0
    longest = max(training, key=len)
    predicted = longest.effort - residuals(sought, phi, samples_of([longest]))
    try:
        found = estimated_delay(longest, np.asarray(predicted, float)).common
    except LogError:
        return given
    bounds = [unknown.bounds for unknown in unknowns if isinstance(unknown, Unknown) and unknown.leaf == "delay"]
    low, high = next((pair for pair in bounds if pair is not None), (-np.inf, np.inf))
    return float(np.clip(found, np.max(low), np.min(high)))


def _fit_inverse_dynamics(
    sought: Parameterization,
    training: Sequence[Motion],
    starts: Float[Array, "starts m"],
    course: _Course,
    checkpoint: Checkpoint,
) -> Fit:
    def samples_at(delay: Float[Array, ""]) -> Samples:
        return samples_of(training, delay)

    told = course.progress
    tell = None if told is None else lambda step: told(INVERSE_DYNAMICS, step)
    delay = sought.given.drives.delay
    samples = samples_at(delay) if "delay" in sought.names else samples_of(training, delay if float(delay) else None)
    return fit_inverse_dynamics(
        sought,
        samples._replace(rates=None),
        starts=starts,
        robust=course.robust,
        samples_at=samples_at,
        progress=tell,
        checkpoint=checkpoint,
    )
