"""A log of any length, compressed into small matrices that say all that least squares needs of it.

The residuals are linearised about one phi, e - J d for the change d from there, and of [J e] only the products of its columns are
kept, summed over the log chunk by chunk: memory does not grow with the log. There is one matrix a signal, so that signals can
be weighted afterwards. Such normal equations square the condition number, which is harmless here: regressors of base parameters are
well conditioned, and compressing again about the solution, where e is no more than the errors, gives what rounding took
(iterative refinement; Bjorck 1996, Numerical methods for least squares problems, 2.9).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from kanejax._parameters.parameterization import Parameterization
from kanejax._regression.huber import huber_weight
from kanejax._regression.linearization import (
    CHUNK,
    Samples,
    chunks,
    delay_index,
    linearization,
    predicted_at_samples,
    predicted_with_derivatives,
)


class Compressed(NamedTuple):
    """Least squares of all samples, linearised.

    Attributes:
        products: of the columns of [J e], one matrix a signal; the sum of squares at phi has (center - phi, 1) on both sides of it.
        center: phi at which the residuals were linearised.
        count: number of samples of each signal, (nv,).
    """

    products: Float[Array, "nv n1 n1"]
    center: Float[Array, " n"]
    count: Float[Array, " nv"]


def compress(
    parameterization: Parameterization,
    phi: Float[Array, " n"],
    samples: Samples,
    scale: Float[Array, " nv"] | None = None,
    chunk: int = CHUNK,
) -> Compressed:
    """Linearise the residuals of all samples about `phi`, and compress them.

    Args:
        parameterization: what is sought.
        phi: where to linearise.
        samples: states and signals.
        scale: standard deviation of each signal's errors: those far out weigh less, by Huber's function.
        chunk: samples at a time.
    """
    tree, at, delay = parameterization.tree, linearization(parameterization, phi), delay_index(parameterization)
    size = len(phi) + 1
    total = Compressed(jnp.zeros((tree.nv, size, size), phi.dtype), phi, jnp.zeros(tree.nv, phi.dtype))
    for piece in chunks(samples, chunk):
        total = _taken_up(total, *predicted_with_derivatives(tree, at, piece, delay), piece, scale)
    return total


@jax.jit
def _taken_up(total: Compressed, value: jax.Array, derivative: jax.Array, piece: Samples, scale: jax.Array | None) -> Compressed:
    error, weight = piece.effort - value, piece.weight
    if scale is not None:
        weight = weight * huber_weight(jnp.abs(error) / scale[None])
    whole = jnp.concatenate((derivative, error[..., None]), -1)
    # A weight of zero also takes out what is not a number.
    rows = jnp.where(weight[..., None] > 0, jnp.sqrt(weight)[..., None] * whole, 0.0)
    products = jnp.einsum("cri,crj->rij", rows, rows, precision="highest")
    return Compressed(total.products + products, total.center, total.count + jnp.sum(piece.weight, 0))


def residuals(
    parameterization: Parameterization, phi: Float[Array, " n"], samples: Samples, chunk: int = CHUNK
) -> Float[Array, "samples nv"]:
    """Measured less predicted signals, zero where they do not count."""
    tree, at = parameterization.tree, linearization(parameterization, phi)
    pieces = chunks(samples._replace(rates=None), chunk)
    values = [np.asarray(predicted_at_samples(tree, at, piece)) for piece in pieces]
    error = np.asarray(samples.effort) - np.concatenate(values)[: len(samples.q)]
    return jnp.asarray(np.where(np.asarray(samples.weight) > 0, error, 0.0))


@jax.jit
def sums_of_squares(compressed: Compressed, phi: Float[Array, " n"]) -> Float[Array, " nv"]:
    """The sum of squared residuals of each signal at `phi`, as far as they are linear."""
    change = jnp.append(compressed.center - phi, jnp.ones_like(phi[:1]))
    one_side = jnp.matmul(compressed.products, change, precision="highest")
    return jnp.maximum(jnp.matmul(one_side, change, precision="highest"), 0.0)


@jax.jit
def combined(compressed: Compressed, sigma: Float[Array, " nv"]) -> Float[Array, "n1 n1"]:
    """A square root R of the products of all signals, each divided by its standard deviation."""
    products = jnp.sum(compressed.products / jnp.square(sigma)[:, None, None], 0)
    lengths = jnp.sqrt(jnp.diagonal(products))
    scale = jnp.where(lengths > 0, lengths, 1.0)
    values, vectors = jnp.linalg.eigh(products / scale[:, None] / scale[None, :])
    return jnp.sqrt(jnp.maximum(values, 0.0))[:, None] * vectors.T * scale[None, :]
