"""From what is handed in to arrays that fit the model."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kanejax._errors import KanejaxError
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds, own
from kanejax._model.model import Model
from kanejax._model.specialized import whole
from kanejax._optimize.limits import Limits, joint_ranges

Array = np.ndarray
_SIZES = {"q": "nq", "u": "nv", "tau": "nv"}


class PlotError(KanejaxError, ValueError):
    """What is to be drawn does not fit the model, or is not what is drawn that way."""


class Series(NamedTuple):
    """Values over time; one row fewer than times are held from each time to the next."""

    ts: Float[Array, " n"]
    values: Float[Array, "m k"]

    @property
    def is_held(self) -> bool:
        """Whether each row holds until the next time."""
        return len(self.values) < len(self.ts)


def plain_model(model: AnyModel) -> Model:
    """The mechanism with its parameters, for ranges of joints."""
    return whole(own(model))


def series(model: AnyModel, path: Any, field: str, origin: str) -> Series:
    """One field of one motion over time.

    Args:
        model: of the robot.
        path: with the times `ts`, and the field.
        field: "q", "u" or "tau".
        origin: the argument that the path is, for messages.

    Raises:
        PlotError: the path has no such field, several motions, or another robot's.
    """
    for name in ("ts", field):
        if not hasattr(path, name):
            remedy = "give what kj.simulate or kj.optimize returns, or another object with such arrays"
            raise PlotError(f"{origin} is a {type(path).__name__}, which has no {name!r}; {remedy}")
    return checked_series(model, path.ts, getattr(path, field), field, (f"{origin}.ts", f"{origin}.{field}"))


def checked_series(model: AnyModel, ts: Any, values: Any, field: str, names: tuple[str, str]) -> Series:
    """Times and values as arrays of one motion; the names are for messages.

    Raises:
        PlotError: a shape does not fit.
    """
    check_speeds_are_own(model, field)
    found = Series(np.asarray(ts), np.asarray(values))
    size = model.nq if field == "q" else model.nv
    needed = f"(n, {_SIZES[field]}) = (n, {size})"
    for name, array, axes in ((names[0], found.ts, 1), (names[1], found.values, 2)):
        if array.ndim > axes:
            remedy = "choose one with jax.tree.map(lambda x: x[0], ...), or draw all of them with kj.plots.quantiles"
            raise PlotError(f"{name} has shape {array.shape}, but one motion has {'(n,)' if axes == 1 else needed}; {remedy}")
    if found.values.ndim != 2 or found.values.shape[1] != size:
        remedy = "give the model that the motion is of"
        raise PlotError(f"{names[1]} has shape {found.values.shape}, but this model needs {needed}; {remedy}")
    if found.ts.ndim != 1 or len(found.ts) < 1:
        raise PlotError(f"{names[0]} has shape {found.ts.shape}, but a plot needs (n,) with n of at least 1")
    allowed = (len(found.ts), len(found.ts) - 1) if field == "tau" else (len(found.ts),)
    if len(found.values) not in allowed:
        rows = " or ".join(str(count) for count in allowed)
        raise PlotError(f"{names[1]} has {len(found.values)} rows, but {names[0]} has {len(found.ts)} times; give {rows} rows")
    return found


def check_speeds_are_own(model: AnyModel, field: str) -> None:
    """Refuse speeds of the user's choice, which belong to no joint and have no unit that is known here.

    Raises:
        PlotError: they are drawn.
    """
    if field == "u" and isinstance(model, WithSpeeds):
        remedy = "draw those of the model itself, which kj.rates_from_speeds gives"
        raise PlotError(f"the speeds of a model with chosen speeds belong to no joint; {remedy}")


def limits_of(model: AnyModel, field: str, limits: Any) -> Float[Array, "2 nv"] | None:
    """Least and greatest of each speed.

    Args:
        model: of the robot.
        field: "q", whose limits are the joints' ranges unless there are others; "u" or "tau".
        limits: `Limits`, or what it takes for this field; None for none.

    Raises:
        PlotError: they do not fit the model.
    """
    if isinstance(limits, Limits):
        found = getattr(limits, field)
    elif limits is None:
        found = joint_ranges(plain_model(model)) if field == "q" else None
    else:
        try:
            found = getattr(Limits(plain_model(model), **{field: limits}), field)
        except ValueError as error:
            raise PlotError(str(error)) from error
    if found is not None and found.shape != (2, model.nv):
        raise PlotError(f"limits.{field} has shape {found.shape}, but this model needs (2, nv) = (2, {model.nv})")
    return None if found is None else np.asarray(found)


def energy_states(model: AnyModel, path: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, coordinates and speeds of one motion, in whatever speeds the model has.

    Raises:
        PlotError: the path has no such field, several motions, or another robot's.
    """
    q, u = series(model, path, "q", "path"), series(own(model), path, "u", "path")
    return q.ts, q.values, u.values


def several(model: AnyModel, paths: Any, field: str) -> list[Series]:
    """One field of one motion, of those in a list, or of those along a batch axis.

    Raises:
        PlotError: a path has no such field, or another robot's.
    """
    if isinstance(paths, list | tuple) and not hasattr(paths, "ts"):
        if not paths:
            raise PlotError("paths is empty; give at least one motion")
        return [series(model, path, field, f"paths[{i}]") for i, path in enumerate(paths)]
    if np.ndim(getattr(paths, field, 0)) < 3:
        return [series(model, paths, field, "paths")]
    ts, values = np.asarray(paths.ts), np.asarray(getattr(paths, field))
    rows = np.broadcast_to(ts, (len(values), *ts.shape[-1:])) if ts.ndim < 3 else ts
    names = ("paths.ts", f"paths.{field}")
    return [checked_series(model, t, row, field, names) for t, row in zip(rows, values, strict=True)]


def batch(model: AnyModel, paths: Any, field: str) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "batch m k"]]:
    """Times and one field of motions along a batch axis.

    Raises:
        PlotError: there is no batch axis, times differ, or the motions are another robot's.
    """
    if field not in _SIZES:
        raise PlotError(f"what is {field!r}; use {', '.join(map(repr, _SIZES))}")
    if not isinstance(paths, list | tuple) and np.ndim(getattr(paths, field, np.zeros((1, 1, 1)))) < 3:
        shape = np.shape(getattr(paths, field))
        needed = f"(batch, n, {_SIZES[field]})"
        remedy = "give a batch, such as kj.simulate_batch returns, or draw one motion with kj.plots.motion"
        raise PlotError(f"paths.{field} has shape {shape}, but quantiles need {needed}; {remedy}")
    rows = several(model, paths, field)
    ts = rows[0].ts
    for number, row in enumerate(rows):
        if row.ts.shape != ts.shape or not np.array_equal(row.ts, ts):
            raise PlotError(f"motion {number} of paths has other times than motion 0; interpolate them to the same")
    return ts, np.stack([row.values for row in rows])
