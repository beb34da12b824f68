"""Views of one body or joint of a model, by name: its numbers, and a new model with some of them changed."""

import dataclasses
from typing import Any, final

import jax
import jax.numpy as jnp

from kanejax._errors import UnknownNameError
from kanejax._model import model as _model
from kanejax._model.tree import COORDINATES, SPEEDS, WORLD, JointType

_OF_BODY = {
    "position": "body_position",
    "quaternion": "body_quaternion",
    "mass": "mass",
    "com": "com",
    "central_inertia": "central_inertia",
}
_OF_JOINT = {"axis": "joint_axis", "anchor": "joint_anchor", "stiffness": "stiffness", "range": "joint_range"}
_OF_SPEEDS = ("armature", "damping", "coulomb_friction", "friction_width")
_OF_COORDINATES = ("spring_reference", "coordinate_reference")


@final
@dataclasses.dataclass(frozen=True, repr=False)
class BodyView:
    """One body of a model.

    Attributes:
        model: the model it is in.
        index: its row in the model's leaves.
    """

    model: "_model.Model"
    index: int

    @property
    def name(self) -> str:
        """Name of the body."""
        return self.model.tree.body_names[self.index]

    @property
    def mass(self) -> jax.Array:
        """Mass [kg], ()."""
        return _part(self.model, "mass", self.index)

    @property
    def com(self) -> jax.Array:
        """Mass centre [m] in the body's frame, (3,)."""
        return _part(self.model, "com", self.index)

    @property
    def central_inertia(self) -> jax.Array:
        """Inertia [kg m^2] about the mass centre in the body's axes, (3, 3)."""
        return _part(self.model, "central_inertia", self.index)

    @property
    def position(self) -> jax.Array:
        """Position [m] of the body's frame in its parent's at zero displacement of the joints, (3,)."""
        return _part(self.model, "body_position", self.index)

    @property
    def quaternion(self) -> jax.Array:
        """Orientation (w, x, y, z) of the body's frame in its parent's at zero displacement of the joints, (4,)."""
        return _part(self.model, "body_quaternion", self.index)

    @property
    def parent(self) -> "BodyView | None":
        """The body it hangs on, None for the world."""
        parent = self.model.tree.body_parents[self.index]
        return None if parent == WORLD else BodyView(self.model, parent)

    @property
    def joints(self) -> "tuple[JointView, ...]":
        """The joints that move it against its parent, in the order in which they act."""
        bodies = self.model.tree.joint_bodies
        return tuple(JointView(self.model, joint) for joint, body in enumerate(bodies) if body == self.index)

    def set(self, **values: Any) -> "_model.Model":
        """Return a model in which this body has other numbers; works on values that JAX traces.

        Args:
            **values: any of mass, com, central_inertia, position and quaternion. They are not checked but for their shapes:
                see `check_model`.

        Returns:
            A new model; the view still shows the old one.

        Raises:
            UnknownNameError: a body has no such number.
            ValueError: a shape is wrong.
        """
        changed = {}
        for name, value in values.items():
            if name not in _OF_BODY:
                raise UnknownNameError("number of a body", name, _OF_BODY)
            leaf = _OF_BODY[name]
            changed[leaf] = _with_part(self.model, leaf, self.index, value, f"body {self.name!r}: {name}")
        return replaced(self.model, **changed)

    def __repr__(self) -> str:
        """Name it; its numbers may be unknown while tracing."""
        return f"<body {self.name!r}>"


