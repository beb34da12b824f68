"""What joints do to the links they move, in scalar form.

A link's frame has its z axis along the joint's axis, so the components of the axis are known numbers. All joints but free ones
are taken one generalized speed at a time: a ball joint is three massless steps at one point, about the x, y and z axes of the link
it moves. Each step turns its frame so that its own axis becomes z; the first one also makes the whole turn of the joint.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import lax

from kanejax._scalar import (
    IDENTITY,
    ZERO,
    column,
    is_known,
    matmul,
    plus,
    rotate_about_z,
    rotation_from_quaternion,
    scale,
    sub,
)
from kanejax._types import Matrix, Quaternion, Scalar, Vector

# An axis of motion: the angular velocity and the velocity of the link's origin for unit generalized speed.
Axis = tuple[Vector, Vector]
# From components along (y, z, x) to components along (x, y, z).
CYCLE: Matrix = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


class StepFeatures(NamedTuple):
    """What placing needs of the coordinates: sine and cosine of a hinge's angle, a slide's displacement, a ball joint's turn."""

    sine: Scalar
    cosine: Scalar
    displacement: Scalar
    quaternion: Quaternion


class Step(NamedTuple):
    """Motion along or about the z axis of the link, with one generalized speed.

    Attributes:
        slides: 1 for a translation, 0 for a rotation.
        hinge: 1 if the link turns by an angle, 0 if not.
        ball: whether the link turns by a quaternion: the first step of a ball joint.
    """

    slides: Scalar
    hinge: Scalar
    ball: Scalar

    def place(self, rotation: Matrix, position: Vector, features: Any) -> tuple[Matrix, Vector]:
        """A_k of Nie (2.1) with a constant rotation in front; a slide's offset grows along its axis, Nie (3.22)-(3.23)."""
        position = plus(position, scale(features.displacement, column(rotation, 2)))
        if not is_known(self.ball):
            return self._place_either(rotation, features), position
        return (_turn_freely(rotation, features) if self.ball else self._turn_about_z(rotation, features)), position

    def link_axes(self, rotation: Matrix) -> tuple[Axis, ...]:
        """Along z."""
        return (((0.0, 0.0, sub(1.0, self.slides)), (0.0, 0.0, self.slides)),)

    def world_axes(self, rotation: Matrix) -> tuple[Axis, ...]:
        """Along the link's z axis."""
        z = column(rotation, 2)
        return ((scale(sub(1.0, self.slides), z), scale(self.slides, z)),)

    def _turn_about_z(self, rotation: Matrix, features: StepFeatures) -> Matrix:
        if is_known(self.hinge) and not self.hinge:
            return rotation
        return rotate_about_z(rotation, features.sine, features.cosine)

    def _place_either(self, rotation: Matrix, features: StepFeatures) -> Matrix:
        # A conditional, not a selection: most links are no ball joints, and then nothing is computed for one.
        shape, dtype = jnp.shape(features.quaternion[0]), jnp.result_type(features.quaternion[0])

        def fill(m: Matrix) -> Matrix:
            return tuple(tuple(jnp.broadcast_to(jnp.asarray(x, dtype), shape) for x in row) for row in m)  # type: ignore[return-value]

        return lax.cond(
            jnp.asarray(self.ball, bool),
            lambda: fill(_turn_freely(rotation, features)),
            lambda: fill(self._turn_about_z(rotation, features)),
        )


def _turn_freely(rotation: Matrix, features: StepFeatures) -> Matrix:
    """The quaternion's rotation behind the constant one, and then the axes of the first of the three steps."""
    return matmul(matmul(rotation, rotation_from_quaternion(features.quaternion)), CYCLE)


class Free(NamedTuple):
    """Floating base: position and quaternion in the world; speeds are the velocity of the link's origin in world axes and the
    angular velocity in the link's axes, as in MuJoCo.
    """

    def place(self, rotation: Matrix, position: Vector, features: Any) -> tuple[Matrix, Vector]:
        """Absolute: where the body stands in the file does not matter."""
        return rotation_from_quaternion(features[3:]), features[:3]  # type: ignore[return-value]

    def link_axes(self, rotation: Matrix) -> tuple[Axis, ...]:
        """World axes for the velocity, the link's for the angular velocity."""
        return (*((ZERO, row) for row in rotation), *((axis, ZERO) for axis in IDENTITY))

    def world_axes(self, rotation: Matrix) -> tuple[Axis, ...]:
        """World axes for the velocity, the link's for the angular velocity."""
        return (*((ZERO, axis) for axis in IDENTITY), *((column(rotation, j), ZERO) for j in range(3)))


Joint = Step | Free
