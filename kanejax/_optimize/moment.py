"""What costs and constraints are functions of, and both as values."""

from collections.abc import Callable
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float


class Moment(NamedTuple):
    """The motion at one time.

    At the last node there is no force any more, and `u_dot`, `tau`, `tau_rate` and `jerk` are None.

    Attributes:
        t: time since the start [s].
        q: generalized coordinates.
        u: generalized speeds.
        u_dot: their rates.
        tau: forces [N] and torques [N m] at the joints.
        tau_rate: change of the forces since the step before, a unit of time; None where no cost, constraint or limit asks for it.
        jerk: change of u_dot since the step before, a unit of time; None likewise.
    """

    t: Float[Array, ""]
    q: Float[Array, " nq"]
    u: Float[Array, " nv"]
    u_dot: Any = None
    tau: Any = None
    tau_rate: Any = None
    jerk: Any = None


@final
class Cost(eqx.Module):
    """A term of the cost: weight times the integral of a function over the motion, or times its value at the end.

    Attributes:
        function: of (model, moment), a number; with arrays as leaves if it is a module, which can be batched and differentiated.
        weight: factor.
        name: for results and errors.
        at_end: whether it counts at the last node instead of along the motion.
        needs: what of "tau_rate" and "jerk" the function looks at.
    """

    function: Callable[[Any, Moment], Float[Array, ""]]
    weight: Float[Array, ""]
    name: str = eqx.field(static=True)
    at_end: bool = eqx.field(static=True)
    needs: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        function: Callable[[Any, Moment], Any],
        weight: Float[ArrayLike, ""] = 1.0,
        *,
        name: str | None = None,
        at_end: bool = False,
        needs: tuple[str, ...] = (),
    ) -> None:
        """Store the term; its name is the function's unless given."""
        self.function, self.weight = _leafless(function), jnp.asarray(weight, float)
        self.name = getattr(function, "__name__", type(function).__name__) if name is None else name
        self.at_end, self.needs = at_end, _checked_needs(needs)


@final
class Constraint(eqx.Module):
    """Functions of the motion that stay between bounds, along the motion or at its end; equal bounds make equations.

    Attributes:
        function: of (model, moment), an array of one axis; with arrays as leaves if it is a module.
        lower: least values, one for all or one each; minus infinity for none.
        upper: greatest values.
        name: for results and errors.
        at_end: whether it holds at the last node only, instead of along the motion and there; functions that hold along the motion
            and look at forces are left out at the last node.
        needs: what of "tau_rate" and "jerk" the function looks at.
    """

    function: Callable[[Any, Moment], Float[Array, " n"]]
    lower: Float[Array, " *n"]
    upper: Float[Array, " *n"]
    name: str = eqx.field(static=True)
    at_end: bool = eqx.field(static=True)
    needs: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        function: Callable[[Any, Moment], Any],
        lower: Float[ArrayLike, " *n"] = -jnp.inf,
        upper: Float[ArrayLike, " *n"] = 0.0,
        *,
        name: str | None = None,
        at_end: bool = False,
        needs: tuple[str, ...] = (),
    ) -> None:
        """Store the constraint, function <= 0 by default; its name is the function's unless given."""
        self.function, self.lower, self.upper = _leafless(function), jnp.asarray(lower, float), jnp.asarray(upper, float)
        self.name = getattr(function, "__name__", type(function).__name__) if name is None else name
        self.at_end, self.needs = at_end, _checked_needs(needs)


def _leafless(function: Any) -> Any:
    """A plain function becomes part of the structure of a pytree, so that tasks go through JAX's own transformations."""
    return function if isinstance(function, eqx.Module) else jax.tree_util.Partial(function)


def _checked_needs(needs: tuple[str, ...]) -> tuple[str, ...]:
    if unknown := set(needs) - {"tau_rate", "jerk"}:
        raise ValueError(f"needs names {sorted(unknown)}; give 'tau_rate', 'jerk', both or nothing")
    return tuple(needs)
