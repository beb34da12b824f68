"""Excitation design: the periodic motion within a robot's limits that tells most of its parameters (Swevers et al. 1997)."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from kanejax._excitation.fourier_motion import FourierMotion, Numbers, check_period, one_coordinate_joints, rest_directions
from kanejax._excitation.motion_information import (
    DEFAULT,
    MotionInformation,
    Scaling,
    base_of_unknowns,
    checked_sigma,
    motion_information,
    nominal_sizes,
)
from kanejax._excitation.motion_limits import Margins, MotionLimits, motion_limits, typical_speed
from kanejax._excitation.motion_search import (
    CHECKED,
    Candidates,
    Objective,
    PathConstraint,
    Problem,
    Progress,
    margins,
    objective_value,
    repaired,
    searched,
    states,
)
from kanejax._model.model import Model
from kanejax._regression.base_parameters import BaseParameters


@final
@dataclasses.dataclass(frozen=True, eq=False)
class ExcitationDesign:
    """What `excitation` returns.

    Attributes:
        motion: the best motion found; starts and ends at rest.
        objective: what was sought.
        information: what the motion tells of the base parameters; `information.std(samples)` is the precision to expect.
        margins: what the motion leaves of each limit, the reserve included.
        feasible: whether it keeps all limits, less the reserve.
        values: objective of the motion found from each start; nan where that does not keep the limits.
        random_values: the same of the random motions at the start.
        message: all of this in words.
    """

    motion: FourierMotion
    objective: Objective
    information: MotionInformation
    margins: Margins
    feasible: bool
    values: Float[np.ndarray, " starts"]
    random_values: Float[np.ndarray, " starts"]
    message: str

    @property
    def value(self) -> float:
        """The objective's."""
        return self.log_det if self.objective == "log det" else self.condition_number

    @property
    def log_det(self) -> float:
        """Logarithm of the determinant of the information, see `MotionInformation`."""
        return self.information.log_det

    @property
    def condition_number(self) -> float:
        """Of the scaled regressor, see `MotionInformation`."""
        return self.information.condition_number


def excitation(
    model: Model,
    *,
    period: float,
    harmonics: int = 5,
    position: Numbers | None = None,
    speed: Numbers | None = None,
    acceleration: Numbers | None = None,
    torque: Numbers | None = None,
    path_constraint: PathConstraint | None = None,
    margin: float = 0.05,
    unknowns: Sequence[str] = DEFAULT,
    sigma: Numbers | None = None,
    objective: Objective = "log det",
    scaling: Scaling = "length",
    starts: int = 16,
    seed: int = 0,
    max_steps: int = 500,
    progress: Callable[[Progress], object] | None = None,
) -> ExcitationDesign:
    """Find the Fourier motion within limits that tells most of a robot's parameters.

    "log det" is the D-optimal design: the smallest confidence ellipsoid of the base parameters by volume, whatever their units.
    "condition number" is that of the regressor with scaled columns (Gautier and Khalil 1992); with columns scaled by their own
    lengths it does not ask for large motions, so prefer the former. Both are of base parameters, with rows divided by sigma, and
    computed in float64 whatever JAX's settings.

    The motion starts and ends at rest, with zero acceleration, and keeps the limits of position, speed and acceleration at all
    times, also between those of the grid on which it is checked. Torques, those of `inverse_dynamics` of the given model, and
    `path_constraint` are kept at 192 times a period for each harmonic.

    Args:
        model: the robot, whose joints have one coordinate each. Its parameters matter to torques, and to `scaling`.
        period: of the motion [s].
        harmonics: the highest frequency is harmonics / period; stay well below those of the robot's vibrations.
        position: least and greatest coordinate of each joint [rad or m], (nv, 2). `model.joint_range` holds as well.
        speed: greatest speed of each joint [rad/s or m/s]: one number, or one a joint; None or infinite: no limit.
        acceleration: greatest rate of the speeds [rad/s^2 or m/s^2].
        torque: greatest torque [N m] or force [N] of each joint.
        path_constraint: function of q, which JAX can trace, that returns numbers of sizes about 1 that must not be positive, such
            as how far bodies are below a table, from `poses`. It is called with one q in the model's data type.
        margin: fraction of each limit, and of each range on both sides, kept in reserve for errors of tracking and of the model.
        unknowns: see `motion_information`.
        sigma: standard deviation of the errors of each measured torque or force; 1 by default.
        objective: "log det" or "condition number".
        scaling: of columns for the condition number, see `motion_information`.
        starts: number of random motions to start from.
        seed: of these: the same seed gives the same design.
        max_steps: of the search. With 0 the result is the best of the random motions.
        progress: called every 25 steps.

    Returns:
        The best motion that keeps all limits; if there is none, the one that breaks them least: `feasible` and `message` say so.

    Raises:
        ValueError: an argument makes no sense, limits leave no motion, or a joint has none.
        UnsupportedModelError: a joint has several coordinates.
        UnknownNameError: an unknown is not one that forces are linear in.
    """
    one_coordinate_joints(model)
    check_period(period)
    _check_options(objective, scaling, starts, max_steps, margin)
    rest = rest_directions(harmonics)
    given = motion_limits(model, position, speed, acceleration, torque)
    sigmas = checked_sigma(model, sigma)
    base = base_of_unknowns(model, unknowns)
    size = nominal_sizes(model, unknowns, base) if scaling == "nominal" else None
    with jax.enable_x64(True):
        problem = _problem(model, given.less(margin), period, rest, sigmas, base, size, tuple(unknowns), objective, path_constraint)
        x = jnp.asarray(np.random.default_rng(seed).normal(size=(starts, model.nv, 2 * harmonics - 1)))
        before = _numpy(repaired(problem, x))
        after = _numpy(repaired(problem, searched(problem, x, max_steps, progress))) if max_steps else before
        motion = _best(before, after)
        sampled = _numpy(states(motion, problem.times(CHECKED)))
        left, reserve = (_numpy(margins(problem, motion, limits)) for limits in (jax.tree.map(jnp.asarray, given), problem.limits))
    information = motion_information(model, *sampled, unknowns=unknowns, sigma=sigmas, scaling=scaling, base=base)
    found, random = (_values(objective, candidates) for candidates in (after, before))
    feasible = all(bool(np.all(part >= 0)) for part in reserve)
    rounded = jax.tree.map(lambda leaf: jnp.asarray(leaf, model.dtype), motion)
    design = ExcitationDesign(rounded, objective, information, left, feasible, found, random, "")
    return dataclasses.replace(design, message=_success(design) if feasible else _failure(model, reserve, margin))


