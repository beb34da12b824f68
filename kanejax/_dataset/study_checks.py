"""What a study refuses before anything is simulated."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kanejax._model.model import Model, leaf_shapes
from kanejax._model.tree import COORDINATES
from kanejax.distributions import AbstractDistribution

# The mass and the central inertia of a body by the same factor.
DENSITY = "density"
# What `simulate` takes and a study may say of all its trajectories.
OPTIONS = ("solver", "dt0", "rtol", "atol", "stepsize_controller", "events", "joint_limits", "max_steps")
# What must not be negative, and so must not be drawn from a distribution that can be.
_NOT_NEGATIVE = ("mass", "central_inertia", "armature", "damping", "stiffness", "coulomb_friction", "friction_width")


def check_options(options: Mapping[str, Any]) -> None:
    """Check that `simulate` can be given these.

    Raises:
        ValueError: it cannot.
    """
    if unknown := set(options) - set(OPTIONS):
        raise ValueError(f"a study has no option {', '.join(sorted(unknown))}; the options are: {', '.join(OPTIONS)}")


def check_states(model: Model, trajectories: int, q0: Any, u0: Any) -> None:
    """Check distributions or arrays of initial states.

    Raises:
        ValueError: a shape does not fit, or quaternions would be drawn number by number.
    """
    for name, source, size, size_name in (("q0", q0, model.nq, "nq"), ("u0", u0, model.nv, "nv")):
        if isinstance(source, AbstractDistribution):
            _check_width(f"{name}'s distribution", source, size)
        elif source is not None:
            _check_shape(name, source, (trajectories, size), f"(trajectories, {size_name})")
    for joint, kind in zip(model.tree.joint_names, model.tree.joint_types, strict=True):
        if isinstance(q0, AbstractDistribution) and COORDINATES[kind] > 1:
            raise ValueError(
                f"q0 of joint {joint!r} is a quaternion, which is not drawn number by number; leave q0 out, or give states"
            )


def check_parameters(model: Model, parameters: Mapping[str, Any]) -> None:
    """Check how leaves of the model are randomised.

    Raises:
        ValueError: there is no such leaf, the numbers do not fit it, or it could become what no mechanism can have.
    """
    shapes = leaf_shapes(model.tree)
    for name, randomized in parameters.items():
        if name not in shapes and name != DENSITY:
            raise ValueError(f"a model has no leaf {name!r} to randomise; the names are: {DENSITY}, {', '.join(shapes)}")
        if randomized.how not in ("factor", "added"):
            raise ValueError(f'{name} is randomised by {randomized.how!r}; it must be "factor" or "added"')
        if name == DENSITY and randomized.how == "added":
            raise ValueError("density is a factor on mass and central inertia; it cannot be added")
        leaf = "mass" if name == DENSITY else name
        _check_width(f"the distribution of {name}", randomized.distribution, numbers_of(shapes[leaf], randomized.how))
        nominal = (
            float(np.min(np.asarray(getattr(model, leaf)))) if randomized.how == "added" and np.size(getattr(model, leaf)) else 0.0
        )
        if leaf in _NOT_NEGATIVE and nominal + randomized.distribution.least < 0:
            raise ValueError(
                f"{name} must not become negative, as {randomized.distribution} could make it; "
                "take a factor that is log-normal, log-uniform, or uniform from a number that is not negative"
            )


def numbers_of(shape: tuple[int, ...], how: str) -> int:
    """How many numbers are drawn for a leaf: a factor for each row, or what is added to each number."""
    return shape[0] if how == "factor" else int(np.prod(shape))


def check_random_forces(model: Model, distribution: AbstractDistribution, period: float) -> None:
    """Check forces that are drawn.

    Raises:
        ValueError: the distribution does not fit the speeds, or the period is not positive.
    """
    _check_width("the distribution of the forces", distribution, model.nv)
    if not (np.isfinite(period) and period > 0):
        raise ValueError(f"the period of the forces is {period}; it must be positive")


def check_given_forces(model: Model, trajectories: int, ts: Any, values: Any) -> None:
    """Check tables of forces.

    Raises:
        ValueError: shapes do not fit, or the times do not increase.
    """
    ts = np.asarray(ts)
    if ts.ndim != 1 or len(ts) < 2 or not np.all(np.diff(ts) > 0):
        raise ValueError(f"the times of the forces, of shape {ts.shape}, must be two or more that strictly increase")
    _check_shape("the forces", values, (trajectories, len(ts), model.nv), "(trajectories, times, nv)")


def _check_width(what: str, distribution: AbstractDistribution, width: int) -> None:
    """Check that a distribution's parameters are for one number or for all."""
    try:
        shape = distribution.of(np.full((1, width), 0.5)).shape
    except ValueError:
        shape = None
    if shape != (1, width):
        raise ValueError(f"{what}, {distribution}, is for {width} numbers; give each of its parameters as one number, or {width}")


def _check_shape(what: str, values: Any, needed: tuple[int, ...], names: str) -> None:
    if np.shape(values) != needed:
        raise ValueError(f"{what} has shape {np.shape(values)}, but this study needs {needed} = {names}")
