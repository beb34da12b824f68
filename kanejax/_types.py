"""Shapes and scalars, as jaxtyping aliases.

Dimension names used throughout: `nq` generalized coordinates, `nv` generalized speeds, `nbody` bodies (the world is
not counted), `njoint` joints, `nlink` links (one a joint), `*batch` trailing batch axes of the internal functions.
"""

from typing import Any

from jaxtyping import Array, Float

Coordinates = Float[Array, " nq"]
Speeds = Float[Array, " nv"]
Forces = Float[Array, " nv"]

# One component of a vector or matrix: a Python number that is known while tracing, or an array over the batch.
Scalar = Any
Vector = tuple[Scalar, Scalar, Scalar]
Matrix = tuple[Vector, Vector, Vector]
Symmetric = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]
Quaternion = tuple[Scalar, Scalar, Scalar, Scalar]
