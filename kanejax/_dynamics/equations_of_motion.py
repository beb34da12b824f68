"""The equations of motion: F(q) u_dot + bias(q, u) = tau + what springs, dampers and friction apply.

Functions take the model and one state; `jax.vmap` makes a batch of them. With what `with_speeds` returns in place of a model, u,
u_dot and the generalized forces are those of the chosen speeds, and tau is still the forces and torques of the joints.
"""

import functools
from collections.abc import Callable
from types import ModuleType

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._dynamics import articulated_inertia, composite_inertia
from kanejax._dynamics.active_force import passive_force as _passive_force
from kanejax._dynamics.inertia_force import inertia_force
from kanejax._dynamics.mass_matrix import mass_matrix as _mass_matrix_of_links
from kanejax._evaluate import check_state, evaluate
from kanejax._kinematics.change_of_speeds import (
    chosen_accelerations,
    chosen_forces,
    chosen_mass_matrix,
    own_motion,
    own_speeds,
)
from kanejax._model.generalized_speeds import AnyModel, WithSpeeds, own
from kanejax._model.prepared import Prepared, displacement
from kanejax._model.tree import Tree
from kanejax._recursion.rows import split_parameters
from kanejax._recursion.sweeps import is_written_out
from kanejax._scalar import add, is_known, mul, sub
from kanejax._types import Coordinates, Forces, Scalar, Speeds

Solve = Callable[[jax.Array], jax.Array]
# Links between the world and the farthest tip, up to which forming the mass matrix pays.
DEEPEST = 12


def inverse_dynamics(model: AnyModel, q: Coordinates, u: Speeds, u_dot: Speeds) -> Forces:
    """Forces at the joints that make the mechanism move with the given accelerations.

    MuJoCo's `qfrc_inverse`, contacts and constraints aside: F(q) u_dot + bias(q, u) less the forces of springs, dampers
    and friction. Nie (3.62), where the driving forces are what balances generalized inertia forces and gravity.

    Args:
        model: the mechanism.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds, MuJoCo's qvel.
        u_dot: their rates.

    Returns:
        Force [N] or torque [N m] on each of the model's own speeds, also in chosen ones.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q, u=u, u_dot=u_dot)
    if isinstance(model, WithSpeeds):
        return inverse_dynamics(model.model, q, *own_motion(model, q, u, u_dot))
    return evaluate(inverse_dynamics_kernel, model, q, u, u_dot)


def forward_dynamics(model: AnyModel, q: Coordinates, u: Speeds, tau: Forces) -> Speeds:
    """Rates of the generalized speeds under forces at the joints.

    MuJoCo's `qacc`, contacts and constraints aside. Order-N elimination; derivatives come from implicit differentiation of the
    equations of motion, not from differentiating the elimination.

    Args:
        model: the mechanism.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds, MuJoCo's qvel.
        tau: force [N] or torque [N m] on each of the model's own speeds, also in chosen ones.

    Returns:
        u_dot.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q, u=u, tau=tau)
    if isinstance(model, WithSpeeds):
        rates = own_speeds(model, q, u)
        return chosen_accelerations(model, q, rates, forward_dynamics(model.model, q, rates, tau))
    return evaluate(_forward_dynamics, model, q, u, tau)


def mass_matrix(model: AnyModel, q: Coordinates) -> Float[Array, "nv nv"]:
    """Kane's F, Nie (3.56): the kinetic energy is u . F u / 2. MuJoCo's `M` (full), armature included.

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.

    Returns:
        F, symmetric: [kg], [kg m] or [kg m^2] by what the two speeds are of.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q)
    if isinstance(model, WithSpeeds):
        return chosen_mass_matrix(model, q, mass_matrix(model.model, q))
    return evaluate(_mass_matrix, model, q)


def bias_force(model: AnyModel, q: Coordinates, u: Speeds) -> Forces:
    """Forces that hold the speeds constant without springs, dampers and friction: MuJoCo's `qfrc_bias`, sign included.

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds.

    Returns:
        Force [N] or torque [N m] on each speed.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q, u=u)
    if isinstance(model, WithSpeeds):
        return -generalized_inertia_force(model, q, u, jnp.zeros_like(u)) - gravity_force(model, q)
    return evaluate(_bias_force, model, q, u)


def gravity_force(model: AnyModel, q: Coordinates) -> Forces:
    """Generalized active force of gravity, Nie (3.54): minus the bias force at rest.

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.

    Returns:
        Force [N] or torque [N m] on each speed.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q)
    if isinstance(model, WithSpeeds):
        return chosen_forces(model, q, gravity_force(model.model, q))
    return -evaluate(_bias_force, model, q, jnp.zeros(model.nv, model.dtype))


def passive_force(model: AnyModel, q: Coordinates, u: Speeds) -> Forces:
    """Generalized active force of springs, dampers and smoothed friction: MuJoCo's `qfrc_passive`, and the friction.

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds.

    Returns:
        Force [N] or torque [N m] on each speed.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q, u=u)
    if isinstance(model, WithSpeeds):
        return chosen_forces(model, q, passive_force(model.model, q, own_speeds(model, q, u)))
    return evaluate(_passive_force_array, model, q, u)


