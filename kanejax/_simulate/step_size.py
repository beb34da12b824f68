"""Control of adaptive steps which a step to infinity cannot stop."""

from typing import Any, final

import diffrax
import jax.numpy as jnp


@final
class FiniteSteps(diffrax.PIDController):
    """diffrax's controller, for which a step that ends in infinity or NaN is too long.

    Where a state overflows, diffrax compares infinite errors with infinite states. The length of all further steps would be NaN,
    none of them taken and none of them too short, up to `max_steps` or for ever.
    """

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, dt0: Any, *rest: Any) -> tuple:
        """The first step; the whole time, where the estimate overflows."""
        first, state = super().init(terms, t0, t1, y0, dt0, *rest)
        return jnp.where(jnp.isfinite(first), first, t1), state

    def adapt_step_size(self, t0: Any, t1: Any, y0: Any, y1_candidate: Any, args: Any, y_error: Any, *rest: Any) -> tuple:
        """Whether to keep a step, and the next."""
        finite = jnp.all(jnp.isfinite(y1_candidate))
        if y_error is not None:
            y_error = jnp.where(finite & jnp.isfinite(y_error), y_error, jnp.inf).astype(y_error.dtype)
        return super().adapt_step_size(t0, t1, y0, jnp.where(finite, y1_candidate, y0), args, y_error, *rest)
