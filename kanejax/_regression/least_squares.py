"""Least squares on compressed data: what each round of the inverse-dynamics stage solves."""

from typing import Any

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jax import lax

from kanejax._parameters.parameterization import Parameterization
from kanejax._regression.compress import Compressed, sums_of_squares
from kanejax._regression.linear_estimate import UNEXCITED, scaled_gram


@jax.jit
def solved(
    parameterization: Parameterization, root: jax.Array, thetas: jax.Array, center: jax.Array, damping: Any, held: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The best theta from each start, and their costs.

    `damping` holds phi near to where the data were linearised, and what is `held` right there.
    """
    lengths = jnp.linalg.norm(root[:, :-1], axis=0)

    def errors(theta: jax.Array, _: Any) -> tuple[jax.Array, jax.Array, jax.Array]:
        spring = jnp.sqrt(jnp.asarray(damping, theta.dtype)) * jnp.where(held, 1e6, 1.0) * lengths
        return *_errors(parameterization, root, center, theta), spring * (parameterization.phi(theta) - center)

    # Of many starts the best is solved for again in the next round.
    tolerance = (1e-10 if len(thetas) == 1 else 1e-6) if thetas.dtype == jnp.float64 else 1e-5
    # Normal equations for the steps: the residuals, which say where they end, are not squared.
    solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance, linear_solver=lx.Normal(lx.Cholesky()))

    def solve(theta: jax.Array) -> tuple[jax.Array, jax.Array]:
        value = optx.least_squares(errors, solver, theta, max_steps=300, throw=False).value
        left = errors(value, None)
        cost = sum(jnp.sum(x * x) for x in left)
        return value, jnp.where(jnp.isfinite(cost), cost, jnp.inf)

    # One after another: side by side all would take as many steps as the slowest, in matrices that leave the cache.
    return lax.map(solve, thetas)


def _errors(
    parameterization: Parameterization, root: jax.Array, center: jax.Array, theta: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Residuals of the data, and of the priors."""
    change = parameterization.phi(theta) - center
    return root[:, -1] - jnp.matmul(root[:, :-1], change, precision="highest"), parameterization.prior(theta)


@jax.jit
def _system(
    parameterization: Parameterization, root: jax.Array, center: jax.Array, theta: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """All residuals, and their derivatives."""

    def errors(theta: jax.Array) -> jax.Array:
        return jnp.concatenate(_errors(parameterization, root, center, theta))

    return errors(theta), jax.jacfwd(errors)(theta)


def polished(parameterization: Parameterization, root: jax.Array, center: jax.Array, theta: jax.Array) -> jax.Array:
    """Theta after steps of Gauss and Newton by orthogonal transformations, for what normal equations leave of exact data."""
    for _ in range(3):
        error, columns = (np.asarray(x, float) for x in _system(parameterization, root, center, theta))
        length = np.linalg.norm(columns, axis=0)
        length = np.where(length > 0, length, 1.0)
        new = theta - jnp.asarray(np.linalg.lstsq(columns / length, error, rcond=None)[0] / length, theta.dtype)
        after = np.asarray(_system(parameterization, root, center, new)[0], float)
        if not np.sum(after**2) < np.sum(error**2):
            break
        theta = new
    return theta


@jax.jit
def cost_of(parameterization: Parameterization, compressed: Compressed, sigma: jax.Array, theta: jax.Array) -> jax.Array:
    """Sum of squared residuals, each divided by its standard deviation, and of priors."""
    prior = parameterization.prior(theta)
    return jnp.sum(sums_of_squares(compressed, parameterization.phi(theta)) / sigma**2) + jnp.sum(prior * prior)


@jax.jit
def _largest_change(compressed: Compressed, sigma: jax.Array, before: jax.Array, after: jax.Array) -> jax.Array:
    moved = after - before
    square = jnp.einsum("i,rij,j->r", moved, compressed.products[:, :-1, :-1], moved, precision="highest")
    return jnp.sqrt(jnp.max(jnp.maximum(square, 0.0) / jnp.maximum(compressed.count, 1.0) / sigma**2))


def change_between(compressed: Compressed, sigma: jax.Array, before: jax.Array, after: jax.Array) -> float:
    """Root mean square by which a signal's prediction changes, relative to its errors, of the signal where that is most."""
    return float(_largest_change(compressed, sigma, before, after))


def rank(compressed: Compressed) -> int:
    """Number of combinations of parameters that the data determine."""
    products = np.asarray(jnp.sum(compressed.products, 0), float)[:-1, :-1]
    values = np.linalg.eigvalsh(scaled_gram(products)[0])
    return int(np.sum(values > UNEXCITED**2 * values.max(initial=0.0)))
