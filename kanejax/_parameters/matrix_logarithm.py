"""The logarithm of a positive definite matrix, with first and second derivatives that do not mind equal eigenvalues.

Automatic differentiation through eigenvectors fails where eigenvalues are equal, as they are for the identity. The derivatives of a
function of a symmetric matrix are given by its divided differences at the eigenvalues (Daleckii and Krein 1965; Higham 2008,
Functions of matrices, chapter 3), and these have limits.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Matrices = Float[Array, "*batch n n"]
# Eigenvalues that differ by less than this fraction of them: series replace differences.
_CLOSE = 1e-2


@jax.custom_jvp
def matrix_logarithm(matrix: Matrices) -> Matrices:
    """The symmetric logarithm of a symmetric positive definite matrix."""
    values, vectors = _spectrum(matrix)
    return jnp.einsum("...ia,...a,...ja->...ij", vectors, jnp.log(values), vectors, precision="highest")


@matrix_logarithm.defjvp
def _rate(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> tuple[jax.Array, jax.Array]:
    (matrix,), (rate,) = primals, tangents
    return matrix_logarithm(matrix), jnp.einsum("...ijkl,...kl->...ij", _derivative(matrix), rate, precision="highest")


@jax.custom_jvp
def _derivative(matrix: Matrices) -> Float[Array, "*batch n n n n"]:
    """Derivative of the logarithm: how entry ij depends on entry kl."""
    values, vectors = _spectrum(matrix)
    difference = _first_difference(values[..., :, None], values[..., None, :])
    v = vectors
    return jnp.einsum("...ia,...jb,...ab,...ka,...lb->...ijkl", v, v, difference, v, v, precision="highest")


@_derivative.defjvp
def _derivative_rate(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> tuple[jax.Array, jax.Array]:
    (matrix,), (rate,) = primals, tangents
    values, vectors = _spectrum(matrix)
    v = vectors
    turned = jnp.einsum("...ia,...ij,...jb->...ab", v, rate, v, precision="highest")
    differences = _second_difference(values[..., :, None, None], values[..., None, :, None], values[..., None, None, :])
    # In the eigenvectors' axes, entry ab changes by sum_c difference[acb] (E_ac H_cb + H_ac E_cb) for changes E and H.
    right, left = turned[..., None, :, :] * differences, turned[..., :, :, None] * differences
    of_right = jnp.einsum("...ia,...jb,...acb,...ka,...lc->...ijkl", v, v, right, v, v, precision="highest")
    of_left = jnp.einsum("...ia,...jb,...acb,...kc,...lb->...ijkl", v, v, left, v, v, precision="highest")
    return _derivative(matrix), of_right + of_left


def _spectrum(matrix: Matrices) -> tuple[jax.Array, jax.Array]:
    """Eigenvalues, those that rounding may have made negative raised, and eigenvectors."""
    values, vectors = jnp.linalg.eigh(matrix)
    return jnp.maximum(values, float(jnp.finfo(values.dtype).eps) * values[..., -1:]), vectors


def _first_difference(a: jax.Array, b: jax.Array) -> jax.Array:
    """(log a - log b) / (a - b), which is 2 artanh(x) / (x (a + b)) at x = (a - b) / (a + b)."""
    total = a + b
    x = (a - b) / total
    close = jnp.abs(x) < 0.1
    square = jnp.where(close, x * x, 0.0)
    series = jnp.zeros_like(square)
    for k in range(9, -1, -1):
        series = 1.0 / (2 * k + 1) + square * series
    apart = jnp.where(close, 1.0, a - b)
    return jnp.where(close, 2.0 * series / total, jnp.log(a / b) / apart)


def _second_difference(a: jax.Array, b: jax.Array, c: jax.Array) -> jax.Array:
    """The second divided difference of the logarithm: minus the integral of 1 / ((a + t) (b + t) (c + t)) over positive t."""
    a, b, c = jnp.broadcast_arrays(a, b, c)
    low, middle, high = jnp.moveaxis(jnp.sort(jnp.stack((a, b, c), -1), -1), -1, 0)
    close = high - low < _CLOSE * high
    apart = jnp.where(close, 1.0, high - low)
    direct = (_first_difference(high, middle) - _first_difference(middle, low)) / apart
    # About the mean m, the product is s^3 + p s + q with s = m + t, and the integral a series in p / m^2 and q / m^3.
    mean = (low + middle + high) / 3.0
    x, y, z = ((value - mean) / mean for value in (low, middle, high))
    p, q = x * y + y * z + z * x, x * y * z
    terms = 0.5 - p / 4.0 - q / 5.0 + p * p / 6.0 + 2.0 * p * q / 7.0 + (q * q - p * p * p) / 8.0
    return jnp.where(close, -terms / (mean * mean), direct)
