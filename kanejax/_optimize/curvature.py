"""First derivatives of inverse and forward dynamics, and second ones of a weighted sum.

In closed form for trees of revolute and prismatic joints. Otherwise by differentiation, at half the cost of all derivatives:
inverse dynamics is linear in u_dot with Kane's F, Nie (3.56), and what is quadratic in the speeds does not depend on u_dot.
Derivatives of forward dynamics follow by differentiating tau(q, u, u_dot(q, u, tau)) = tau twice. Coordinates are counted by
displacements from the given ones, one a speed.
"""

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve

from kanejax._dynamics.curvature import Curvature, inertia_force_curvature
from kanejax._dynamics.equations_of_motion import forward_dynamics, inverse_dynamics, mass_matrix, passive_force
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
    factor = cho_factor(mass_matrix(model, q), lower=True)
    weights = cho_solve(factor, weigh(u_dot))
    needed = curved_inverse_dynamics(model, q, u, u_dot, lambda _: -weights)
    jacobian = cho_solve(factor, jnp.concatenate((-needed.jacobian[:, : 2 * nv], jnp.eye(nv, dtype=u.dtype)), 1))
    state = jnp.zeros((3 * nv, 3 * nv), u.dtype).at[: 2 * nv, : 2 * nv].set(needed.curvature[: 2 * nv, : 2 * nv])
    mixed = jnp.matmul(needed.curvature[:, 2 * nv :], jacobian, precision="highest")
    return Curved(u_dot, jacobian, state + mixed + mixed.T)


def _closed_form(model: Model, q: Coordinates, u: Speeds, u_dot: Speeds, weights: Forces) -> Curvature:
    """Of inertia forces and rotors, and of springs, dampers and friction, each of which depends on its own joint."""
    rigid = Curvature(*evaluate(inertia_force_curvature, model, q, u, u_dot, weights))

    def slopes(q: jax.Array, u: jax.Array) -> tuple:
        force, pull_back = jax.vjp(lambda q, u: passive_force(model, q, u), q, u)
        return force, pull_back(weights)

    every, none = jnp.ones_like(u), jnp.zeros_like(u)
    of_q, (qq, uq) = jax.jvp(slopes, (q, u), (every, none))[1]
    of_u, (_, uu) = jax.jvp(slopes, (q, u), (none, every))[1]
    changes = (-of_q, -of_u, model.armature, -qq, -uq, -uu, none)
    return Curvature(*(each + jnp.diag(change) for each, change in zip(rigid, changes, strict=True)))


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
