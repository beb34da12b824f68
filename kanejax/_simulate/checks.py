"""What a simulation refuses before it starts. Values are looked at where they are known: not under jit and vmap."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from kanejax._model.model import Model
from kanejax._model.specialized import Specialized
from kanejax._model.tree import COORDINATES, SPEEDS, Tree

# Options that are numbers.
TOLERANCES = ("rtol", "atol")
COUNTS = ("batch_size", "threads", "max_steps", "max_events")


def checked_state(model: Model | Specialized, q0: Any, u0: Any) -> tuple[jax.Array, jax.Array]:
    """The initial state as arrays.

    Raises:
        ValueError: a shape or data type does not fit the model, a value is not finite, or a quaternion is zero.
    """
    q0, u0 = _checked(model, "q0", q0, "nq"), _checked(model, "u0", u0, "nv")
    if _known(q0):
        for name, (first, size) in _slots(model.tree, COORDINATES, model.tree.q_start).items():
            if size >= 4 and not np.any(q0[first + size - 4 : first + size]):
                raise ValueError(f"q0[{first + size - 4}:{first + size}], the quaternion of joint {name!r}, is zero")
    return q0, u0


def check_batch(model: Model | Specialized, q0: Any, u0: Any) -> tuple[np.ndarray, np.ndarray]:
    """Many initial states as numpy arrays. A value that is not finite is left to the trajectory's status.

    Raises:
        ValueError: the shapes do not fit the model or each other, or there is no state.
    """
    q0, u0 = np.asarray(q0), np.asarray(u0)
    for name, value, size_name in (("q0", q0, "nq"), ("u0", u0, "nv")):
        size = getattr(model, size_name)
        if value.ndim != 2 or value.shape[1] != size or len(value) == 0:
            raise ValueError(f"{name} has shape {value.shape}, but this model needs (batch, {size}) = (batch, {size_name})")
    if len(q0) != len(u0):
        raise ValueError(f"q0 has {len(q0)} rows, but u0 has {len(u0)}")
    return q0, u0


def _checked(model: Model | Specialized, name: str, value: Any, size_name: str) -> jax.Array:
    value = value if isinstance(value, jax.Array) else np.asarray(value)
    size = getattr(model, size_name)
    if value.shape != (size,):
        hint = "; batches go through jax.vmap or simulate_batch" if value.ndim > 1 else ""
        raise ValueError(f"{name} has shape {value.shape}, but this model needs ({size},) = ({size_name},){hint}")
    if jnp.result_type(value) != model.dtype:
        raise ValueError(f"{name} has dtype {value.dtype}, but the model has {model.dtype}; convert one, e.g. with model.astype")
    if _known(value) and not np.all(np.isfinite(value)):
        index = int(np.flatnonzero(~np.isfinite(value))[0])
        raise ValueError(f"{name}[{index}] of joint {_joint_of(model.tree, size_name, index)!r} is {float(value[index])}")
    return jnp.asarray(value)


def checked_times(ts: Any, dtype: Any) -> Any:
    """The times to save, in the state's data type; a numpy array if they are known, so that they stay known while tracing.

    Raises:
        ValueError: fewer than two, not finite, or not strictly increasing.
    """
    ts = np.asarray(ts, dtype) if _known(ts) else ts.astype(dtype)
    if ts.ndim != 1 or len(ts) < 2:
        raise ValueError(f"ts has shape {ts.shape}, but it needs (n,) with n of at least 2: the first time, and those to save")
    if _known(ts) and not np.all(np.isfinite(ts)):
        raise ValueError(f"ts[{int(np.flatnonzero(~np.isfinite(ts))[0])}] is not finite")
    if _known(ts) and not np.all(np.diff(ts) > 0):
        index = int(np.flatnonzero(~(np.diff(ts) > 0))[0])
        raise ValueError(
            f"ts must be strictly increasing in {np.dtype(dtype)}, but ts[{index + 1}] = {ts[index + 1]} follows {ts[index]}"
        )
    return ts


def check_step(dt0: Any, ts: Any) -> None:
    """Check that a step, if it and the times are known, moves the time in their data type.

    Raises:
        ValueError: it is shorter than twice the distance of two numbers there.
    """
    if dt0 is None or not _known(dt0) or not _known(ts):
        return
    last = np.max(np.abs(np.asarray(ts)))
    if not float(dt0) >= 2.0 * float(np.spacing(last)):
        raise ValueError(
            f"dt0 is {float(dt0):.3g}, but {last.dtype} cannot tell times around {float(last):.6g} apart by less than "
            f"{float(np.spacing(last)):.2g}; let ts begin at zero, take longer steps, or use float64"
        )


def check_positive(**values: Any) -> None:
    """Check numbers that are known and not None.

    Raises:
        ValueError: naming the first that is not finite and positive, or the first count that is not whole.
    """
    for name, value in values.items():
        if value is not None and _known(value) and not (np.isfinite(value) and value > 0):
            raise ValueError(f"{name} is {value}; it must be positive and finite")
        if name in COUNTS and value is not None and value != int(value):
            raise ValueError(f"{name} is {value}; it must be a whole number")


def compilable(options: dict[str, Any], dtype: Any) -> dict[str, Any]:
    """The options as arguments of a compiled program, checked where they are traced.

    Counts, which it must know, as Python's integers, for NumPy's would be traced; tolerances as arrays, so that other ones do not
    compile again.

    Raises:
        ValueError: one is not positive or not finite.
    """
    given = {name: value for name, value in options.items() if value is not None}
    check_positive(**{name: given[name] for name in TOLERANCES if name in given})
    counts = {name: int(given[name]) for name in ("max_steps", "max_events") if name in given}
    return options | counts | {name: np.asarray(given[name], dtype) for name in TOLERANCES if name in given}


def joint_ranges(model: Model | Specialized) -> jax.Array:
    """The model's joint ranges.

    Raises:
        ValueError: the model is specialized; what stops a simulation is no part of the dynamics that it keeps.
    """
    if isinstance(model, Specialized):
        raise ValueError("a specialized model has no joint ranges; give the model itself, or an event for each limit")
    return model.joint_range


def check_within_limits(tree: Tree, ranges: jax.Array, q0: jax.Array) -> None:
    """Check that joints start within their ranges, so that leaving them is an event.

    Raises:
        ValueError: naming the first joint that starts outside.
    """
    if not _known(q0) or not _known(ranges):
        return
    for joint, (name, kind) in enumerate(zip(tree.joint_names, tree.joint_types, strict=True)):
        low, high = np.asarray(ranges[joint])
        value = float(q0[tree.q_start[joint]])
        if kind in ("revolute", "prismatic") and not low <= value <= high:
            raise ValueError(f"q0[{tree.q_start[joint]}] = {value} of joint {name!r} is outside of its range {low} to {high}")


def _known(value: Any) -> bool:
    return not isinstance(value, Tracer)


def _slots(tree: Tree, sizes: dict[str, int], starts: tuple[int, ...]) -> dict[str, tuple[int, int]]:
    """First index and number of coordinates or speeds of each joint."""
    return {name: (start, sizes[kind]) for name, start, kind in zip(tree.joint_names, starts, tree.joint_types, strict=True)}


def _joint_of(tree: Tree, size_name: str, index: int) -> str:
    slots = _slots(tree, COORDINATES, tree.q_start) if size_name == "nq" else _slots(tree, SPEEDS, tree.v_start)
    return next(name for name, (start, size) in slots.items() if start <= index < start + size)
