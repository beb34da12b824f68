"""Lists of equations as text, in the thesis's own notation: parsing, evaluation, and what depends on what.

An appendix that is a list of assignments stays one, so that a reader can hold the two side by side. Names are those of the thesis
without subscripts (Z27, L13, c3, s45, u1; A2 is a moment of inertia of link A, mA its mass), products are written out, and `#`
starts a comment. Values are numbers or NumPy arrays with any axes of states.
"""

import ast
import functools
from collections.abc import Iterable, Mapping
from types import CodeType
from typing import Any

# An equation by the name that it defines; the order is that of evaluation.
Equations = dict[str, str]


def parse(*texts: str) -> Equations:
    """Read lines of the form `name = expression`, in order.

    Raises:
        ValueError: a name is defined twice.
    """
    equations: Equations = {}
    for text in texts:
        for line in text.splitlines():
            statement = line.partition("#")[0].strip()
            if not statement:
                continue
            name, _, expression = statement.partition(" = ")
            if name in equations:
                raise ValueError(f"{name} is defined twice, as {equations[name]} and as {expression}")
            equations[name] = expression
    return equations


def evaluate(equations: Equations, known: Mapping[str, Any]) -> dict[str, Any]:
    """Evaluate the equations one after the other; returns the known values and the new ones by name.

    Raises:
        NameError: an equation needs a name that is neither known nor defined before it.
    """
    values: dict[str, Any] = {"__builtins__": {}, **known}
    exec(_compiled("\n".join(f"{name} = {expression}" for name, expression in equations.items())), values)
    del values["__builtins__"]
    return values


def instead(equations: Equations, printed: Mapping[str, str]) -> Equations:
    """The list with some equations as they are printed.

    Raises:
        KeyError: there is no such equation.
    """
    if unknown := set(printed) - set(equations):
        raise KeyError(f"no equation defines {', '.join(sorted(unknown))}")
    return {**equations, **printed}


def unused(equations: Equations, wanted: Iterable[str]) -> list[str]:
    """Names that do not influence the wanted ones, in order."""
    needed, open_names = set(), list(wanted)
    while open_names:
        name = open_names.pop()
        if name in equations and name not in needed:
            needed.add(name)
            open_names += names_in(equations[name])
    return [name for name in equations if name not in needed]


def names_in(expression: str) -> set[str]:
    """The names in an expression."""
    return {node.id for node in ast.walk(ast.parse(expression)) if isinstance(node, ast.Name)}


@functools.cache
def _compiled(source: str) -> CodeType:
    return compile(source, "<equations>", "exec")
