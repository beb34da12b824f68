"""The equations of motion: F(q) u_dot + bias(q, u) = tau + what springs, dampers and friction apply.

Functions take the model and one state; `jax.vmap` makes a batch of them.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._dynamics import articulated_inertia
from kanejax._dynamics.active_force import passive_force as _passive_force
from kanejax._dynamics.inertia_force import inertia_force
from kanejax._dynamics.mass_matrix import mass_matrix as _mass_matrix_of_links
from kanejax._evaluate import check_state, evaluate
from kanejax._model.model import Model
from kanejax._model.prepared import Prepared, displacement
from kanejax._model.specialized import Specialized
from kanejax._model.tree import Tree
from kanejax._types import Coordinates, Forces, Speeds


def inverse_dynamics(model: Model | Specialized, q: Coordinates, u: Speeds, u_dot: Speeds) -> Forces:
    """Forces at the joints that make the mechanism move with the given accelerations.

    MuJoCo's `qfrc_inverse`, contacts and constraints aside: F(q) u_dot + bias(q, u) less the forces of springs, dampers
    and friction. Nie (3.62), where the driving forces are what balances generalized inertia forces and gravity.

    Args:
        model: the mechanism.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds, MuJoCo's qvel.
        u_dot: their rates.

    Returns:
        Force [N] or torque [N m] on each generalized speed.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(model, q=q, u=u, u_dot=u_dot)
    return evaluate(_inverse_dynamics, model, q, u, u_dot)


def forward_dynamics(model: Model | Specialized, q: Coordinates, u: Speeds, tau: Forces) -> Speeds:
    """Rates of the generalized speeds under forces at the joints.

    MuJoCo's `qacc`, contacts and constraints aside. Order-N elimination; derivatives come from implicit differentiation of the
    equations of motion, not from differentiating the elimination.

    Args:
        model: the mechanism.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds, MuJoCo's qvel.
        tau: force [N] or torque [N m] on each generalized speed.

    Returns:
        u_dot.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(model, q=q, u=u, tau=tau)
    return evaluate(_forward_dynamics, model, q, u, tau)


def mass_matrix(model: Model | Specialized, q: Coordinates) -> Float[Array, "nv nv"]:
    """Kane's F, Nie (3.56): the kinetic energy is u . F u / 2. MuJoCo's `M` (full), armature included."""
    check_state(model, q=q)
    return evaluate(_mass_matrix, model, q)


def bias_force(model: Model | Specialized, q: Coordinates, u: Speeds) -> Forces:
    """Forces that hold the speeds constant without springs, dampers and friction: MuJoCo's `qfrc_bias`, sign included."""
    check_state(model, q=q, u=u)
    return evaluate(_bias_force, model, q, u)


def gravity_force(model: Model | Specialized, q: Coordinates) -> Forces:
    """Generalized active force of gravity, Nie (3.54): minus the bias force at rest."""
    check_state(model, q=q)
    return -evaluate(_bias_force, model, q, jnp.zeros(model.nv, model.dtype))


def passive_force(model: Model | Specialized, q: Coordinates, u: Speeds) -> Forces:
    """Generalized active force of springs, dampers and smoothed friction: MuJoCo's `qfrc_passive`, and the friction."""
    check_state(model, q=q, u=u)
    return evaluate(_passive_force, model, q, u)


def generalized_inertia_force(model: Model | Specialized, q: Coordinates, u: Speeds, u_dot: Speeds) -> Forces:
    """Kane's F*_r, Nie (3.46), rotor inertias included: -(F(q) u_dot + bias(q, u)) with gravity left out."""
    check_state(model, q=q, u=u, u_dot=u_dot)
    return evaluate(_inertia_force, model, q, u, u_dot)


def generalized_active_force(model: Model | Specialized, q: Coordinates, u: Speeds, tau: Forces) -> Forces:
    """Kane's F_r, Nie (3.50): gravity, springs, dampers, friction, and the forces at the joints."""
    return tau + gravity_force(model, q) + passive_force(model, q, u)


def _inverse_dynamics(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
    dynamic = inertia_force(tree, prepared.links, prepared.gravity, displacement(tree, prepared, q), u, u_dot)
    return dynamic + prepared.armature * u_dot - _passive_force(tree, prepared, q, u)


def _mass_matrix(tree: Tree, prepared: Prepared, q: jax.Array) -> jax.Array:
    return _mass_matrix_of_links(tree, prepared.links, prepared.armature, displacement(tree, prepared, q))


def _bias_force(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array) -> jax.Array:
    return inertia_force(tree, prepared.links, prepared.gravity, displacement(tree, prepared, q), u, jnp.zeros_like(u))


def _inertia_force(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
    dynamic = inertia_force(tree, prepared.links, (0.0, 0.0, 0.0), displacement(tree, prepared, q), u, u_dot)
    return -dynamic - prepared.armature * u_dot


def _forward_dynamics(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array, tau: jax.Array) -> jax.Array:
    # Constants must not become traced arguments of the derivative rule.
    traced, known = eqx.partition(prepared, lambda x: isinstance(x, jax.Array))
    return _solve_motion(tree, _Known(known), traced, q, u, tau)


class _Known:
    """Parameters that are constants, None in place of the others, as an argument that is compared by identity."""

    def __init__(self, prepared: Prepared) -> None:
        self.prepared = prepared


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _solve_motion(tree: Tree, known: _Known, traced: Prepared, q: jax.Array, u: jax.Array, tau: jax.Array) -> jax.Array:
    prepared = eqx.combine(traced, known.prepared)
    force = tau + _passive_force(tree, prepared, q, u)
    relative = displacement(tree, prepared, q)
    armature = jnp.broadcast_to(prepared.armature, u.shape)
    return articulated_inertia.forward_dynamics(tree, prepared.links, prepared.gravity, armature, relative, u, force)


@_solve_motion.defjvp
def _implicit_derivative(tree: Tree, known: _Known, primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    """Differentiate inverse_dynamics(q, u, u_dot) = tau: F u_dot' = tau' - what the force changes at fixed u_dot."""
    traced, q, u, tau = primals
    prepared = eqx.combine(traced, known.prepared)
    armature = jnp.broadcast_to(prepared.armature, u.shape)
    factor = articulated_inertia.factorize(tree, prepared.links, armature, displacement(tree, prepared, q))
    u_dot = articulated_inertia.solve(tree, factor, tau - _inverse_dynamics(tree, prepared, q, u, jnp.zeros_like(u)))

    def needed(traced: Prepared, q: jax.Array, u: jax.Array) -> jax.Array:
        return _inverse_dynamics(tree, eqx.combine(traced, known.prepared), q, u, u_dot)

    change = jax.jvp(needed, (traced, q, u), tangents[:3])[1]
    return u_dot, articulated_inertia.solve(tree, factor, tangents[3] - change)
