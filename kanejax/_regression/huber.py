"""Huber's function: least squares for errors of usual size, in which errors far out count less (Huber 1964)."""

import jax
import jax.numpy as jnp

# Errors of more standard deviations than this are far out: as efficient as least squares to 95 % where errors are normal.
HUBER = 1.345


def huber_cost(size: jax.Array) -> jax.Array:
    """What errors cost, by their size in standard deviations: its square, and on a straight line from where they are far out."""
    return jnp.where(size < HUBER, size**2, HUBER * (2.0 * size - HUBER))


def huber_weight(size: jax.Array) -> jax.Array:
    """With which weight the square of such an error has the same derivative."""
    return HUBER / jnp.maximum(size, HUBER)
