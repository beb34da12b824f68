"""What is sought: leaves of a plant, of which bodies and joints, within which bounds, and what is believed of them before."""

import dataclasses
import fnmatch
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, final

from kanejax._errors import UnknownNameError
from kanejax._model.tree import Tree
from kanejax._parameters.leaves import LEAVES, Element, elements, owners
from kanejax._parameters.priors import Entropic, Gaussian, Geodesic, Prior

Bound = float | tuple[float, ...]
# Leaves whose numbers are free coordinates already, or are kept physical by others.
UNBOUNDED = ("inertia", "central_inertia", "body_quaternion", "joint_axis")


@final
@dataclasses.dataclass(frozen=True)
class Unknown:
    """Numbers of a plant that are to be found.

    "inertia" is all ten inertia parameters of a body, kept physical; the others are leaves of `Model` and `Drives` by name:
    "mass", "com" and "central_inertia" one at a time; "armature", "damping", "coulomb_friction", "friction_width", "stiffness",
    "spring_reference"; "gain", "offset", "stribeck_friction", "stribeck_speed", "load_friction", "delay"; "gravity"; and, of the
    geometry, "body_position", "body_quaternion", "joint_axis", "joint_anchor" and "coordinate_reference". The lengths of
    quaternions and axes do not matter, so what is sought is how they turn from the given ones: of a body's frame, the three
    components, in its own axes, of the rotation vector with length 2 tan(angle / 2); of an axis, the two components of its
    tangent across it. Both are angles in rad as long as they are small.

    Attributes:
        leaf: "inertia", or the leaf's name.
        of: names of bodies or joints, patterns such as "wrist*", or a function that says of a name whether it counts. By default
            all bodies that move, less those that are frames without mass where it is about mass; or all joints.
        bounds: least and greatest value, None or infinite where there is none; each one number, or one for each number of a body
            or joint. By default masses, rotor inertias, stiffness, friction and damping are positive, and gains keep their signs.
        prior: what is believed before; nothing by default.
        tied: whether all selected numbers are equal.
        scale: a typical size, in the unit of the numbers; by default 1 N m of friction, 0.1 kg m^2 of rotor inertia and the like,
            or how far the given number is from its bound, if that is more. A number whose start is at its bound starts at a tenth
            of it instead, for there it would hardly move. For "inertia", mass [kg] and radius of gyration [m] for bodies that have
            none; by default a hundredth and a tenth of the means of the others'.

    Raises:
        UnknownNameError: there is no such leaf; the message lists those there are.
        ValueError: the bounds or the scale make no sense, or do not go with the leaf.
    """

    leaf: str
    of: str | Iterable[str] | Callable[[str], bool] | None = None
    _: dataclasses.KW_ONLY
    bounds: Sequence[Any] | None = None
    prior: Prior | None = None
    tied: bool = False
    scale: float | tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Bring names and bounds to one form that can be hashed, and check what does not depend on the plant."""
        if self.leaf not in LEAVES:
            raise UnknownNameError("leaf that can be identified", self.leaf, LEAVES)
        of = (self.of,) if isinstance(self.of, str) else self.of
        object.__setattr__(self, "of", of if of is None or callable(of) else tuple(of))
        if self.tied and len(LEAVES[self.leaf].parts) > 1:
            raise ValueError(
                f"Unknown({self.leaf!r}) cannot be tied: a tie joins single numbers, such as 'damping', and {self.leaf!r} has "
                f"{len(LEAVES[self.leaf].parts)} for each element"
            )
        if self.bounds is not None:
            object.__setattr__(self, "bounds", _checked_bounds(self.leaf, self.bounds))
        if not isinstance(self.prior, Prior | None):
            raise ValueError(f"prior of Unknown({self.leaf!r}) is {self.prior!r}; use Gaussian, Entropic or Geodesic")
        if isinstance(self.prior, Entropic | Geodesic) and self.leaf != "inertia":
            raise ValueError(f"Unknown({self.leaf!r}) has prior {self.prior}, which is for 'inertia'; use Gaussian")
        if isinstance(self.prior, Gaussian) and self.prior.relative and self.leaf in UNBOUNDED:
            raise ValueError(f"Unknown({self.leaf!r}) has a relative Gaussian prior, but some of its numbers are naturally zero")
        _check_scale(self.leaf, self.scale)


def selected(unknown: Unknown, tree: Tree) -> list[Element]:
    """The rows of its leaf that an unknown is about, in the order of the leaf.

    Raises:
        UnknownNameError: no body or joint has the name or matches the pattern.
        ValueError: nothing is selected, or what is selected has no such number.
    """
    there = elements(unknown.leaf, tree)
    if LEAVES[unknown.leaf].place == "plant":
        if unknown.of is not None:
            raise ValueError(f"Unknown({unknown.leaf!r}) belongs to the whole plant; leave `of` out")
        return there
    kind, names = owners(unknown.leaf, tree)
    if unknown.of is None:
        chosen = {element.owner for element in there if element.moves}
    elif callable(unknown.of):
        chosen = {name for name in names if unknown.of(name)} & {element.owner for element in there}
    else:
        chosen = set().union(*(_matching(pattern, kind, names) for pattern in unknown.of))
    if without := [name for name in names if name in chosen - {element.owner for element in there}]:
        joint_type = tree.joint_types[tree.joint(without[0])]
        raise ValueError(f"Unknown({unknown.leaf!r}): joint {without[0]!r} is {joint_type} and has no {unknown.leaf}")
    if not chosen:
        listed = ", ".join(repr(name) for name in names) or "none"
        raise ValueError(f"Unknown({unknown.leaf!r}) selects no {kind}; the names are: {listed}")
    return [element for element in there if element.owner in chosen]


def _matching(pattern: str, kind: str, names: tuple[str, ...]) -> set[str]:
    found = {pattern} & set(names) or set(fnmatch.filter(names, pattern))
    if not found:
        raise UnknownNameError(kind, pattern, names)
    return found


def _checked_bounds(leaf: str, bounds: Sequence[Any]) -> tuple[Bound, Bound]:
    if leaf in UNBOUNDED:
        raise ValueError(f"Unknown({leaf!r}) takes no bounds: all that it can become is physical; a prior can hold it")
    if len(bounds) != 2:
        raise ValueError(f"bounds of Unknown({leaf!r}) are {bounds!r}; give a pair, least and greatest")
    low, high = (_bound(leaf, bound, none) for bound, none in zip(bounds, (-math.inf, math.inf), strict=True))
    size = len(LEAVES[leaf].parts)
    for a, b in zip(_each(low, size), _each(high, size), strict=True):
        if not a < b:
            raise ValueError(f"bounds of Unknown({leaf!r}) are {low} and {high}; the first must be less than the second")
    return low, high


def _bound(leaf: str, bound: Any, none: float) -> Bound:
    if bound is None:
        return none
    if isinstance(bound, Sequence) or getattr(bound, "ndim", 0):
        values, size = tuple(float(value) for value in bound), len(LEAVES[leaf].parts)
        if len(values) != size:
            raise ValueError(f"a bound of Unknown({leaf!r}) has {len(values)} numbers; give one, or {size}")
        return values
    return float(bound)


def bounds_of_parts(unknown: Unknown) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """Least and greatest value of each number of an element, None where the user gave none."""
    if unknown.bounds is None:
        return None
    size = len(LEAVES[unknown.leaf].parts)
    low, high = unknown.bounds
    return _each(low, size), _each(high, size)


def _each(bound: Bound, size: int) -> tuple[float, ...]:
    return bound if isinstance(bound, tuple) else (bound,) * size


def _check_scale(leaf: str, scale: float | tuple[float, float] | None) -> None:
    if scale is None:
        return
    values = scale if isinstance(scale, tuple) else (scale,)
    if len(values) != (2 if leaf == "inertia" else 1):
        wanted = "a pair, mass [kg] and radius of gyration [m]" if leaf == "inertia" else "one number"
        raise ValueError(f"scale of Unknown({leaf!r}) is {scale!r}; give {wanted}")
    if not all(0 < value < math.inf for value in values):
        raise ValueError(f"scale of Unknown({leaf!r}) is {scale!r}; it must be positive and finite")
