"""The default method of the simulation stage."""

from typing import Any, ClassVar, final

import diffrax
import jax
import jax.numpy as jnp
from jax import lax


@final
class RungeKutta4(diffrax.AbstractSolver[Any]):
    """The classical method of order four; for equal steps."""

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Any] = diffrax.LocalLinearInterpolation

    def order(self, terms: Any) -> int:
        """Order of convergence."""
        return 4

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> None:
        """Nothing goes from step to step."""

    def step(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any) -> tuple:
        """One step: a loop over the stages, so that the program has the equations of motion once."""
        h = t1 - t0
        nodes, weights = (jnp.asarray(x, y0.dtype) for x in ((0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)))

        def stage(i: jax.Array, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            rate, total = carry
            rate = terms.vf(t0 + nodes[i] * h, y0 + nodes[i] * h * rate, args)
            return rate, total + weights[i] * rate

        zero = jnp.zeros_like(y0)
        y1 = y0 + h * lax.fori_loop(0, 4, stage, (zero, zero))[1]
        return y1, None, {"y0": y0, "y1": y1}, None, diffrax.RESULTS.successful

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """Right-hand side."""
        return terms.vf(t0, y0, args)
