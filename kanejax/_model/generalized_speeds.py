"""Generalized speeds of the user's choice, Nie (2.13), and a model whose motion they describe."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from kanejax._model.model import Model
from kanejax._model.specialized import Specialized
from kanejax._model.tree import OnTree, Tree
from kanejax._types import Coordinates, Speeds


class SpeedTerms(NamedTuple):
    """Y and Z of u = Y rates + Z, where the rates are the model's own speeds; or their time derivatives.

    Attributes:
        matrix: Y.
        drift: Z.
    """

    matrix: Float[Array, "nv nv"]
    drift: Speeds


class AbstractSpeeds(eqx.Module):
    """A choice of generalized speeds; `terms` says how they depend on a model's own."""

    @abc.abstractmethod
    def terms(self, model: Model | Specialized, q: Coordinates, t: Float[Array, ""]) -> SpeedTerms:
        """Y and Z at a configuration and a time.

        Args:
            model: the mechanism in its own speeds.
            q: coordinates, whose quaternions are of unit length.
            t: the time [s].

        Returns:
            Y and Z in the data type of q.
        """


@final
class GeneralizedSpeeds(AbstractSpeeds):
    """Speeds u = Y(q, t) rates + Z(q, t), Nie (2.13), for `with_speeds`.

    The rates are the model's own speeds: those of revolute and prismatic coordinates, and the velocities and angular
    velocities that ball and free joints have in MuJoCo. Y must be invertible wherever the mechanism goes. Derivatives of Y and Z
    are taken by `jax.jvp`.

    Attributes:
        matrix: function of (q, t) that returns Y, (nv, nv). An `equinox.Module` can have parameters to differentiate; a plain
            function counts as a constant, and a new one compiles anew.
        drift: function of (q, t) that returns Z, (nv,); None for zero.
    """

    matrix: Callable[..., Any]
    drift: Callable[..., Any] | None

    def __init__(self, matrix: Any, drift: Any = None) -> None:
        """Keep the functions.

        Raises:
            TypeError: one is not callable.
        """
        for name, function in (("matrix", matrix), ("drift", drift)):
            if not callable(function) and not (name == "drift" and function is None):
                raise TypeError(f"{name} is {type(function).__name__}; give a function of (q, t)")
        self.matrix, self.drift = _as_tree(matrix), None if drift is None else _as_tree(drift)

    def terms(self, model: Model | Specialized, q: Coordinates, t: Float[Array, ""]) -> SpeedTerms:
        """What the functions return, in the data type of q."""
        drift = jnp.zeros(model.nv, q.dtype) if self.drift is None else jnp.asarray(self.drift(q, t)).astype(q.dtype)
        return SpeedTerms(jnp.asarray(self.matrix(q, t)).astype(q.dtype), drift)


@final
class WithSpeeds(eqx.Module, OnTree):
    """A model in generalized speeds that were chosen, in place of a model; see `with_speeds`.

    Attributes:
        model: the mechanism in its own speeds.
        speeds: the choice.
        t: the time [s] at which Y and Z are taken; `simulate` puts its own.
        tree: of the model; static.
    """

    model: Model | Specialized
    speeds: AbstractSpeeds
    t: Float[Array, ""]
    tree: Tree = eqx.field(static=True)

    @property
    def dtype(self) -> jnp.dtype:
        """Data type of the model's leaves."""
        return self.model.dtype

    def at(self, t: Float[ArrayLike, ""]) -> "WithSpeeds":
        """The same at another time [s], for speeds that depend on time."""
        return WithSpeeds(self.model, self.speeds, jnp.asarray(t).astype(self.dtype), self.tree)

    def __getattr__(self, name: str) -> Any:
        """Explain why there is no such attribute.

        Raises:
            AttributeError: always.
        """
        raise AttributeError(
            f"a model with chosen speeds has no {name!r}; what does not know of chosen speeds takes the model itself, its `model`, "
            "and rates_from_speeds"
        )


def with_speeds(model: Model | Specialized, speeds: AbstractSpeeds, t: Float[ArrayLike, ""] = 0.0) -> WithSpeeds:
    """A model in generalized speeds of the user's choice, Nie (2.13).

    It stands in place of the model in the equations of motion, `kane_equations`, partial velocities, `kinetic_energy` and
    `simulate`: their `u` and `u_dot` are the chosen speeds and their rates, and every generalized force (`bias_force`,
    `gravity_force`, `passive_force`, `generalized_active_force`, `generalized_inertia_force`) and the mass matrix belong to them.
    `tau` alone stays what it is for the model, the forces and torques of the joints, because these are what actuators apply:
    `inverse_dynamics` returns it, `forward_dynamics`, `generalized_active_force` and a `control` take it. With W the inverse of
    Y its generalized active force is W^T tau, so that mass_matrix u_dot + bias_force = W^T tau + passive_force.

    Args:
        model: the mechanism.
        speeds: `GeneralizedSpeeds`, or what `link_speeds` returns.
        t: the time [s], for speeds that depend on time; `WithSpeeds.at` changes it.

    Raises:
        ValueError: Y or Z does not have the shape that the model needs.
    """
    q, time = jnp.zeros(model.nq, model.dtype), jnp.asarray(t).astype(model.dtype)
    found = eqx.filter_eval_shape(speeds.terms, model, q, time)
    for name, value, shape, label in (
        ("matrix", found.matrix, (model.nv, model.nv), "(nv, nv)"),
        ("drift", found.drift, (model.nv,), "(nv,)"),
    ):
        if value.shape != shape:
            raise ValueError(f"{name} returns shape {value.shape}, but this model needs {shape} = {label}")
    return WithSpeeds(model, speeds, time, model.tree)


def own(model: "AnyModel") -> Model | Specialized:
    """The mechanism in its own speeds."""
    return model.model if isinstance(model, WithSpeeds) else model


@final
class _Constant(eqx.Module):
    """A function without parameters, as a part of a pytree that is no leaf."""

    function: Callable[..., Any] = eqx.field(static=True)

    def __call__(self, *args: Any) -> Any:
        """Call it."""
        return self.function(*args)


def _as_tree(function: Callable[..., Any]) -> Callable[..., Any]:
    return _Constant(function) if jax.tree_util.all_leaves([function]) else function


AnyModel = Model | Specialized | WithSpeeds
