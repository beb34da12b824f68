"""Small changes of quaternions and axes, as vectors that have no superfluous component."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def turned_quaternions(quaternions: Float[Array, "n 4"], rotations: Float[Array, "n 3"]) -> Float[Array, "n 4"]:
    """Quaternions (w, x, y, z) turned in their own axes by rotation vectors of length 2 tan(angle / 2); the lengths stay."""
    half = 0.5 * rotations
    turn = jnp.concatenate((jnp.ones_like(half[:, :1]), half), -1) * jax.lax.rsqrt(1.0 + jnp.sum(half * half, -1, keepdims=True))
    w, x, y, z = (quaternions[:, i : i + 1] for i in range(4))
    # Columns of the matrix that multiplies by the quaternion from the left.
    columns = ((w, x, y, z), (-x, w, z, -y), (-y, -z, w, x), (-z, y, -x, w))
    return sum(turn[:, i : i + 1] * jnp.concatenate(column, -1) for i, column in enumerate(columns))  # type: ignore[return-value]


def tilted_axes(axes: Float[Array, "n 3"], tangents: Float[Array, "n 2"]) -> Float[Array, "n 3"]:
    """Axes tilted by tangents of angles along two directions across them; the lengths stay.

    The directions are those that Duff et al. (2017, Building an orthonormal basis, revisited) give: x and y for the z axis.
    """
    length = jnp.sqrt(jnp.sum(axes * axes, -1, keepdims=True))
    axis = axes / length
    x, y, z = (axis[:, i : i + 1] for i in range(3))
    sign = jnp.where(z < 0, -1.0, 1.0).astype(z.dtype)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = jnp.concatenate((1.0 + sign * x * x * a, sign * b, -sign * x), -1)
    second = jnp.concatenate((b, sign + y * y * a, -y), -1)
    tilted = axis + tangents[:, :1] * first + tangents[:, 1:] * second
    return length * tilted * jax.lax.rsqrt(1.0 + jnp.sum(tangents * tangents, -1, keepdims=True))
