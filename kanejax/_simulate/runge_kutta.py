"""Explicit Runge-Kutta methods, with stages that cost little beside the equations of motion."""

from typing import Any, final

import diffrax
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np


@final
class ExplicitRungeKutta(diffrax.AbstractAdaptiveSolver):
    """A step of diffrax's `solver` for one array of states: the same numbers but for rounding errors.

    diffrax multiplies tableau and stages as matrices, which in a batch of small states takes time that is a quarter (float64) to a
    half (float32) of that of an arm's equations of motion. Weighted sums, which XLA makes vector instructions of, cost a tenth.
    Forward and reverse mode both work; the solver's `scan_kind` has no say.
    """

    solver: diffrax.AbstractERK

    @property
    def term_structure(self) -> Any:
        """What it integrates."""
        return self.solver.term_structure

    @property
    def interpolation_cls(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The solution within a step."""
        return self.solver.interpolation_cls

    def order(self, terms: Any) -> int | None:
        """Order of convergence."""
        return self.solver.order(terms)

    def error_order(self, terms: Any) -> Any:
        """Order of the error estimate."""
        return self.solver.error_order(terms)

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Any:
        """Whether the first stage is unknown, and the last stage of the step before, which is the first of the next."""
        return jnp.asarray(True), jnp.zeros_like(y0)

    def step(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any) -> tuple:
        """One step: a loop over the stages, so that the program has the equations of motion once."""
        tableau, dt = self.solver.tableau, t1 - t0
        assert isinstance(tableau, diffrax.ButcherTableau)
        stages = tableau.num_stages
        lower, nodes = np.zeros((stages, stages)), np.append(0.0, tableau.c)
        for i, row in enumerate(tableau.a_lower):
            lower[i + 1, : i + 1] = row
        weights, times = jnp.asarray(lower, y0.dtype), jnp.where(nodes == 1, t1, t0 + nodes.astype(dt.dtype) * dt)
        unknown, last = solver_state
        # Of a batch all or none: a choice for each would evaluate both.
        unknown = eqxi.unvmap_any(unknown | made_jump) | (not tableau.fsal)

        def stage(i: jax.Array, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            rates, _ = carry
            y = y0 + dt * _weighted(weights[i], rates)
            rate = jax.lax.cond(unknown | (i > 0), lambda: terms.vf(times[i], y, args), lambda: last)
            return rates.at[i].set(rate), y

        rates, y1 = jax.lax.fori_loop(0, stages, stage, (jnp.broadcast_to(jnp.zeros_like(y0), (stages, *y0.shape)), y0))
        if not tableau.ssal:
            y1 = y0 + dt * _weighted(np.asarray(tableau.b_sol, y0.dtype), rates)
        error = dt * _weighted(np.asarray(tableau.b_error, y0.dtype), rates)
        dense = {"y0": y0, "y1": y1, "k": dt * rates}
        return y1, error, dense, (jnp.zeros_like(solver_state[0]), rates[-1]), diffrax.RESULTS.successful

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """Right-hand side."""
        return terms.vf(t0, y0, args)


def _weighted(weights: Any, rates: jax.Array) -> jax.Array:
    total = weights[0] * rates[0]
    for j in range(1, len(rates)):
        total = total + weights[j] * rates[j]
    return total
