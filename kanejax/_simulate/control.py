"""Forces at the joints as functions of time and state."""

from collections.abc import Callable
from typing import Any, Literal, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Float

Interpolation = Literal["linear", "cubic", "hold"]


@final
class TorqueTable(eqx.Module):
    """Forces at the joints, tabulated over time: `simulate(..., control=TorqueTable(ts, values))`.

    Before the first time and after the last, the first and last row hold. The values can be differentiated, the times not.

    Attributes:
        ts: times [s], strictly increasing.
        values: force [N] or torque [N m] on each generalized speed, at each time.
        interpolation: "linear"; "cubic", piecewise cubics with a continuous rate whose slopes come from the parabola through three
            neighbours; or "hold", each row until the next time, which is how Nie's program AUTOQ reads its table.
    """

    ts: Float[Array, " n"]
    values: Float[Array, "n nv"]
    interpolation: Interpolation = eqx.field(static=True)

    def __init__(self, ts: ArrayLike, values: ArrayLike, interpolation: Interpolation = "linear") -> None:
        """Store the table.

        Raises:
            ValueError: the shapes do not fit, there are fewer than two times, or they do not increase.
        """
        self.ts, self.values = jnp.asarray(ts), jnp.asarray(values)
        self.interpolation = interpolation

    def __check_init__(self) -> None:
        """Check the shapes, and the times where they are known."""
        if self.interpolation not in ("linear", "cubic", "hold"):
            raise ValueError(f"interpolation is {self.interpolation!r}; use 'linear', 'cubic' or 'hold'")
        if self.ts.ndim != 1 or len(self.ts) < 2:
            raise ValueError(f"ts has shape {self.ts.shape}, but a table needs (n,) with n of at least 2")
        if self.values.ndim != 2 or len(self.values) != len(self.ts):
            raise ValueError(f"values has shape {self.values.shape}, but this table needs ({len(self.ts)}, nv)")
        if not isinstance(self.ts, Tracer) and not np.all(np.diff(self.ts) > 0):
            raise ValueError("ts must be strictly increasing")

    def __call__(self, t: Float[ArrayLike, ""], q: Any = None, u: Any = None) -> Float[Array, " nv"]:
        """Forces at time t [s]; the state is not looked at."""
        ts = jax.lax.stop_gradient(self.ts)
        t = jnp.clip(jnp.asarray(t, ts.dtype), ts[0], ts[-1])
        if self.interpolation == "hold":
            return self.values[jnp.searchsorted(ts, t, side="right") - 1]
        if self.interpolation == "linear":
            return diffrax.LinearInterpolation(ts, self.values).evaluate(t)
        return _cubic(ts, self.values, t)


def _cubic(ts: jax.Array, values: jax.Array, t: jax.Array) -> jax.Array:
    """The cubic between the two times around t, from values and slopes at both: the cost does not grow with the table."""
    last = len(ts) - 1
    left = jnp.clip(jnp.searchsorted(ts, t, side="right") - 1, 0, last - 1)
    h = ts[left + 1] - ts[left]
    s = (t - ts[left]) / h
    rise = (values[left + 1] - values[left]) / h
    # Less the straight line, whose slope is the rise.
    excess, next_excess = _slope(ts, values, left) - rise, _slope(ts, values, left + 1) - rise
    bend = s * (1.0 - s) * ((1.0 - s) * excess - s * next_excess)
    return values[left] + h * (s * rise + bend)


def _slope(ts: jax.Array, values: jax.Array, k: jax.Array) -> jax.Array:
    """Slope at the k-th time, of the parabola through it and its neighbours, or through the three times nearest to an end."""
    last = len(ts) - 1
    if last == 1:
        return (values[1] - values[0]) / (ts[1] - ts[0])
    middle = jnp.clip(k, 1, last - 1)
    before, after = ts[middle] - ts[middle - 1], ts[middle + 1] - ts[middle]
    rise, next_rise = (values[middle] - values[middle - 1]) / before, (values[middle + 1] - values[middle]) / after
    slope = (after * rise + before * next_rise) / (before + after)
    return jnp.where(k == 0, 2.0 * rise - slope, jnp.where(k == last, 2.0 * next_rise - slope, slope))


@final
class Controlled(eqx.Module):
    """Any of the forms of `control` as one function of (t, q, u)."""

    function: Any
    params: Any = None
    has_params: bool = eqx.field(static=True, default=False)

    def __call__(self, t: jax.Array, q: jax.Array, u: jax.Array) -> jax.Array:
        """Forces at the joints, zero without a control."""
        if self.function is None:
            return jnp.zeros_like(u)
        extra = (self.params,) if self.has_params else ()
        return jnp.asarray(self.function(t, q, u, *extra)).astype(u.dtype)


def as_control(control: Any) -> Controlled:
    """Bring `control` of `simulate` to one form.

    Raises:
        TypeError: it is none of the forms.
    """
    if isinstance(control, tuple) and len(control) == 2 and callable(control[0]):
        return Controlled(control[0], control[1], True)
    if control is None or callable(control):
        return Controlled(control)
    raise TypeError(
        f"control is {type(control).__name__}; give a function of (t, q, u), a pair of a function of (t, q, u, params) and params, "
        "a TorqueTable, or None"
    )


def check_control(control: Callable[..., jax.Array], t: jax.Array, q: jax.Array, u: jax.Array) -> None:
    """Compare the shape of the forces with that of the speeds.

    Raises:
        ValueError: they differ.
    """
    shape = eqx.filter_eval_shape(control, t, q, u).shape
    if shape != u.shape:
        raise ValueError(
            f"control returns shape {shape}, but this model needs {u.shape} = (nv,), a force on each generalized speed"
        )
