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
        return diffrax.CubicInterpolation(ts, _cubics(ts, self.values)).evaluate(t)


def _cubics(ts: jax.Array, values: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Coefficients, highest power first, of cubics between the times, from values and slopes at both ends."""
    h = jnp.diff(ts)[:, None]
    rise = jnp.diff(values, axis=0) / h
    if len(ts) == 2:
        slopes = jnp.concatenate((rise, rise))
    else:
        inner = (h[1:] * rise[:-1] + h[:-1] * rise[1:]) / (h[:-1] + h[1:])
        # At the ends, the parabola through the three nearest points.
        slopes = jnp.concatenate((2.0 * rise[:1] - inner[:1], inner, 2.0 * rise[-1:] - inner[-1:]))
    left, right = slopes[:-1], slopes[1:]
    return (left + right - 2.0 * rise) / (h * h), (3.0 * rise - 2.0 * left - right) / h, left, values[:-1]


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
