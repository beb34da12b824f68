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
from jax import lax
from jaxtyping import Array, Float

from kanejax._identify.linearization import Samples, linearization, predicted, predicted_with_derivative
from kanejax._identify.parameterization import Parameterization

CHUNK = 512
# Errors of more standard deviations than this count less: as efficient as least squares to 95 % where errors are normal.
HUBER = 1.345


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
        scale: standard deviation of each signal's errors: those of more than `HUBER` times that weigh less, by Huber's function.
        chunk: samples at a time.
    """
    return _compress(parameterization, phi, _pieces(samples, chunk), scale)


@jax.jit
def _compress(parameterization: Parameterization, phi: jax.Array, pieces: Samples, scale: jax.Array | None) -> Compressed:
    tree = parameterization.tree
    delay = parameterization.names.index("delay") if "delay" in parameterization.names else None
    at = linearization(parameterization, phi)
    size = len(phi) + 1

    def rows(sample: Samples) -> tuple[jax.Array, jax.Array]:
        value, derivative = predicted_with_derivative(tree, at, sample, delay)
        error = sample.effort - value
        weight = sample.weight
        if scale is not None:
            limit = HUBER * scale
            weight = weight * jnp.minimum(1.0, limit / jnp.maximum(jnp.abs(error), jnp.finfo(error.dtype).tiny))
        whole = jnp.concatenate((derivative, error[:, None]), 1)
        # A weight of zero also takes out what is not a number.
        return jnp.where(weight[:, None] > 0, jnp.sqrt(weight)[:, None] * whole, 0.0), sample.weight

    def take_up(total: Compressed, piece: Samples) -> tuple[Compressed, None]:
        more, weight = jax.vmap(rows)(piece)
        products = jnp.einsum("cri,crj->rij", more, more, precision="highest")
        return Compressed(total.products + products, phi, total.count + jnp.sum(weight, 0)), None

    none = Compressed(jnp.zeros((tree.nv, size, size), phi.dtype), phi, jnp.zeros(tree.nv, phi.dtype))
    return lax.scan(take_up, none, pieces)[0]


def residuals(
    parameterization: Parameterization, phi: Float[Array, " n"], samples: Samples, chunk: int = CHUNK
) -> Float[Array, "samples nv"]:
    """Measured less predicted signals, zero where they do not count."""
    found = _residuals(parameterization, phi, _pieces(samples._replace(rates=None), chunk))
    return found.reshape(-1, found.shape[-1])[: len(samples.q)]


@jax.jit
def _residuals(parameterization: Parameterization, phi: jax.Array, pieces: Samples) -> Float[Array, "pieces chunk nv"]:
    at = linearization(parameterization, phi)

    def errors(sample: Samples) -> jax.Array:
        error = sample.effort - predicted(parameterization.tree, at, sample.q, sample.u, sample.u_dot)
        return jnp.where(sample.weight > 0, error, 0.0)

    return lax.map(jax.vmap(errors), pieces)


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


def _pieces(samples: Samples, chunk: int) -> Samples:
    """Samples as (pieces, chunk, ...), filled up with copies of the last that do not count.

    The number of pieces is rounded up to three binary digits, so that logs of many lengths share a compiled program.
    """
    count = -(-len(samples.q) // chunk)
    step = 2 ** max(0, (count - 1).bit_length() - 3)
    spare = -(-count // step) * step * chunk - len(samples.q)

    def cut(x: jax.Array, filling: jax.Array) -> jax.Array:
        full = jnp.concatenate((x, jnp.broadcast_to(filling, (spare, *x.shape[1:])))) if spare else x
        return full.reshape(-1, chunk, *x.shape[1:])

    cuts = jax.tree.map(lambda x: cut(x, x[-1:]), samples)
    return cuts._replace(weight=cut(samples.weight, jnp.zeros_like(samples.weight[-1:])))
