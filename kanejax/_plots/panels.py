"""What is drawn of each joint, in which panels and units."""

from collections.abc import Iterable
from typing import NamedTuple

from kanejax._errors import UnknownNameError
from kanejax._model.tree import Tree
from kanejax._plots.arrays import PlotError

_XYZ, _WXYZ = ("x", "y", "z"), ("w", "x", "y", "z")


class Quantity(NamedTuple):
    """One quantity of a panel: where it is among coordinates or speeds, its unit, and the names of its parts.

    The unit is empty for quaternions; a quantity of one part has no names.
    """

    columns: slice
    unit: str
    parts: tuple[str, ...]


class Panel(NamedTuple):
    """A joint, or the half of a free one.

    Attributes:
        joint: name.
        title: the name, and which half.
        q: its coordinates.
        u: its speeds.
        tau: its forces.
        plain: whether it has one coordinate, which may have a range.
    """

    joint: str
    title: str
    q: Quantity
    u: Quantity
    tau: Quantity
    plain: bool


def panels_of(tree: Tree, joints: str | Iterable[str] | None = None) -> list[Panel]:
    """The panels of some joints, by default of all; two of a free joint, one for translation and one for rotation.

    Raises:
        PlotError: there are none.
        UnknownNameError: a joint is not in the model; the message lists those that are.
    """
    names = tree.joint_names if joints is None else (joints,) if isinstance(joints, str) else tuple(joints)
    if not names:
        raise PlotError("there are no joints to draw")
    return [panel for name in names for panel in _panels(tree, tree.joint(name))]


def plain_joint(tree: Tree, name: str) -> Panel:
    """The panel of a joint with one coordinate.

    Raises:
        UnknownNameError: there is none of that name; the message lists those there are.
    """
    plain = [joint for joint, kind in zip(tree.joint_names, tree.joint_types, strict=True) if kind in ("revolute", "prismatic")]
    if name not in plain:
        raise UnknownNameError("joint with one coordinate", name, plain)
    return _panels(tree, tree.joint(name))[0]


def _panels(tree: Tree, joint: int) -> list[Panel]:
    name, kind = tree.joint_names[joint], tree.joint_types[joint]
    q, v = tree.q_start[joint], tree.v_start[joint]
    if kind == "revolute":
        return [Panel(name, name, *_quantities(q, v, ("rad", "rad/s", "N m")), plain=True)]
    if kind == "prismatic":
        return [Panel(name, name, *_quantities(q, v, ("m", "m/s", "N")), plain=True)]
    if kind == "ball":
        return [_turning(name, name, q, v)]
    moving = _quantities(q, v, ("m", "m/s", "N"), _XYZ)
    return [Panel(name, f"{name}, translation", *moving, plain=False), _turning(name, f"{name}, rotation", q + 3, v + 3)]


def _quantities(q: int, v: int, units: tuple[str, str, str], parts: tuple[str, ...] = ()) -> list[Quantity]:
    size = len(parts) or 1
    return [Quantity(slice(start, start + size), unit, parts) for start, unit in zip((q, v, v), units, strict=True)]


def _turning(joint: str, title: str, q: int, v: int) -> Panel:
    """Of a quaternion."""
    _, u, tau = _quantities(q, v, ("", "rad/s", "N m"), _XYZ)
    return Panel(joint, title, Quantity(slice(q, q + 4), "", _WXYZ), u, tau, plain=False)