@final
@dataclasses.dataclass(frozen=True, repr=False)
class JointView:
    """One joint of a model.

    What belongs to a coordinate or a speed is a scalar for revolute and prismatic joints, and otherwise an array with an
    element for each of the joint's coordinates or speeds.

    Attributes:
        model: the model it is in.
        index: its row in the model's leaves.
    """

    model: "_model.Model"
    index: int

    @property
    def name(self) -> str:
        """Name of the joint."""
        return self.model.tree.joint_names[self.index]

    @property
    def type(self) -> JointType:
        """One of "revolute", "prismatic", "ball" and "free"."""
        return self.model.tree.joint_types[self.index]

    @property
    def body(self) -> BodyView:
        """The body it moves."""
        return BodyView(self.model, self.model.tree.joint_bodies[self.index])

    @property
    def coordinates(self) -> slice:
        """Its place in q: `q[model.joint("elbow").coordinates]`."""
        start = self.model.tree.q_start[self.index]
        return slice(start, start + COORDINATES[self.type])

    @property
    def speeds(self) -> slice:
        """Its place in u, u_dot and tau."""
        start = self.model.tree.v_start[self.index]
        return slice(start, start + SPEEDS[self.type])

    @property
    def axis(self) -> jax.Array:
        """Direction in the body's frame, of any length, (3,); unused by ball and free joints."""
        return _part(self.model, "joint_axis", self.index)

    @property
    def anchor(self) -> jax.Array:
        """A point [m] of the joint in the body's frame, (3,); unused by free joints."""
        return _part(self.model, "joint_anchor", self.index)

    @property
    def stiffness(self) -> jax.Array:
        """Of the spring, force [N] or torque [N m] a unit of displacement, ()."""
        return _part(self.model, "stiffness", self.index)

    @property
    def range(self) -> jax.Array:
        """Least and greatest coordinate, (2,), infinite where there is none."""
        return _part(self.model, "joint_range", self.index)

    @property
    def armature(self) -> jax.Array:
        """Inertia of the rotor, reflected to the speed [kg m^2 or kg]."""
        return _part(self.model, "armature", self._place("armature"))

    @property
    def damping(self) -> jax.Array:
        """Force [N] or torque [N m] a unit of speed."""
        return _part(self.model, "damping", self._place("damping"))

    @property
    def coulomb_friction(self) -> jax.Array:
        """Greatest friction force [N] or torque [N m]."""
        return _part(self.model, "coulomb_friction", self._place("coulomb_friction"))

    @property
    def friction_width(self) -> jax.Array:
        """Speed [rad/s or m/s] over which friction builds up."""
        return _part(self.model, "friction_width", self._place("friction_width"))

    @property
    def spring_reference(self) -> jax.Array:
        """Coordinates [rad or m] at which the spring is relaxed."""
        return _part(self.model, "spring_reference", self._place("spring_reference"))

    @property
    def coordinate_reference(self) -> jax.Array:
        """Coordinates [rad or m] in the pose that the position and quaternion of the body describe."""
        return _part(self.model, "coordinate_reference", self._place("coordinate_reference"))

    def set(self, **values: Any) -> "_model.Model":
        """Return a model in which this joint has other numbers; works on values that JAX traces.

        Args:
            **values: any of axis, anchor, stiffness, range, armature, damping, coulomb_friction, friction_width,
                spring_reference and coordinate_reference. One number may stand for all speeds of a ball or free joint.

        Returns:
            A new model; the view still shows the old one.

        Raises:
            UnknownNameError: a joint has no such number.
            ValueError: a shape is wrong.
        """
        changed = {}
        for name, value in values.items():
            leaf = _OF_JOINT.get(name, name)
            if name not in (*_OF_JOINT, *_OF_SPEEDS, *_OF_COORDINATES):
                raise UnknownNameError("number of a joint", name, (*_OF_JOINT, *_OF_SPEEDS, *_OF_COORDINATES))
            place = self.index if name in _OF_JOINT else self._place(name)
            changed[leaf] = _with_part(self.model, leaf, place, value, f"joint {self.name!r}: {name}", spread=name in _OF_SPEEDS)
        return replaced(self.model, **changed)

    def _place(self, leaf: str) -> int | slice:
        place = self.speeds if leaf in _OF_SPEEDS else self.coordinates
        return place.start if place.stop == place.start + 1 else place

    def __repr__(self) -> str:
        """Name it; its numbers may be unknown while tracing."""
        return f"<joint {self.name!r}>"


def replaced(model: "_model.Model", **leaves: Any) -> "_model.Model":
    """Return `model` with other leaves, which are converted to arrays of its data type; see `Model.replace`."""
    shapes = _model.leaf_shapes(model.tree)
    for name in leaves:
        if name not in shapes:
            raise UnknownNameError("leaf of a model", name, shapes)
    return dataclasses.replace(model, **{name: jnp.asarray(value).astype(model.dtype) for name, value in leaves.items()})


def _part(model: "_model.Model", leaf: str, place: int | slice) -> jax.Array:
    return _unbatched(model, leaf)[place]


def _with_part(model: "_model.Model", leaf: str, place: int | slice, value: Any, label: str, *, spread: bool = False) -> jax.Array:
    """Return a leaf with another value in one place; `spread` lets one number stand for several."""
    old = _unbatched(model, leaf)
    shape, array = old[place].shape, jnp.asarray(value)
    if array.shape != shape and not (spread and array.ndim == 0):
        raise ValueError(f"{label} has shape {array.shape}, but needs {shape}")
    return old.at[place].set(array.astype(old.dtype))


def _unbatched(model: "_model.Model", leaf: str) -> jax.Array:
    array, shape = getattr(model, leaf), _model.leaf_shapes(model.tree)[leaf]
    if jnp.shape(array) != shape:
        raise ValueError(f"model.{leaf} has shape {jnp.shape(array)} instead of {shape}; view a batch of models under jax.vmap")
    return array
