"""The model: every number that the dynamics depend on, as one pytree."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from kanejax._model import view
from kanejax._model.tree import OnTree, Tree


class Model(eqx.Module, OnTree):
    """A mechanism: a static tree, and its parameters as arrays that can be changed, batched and differentiated.

    Nothing derived is stored, so changing a leaf leaves nothing stale, and it does not compile anything again.
    Quantities are in SI units and radians; bodies and joints are in MuJoCo's order, the world is not a body.

    Attributes:
        tree: names, parents and joint types; static.
        gravity: acceleration of free fall in world axes.
        body_position: of the body's frame in its parent's frame, at zero displacement of the joints.
        body_quaternion: (w, x, y, z) of the body's frame in its parent's; normalised where it is used.
        joint_axis: direction in the body's frame, of any length; unused by ball and free joints.
        joint_anchor: a point of the joint in the body's frame; unused by free joints.
        mass: of each body.
        com: mass centre in the body's frame.
        central_inertia: about the mass centre in the body's axes; only the symmetric part counts.
        armature: inertia of the rotor, reflected to the speed; added to the diagonal of the mass matrix.
        damping: force or torque a unit of speed.
        stiffness: of the joint's spring; for ball joints against the rotation vector, for free joints both parts.
        spring_reference: coordinates at which the springs are relaxed.
        coordinate_reference: coordinates of revolute and prismatic joints in the pose that body_position describes.
        coulomb_friction: greatest friction force or torque of each speed, opposing it as u / sqrt(u^2 + friction_width^2).
        friction_width: speed over which the friction builds up.
        joint_range: least and greatest coordinate of revolute and prismatic joints, infinite where there is none.
    """

    tree: Tree = eqx.field(static=True)
    gravity: Float[Array, "3"]
    body_position: Float[Array, "nbody 3"]
    body_quaternion: Float[Array, "nbody 4"]
    joint_axis: Float[Array, "njoint 3"]
    joint_anchor: Float[Array, "njoint 3"]
    mass: Float[Array, " nbody"]
    com: Float[Array, "nbody 3"]
    central_inertia: Float[Array, "nbody 3 3"]
    armature: Float[Array, " nv"]
    damping: Float[Array, " nv"]
    stiffness: Float[Array, " njoint"]
    spring_reference: Float[Array, " nq"]
    coordinate_reference: Float[Array, " nq"]
    coulomb_friction: Float[Array, " nv"]
    friction_width: Float[Array, " nv"]
    joint_range: Float[Array, "njoint 2"]

    def __check_init__(self) -> None:
        """Compare each leaf's shape with what the tree asks for."""
        for name, shape in leaf_shapes(self.tree).items():
            leaf = getattr(self, name)
            if jnp.shape(leaf) != shape:
                raise ValueError(f"model.{name} has shape {jnp.shape(leaf)}, but this tree needs {shape}")
            if leaf.dtype not in (jnp.float32, jnp.float64):
                raise ValueError(f"model.{name} has dtype {leaf.dtype}; use float32 or float64")

    @property
    def dtype(self) -> jnp.dtype:
        """Data type of the leaves."""
        return self.mass.dtype

    def astype(self, dtype: jax.typing.DTypeLike) -> "Model":
        """The same model with leaves of another data type, float32 or float64."""
        if jnp.dtype(dtype) not in (jnp.float32, jnp.float64):
            raise ValueError(f"a model cannot have leaves of type {jnp.dtype(dtype)}; use float32 or float64")
        return jax.tree.map(lambda leaf: leaf.astype(dtype), self)

    def body(self, name: str) -> "view.BodyView":
        """View of the body called `name`, to read its numbers or to `set` them in a new model.

        Raises:
            UnknownNameError: there is no such body; the message lists those there are.
        """
        return view.BodyView(self, self.tree.body(name))

    def joint(self, name: str) -> "view.JointView":
        """View of the joint called `name`, to read its numbers or to `set` them in a new model.

        Raises:
            UnknownNameError: there is no such joint; the message lists those there are.
        """
        return view.JointView(self, self.tree.joint(name))

    def replace(self, **leaves: Any) -> "Model":
        """The same model with other leaves, given by name and converted to its data type.

        Raises:
            UnknownNameError: a model has no such leaf; the message lists those it has.
            ValueError: a shape does not fit the tree.
        """
        return view.replaced(self, **leaves)


def leaf_shapes(tree: Tree) -> dict[str, tuple[int, ...]]:
    """The shape of every leaf of a model on `tree`, in the order of the fields."""
    nbody, njoint, nq, nv = tree.nbody, tree.njoint, tree.nq, tree.nv
    return {
        "gravity": (3,),
        "body_position": (nbody, 3),
        "body_quaternion": (nbody, 4),
        "joint_axis": (njoint, 3),
        "joint_anchor": (njoint, 3),
        "mass": (nbody,),
        "com": (nbody, 3),
        "central_inertia": (nbody, 3, 3),
        "armature": (nv,),
        "damping": (nv,),
        "stiffness": (njoint,),
        "spring_reference": (nq,),
        "coordinate_reference": (nq,),
        "coulomb_friction": (nv,),
        "friction_width": (nv,),
        "joint_range": (njoint, 2),
    }
