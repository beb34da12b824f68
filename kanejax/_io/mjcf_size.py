"""How large a model an MJCF asks for: a line of XML can ask for more bodies, numbers or pixels than any memory holds."""

import dataclasses
import math
from xml.etree import ElementTree

from kanejax._errors import ModelFileError

# Bodies in a model, one below another, and elements of any kind. MuJoCo's compiler goes no deeper, but takes minutes to say so, and
# its time grows with the square of their number.
LARGEST_TREE = 10_000
DEEPEST_TREE = 1_000
_LARGEST_ELEMENTS = 50_000
# Copies that <replicate> or <flexcomp> may make, which take MuJoCo longer than bodies that are written out.
_MOST_COPIES = 2_000
_COPYING = ("replicate", "flexcomp")
# Attributes that say how much memory to take, or how long to compute, and the largest number in them. Where memory is wanting in
# MuJoCo's reader, the next warning in the same process never ends.
_LARGEST = {
    ("flexcomp", "cellcount"): 64,
    ("hfield", "nrow"): 4096,
    ("hfield", "ncol"): 4096,
    ("camera", "resolution"): 4096,
    # How finely a built-in shape is divided.
    ("mesh", "params"): 256,
    ("general", "actdim"): 10_000,
    ("user", "dim"): 10_000,
    ("contact", "num"): 10_000,
}


@dataclasses.dataclass(frozen=True)
class MjcfDocument:
    """An MJCF: its root and those of the files that it includes, and the models by name that it takes parts from."""

    roots: tuple[ElementTree.Element, ...]
    models: "dict[str, MjcfDocument]"


def check_size(document: MjcfDocument, origin: str) -> None:
    """Refuse numbers that ask for too much, and more bodies or elements than can be compiled, copies counted.

    Raises ModelFileError naming the element and the number.
    """
    bodies = elements = 0
    # Elements, the bodies above each, the number of copies that are made of it, and the document that it belongs to.
    stack = [(root, 0, 1, document) for root in document.roots]
    while stack:
        element, depth, copies, owner = stack.pop()
        _check_numbers(element, origin)
        copies *= _copies(element, origin)
        if copies > _MOST_COPIES:
            raise ModelFileError(f"{origin}: <{element.tag}> makes {copies} copies, but at most {_MOST_COPIES} can be made")
        depth, elements, bodies = depth + (element.tag == "body"), elements + copies, bodies + copies * (element.tag == "body")
        if bodies > LARGEST_TREE or elements > _LARGEST_ELEMENTS:
            raise ModelFileError(
                too_large(origin, f"more than {LARGEST_TREE} bodies or {_LARGEST_ELEMENTS} elements, with all copies")
            )
        if depth > DEEPEST_TREE:
            raise ModelFileError(too_large(origin, f"more than {DEEPEST_TREE} bodies one below another"))
        part = owner.models.get(element.get("model", "")) if element.tag == "attach" else None
        if part is not None:
            stack += [(root, depth, copies, part) for root in part.roots]
        stack += [(child, depth, copies, owner) for child in element]


def too_large(origin: str, what: str) -> str:
    """Say that a model cannot be compiled."""
    return f"{origin}: the model has {what}; divide it"


def _copies(element: ElementTree.Element, origin: str) -> int:
    """How many copies an element makes of what is in it."""
    if element.tag not in _COPYING:
        return 1
    numbers = _numbers(element.get("count", ""))
    if not all(0 <= number <= _MOST_COPIES for number in numbers):
        what = f"<{element.tag} count={element.get('count', '')[:60]!r}>"
        raise ModelFileError(f"{origin}: {what} is not made of whole numbers up to {_MOST_COPIES}; correct it")
    return math.prod(max(int(number), 1) for number in numbers)


def _check_numbers(element: ElementTree.Element, origin: str) -> None:
    for attribute, value in element.items():
        largest = _LARGEST.get((element.tag, attribute))
        if largest is not None and not all(number <= largest for number in _numbers(value)):
            name = f" {element.get('name')!r}" if element.get("name") else ""
            what = f"<{element.tag} {attribute}={value[:60]!r}>{name}"
            raise ModelFileError(f"{origin}: {what} is not made of numbers up to {largest}; give smaller ones")


def _numbers(value: str) -> list[float]:
    """The numbers in an attribute, NaN if one is none."""
    try:
        return [float(word) for word in value.split()]
    except ValueError:
        return [math.nan]
