"""The scalar form: vectors and matrices as tuples of scalars.

Nie's thesis writes every equation in scalar form "to save computation time". It still does: under a batch, each scalar
is one contiguous array, every operation is elementwise, and XLA vectorises it. A Python number is a known value: products with
0 and 1 and sums with 0 are not traced.

Vectors are 3-tuples, matrices 3-tuples of rows, symmetric matrices 6-tuples (xx, yy, zz, xy, xz, yz).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.core import Tracer

from kanejax._types import Matrix, Scalar, Symmetric, Vector

ZERO: Vector = (0.0, 0.0, 0.0)
IDENTITY: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
SYMMETRIC_ZERO: Symmetric = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def is_known(x: Scalar) -> bool:
    """Whether `x` is a number that is known while tracing."""
    return isinstance(x, int | float)


def mul(x: Scalar, y: Scalar) -> Scalar:
    """Product, with known zeros and ones folded."""
    if is_known(x) and is_known(y):
        return x * y
    if is_known(y):
        x, y = y, x
    if is_known(x):
        if x == 0:
            return 0.0
        if x == 1:
            return y
        if x == -1:
            return -y
    return x * y


def add(x: Scalar, y: Scalar) -> Scalar:
    """Sum, with known zeros folded."""
    if is_known(x) and x == 0:
        return y
    if is_known(y) and y == 0:
        return x
    return x + y


def sub(x: Scalar, y: Scalar) -> Scalar:
    """Difference, with known zeros folded."""
    if is_known(y) and y == 0:
        return x
    if is_known(x) and x == 0:
        return -y
    return x - y


def dot(a: Vector, b: Vector) -> Scalar:
    """A . b."""
    return add(add(mul(a[0], b[0]), mul(a[1], b[1])), mul(a[2], b[2]))


def cross(a: Vector, b: Vector) -> Vector:
    """A x b."""
    return (
        sub(mul(a[1], b[2]), mul(a[2], b[1])),
        sub(mul(a[2], b[0]), mul(a[0], b[2])),
        sub(mul(a[0], b[1]), mul(a[1], b[0])),
    )


def plus(*vectors: tuple[Scalar, ...]) -> tuple:
    """Sum of vectors, component by component."""
    total = vectors[0]
    for vector in vectors[1:]:
        total = tuple(add(x, y) for x, y in zip(total, vector, strict=True))
    return total


def minus(a: tuple[Scalar, ...], b: tuple[Scalar, ...]) -> tuple:
    """Difference of vectors, component by component."""
    return tuple(sub(x, y) for x, y in zip(a, b, strict=True))


def scale(s: Scalar, a: tuple[Scalar, ...]) -> tuple:
    """S times a."""
    return tuple(mul(s, x) for x in a)


def transpose(m: Matrix) -> Matrix:
    """Transposed matrix."""
    return ((m[0][0], m[1][0], m[2][0]), (m[0][1], m[1][1], m[2][1]), (m[0][2], m[1][2], m[2][2]))


def column(m: Matrix, j: int) -> Vector:
    """The j-th column."""
    return (m[0][j], m[1][j], m[2][j])


def apply(m: Matrix, a: Vector) -> Vector:
    """M a."""
    return (dot(m[0], a), dot(m[1], a), dot(m[2], a))


def apply_transposed(m: Matrix, a: Vector) -> Vector:
    """M^T a."""
    return (dot(column(m, 0), a), dot(column(m, 1), a), dot(column(m, 2), a))


def matmul(a: Matrix, b: Matrix) -> Matrix:
    """A b."""
    return (apply_transposed(b, a[0]), apply_transposed(b, a[1]), apply_transposed(b, a[2]))


def full(s: Symmetric) -> Matrix:
    """The nine components of a symmetric matrix."""
    xx, yy, zz, xy, xz, yz = s
    return ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))


def apply_symmetric(s: Symmetric, a: Vector) -> Vector:
    """S a for a symmetric matrix."""
    return apply(full(s), a)


def rotate_symmetric(r: Matrix, s: Symmetric) -> Symmetric:
    """R s r^T for a symmetric matrix; the first product is materialised, or XLA would evaluate it six times."""
    t = barrier(matmul(r, full(s)))
    return (dot(t[0], r[0]), dot(t[1], r[1]), dot(t[2], r[2]), dot(t[0], r[1]), dot(t[0], r[2]), dot(t[1], r[2]))


def inertia_of(second: Symmetric) -> Symmetric:
    """Inertia tr(J) 1 - J for the second moment J."""
    xx, yy, zz, xy, xz, yz = second
    return (add(yy, zz), add(xx, zz), add(xx, yy), sub(0.0, xy), sub(0.0, xz), sub(0.0, yz))


def outer_symmetric(a: Vector) -> Symmetric:
    """The symmetric matrix a a^T."""
    return (mul(a[0], a[0]), mul(a[1], a[1]), mul(a[2], a[2]), mul(a[0], a[1]), mul(a[0], a[2]), mul(a[1], a[2]))


def rotate_about_z(m: Matrix, sine: Scalar, cosine: Scalar) -> Matrix:
    """M times the rotation about z with the given sine and cosine."""
    return tuple((add(mul(r[0], cosine), mul(r[1], sine)), sub(mul(r[1], cosine), mul(r[0], sine)), r[2]) for r in m)  # type: ignore[return-value]


def rotation_from_quaternion(quaternion: tuple[Scalar, Scalar, Scalar, Scalar]) -> Matrix:
    """Rotation matrix of the quaternion (w, x, y, z), which need not be of unit length.

    Dividing by the square of the length instead of normalising needs no root and keeps every derivative finite.
    """
    w, x, y, z = quaternion
    s = 2.0 / (w * w + x * x + y * y + z * z)
    xs, ys, zs = s * x, s * y, s * z
    wx, wy, wz, xx, xy, xz, yy, yz, zz = w * xs, w * ys, w * zs, x * xs, x * ys, x * zs, y * ys, y * zs, z * zs
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


def barrier[T](tree: T) -> T:
    """Materialise the traced scalars of `tree`, so that XLA evaluates each once instead of once for every consumer.

    Without barriers XLA:CPU copies producers into their consumers and the cost grows exponentially with the depth of
    the recursion. Known numbers pass through.
    """
    # One barrier for each scalar: jax 0.12 cannot transpose a common one of which a derivative reaches only a part.
    return jax.tree.map(lambda leaf: lax.optimization_barrier(leaf) if isinstance(leaf, Tracer) else leaf, tree)


@jax.custom_jvp
def sincos(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Sine and cosine of x [rad] from one range reduction.

    On the CPU XLA's own pair costs more than the rest of the inverse dynamics. Here: Cody-Waite reduction by pi/2 and the
    classical minimax kernels (fdlibm's in float64, Cephes' in float32), to about one unit in the last place for arguments up to
    1e4 (float32) and 1e6 (float64); the library's functions beyond, and on other platforms.
    """
    return lax.platform_dependent(x, cpu=_sincos_guarded, default=lambda x: (jnp.sin(x), jnp.cos(x)))


