"""The integration scheme of Nie's programs ANGLE and AUTOQ."""

from collections.abc import Callable
from typing import Any, ClassVar, final

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx


@final
class BetaScheme(diffrax.AbstractImplicitSolver[Any]):
    """y1 = y0 + h f(t0 + beta h, (1 - beta) y0 + beta y1), which AUTOQ calls explicit at beta = 0, implicit at 1,
    "Crank-Nelson" between.

    Of order 2 at beta = 0.5, where it is the implicit midpoint rule, which keeps quadratic invariants such as the length of
    quaternions; of order 1 otherwise. A-stable from beta = 0.5 on. Only for equal steps: `simulate(..., solver=BetaScheme(0.5),
    dt0=1e-3)`.

    From its second step on AUTOQ replaces the difference quotient (y1 - y0) / h by (3 y1 - 4 y0 + y_before) / (2 h). That is
    `three_point`; it is of order 2 at beta = 1, where it is the backward differentiation formula, and of order 1 otherwise,
    since quotient and right-hand side belong to different times. AUTOQ solves for y1 by Broyden's method, here by Newton's with
    one Jacobian a step.

    Attributes:
        beta: from 0 to 1.
        three_point: AUTOQ's difference quotient.
        root_finder: of optimistix; takes its tolerances from `simulate`.
        root_find_max_steps: iterations after which a step fails.
    """

    beta: float = eqx.field(static=True, default=0.5)
    three_point: bool = eqx.field(static=True, default=False)
    root_finder: optx.AbstractRootFinder[Any, Any, Any, Any] = diffrax.with_stepsize_controller_tols(optx.Chord)()
    root_find_max_steps: int = 20

    term_structure: ClassVar[Any] = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable[..., diffrax.LocalLinearInterpolation]] = diffrax.LocalLinearInterpolation

    def __check_init__(self) -> None:
        """Check beta."""
        if not 0 <= self.beta <= 1:
            raise ValueError(f"beta is {self.beta}; it must be from 0 to 1")

    def order(self, terms: Any) -> int:
        """Order of convergence."""
        return 2 if self.beta == (1.0 if self.three_point else 0.5) else 1

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Any:
        """Whether a step was made, and its change of y, which is also the guess for the next."""
        return jnp.asarray(False), jax.tree.map(jnp.zeros_like, y0)

    def step(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any) -> tuple[Any, ...]:
        """One step; the unknown is the change of y."""
        moved, before = solver_state
        control = terms.contr(t0, t1)
        three_point = moved & self.three_point
        ahead, behind = jnp.where(three_point, 2 / 3, 1.0), jnp.where(three_point, 1 / 3, 0.0)

        def required(change: Any, args: Any) -> Any:
            middle = jax.tree.map(lambda y, z: y + self.beta * z, y0, change)
            increment = terms.vf_prod(t0 + self.beta * (t1 - t0), middle, args, control)
            return jax.tree.map(lambda f, z: ahead.astype(f.dtype) * f + behind.astype(f.dtype) * z, increment, before)

        def residual(change: Any, args: Any) -> Any:
            return jax.tree.map(lambda new, z: new - z, required(change, args), change)

        if self.beta == 0:
            change, result = required(before, args), diffrax.RESULTS.successful
        else:
            found = optx.root_find(residual, self.root_finder, before, args, throw=False, max_steps=self.root_find_max_steps)
            change, result = found.value, diffrax.RESULTS.promote(found.result)
        y1 = jax.tree.map(jnp.add, y0, change)
        return y1, None, {"y0": y0, "y1": y1}, (jnp.ones_like(moved), change), result

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """Right-hand side."""
        return terms.vf(t0, y0, args)
