"""First derivatives of inverse and forward dynamics, and second ones of a weighted sum, in closed form.

Derivatives of forward dynamics follow by differentiating tau(q, u, u_dot(q, u, tau)) = tau twice. Coordinates are counted by
displacements from the given ones, one a speed.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._dynamics.active_force import spring_force
from kanejax._dynamics.curvature import Curvature, inertia_force_curvature
from kanejax._dynamics.equations_of_motion import forward_dynamics, inverse_dynamics
from kanejax._evaluate import evaluate
from kanejax._model.model import Model
from kanejax._model.prepared import Prepared
from kanejax._model.tree import Tree
from kanejax._optimal_control.composition import Curved, Weigh
from kanejax._optimal_control.products import product
from kanejax._optimize.displacement import displaced
from kanejax._types import Coordinates, Forces, Speeds


def curved_inverse_dynamics(model: Model, q: Coordinates, u: Speeds, u_dot: Speeds, weigh: Weigh) -> Curved:
    """The forces, by displacement, speeds and u_dot."""
    tau = inverse_dynamics(model, q, u, u_dot)
    return _assembled(tau, _closed_form(model, q, u, u_dot, weigh(tau)))


def curved_forward_dynamics(model: Model, q: Coordinates, u: Speeds, tau: Forces, weigh: Weigh) -> Curved:
    """The rates of the speeds, by displacement, speeds and forces."""
    u_dot = forward_dynamics(model, q, u, tau)
    jacobian = forward_jacobian(model, q, u, u_dot)
    return Curved(u_dot, jacobian, forward_curvature(model, q, u, u_dot, jacobian, weigh(u_dot)))


def forward_jacobian(model: Model, q: Coordinates, u: Speeds, u_dot: Speeds) -> Float[Array, "nv 3*nv"]:
    """Derivatives of the rates of the speeds by displacement, speeds and forces, where these rates are known."""
    nv, unweighted = model.nv, jnp.zeros_like(u)
    needed = curved_inverse_dynamics(model, q, u, u_dot, lambda _: unweighted).jacobian
    inverse = _inverse(needed[:, 2 * nv :])
    return jnp.concatenate((-product(inverse, needed[:, : 2 * nv]), inverse), 1)


def forward_curvature(
    model: Model, q: Coordinates, u: Speeds, u_dot: Speeds, jacobian: Float[Array, "nv 3*nv"], weights: Speeds
) -> Float[Array, "3*nv 3*nv"]:
    """Second derivatives of the weighted sum of these rates, where their first ones are known."""
    nv = model.nv
    pulled = -product(jacobian[:, 2 * nv :], weights)
    of_forces = curved_inverse_dynamics(model, q, u, u_dot, lambda _: pulled).curvature
    state = jnp.zeros_like(of_forces).at[: 2 * nv, : 2 * nv].set(of_forces[: 2 * nv, : 2 * nv])
    mixed = product(of_forces[:, 2 * nv :], jacobian)
    return state + mixed + mixed.T


def _inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Of a symmetric positive matrix, by sweeps: for many small ones at a time, of which LAPACK would take one after another."""
    for k in range(len(matrix)):
        pivot, row = matrix[k, k], matrix[k]
        scaled = (row / pivot).at[k].set(-1.0 / pivot)
        matrix = (matrix - jnp.outer(row, row) / pivot).at[k].set(scaled).at[:, k].set(scaled)
    return -matrix


def _closed_form(model: Model, q: Coordinates, u: Speeds, u_dot: Speeds, weights: Forces) -> Curvature:
    """Of inertia forces and rotors, and of springs, dampers and friction f u / sqrt(u^2 + w^2), each of its own joint."""
    rigid = Curvature(*evaluate(inertia_force_curvature, model, q, u, u_dot, weights))
    square = model.friction_width * model.friction_width
    rounded = jax.lax.rsqrt(u * u + square)
    friction = model.coulomb_friction * square * rounded**3
    by_u, by_u_twice = model.damping + friction, -3.0 * weights * friction * u * rounded**2
    stiffness, of_stiffness = _springs(model, q, weights)
    return rigid._replace(
        force_by_q=rigid.force_by_q + stiffness,
        force_by_u=rigid.force_by_u + jnp.diag(by_u),
        mass_matrix=rigid.mass_matrix + jnp.diag(model.armature),
        q_q=rigid.q_q + of_stiffness,
        u_u=rigid.u_u + jnp.diag(by_u_twice),
    )


def _springs(model: Model, q: Coordinates, weights: Forces) -> tuple[Float[Array, "nv nv"], Float[Array, "nv nv"]]:
    """First derivatives of the springs' forces, and second ones of their weighted sum, which only springs of balls have."""
    if model.nq == model.nv:
        return jnp.diag(model.stiffness), jnp.zeros((model.nv, model.nv), q.dtype)

    def slope(moved: jax.Array) -> tuple[jax.Array, jax.Array]:
        force, pull_back = jax.vjp(lambda moved: evaluate(_spring_force, model, displaced(model.tree, q, moved)), moved)
        return force, pull_back(weights)[0]

    still, directions = jnp.zeros(model.nv, q.dtype), jnp.eye(model.nv, dtype=q.dtype)
    return jax.vmap(lambda way: jax.jvp(slope, (still,), (way,))[1], out_axes=-1)(directions)


def _spring_force(tree: Tree, prepared: Prepared, q: jax.Array) -> jax.Array:
    return jnp.asarray(spring_force(tree, prepared, q))


def _assembled(tau: Forces, of: Curvature) -> Curved:
    none = jnp.zeros_like(of.u_u)
    curvature = jnp.block([[of.q_q, of.u_q.T, of.a_q.T], [of.u_q, of.u_u, none], [of.a_q, none, none]])
    return Curved(tau, jnp.concatenate((of.force_by_q, of.force_by_u, of.mass_matrix), 1), curvature)
