"""Adaptive integration in segments, so that a batch need not wait for the trajectory that takes most steps."""

import functools
from typing import Any, final

import diffrax
import equinox as eqx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp


@final
class Segment(diffrax.AbstractAdjoint):
    """`length` steps of diffrax's loop, which the next segment goes on with as if it had not been left.

    As diffrax's `adjoint`, because that is what runs its loop. The loop's state and whether it is unfinished come back in the
    solution's statistics. Without derivatives.

    Attributes:
        before: the loop's state at the end of the last segment; None if there was none.
        fresh: whether to start anew instead.
        length: most steps of one segment.
    """

    before: Any
    fresh: Any
    length: int = eqx.field(static=True)

    def loop(
        self, *, init_state: Any, max_steps: int, throw: Any, passed_solver_state: Any, passed_controller_state: Any, **rest: Any
    ) -> Any:
        """Run the loop; called by diffrax."""
        left = {}

        def outer(condition: Any, body: Any, state: Any, buffers: Any, **_: Any) -> Any:
            state = jax.tree.map(jnp.asarray, state)
            if self.before is not None:
                state = jax.tree.map(lambda new, old: jnp.where(self.fresh, new, old), state, self.before)
            last = jnp.minimum(state.num_steps + self.length, max_steps)
            state = eqxi.while_loop(lambda s: condition(s) & (s.num_steps < last), body, state, buffers=buffers, kind="lax")
            left["segment"] = state, condition(state) & (state.num_steps < max_steps)
            return state

        inner = functools.partial(eqxi.while_loop, kind="lax")
        loops = {"inner_while_loop": inner, "outer_while_loop": outer}
        final, statistics = self._loop(init_state=init_state, max_steps=max_steps, **loops, **rest)
        return final, statistics | left
