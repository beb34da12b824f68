"""The state's rates as diffrax wants them: coordinates and speeds in one vector, one kernel an evaluation."""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp

from kanejax._dynamics.equations_of_motion import _forward_dynamics
from kanejax._evaluate import evaluate_prepared, prepare_once
from kanejax._kinematics.change_of_speeds import chosen_accelerations, own_speeds
from kanejax._kinematics.coordinate_rates import kinematical_rates, unit_quaternions
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds, own
from kanejax._model.prepared import Prepared
from kanejax._model.specialized import PartlyPrepared
from kanejax._model.tree import Tree
from kanejax._scalar import barrier
from kanejax._simulate.control import Controlled


@final
class System(eqx.Module):
    """What the rates depend on besides time and state: diffrax's `args`. The links' parameters are computed once."""

    prepared: Prepared | PartlyPrepared
    control: Controlled
    tree: Tree = eqx.field(static=True)
    chosen: WithSpeeds | None = None

    def split(self, y: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Coordinates, quaternions of unit length, and speeds of states (..., nq + nv)."""
        return unit_quaternions(self.tree, y[..., : self.tree.nq]), y[..., self.tree.nq :]


def system(model: AnyModel, control: Controlled) -> System:
    """Prepare a model for many evaluations."""
    return System(prepare_once(own(model)), control, model.tree, model if isinstance(model, WithSpeeds) else None)


def rates(t: Any, y: Any, system: Any) -> jax.Array:
    """Rates of the state y at time t, as diffrax calls it with a System."""
    q, u = y[: system.tree.nq], y[system.tree.nq :]
    tau = system.control(t, *system.split(y))
    if system.chosen is None:
        return evaluate_prepared(_state_rates, system.tree, system.prepared, q, u, tau)
    model = system.chosen.at(t)
    own_u = own_speeds(model, q, u)
    moving = evaluate_prepared(_state_rates, system.tree, system.prepared, q, own_u, tau)
    q_dot, own_u_dot = moving[: system.tree.nq], moving[system.tree.nq :]
    return jnp.concatenate((q_dot, chosen_accelerations(model, q, own_u, own_u_dot)))


def _state_rates(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array, tau: jax.Array) -> jax.Array:
    u_dot = _forward_dynamics(tree, prepared, q, u, tau)
    q_dot = kinematical_rates(tree, q, u, restore=True)
    return jnp.concatenate(barrier((q_dot, u_dot)))