def _problem(
    model: Model,
    limits: MotionLimits,
    period: float,
    rest: tuple[np.ndarray, np.ndarray],
    sigma: np.ndarray,
    base: BaseParameters,
    size: np.ndarray | None,
    unknowns: tuple[str, ...],
    objective: Objective,
    path_constraint: PathConstraint | None,
) -> Problem:
    """What is sought as arrays in float64; needs JAX's settings to allow it."""
    return Problem(
        model=model.astype(jnp.float64),
        limits=jax.tree.map(jnp.asarray, limits),
        period=jnp.asarray(float(period)),
        rest=(jnp.asarray(rest[0]), jnp.asarray(rest[1])),
        typical_speed=jnp.asarray(typical_speed(limits, period, len(rest[0]))),
        weight=jnp.asarray(1.0 / sigma),
        independent=jnp.asarray(base.independent),
        size=None if size is None else jnp.asarray(size),
        unknowns=unknowns,
        objective=objective,
        path_constraint=path_constraint,
        has_torque_limits=bool(np.any(np.isfinite(limits.torque))),
        dtype=jnp.dtype(model.dtype).name,
    )


def _check_options(objective: str, scaling: str, starts: int, max_steps: int, margin: float) -> None:
    for name, value, choices in (
        ("objective", objective, ("log det", "condition number")),
        ("scaling", scaling, ("length", "nominal")),
    ):
        if value not in choices:
            raise ValueError(f"{name} is {value!r}; use {choices[0]!r} or {choices[1]!r}")
    for name, count, least in (("starts", starts, 1), ("max_steps", max_steps, 0)):
        if count != int(count) or count < least:
            raise ValueError(f"{name} is {count}; it must be a whole number of at least {least}")
    if not 0 <= margin < 1:
        raise ValueError(f"margin is {margin}; it must be at least 0 and less than 1")


def _numpy(tree: Any) -> Any:
    return jax.tree.map(np.asarray, tree)


def _best(*candidates: Candidates) -> FourierMotion:
    """Of the motions that keep the limits the one of least cost; if there are none, the one that breaks them least."""
    every = jax.tree.map(lambda *parts: np.concatenate(parts), *candidates)
    kept = every.violation <= 0
    rank = np.where(kept & np.isfinite(every.cost), every.cost, np.inf) if np.any(kept) else every.violation
    return jax.tree.map(lambda leaf: jnp.asarray(leaf[int(np.argmin(rank))]), every.motion)


def _values(objective: Objective, candidates: Candidates) -> Float[np.ndarray, " starts"]:
    return np.where(candidates.violation <= 0, objective_value(objective, candidates.cost), np.nan)


def _success(design: ExcitationDesign) -> str:
    kept = design.random_values[np.isfinite(design.random_values)]
    better = np.max if design.objective == "log det" else np.min
    before = (
        f"the best of {len(design.values)} random motions has {better(kept):.4g}"
        if len(kept)
        else "no random motion keeps the limits"
    )
    number = "condition number" if design.objective == "log det" else "log det"
    other = design.condition_number if design.objective == "log det" else design.log_det
    return f"all limits are kept; {design.objective} {design.value:.4g}, {number} {other:.4g}; {before}"


def _failure(model: Model, margins: Margins, margin: float) -> str:
    broken = [
        f"{name} of joint {joint!r} by {-left:.3g}"
        for name in ("position", "speed", "acceleration", "torque")
        for joint, left in zip(model.tree.joint_names, getattr(margins, name), strict=True)
        if left < 0
    ]
    broken += [f"path constraint {i} by {-left:.3g}" for i, left in enumerate(margins.path) if left < 0]
    return (
        f"no motion was found that keeps all limits with a reserve of {margin:.3g}; the one that breaks them least exceeds "
        f"{', '.join(broken)}. Relax them, or try more starts and steps"
    )
