"""How large a model an MJCF asks for: a line of XML can ask for more bodies, numbers or pixels than any memory holds."""

import dataclasses
import math
from xml.etree import ElementTree

from kanejax._errors import ModelFileError

# Bodies in a model. Larger ones compile, but MuJoCo's compiler takes a time that grows with the square of their number.
LARGEST_TREE = 10_000
_LARGEST_ELEMENTS = 500_000
# Copies that <replicate> may make, which takes MuJoCo longer than bodies that are written out.
_MOST_COPIES = 2_000
# Elements with attributes that say how much to make: the largest product of the numbers in one.
_LARGEST: dict[tuple[str, str], int] = {
    ("replicate", "count"): _MOST_COPIES,
    ("flexcomp", "count"): 10_000,
    ("hfield", "nrow"): 4096,
    ("hfield", "ncol"): 4096,
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
    # Elements with the number of copies that are made of each, and the document they belong to.
    stack = [(root, 1, document) for root in document.roots]
    while stack:
        element, copies, owner = stack.pop()
        _check_numbers(element, origin)
        elements += copies
        bodies += copies * (element.tag == "body")
        if bodies > LARGEST_TREE or elements > _LARGEST_ELEMENTS:
            raise ModelFileError(too_large(origin, f"more than {LARGEST_TREE} bodies or {_LARGEST_ELEMENTS} elements, with all copies"))
        if element.tag == "replicate":
            copies *= max(int(_product(element.get("count", "1"))), 1)
            if copies > _MOST_COPIES:
                raise ModelFileError(f"{origin}: nested <replicate> makes {copies} copies, but at most {_MOST_COPIES} can be made")
        part = owner.models.get(element.get("model", "")) if element.tag == "attach" else None
        if part is not None:
            stack += [(root, copies, part) for root in part.roots]
        stack += [(child, copies, owner) for child in element]


def too_large(origin: str, what: str) -> str:
    """Say that a model cannot be compiled."""
    return f"{origin}: the model has {what}; divide it"


def _check_numbers(element: ElementTree.Element, origin: str) -> None:
    for attribute, value in element.items():
        largest = _LARGEST.get((element.tag, attribute))
        if largest is not None and not _product(value) <= largest:
            name = f" {element.get('name')!r}" if element.get("name") else ""
            what = f"<{element.tag} {attribute}={value[:60]!r}>{name}"
            raise ModelFileError(f"{origin}: {what} asks for more than the {largest} that can be made; give a smaller number")


def _product(value: str) -> float:
    """The product of the numbers in an attribute, NaN if one is none."""
    try:
        return math.prod(max(float(word), 1.0) for word in value.split())
    except ValueError:
        return math.nan
