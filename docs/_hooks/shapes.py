"""Annotations and fields of the API pages, where griffe reads less than there is."""

import ast
import dataclasses
from collections.abc import Iterator
from typing import Any

import griffe

_ARRAYS = ("Bool", "Float", "Int")


class Shapes(griffe.Extension):
    """Shapes of arrays as they were meant, `Float[Array, "nbody 3"]`, and fields of classes that have no section for them."""

    def on_function_instance(self, *, func: griffe.Function, **_: Any) -> None:
        """Mend the annotations of the parameters and of what is returned."""
        for annotation in (func.returns, *(parameter.annotation for parameter in func.parameters)):
            _mend(annotation)

    def on_attribute_instance(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Mend the annotation, and take the meaning of a number of a body or joint from where it is defined."""
        _mend(attr.annotation)
        if isinstance(attr.value, griffe.ExprCall) and str(attr.value.function) == "_Number":
            attr.docstring = griffe.Docstring(ast.literal_eval(str(attr.value.arguments[1])), parent=attr)
            attr.value = None

    def on_class_members(self, *, cls: griffe.Class, **_: Any) -> None:
        """List the fields, with their types alone, where the docstring does not."""
        fields = [field for field in cls.members.values() if _is_field(field)]
        if not cls.docstring or not fields:
            return
        if any(section.kind is griffe.DocstringSectionKind.attributes for section in cls.docstring.parse("google")):
            return
        cls.docstring.value += "\n\nAttributes:\n" + "".join(f"    {field.name}: &nbsp;\n" for field in fields)


def _is_field(member: Any) -> bool:
    return member.is_attribute and member.annotation is not None and not member.is_private and "property" not in member.labels


def _mend(annotation: Any) -> None:
    """Write the second part of each array type as the string that it is in the source, less the space that begins it."""
    for part in _parts(annotation):
        if isinstance(part, griffe.ExprSubscript) and str(part.left) in _ARRAYS and isinstance(part.slice, griffe.ExprTuple):
            part.slice.elements[1] = '"' + str(part.slice.elements[1]).strip("'\" ") + '"'


def _parts(expression: Any) -> Iterator[Any]:
    if isinstance(expression, griffe.Expr):
        yield expression
        for field in dataclasses.fields(expression):
            yield from _parts(getattr(expression, field.name))
    elif isinstance(expression, list | tuple):
        for element in expression:
            yield from _parts(element)