@sincos.defjvp
def _sincos_jvp(primals, tangents):  # noqa: ANN001, ANN202
    s, c = sincos(primals[0])
    return (s, c), (c * tangents[0], -s * tangents[0])


def _sincos_guarded(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    limit = 1e6 if x.dtype == jnp.float64 else 1e4
    # NaN and infinity compare false and go to the library's functions.
    within = jnp.abs(x) < limit

    def either(x: jax.Array) -> tuple[jax.Array, jax.Array]:
        # Each of a batch what it would get alone: one that fails leaves the others their bits.
        near = _sincos_kernel(jnp.where(within, x, 0.0))
        return jnp.where(within, near[0], jnp.sin(x)), jnp.where(within, near[1], jnp.cos(x))

    return lax.cond(jnp.all(within), _sincos_kernel, either, x)


def _sincos_kernel(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    double = x.dtype == jnp.float64
    halfpi = (
        (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
        if double
        else (1.5703125, 4.837512969970703125e-4, 7.549789948768648e-8)
    )
    sine_terms = (
        (-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04, 2.75573137070700676789e-06,
         -2.50507602534068634195e-08, 1.58969099521155010221e-10)
        if double
        else (-1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4)
    )  # fmt: skip
    cosine_terms = (
        (4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05, -2.75573143513906633035e-07,
         2.08757232129817482790e-09, -1.13596475577881948265e-11)
        if double
        else (4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5)
    )  # fmt: skip
    quarter = jnp.round(x * np.asarray(2 / np.pi, x.dtype))
    r = x
    for part in halfpi:
        r = r - quarter * np.asarray(part, x.dtype)
    z = r * r
    sine = r + r * z * _polynomial(z, sine_terms)
    cosine = 1.0 - 0.5 * z + z * z * _polynomial(z, cosine_terms)
    k = quarter.astype(jnp.int32)
    odd = (k & 1) == 1
    s, c = jnp.where(odd, cosine, sine), jnp.where(odd, sine, cosine)
    return jnp.where((k & 2) == 2, -s, s), jnp.where(((k + 1) & 2) == 2, -c, c)


def _polynomial(z: jax.Array, coefficients: tuple[float, ...]) -> jax.Array:
    value = jnp.full_like(z, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = value * z + coefficient
    return value
