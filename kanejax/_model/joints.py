"""Joint types: how a joint's coordinates place its link, and along which axes its speeds move it.

A link's frame has its origin at the joint. For a joint with one degree of freedom its z axis is the joint's axis, as in Nie's
frames, so that the components of the axis are known numbers. A class here says, in scalar form, what is particular to a
joint type; the recursions are the same for all.
"""

from typing import ClassVar, final

from kanejax._scalar import (
    IDENTITY,
    ZERO,
    column,
    matmul,
    mul,
    plus,
    rotate_about_z,
    rotation_from_quaternion,
    scale,
    sincos,
    sub,
)
from kanejax._types import Matrix, Scalar, Vector

# An axis of motion: the angular velocity and the velocity of the link's origin for unit generalized speed.
Axis = tuple[Vector, Vector]
Features = tuple[Scalar, ...]


class AbstractJoint:
    """What the recursions need to know of a joint type."""

    nq: ClassVar[int]
    nv: ClassVar[int]

    @staticmethod
    def features(q: tuple[Scalar, ...], revolute: Scalar) -> Features:
        """What placing needs of the coordinates, computed for all links at once before the recursion."""
        raise NotImplementedError

    @staticmethod
    def place(rotation: Matrix, position: Vector, features: Features) -> tuple[Matrix, Vector]:
        """Rotation from link to parent axes and position in the parent, from those at zero displacement."""
        raise NotImplementedError

    @staticmethod
    def link_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """The axes of motion in the link's components; `rotation` is from link to parent axes."""
        raise NotImplementedError

    @staticmethod
    def world_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """The axes of motion in world components; `rotation` is from link to world axes."""
        raise NotImplementedError


@final
class Revolute(AbstractJoint):
    """Rotation about the z axis of the link."""

    nq: ClassVar[int] = 1
    nv: ClassVar[int] = 1

    @staticmethod
    def features(q: tuple[Scalar, ...], revolute: Scalar) -> Features:
        """Sine and cosine of the angle."""
        return sincos(q[0])

    @staticmethod
    def place(rotation: Matrix, position: Vector, features: Features) -> tuple[Matrix, Vector]:
        """A_k of Nie (2.1), with a constant rotation in front."""
        return rotate_about_z(rotation, *features), position

    @staticmethod
    def link_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """Angular velocity along z."""
        return (((0.0, 0.0, 1.0), ZERO),)

    @staticmethod
    def world_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """Angular velocity along the link's z axis."""
        return ((column(rotation, 2), ZERO),)


@final
class Prismatic(AbstractJoint):
    """Translation along the z axis of the link."""

    nq: ClassVar[int] = 1
    nv: ClassVar[int] = 1

    @staticmethod
    def features(q: tuple[Scalar, ...], revolute: Scalar) -> Features:
        """The displacement."""
        return q

    @staticmethod
    def place(rotation: Matrix, position: Vector, features: Features) -> tuple[Matrix, Vector]:
        """Nie (3.22)-(3.23): the offset grows by q_k along the joint's axis."""
        return rotation, plus(position, scale(features[0], column(rotation, 2)))

    @staticmethod
    def link_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """Velocity along z."""
        return ((ZERO, (0.0, 0.0, 1.0)),)

    @staticmethod
    def world_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """Velocity along the link's z axis."""
        return ((ZERO, column(rotation, 2)),)


@final
class Mixed(AbstractJoint):
    """Revolute or prismatic, told apart by a mask: for chains that have both, so that one scan runs over them."""

    nq: ClassVar[int] = 1
    nv: ClassVar[int] = 1

    @staticmethod
    def features(q: tuple[Scalar, ...], revolute: Scalar) -> Features:
        """Sine and cosine of the angle, displacement, and the masks of rotation and translation."""
        angle = mul(q[0], revolute)
        return (*sincos(angle), sub(q[0], angle), revolute, 1.0 - revolute)

    @staticmethod
    def place(rotation: Matrix, position: Vector, features: Features) -> tuple[Matrix, Vector]:
        """The revolute joint's rotation and the prismatic joint's displacement, one of which is none."""
        sine, cosine, displacement = features[:3]
        return rotate_about_z(rotation, sine, cosine), plus(position, scale(displacement, column(rotation, 2)))

    @staticmethod
    def link_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """Along z."""
        return (((0.0, 0.0, features[3]), (0.0, 0.0, features[4])),)

    @staticmethod
    def world_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """Along the link's z axis."""
        z = column(rotation, 2)
        return ((scale(features[3], z), scale(features[4], z)),)


@final
class Ball(AbstractJoint):
    """Any rotation: coordinates are a quaternion (w, x, y, z), speeds the angular velocity in the link's axes."""

    nq: ClassVar[int] = 4
    nv: ClassVar[int] = 3

    @staticmethod
    def features(q: tuple[Scalar, ...], revolute: Scalar) -> Features:
        """The quaternion."""
        return q

    @staticmethod
    def place(rotation: Matrix, position: Vector, features: Features) -> tuple[Matrix, Vector]:
        """The quaternion's rotation behind the constant one."""
        turn = rotation_from_quaternion(features)  # type: ignore[arg-type]
        return matmul(rotation, turn), position

    @staticmethod
    def link_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """Angular velocity along x, y and z."""
        return tuple((axis, ZERO) for axis in IDENTITY)

    @staticmethod
    def world_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """Angular velocity along the link's axes."""
        return tuple((column(rotation, j), ZERO) for j in range(3))


@final
class Free(AbstractJoint):
    """Floating base: position and quaternion in the world; speeds are the velocity of the link's origin in world axes and the
    angular velocity in the link's axes, as in MuJoCo.
    """

    nq: ClassVar[int] = 7
    nv: ClassVar[int] = 6

    @staticmethod
    def features(q: tuple[Scalar, ...], revolute: Scalar) -> Features:
        """Position and quaternion."""
        return q

    @staticmethod
    def place(rotation: Matrix, position: Vector, features: Features) -> tuple[Matrix, Vector]:
        """Absolute: where the body stands in the file does not matter."""
        return rotation_from_quaternion(features[3:]), features[:3]  # type: ignore[return-value]

    @staticmethod
    def link_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """World axes for the velocity, the link's for the angular velocity."""
        return (*((ZERO, row) for row in rotation), *((axis, ZERO) for axis in IDENTITY))

    @staticmethod
    def world_axes(rotation: Matrix, features: Features) -> tuple[Axis, ...]:
        """World axes for the velocity, the link's for the angular velocity."""
        return (*((ZERO, axis) for axis in IDENTITY), *((column(rotation, j), ZERO) for j in range(3)))


KINDS: dict[str, type[AbstractJoint]] = {
    "revolute": Revolute,
    "prismatic": Prismatic,
    "mixed": Mixed,
    "ball": Ball,
    "free": Free,
}
