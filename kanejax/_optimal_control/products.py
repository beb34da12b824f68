"""Products of small matrices."""

import functools

import jax.numpy as jnp
from jaxtyping import Array, Float

# Up to so many terms, a product is faster as one elementwise program than as a call of a library, which costs more to begin.
_FEW = 24


def product(a: Float[Array, "n m"], b: Float[Array, "m *p"]) -> Float[Array, "n *p"]:
    """Matrix times matrix or vector."""
    if len(b) > _FEW or len(b) == 0:
        return jnp.matmul(a, b, precision="highest")
    columns = a.T.reshape(*a.T.shape, *[1] * (b.ndim - 1))
    return functools.reduce(jnp.add, [columns[i] * b[i][None] for i in range(len(b))])