def generalized_inertia_force(model: AnyModel, q: Coordinates, u: Speeds, u_dot: Speeds) -> Forces:
    """Kane's F*_r, Nie (3.46), rotor inertias included: -(F(q) u_dot + bias(q, u)) with gravity left out.

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds.
        u_dot: their rates.

    Returns:
        Force [N] or torque [N m] on each speed.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q, u=u, u_dot=u_dot)
    if isinstance(model, WithSpeeds):
        return chosen_forces(model, q, generalized_inertia_force(model.model, q, *own_motion(model, q, u, u_dot)))
    return evaluate(_inertia_force, model, q, u, u_dot)


def generalized_active_force(model: AnyModel, q: Coordinates, u: Speeds, tau: Forces) -> Forces:
    """Kane's F_r, Nie (3.50): gravity, springs, dampers, friction, and the forces at the joints.

    Args:
        model: the mechanism, or what `with_speeds` returns.
        q: generalized coordinates, MuJoCo's qpos; quaternions need not be of unit length.
        u: generalized speeds.
        tau: force [N] or torque [N m] on each of the model's own speeds, also in chosen ones.

    Returns:
        Force [N] or torque [N m] on each speed; with `generalized_inertia_force` it sums to zero along a motion.

    Raises:
        ValueError: a shape or data type does not fit the model.
    """
    check_state(own(model), q=q, u=u, tau=tau)
    applied = chosen_forces(model, q, tau) if isinstance(model, WithSpeeds) else tau
    return applied + gravity_force(model, q) + passive_force(model, q, u)


def inverse_dynamics_kernel(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array, u_dot: Scalar) -> jax.Array:
    dynamic = inertia_force(tree, prepared.links, prepared.gravity, displacement(tree, prepared, q), u, u_dot)
    return sub(add(dynamic, mul(prepared.armature, u_dot)), _passive_force(tree, prepared, q, u))


def _passive_force_array(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array) -> jax.Array:
    return jnp.broadcast_to(jnp.asarray(_passive_force(tree, prepared, q, u), u.dtype), u.shape)


def _rotors(prepared: Prepared, u: jax.Array) -> Scalar:
    """Armature of each speed, (nv, *batch), or 0 where it is known that there is none."""
    return prepared.armature if is_known(prepared.armature) else jnp.broadcast_to(prepared.armature, u.shape)


def _mass_matrix(tree: Tree, prepared: Prepared, q: jax.Array) -> jax.Array:
    form = composite_inertia.mass_matrix if _is_written_out(tree, prepared, q) else _mass_matrix_of_links
    return form(tree, prepared.links, prepared.armature, displacement(tree, prepared, q))


def _bias_force(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array) -> jax.Array:
    return inertia_force(tree, prepared.links, prepared.gravity, displacement(tree, prepared, q), u, 0.0)


def _inertia_force(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
    dynamic = inertia_force(tree, prepared.links, (0.0, 0.0, 0.0), displacement(tree, prepared, q), u, u_dot)
    return sub(-dynamic, mul(prepared.armature, u_dot))


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
    if _elimination(tree, prepared, q) is composite_inertia:
        return _solve_with_factor(tree, prepared, q, u, tau)[0]
    force = add(tau, _passive_force(tree, prepared, q, u))
    relative = displacement(tree, prepared, q)
    armature = _rotors(prepared, u)
    return articulated_inertia.forward_dynamics(tree, prepared.links, prepared.gravity, armature, relative, u, force)


def _elimination(tree: Tree, prepared: Prepared, q: jax.Array) -> ModuleType:
    """The cheaper way to solve F u_dot = force, with functions `factorize` and `solve`.

    Order-N elimination takes fewer operations for long chains, and in loops. Where all is written out with known numbers,
    forming F in the links' axes and factoring it takes less than half as many at 7 joints, as `operation_count` shows.
    """
    shallow = int(tree.link_ancestors.sum(1).max(initial=0)) <= DEEPEST
    return composite_inertia if shallow and _is_written_out(tree, prepared, q) else articulated_inertia


def _is_written_out(tree: Tree, prepared: Prepared, q: jax.Array) -> bool:
    return tree.njoint > 0 and is_written_out(tree, split_parameters(tree, prepared.links), q)


def _solve_with_factor(tree: Tree, prepared: Prepared, q: jax.Array, u: jax.Array, tau: jax.Array) -> tuple[jax.Array, Solve]:
    """U_dot, and the function that solves F x = force."""
    elimination = _elimination(tree, prepared, q)
    factor = elimination.factorize(tree, prepared.links, _rotors(prepared, u), displacement(tree, prepared, q))
    solve = functools.partial(elimination.solve, tree, factor)
    return solve(tau - inverse_dynamics_kernel(tree, prepared, q, u, 0.0)), solve


@_solve_motion.defjvp
def _implicit_derivative(tree: Tree, known: _Known, primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    """Differentiate inverse_dynamics(q, u, u_dot) = tau: F u_dot' = tau' - what the force changes at fixed u_dot."""
    traced, q, u, tau = primals
    u_dot, solve = _solve_with_factor(tree, eqx.combine(traced, known.prepared), q, u, tau)

    def needed(traced: Prepared, q: jax.Array, u: jax.Array) -> jax.Array:
        return inverse_dynamics_kernel(tree, eqx.combine(traced, known.prepared), q, u, u_dot)

    change = jax.jvp(needed, (traced, q, u), tangents[:3])[1]
    return u_dot, solve(tangents[3] - change)
