"""From what is handed in to arrays that fit the model."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from kanejax._errors import KanejaxError
from kanejax._logs.log import Log, Run
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds, own
from kanejax._model.model import leaf_shapes
from kanejax._model.specialized import whole
from kanejax._optimize.limits import Limits

_SIZES = {"q": "nq", "u": "nv", "tau": "nv"}
_REMEDIES = {
    **dict.fromkeys(("q", "u"), "give what kj.simulate or kj.optimize returns, or another object with such arrays"),
    "tau": "give what kj.optimize returns, or times and forces: torques(model, ts, tau)",
}


class PlotError(KanejaxError, ValueError):
    """What is to be drawn does not fit the model, or is not what is drawn that way."""


class Series(NamedTuple):
    """Values over time; one row fewer than times are held from each time to the next."""

    ts: Float[np.ndarray, " n"]
    values: Float[np.ndarray, "m k"]

    @property
    def is_held(self) -> bool:
        """Whether each row holds until the next time."""
        return len(self.values) < len(self.ts)


def check_one_model(model: AnyModel, leaves: Iterable[str]) -> None:
    """Refuse a batch of models where numbers of one are needed.

    Raises:
        PlotError: one of these leaves has a batch axis.
    """
    one, shapes = whole(own(model)), leaf_shapes(model.tree)
    for name in leaves:
        if (shape := np.shape(getattr(one, name))) != shapes[name]:
            remedy = "choose the one that the motion is of with jax.tree.map"
            raise PlotError(f"model.{name} has shape {shape}, but one model has {shapes[name]}; {remedy}")


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
    kind = type(path).__name__
    if isinstance(path, Log | Run):
        raise PlotError(f"{origin} is a {kind}, whose columns are the log's joints; draw what kj.motions(log, model) returns")
    for name in ("ts", field):
        if not hasattr(path, name):
            raise PlotError(f"{origin} is a {kind}, which has no {name!r}; {_REMEDIES[field]}")
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
    if found.values.ndim > 2:
        remedy = "choose one with jax.tree.map(lambda x: x[0], ...), or draw all of them with kj.plots.quantiles"
        raise PlotError(f"{names[1]} has shape {found.values.shape}, but one motion has {needed}; {remedy}")
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


def limits_of(model: AnyModel, field: str, limits: Any) -> Float[np.ndarray, "2 nv"] | None:
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
    elif limits is None and field != "q":
        found = None
    else:
        check_one_model(model, ("joint_range",))
        try:
            given: dict[str, Any] = {field: limits}
            found = getattr(Limits(whole(own(model)), **given), field)
        except ValueError as error:
            raise PlotError(str(error)) from error
    if found is not None and found.shape != (2, model.nv):
        raise PlotError(f"limits.{field} has shape {found.shape}, but this model needs (2, nv) = (2, {model.nv})")
    return None if found is None else np.asarray(found)


def several(model: AnyModel, paths: Any, field: str) -> list[Series]:
    """One field of one motion, of those in a list, or of those along a batch axis.

    Raises:
        PlotError: a path has no such field, or another robot's.
    """
    if type(paths) in (list, tuple):
        if not paths:
            raise PlotError("paths is empty; give at least one motion")
        return [series(model, path, field, f"paths[{i}]") for i, path in enumerate(paths)]
    if np.ndim(getattr(paths, field, 0)) < 3:
        return [series(model, paths, field, "paths")]
    ts, values = np.asarray(paths.ts), np.asarray(getattr(paths, field))
    if values.ndim > 3 or ts.shape[:-1] not in ((), values.shape[:1]):
        needed = f"(batch, n, {_SIZES[field]}), and paths.ts (n,) or (batch, n)"
        raise PlotError(f"paths.{field} has shape {values.shape} and paths.ts {ts.shape}, but {needed} are needed")
    names = ("paths.ts", f"paths.{field}")
    rows = np.broadcast_to(ts, (len(values), ts.shape[-1]))
    return [checked_series(model, t, row, field, names) for t, row in zip(rows, values, strict=True)]


def batch(model: AnyModel, paths: Any, field: str) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "batch m k"]]:
    """Times and one field of motions in a list or along a batch axis.

    Raises:
        PlotError: there is but one motion, times differ, or the motions are another robot's.
    """
    if field not in _SIZES:
        raise PlotError(f"what is {field!r}; use {', '.join(map(repr, _SIZES))}")
    rows = several(model, paths, field)
    if type(paths) not in (list, tuple) and np.ndim(getattr(paths, field)) == 2:
        shape, needed = np.shape(getattr(paths, field)), f"(batch, n, {_SIZES[field]})"
        remedy = "give a batch, such as kj.simulate_batch returns, or draw one motion with kj.plots.motion"
        raise PlotError(f"paths.{field} has shape {shape}, but quantiles need {needed}; {remedy}")
    first = rows[0]
    for number, row in enumerate(rows):
        if row.values.shape != first.values.shape or not np.array_equal(row.ts, first.ts):
            raise PlotError(f"motion {number} of paths has other times than motion 0; interpolate all to the same")
    return first.ts, np.stack([row.values for row in rows])
