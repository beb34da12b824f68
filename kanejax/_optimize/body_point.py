"""Points that are fixed in bodies."""

from collections.abc import Sequence
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from kanejax._kinematics.pose import poses

# Three numbers.
Vector = Sequence[float] | Float[ArrayLike, "3"]


@final
class BodyPoint(eqx.Module):
    """A point of a body.

    Attributes:
        point: in the body's frame [m].
        body: its name.
    """

    point: Float[Array, "3"]
    body: str = eqx.field(static=True)

    def place(self, model: Any, q: Float[Array, " nq"]) -> Float[Array, "3"]:
        """Where it is, in world axes."""
        found, row = poses(model, q), model.tree.body(self.body)
        return found.origin[row] + jnp.sum(found.rotation[row] * self.point.astype(q.dtype)[None], -1)
