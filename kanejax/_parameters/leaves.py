"""The leaves of a plant that can be unknown: what their numbers belong to, and what these are called, measured in and like."""

import math
from typing import Literal, NamedTuple

from kanejax._model.inertia import NAMES
from kanejax._model.tree import COORDINATES, SPEEDS, WORLD, Tree

Place = Literal["body", "joint", "speed", "coordinate", "plant"]


class Leaf(NamedTuple):
    """A leaf of `Model` or `Drives`, or "inertia".

    Attributes:
        place: what each row of it belongs to.
        units: of its numbers about a joint that turns, and along one that slides.
        parts: names of the numbers in a row.
        scale: a change of this size is neither small nor large; see `Unknown`.
        positive: whether it is bounded by zero from below unless the user says otherwise.
    """

    place: Place
    units: tuple[str, str]
    parts: tuple[str, ...] = ("",)
    scale: float = 1.0
    positive: bool = False


_XYZ = ("x", "y", "z")
_FORCE, _SPEED, _POSITION = ("N m", "N"), ("rad/s", "m/s"), ("rad", "m")
_LENGTH = ("m", "m")

LEAVES = {
    "inertia": Leaf("body", ("", ""), NAMES),
    "mass": Leaf("body", ("kg", "kg"), positive=True),
    "com": Leaf("body", _LENGTH, _XYZ, 0.01),
    "central_inertia": Leaf("body", ("kg m^2", "kg m^2"), ("xx", "yy", "zz", "xy", "xz", "yz")),
    "body_position": Leaf("body", _LENGTH, _XYZ, 0.01),
    "body_quaternion": Leaf("body", ("rad", "rad"), _XYZ, 0.01),
    "joint_axis": Leaf("joint", ("rad", "rad"), ("1", "2"), 0.01),
    "joint_anchor": Leaf("joint", _LENGTH, _XYZ, 0.01),
    "stiffness": Leaf("joint", ("N m/rad", "N/m"), positive=True),
    "armature": Leaf("speed", ("kg m^2", "kg"), scale=0.1, positive=True),
    "damping": Leaf("speed", ("N m s/rad", "N s/m"), positive=True),
    "coulomb_friction": Leaf("speed", _FORCE, positive=True),
    "friction_width": Leaf("speed", _SPEED, scale=0.01, positive=True),
    "spring_reference": Leaf("coordinate", _POSITION, scale=0.1),
    "coordinate_reference": Leaf("coordinate", _POSITION, scale=0.01),
    "gravity": Leaf("plant", ("m/s^2", "m/s^2"), _XYZ),
    "gain": Leaf("speed", ("N m/signal", "N/signal"), positive=True),
    "offset": Leaf("speed", _FORCE),
    "stribeck_friction": Leaf("speed", _FORCE, positive=True),
    "stribeck_speed": Leaf("speed", _SPEED, scale=0.1, positive=True),
    "load_friction": Leaf("speed", ("", ""), scale=0.1, positive=True),
    "delay": Leaf("plant", ("s", "s"), scale=0.01),
}
_INERTIA_UNITS = ("kg", *("kg m",) * 3, *("kg m^2",) * 6)
# The speeds of a joint that has several.
_SPEED_PARTS = {"ball": _XYZ, "free": (*_XYZ, "about_x", "about_y", "about_z")}
_WITHOUT = {"joint_axis": ("ball", "free"), "joint_anchor": ("free",)}


class Element(NamedTuple):
    """One row of a leaf.

    Attributes:
        owner: name of its body or joint; empty for the plant's.
        row: index in the leaf.
        part: which speed of its joint, where there are several.
        slides: whether it belongs to motion along, not about, an axis.
        moves: False for bodies that are fixed in the world.
    """

    owner: str
    row: int
    part: str = ""
    slides: bool = False
    moves: bool = True

    def name(self, leaf: str, part: str) -> str:
        """What a number of it is called, such as "link3.mcx", "joint2.damping", "wrist.damping.z" and "delay"."""
        return ".".join(filter(None, (self.owner, "" if leaf == "inertia" else leaf, self.part, part)))

    def units(self, leaf: str) -> tuple[str, ...]:
        """The units of its numbers."""
        form = LEAVES[leaf]
        return _INERTIA_UNITS if leaf == "inertia" else (form.units[self.slides],) * len(form.parts)


def elements(leaf: str, tree: Tree) -> list[Element]:
    """The rows of a leaf that mean something."""
    place = LEAVES[leaf].place
    if place == "plant":
        return [Element("", 0)]
    if place == "body":
        return [Element(name, row, moves=tree.body_links[row] != WORLD) for row, name in enumerate(tree.body_names)]
    joints = [joint for joint, kind in enumerate(tree.joint_types) if kind not in _WITHOUT.get(leaf, ())]
    if place == "coordinate":
        joints = [joint for joint in joints if COORDINATES[tree.joint_types[joint]] == 1]
        return [_element(tree, joint, tree.q_start[joint]) for joint in joints]
    if place == "joint":
        return [_element(tree, joint, joint) for joint in joints]
    return [_element(tree, joint, tree.v_start[joint] + i, i) for joint in joints for i in range(SPEEDS[tree.joint_types[joint]])]


def owners(leaf: str, tree: Tree) -> tuple[str, tuple[str, ...]]:
    """What the rows of a leaf belong to, "body" or "joint", and the names of all of them."""
    return ("body", tree.body_names) if LEAVES[leaf].place == "body" else ("joint", tree.joint_names)


def default_bounds(leaf: str, nominal: float) -> tuple[float, float]:
    """Bounds of a number that the user gave none: by zero for what cannot be negative; a gain keeps its sign."""
    if not LEAVES[leaf].positive:
        return -math.inf, math.inf
    return (-math.inf, 0.0) if leaf == "gain" and nominal < 0 else (0.0, math.inf)


def _element(tree: Tree, joint: int, row: int, speed: int | None = None) -> Element:
    name, kind = tree.joint_names[joint], tree.joint_types[joint]
    if speed is None or kind not in _SPEED_PARTS:
        return Element(name, row, slides=kind == "prismatic")
    return Element(name, row, _SPEED_PARTS[kind][speed], slides=kind == "free" and speed < 3)
