"""First derivatives of inverse and forward dynamics, and second ones of a weighted sum.

In closed form for trees of revolute and prismatic joints. Otherwise by differentiation, at half the cost of all derivatives:
inverse dynamics is linear in u_dot with Kane's F, Nie (3.56), and what is quadratic in the speeds does not depend on u_dot.
Derivatives of forward dynamics follow by differentiating tau(q, u, u_dot(q, u, tau)) = tau twice. Coordinates are counted by
displacements from the given ones, one a speed.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._dynamics.curvature import Curvature, inertia_force_curvature
from kanejax._dynamics.equations_of_motion import forward_dynamics, inverse_dynamics, mass_matrix
from kanejax._evaluate import evaluate
from kanejax._model.model import Model
from kanejax._optimal_control.composition import Curved, Weigh
from kanejax._optimize.displacement import displaced
from kanejax._types import Coordinates, Forces, Speeds


def curved_inverse_dynamics(model: Model, q: Coordinates, u: Speeds, u_dot: Speeds, weigh: Weigh) -> Curved:
    """The forces, by displacement, speeds and u_dot."""
    if set(model.tree.joint_types) <= {"revolute", "prismatic"}:
        tau = inverse_dynamics(model, q, u, u_dot)
        return _assembled(tau, _closed_form(model, q, u, u_dot, weigh(tau)))
    return _assembled(*_by_differentiation(model, q, u, u_dot, weigh))


def curved_forward_dynamics(model: Model, q: Coordinates, u: Speeds, tau: Forces, weigh: Weigh) -> Curved:
    """The rates of the speeds, by displacement, speeds and forces."""
    nv, u_dot = model.nv, forward_dynamics(model, q, u, tau)
    inverse = _inverse(mass_matrix(model, q))
    weights = jnp.sum(inverse * weigh(u_dot)[None], -1)
    needed = curved_inverse_dynamics(model, q, u, u_dot, lambda _: -weights)
    jacobian = jnp.concatenate((-jnp.matmul(inverse, needed.jacobian[:, : 2 * nv], precision="highest"), inverse), 1)
    state = jnp.zeros((3 * nv, 3 * nv), u.dtype).at[: 2 * nv, : 2 * nv].set(needed.curvature[: 2 * nv, : 2 * nv])
    mixed = jnp.matmul(needed.curvature[:, 2 * nv :], jacobian, precision="highest")
    return Curved(u_dot, jacobian, state + mixed + mixed.T)


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
    return rigid._replace(
        force_by_q=rigid.force_by_q + jnp.diag(model.stiffness),
        force_by_u=rigid.force_by_u + jnp.diag(by_u),
        mass_matrix=rigid.mass_matrix + jnp.diag(model.armature),
        u_u=rigid.u_u + jnp.diag(by_u_twice),
    )


def _by_differentiation(model: Model, q: Coordinates, u: Speeds, u_dot: Speeds, weigh: Weigh) -> tuple[jax.Array, Curvature]:
    still, directions = jnp.zeros_like(u), jnp.eye(model.nv, dtype=u.dtype)

    def forces(moved: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
        return inverse_dynamics(model, displaced(model.tree, q, moved), u, u_dot)

    def by_all(moved: jax.Array) -> tuple:
        tau, pull_back = jax.vjp(forces, moved, u, u_dot)
        weights = jax.lax.stop_gradient(weigh(tau))
        return tau, pull_back(weights), weights

    def by_speeds(u: jax.Array) -> tuple:
        tau, pull_back = jax.vjp(lambda u: forces(still, u, u_dot), u)
        return tau, pull_back(weights)[0]

    along_q = jax.vmap(lambda way: jax.jvp(by_all, (still,), (way,)), out_axes=(None, -1))
    (tau, _, weights), (of_q, (qq, uq, aq), _) = along_q(directions)
    of_u, uu = jax.vmap(lambda way: jax.jvp(by_speeds, (u,), (way,))[1], out_axes=-1)(directions)
    return tau, Curvature(of_q, of_u, mass_matrix(model, q), qq, uq, uu, aq)


def _assembled(tau: Forces, of: Curvature) -> Curved:
    none = jnp.zeros_like(of.u_u)
    curvature = jnp.block([[of.q_q, of.u_q.T, of.a_q.T], [of.u_q, of.u_u, none], [of.a_q, none, none]])
    return Curved(tau, jnp.concatenate((of.force_by_q, of.force_by_u, of.mass_matrix), 1), curvature)
