"""Bounds as a logarithmic barrier: slacks, their multipliers, and what these add to Newton's equations.

A number y between bounds has slacks s > 0 with y - lower = s[0] and upper - y = s[1], and multipliers z with s z = mu, the
barrier's parameter, which goes to zero. Where the bounds are equal, y = lower has a multiplier nu, and is weakened to y - lower =
weakness * (change of nu), which vanishes as nu converges: curvature stays finite, and equations may depend on each other.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from kanejax._optimal_control.products import product

# How far slacks start from zero, for bounds of size one.
_PUSH = 1e-2
# Multipliers stay within this factor of mu / s (Waechter and Biegler 2006, equation 16).
_NEAR = 1e10


class Slacks(NamedTuple):
    """Of numbers with bounds: slacks of the lower and the upper one, their multipliers, and the multiplier of equations."""

    s: Float[Array, "2 *shape"]
    z: Float[Array, "2 *shape"]
    nu: Float[Array, "*shape"]


class Weights(NamedTuple):
    """What bounds add to the curvature and the slope of the cost, by the numbers that have them."""

    curvature: Float[Array, "*shape"]
    slope: Float[Array, "*shape"]


def is_equation(bounds: Float[Array, "2 *shape"]) -> Bool[Array, "*shape"]:
    """Where bounds are equal."""
    return bounds[0] == bounds[1]


def is_limit(bounds: Float[Array, "2 *shape"]) -> Bool[Array, "2 *shape"]:
    """Where there is a barrier."""
    return jnp.isfinite(bounds) & ~is_equation(bounds)[None]


def room(y: Float[Array, "*shape"], bounds: Float[Array, "2 *shape"]) -> Float[Array, "2 *shape"]:
    """Distance to both bounds, positive within them; 1 where there is no barrier."""
    distance = jnp.stack((y - bounds[0], bounds[1] - y))
    return jnp.where(is_limit(bounds), distance, jnp.ones_like(distance))


def excess(y: Float[Array, "*shape"], bounds: Float[Array, "2 *shape"]) -> Float[Array, "*shape"]:
    """By how much equations do not hold; zero elsewhere."""
    # Differences of infinite bounds are not looked at, but would make gradients that are not numbers.
    value = jnp.where(is_equation(bounds), bounds[0], y)
    return y - value


def first_slacks(y: Float[Array, "*shape"], bounds: Float[Array, "2 *shape"], mu: jax.Array) -> Slacks:
    """Slacks at the first guess, which may be out of bounds."""
    size = jnp.where(is_limit(bounds), jnp.maximum(jnp.abs(bounds), jnp.ones_like(bounds)), jnp.ones_like(bounds))
    s = jnp.maximum(room(y, bounds), _PUSH * size)
    return Slacks(s, jnp.where(is_limit(bounds), mu / s, jnp.zeros_like(s)), jnp.zeros_like(y))


def weights(y: jax.Array, bounds: jax.Array, slacks: Slacks, mu: jax.Array) -> Weights:
    """What bounds add to Newton's equations."""
    rate, target = _linear(y, bounds, slacks, mu)
    weak = equation_weakness(y.dtype)
    equation = is_equation(bounds)
    curvature = jnp.where(equation, 1.0 / weak, rate[0] + rate[1])
    slope = jnp.where(equation, slacks.nu + excess(y, bounds) / weak, target[1] - target[0])
    return Weights(curvature, slope)


def change(y: jax.Array, dy: jax.Array, bounds: jax.Array, slacks: Slacks, mu: jax.Array) -> Slacks:
    """Newton's step of the slacks, where that of y is known."""
    rate, target = _linear(y, bounds, slacks, mu)
    distance = jnp.where(is_limit(bounds), jnp.stack((dy, -dy)), jnp.zeros_like(rate))
    s = distance + room(y, bounds) - slacks.s
    nu = (excess(y, bounds) + dy) / equation_weakness(y.dtype)
    return Slacks(s, target - rate * distance - slacks.z, jnp.where(is_equation(bounds), nu, jnp.zeros_like(nu)))


def multiplier(slacks: Slacks) -> jax.Array:
    """Of y in the Lagrangian."""
    return slacks.z[1] - slacks.z[0] + slacks.nu


def kept_near(slacks: Slacks, mu: jax.Array) -> Slacks:
    """Multipliers that have not gone far from mu / s."""
    nearest = mu / slacks.s
    return slacks._replace(z=jnp.where(slacks.z > 0, jnp.clip(slacks.z, nearest / _NEAR, nearest * _NEAR), slacks.z))


def reset(before: Slacks, after: Slacks, y: jax.Array, bounds: jax.Array, fraction: jax.Array) -> Slacks:
    """Slacks that are the distance to the bounds, unless that would shorten them by more than a fraction.

    Newton's step makes them that only where y is linear (Waltz, Morales, Nocedal and Orban 2006, section 3.1).
    """
    distance = room(y, bounds)
    near = is_limit(bounds) & (distance >= (1.0 - fraction) * before.s)
    return after._replace(s=jnp.where(near, distance, after.s))


def bent(rows: Float[Array, "n own"], weights: Float[Array, " own+n"]) -> Float[Array, "own own"]:
    """Curvature by states and controls from that by states, controls and rows."""
    own = rows.shape[1]
    return jnp.diag(weights[:own]) + product(rows.T, weights[own:, None] * rows)


def pulled(rows: jax.Array, weights: jax.Array) -> jax.Array:
    """Weights of states, controls and rows as weights of states and controls."""
    own = rows.shape[-1]
    return weights[..., :own] + jnp.einsum("...cv,...c->...v", rows, weights[..., own:], precision="highest")


def equation_weakness(dtype: jnp.dtype) -> float:
    """By how much equations are weakened."""
    return math.sqrt(float(jnp.finfo(dtype).eps))


def _linear(y: jax.Array, bounds: jax.Array, slacks: Slacks, mu: jax.Array) -> tuple[jax.Array, jax.Array]:
    """New multipliers as target - rate * (change of the distance to the bound)."""
    limit = is_limit(bounds)
    rate = jnp.where(limit, slacks.z / slacks.s, jnp.zeros_like(slacks.z))
    target = jnp.where(limit, mu / slacks.s - rate * (room(y, bounds) - slacks.s), jnp.zeros_like(slacks.z))
    return rate, target
