"""Pseudo-inertias, and coordinates in which each point is a body that can exist.

The pseudo-inertia of a body is P = [[S, h], [h^T, m]] with its second moment S = sum(m r r^T) and first moment h = m c about the
origin of its frame: a mass distribution has it if and only if P is positive definite, and linear in the ten inertia parameters
(Wensing, Kim and Slotine 2018, Linear matrix inequalities for physically-consistent inertial parameter identification).

Log-Cholesky coordinates about a nominal body with P0 = L0 L0^T: P = L0 U U^T L0^T, where L0 and U are upper triangular; the first
four coordinates are the logarithms of U's diagonal, the other six its entries above (Rucker and Wensing 2022, Smooth
parameterization of rigid-body inertia). They have no unit, and zero is the nominal body. Matrices may be of any size n.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from kanejax._model.inertia import InertiaParameters, second_moment, six
from kanejax._parameters.matrix_logarithm import matrix_logarithm

Matrices = Float[Array, "*bodies n n"]
PseudoInertia = Float[Array, "*bodies 4 4"]
LogCholesky = Float[Array, "*bodies coordinates"]

# Eigenvalues are raised to this fraction of the nominal body's where log-Cholesky coordinates are sought for any matrix.
LEAST_EIGENVALUE = 1e-6
_TERMS = 16


def pseudo_inertia(parameters: InertiaParameters) -> PseudoInertia:
    """The pseudo-inertia with these inertia parameters."""
    first = parameters[..., 1:4]
    upper = jnp.concatenate((second_moment(parameters), first[..., None]), -1)
    lower = jnp.concatenate((first, parameters[..., :1]), -1)
    return jnp.concatenate((upper, lower[..., None, :]), -2)


def inertia_parameters_of(pseudo_inertia: PseudoInertia) -> InertiaParameters:
    """The inertia parameters with this pseudo-inertia: `inertia_parameters` has their order."""
    return jnp.concatenate((pseudo_inertia[..., 3, 3:], pseudo_inertia[..., :3, 3], inertia_of(pseudo_inertia[..., :3, :3])), -1)


def inertia_of(second: Float[Array, "*bodies 3 3"]) -> Float[Array, "*bodies 6"]:
    """Entries xx, yy, zz, xy, xz, yz of the inertia tr(S) 1 - S."""
    moments = six(second)
    xx, yy, zz = (moments[..., i : i + 1] for i in range(3))
    return jnp.concatenate((yy + zz, xx + zz, xx + yy, -moments[..., 3:]), -1)


def consistency(parameters: InertiaParameters) -> Float[Array, "*bodies"]:
    """Smallest eigenvalue of the pseudo-inertia over its trace, in SI units; positive for bodies that can exist."""
    matrix = pseudo_inertia(parameters)
    trace = jnp.abs(jnp.trace(matrix, axis1=-2, axis2=-1))
    return jnp.linalg.eigvalsh(matrix)[..., 0] / jnp.where(trace == 0, 1.0, trace)


def matrix_from_coordinates(theta: LogCholesky, factor: Matrices) -> Matrices:
    """The positive definite matrix at log-Cholesky coordinates about a nominal one with upper triangular factor L0."""
    return _gram(jnp.matmul(factor, upper_triangle(theta, factor.shape[-1]), precision="highest"))


def nearest_coordinates(matrix: Matrices, factor: Matrices) -> LogCholesky:
    """Log-Cholesky coordinates of a symmetric matrix; of the nearest that has some, if it is not positive definite.

    Eigenvalues relative to the nominal matrix, which depend on no unit and no choice of frame, are raised to `LEAST_EIGENVALUE`.
    """
    half = lax.linalg.triangular_solve(factor, matrix, left_side=True, lower=False)
    relative = lax.linalg.triangular_solve(factor, half, left_side=False, lower=False, transpose_a=True)
    relative = _clipped(0.5 * (relative + jnp.swapaxes(relative, -1, -2)))
    # The upper factor is the lower one of the matrix read backwards.
    backwards = jnp.linalg.cholesky(relative[..., ::-1, ::-1], symmetrize_input=False)
    upper = backwards[..., ::-1, ::-1]
    rows, columns = np.triu_indices(factor.shape[-1], 1)
    return jnp.concatenate((jnp.log(jnp.diagonal(upper, axis1=-2, axis2=-1)), upper[..., rows, columns]), -1)


def upper_triangle(theta: LogCholesky, n: int) -> Matrices:
    """The upper triangular matrix U of log-Cholesky coordinates."""
    entries = jnp.concatenate((jnp.exp(theta[..., :n]), theta[..., n:], jnp.zeros_like(theta[..., :1])), -1)
    return entries[..., _places(n)]


def entropic_residuals(theta: Float[Array, "*bodies 10"]) -> Float[Array, "*bodies 10"]:
    """Numbers whose squares sum to the entropic divergence of a body from the nominal one, tr(A) - log det A - 4 with A = U U^T.

    Lee, Wensing and Park 2020, Geometric robot dynamic identification. A logarithm d on the diagonal takes e^(2 d) - 2 d - 1, which
    is a square of a smooth function: d sqrt(2 phi(2 d)) with phi(x) = 2 (e^x - 1 - x) / x^2.
    """
    x = 2.0 * theta[..., :4]
    small = jnp.abs(x) < 1.0
    series = functools.reduce(lambda sum_, k: 1.0 + sum_ * jnp.where(small, x, 0.0) / k, range(_TERMS, 2, -1), jnp.ones_like(x))
    away = jnp.where(small, 1.0, x)
    phi = jnp.where(small, series, 2.0 * (jnp.expm1(away) - away) / (away * away))
    return jnp.concatenate((theta[..., :4] * jnp.sqrt(2.0 * phi), theta[..., 4:]), -1)


def geodesic_residuals(theta: Float[Array, "*bodies 10"]) -> Float[Array, "*bodies 10"]:
    """Numbers whose squares sum to that of the affine-invariant distance to the nominal body: half the sum of log^2 eig(P0^-1 P).

    Lee and Park 2018, A geometric algorithm for robust multibody inertial parameter identification. Entries of log(U U^T), those
    off the diagonal for both of the two places that they have.
    """
    logarithm = matrix_logarithm(_gram(upper_triangle(theta, 4)))
    rows, columns = np.triu_indices(4, 1)
    diagonal = jnp.diagonal(logarithm, axis1=-2, axis2=-1)
    return jnp.concatenate((diagonal * np.sqrt(0.5).item(), logarithm[..., rows, columns]), -1)


def _gram(factor: Matrices) -> Matrices:
    return jnp.matmul(factor, jnp.swapaxes(factor, -1, -2), precision="highest")


def _places(n: int) -> np.ndarray:
    """Where each entry of U is among the coordinates; the zeros below come after them."""
    count = n * (n + 1) // 2
    places = np.full((n, n), count)
    np.fill_diagonal(places, range(n))
    places[np.triu_indices(n, 1)] = range(n, count)
    return places


@jax.custom_jvp
def _clipped(matrix: Matrices) -> Matrices:
    """The symmetric matrix with its eigenvalues raised to the least, or to what rounding lets us tell from zero."""
    values, vectors = jnp.linalg.eigh(matrix)
    raised = jnp.maximum(values, _least(values)[..., None])
    changed = jnp.einsum("...ia,...a,...ja->...ij", vectors, raised - values, vectors, precision="highest")
    return matrix + changed


@_clipped.defjvp
def _clipped_rate(primals: tuple[jax.Array], tangents: tuple[jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Daleckii and Krein's derivative of a function of a matrix, which does not mind equal eigenvalues."""
    (matrix,), (rate,) = primals, tangents
    values, vectors = jnp.linalg.eigh(matrix)
    least = _least(values)[..., None]
    raised = jnp.maximum(values, least)
    run = values[..., :, None] - values[..., None, :]
    rise = raised[..., :, None] - raised[..., None, :]
    kept = (values > least).astype(values.dtype)
    slope = jnp.where(run == 0, kept[..., None], rise / jnp.where(run == 0, 1.0, run))
    turned = jnp.einsum("...ia,...ij,...jb->...ab", vectors, rate, vectors, precision="highest")
    return _clipped(matrix), jnp.einsum("...ia,...ab,...jb->...ij", vectors, slope * turned, vectors, precision="highest")


def _least(values: jax.Array) -> jax.Array:
    return jnp.maximum(LEAST_EIGENVALUE, 8.0 * float(jnp.finfo(values.dtype).eps) * values[..., -1])
