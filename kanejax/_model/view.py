"""Views of one body or joint of a model, by name: its numbers, and a new model with some of them changed."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, final

import jax
import jax.numpy as jnp

from kanejax._errors import UnknownNameError
from kanejax._model import model as _model
from kanejax._model.tree import COORDINATES, SPEEDS, WORLD, JointType


class _Number(property):
    """A number of a body or joint: the part of a leaf of its model that belongs to it.

    Attributes:
        leaf: name of the leaf.
        place: the attribute of the view that says which part: its "index", "speeds" or "coordinates".
    """

    def __init__(self, leaf: str, meaning: str, place: Literal["index", "speeds", "coordinates"] = "index") -> None:
        super().__init__(lambda view: _unbatched(view.model, leaf)[self.part(view)], doc=meaning)
        self.leaf, self.place = leaf, place

    def part(self, view: Any) -> int | slice:
        """Where the number is in the leaf: an index where there is one element."""
        place = getattr(view, self.place)
        return place.start if isinstance(place, slice) and place.stop == place.start + 1 else place

    if TYPE_CHECKING:

        def __get__(self, instance: Any, owner: type | None = None, /) -> jax.Array: ...


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

    position: ClassVar[_Number] = _Number(
        "body_position", "Position [m] of the body's frame in its parent's while no joint is displaced, (3,)."
    )
    quaternion: ClassVar[_Number] = _Number(
        "body_quaternion", "Orientation (w, x, y, z) of the body's frame in its parent's while no joint is displaced, (4,)."
    )
    mass: ClassVar[_Number] = _Number("mass", "Mass [kg], ().")
    com: ClassVar[_Number] = _Number("com", "Mass centre [m] in the body's frame, (3,).")
    central_inertia: ClassVar[_Number] = _Number(
        "central_inertia", "Inertia [kg m^2] about the mass centre in the body's axes, (3, 3)."
    )

    @property
    def name(self) -> str:
        """Name of the body."""
        return self.model.tree.body_names[self.index]

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
        return _with_numbers(self, "body", values)

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

    axis: ClassVar[_Number] = _Number(
        "joint_axis", "Direction in the body's frame, of any length, (3,); unused by ball and free joints."
    )
    anchor: ClassVar[_Number] = _Number(
        "joint_anchor", "A point [m] of the joint in the body's frame, (3,); unused by free joints."
    )
    stiffness: ClassVar[_Number] = _Number("stiffness", "Of the spring, force [N] or torque [N m] a unit of displacement, ().")
    range: ClassVar[_Number] = _Number("joint_range", "Least and greatest coordinate, (2,), infinite where there is none.")
    armature: ClassVar[_Number] = _Number("armature", "Inertia of the rotor, reflected to the speed [kg m^2 or kg].", "speeds")
    damping: ClassVar[_Number] = _Number("damping", "Force [N] or torque [N m] a unit of speed.", "speeds")
    coulomb_friction: ClassVar[_Number] = _Number("coulomb_friction", "Greatest friction force [N] or torque [N m].", "speeds")
    friction_width: ClassVar[_Number] = _Number("friction_width", "Speed [rad/s or m/s] over which friction builds up.", "speeds")
    spring_reference: ClassVar[_Number] = _Number(
        "spring_reference", "Coordinates [rad or m] at which the spring is relaxed.", "coordinates"
    )
    coordinate_reference: ClassVar[_Number] = _Number(
        "coordinate_reference", "Coordinates [rad or m] where the body's position and quaternion hold.", "coordinates"
    )

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
        return _with_numbers(self, "joint", values)

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


def _with_numbers(view: BodyView | JointView, kind: str, values: Mapping[str, Any]) -> "_model.Model":
    """Return the model of a view with other values of some of its numbers."""
    numbers = {name: number for name, number in vars(type(view)).items() if isinstance(number, _Number)}
    changed = {}
    for name, value in values.items():
        if name not in numbers:
            raise UnknownNameError(f"number of a {kind}", name, numbers)
        number, array = numbers[name], jnp.asarray(value)
        leaf, part = _unbatched(view.model, number.leaf), number.part(view)
        one_for_all = number.place == "speeds" and array.ndim == 0
        if array.shape != leaf[part].shape and not one_for_all:
            raise ValueError(f"{kind} {view.name!r}: {name} has shape {array.shape}, but needs {leaf[part].shape}")
        changed[number.leaf] = leaf.at[part].set(array.astype(leaf.dtype))
    return replaced(view.model, **changed)


def _unbatched(model: "_model.Model", leaf: str) -> jax.Array:
    array, shape = getattr(model, leaf), _model.leaf_shapes(model.tree)[leaf]
    if jnp.shape(array) != shape:
        raise ValueError(f"model.{leaf} has shape {jnp.shape(array)} instead of {shape}; view a batch of models under jax.vmap")
    return array
