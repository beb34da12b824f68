"""Scalar expressions in which every value occurs once: products with 0 and 1, sums with 0, and repetitions are left out.

Signs are kept apart from values, so that x - y and y - x are one operation, and a change of sign is none. Nothing else is
rearranged: neither are brackets moved nor is a common factor taken out.
"""

import collections
import dataclasses
from collections.abc import Callable, Hashable, Iterable, Mapping
from typing import Any, NamedTuple, final


@final
@dataclasses.dataclass(frozen=True, slots=True)
class Expression:
    """The number of a node in a `Graph`, and the sign it is taken with, 1 or -1."""

    node: int
    sign: int


# A number that is known, or an expression of unknown ones.
Value = float | Expression


class Node(NamedTuple):
    """An operation: "product", "sum", "difference", "quotient", "unknown" for a variable, or what was given to `Graph.apply`."""

    number: int
    operation: Hashable
    operands: tuple[Value, ...]


class Graph:
    """Operations on unknown values, numbered so that operands come first; each is entered once."""

    def __init__(self) -> None:
        self._numbers: dict[tuple, int] = {}
        self._nodes: list[tuple] = []

    def unknown(self) -> Expression:
        """A new variable."""
        self._nodes.append(("unknown",))
        return Expression(len(self._nodes) - 1, 1)

    def apply(self, operation: Hashable, *operands: Value) -> Expression:
        """An operation of which nothing is known but that it can be repeated; a function, if it is to be evaluated."""
        return self._enter((operation, *operands))

    def negative(self, x: Value) -> Value:
        """Minus x."""
        return Expression(x.node, -x.sign) if isinstance(x, Expression) else -x

    def product(self, x: Value, y: Value) -> Value:
        """The product x y."""
        if not isinstance(x, Expression) and not isinstance(y, Expression):
            return x * y
        # What is known comes first.
        first, second = sorted((x, y), key=_place)
        sign = _sign(first) * _sign(second)
        if _bare(first) == 0.0:
            return 0.0
        if _bare(first) == 1.0:
            return self._signed(_bare(second), sign)
        return self._signed(self._enter(("product", _bare(first), _bare(second))), sign)

    def total(self, x: Value, y: Value) -> Value:
        """The sum x + y."""
        if not isinstance(x, Expression) and not isinstance(y, Expression):
            return x + y
        if x == 0.0 or y == 0.0:
            return y if x == 0.0 else x
        if x == self.negative(y):
            return 0.0
        first, second = sorted((x, y), key=_place)
        operation = "sum" if _sign(first) == _sign(second) else "difference"
        # The sign of the first is taken out.
        return self._signed(self._enter((operation, _bare(first), _bare(second))), _sign(first))

    def quotient(self, x: Value, y: Value) -> Value:
        """The quotient x / y; that of an unknown value and a known one other than 0 is a product."""
        if not isinstance(y, Expression) and y != 0.0:
            return self.product(x, 1.0 / y) if isinstance(x, Expression) else x / y
        if isinstance(y, Expression) and x == 0.0:
            return 0.0
        return self._signed(self._enter(("quotient", _bare(x), _bare(y))), _sign(x) * _sign(y))

    def power(self, x: Value, exponent: int) -> Value:
        """The power of x with a whole exponent: repeated squares."""
        if exponent < 0:
            return self.quotient(1.0, self.power(x, -exponent))
        if exponent == 0:
            return 1.0
        half = self.power(x, exponent // 2)
        return self.product(self.product(half, half), x if exponent % 2 else 1.0)

    def count(self, results: Iterable[Value]) -> collections.Counter[Hashable]:
        """How many operations of each kind the results need."""
        return collections.Counter(node.operation for node in self.nodes(results) if node.operation != "unknown")

    def evaluate(self, results: Iterable[Value], variables: Mapping[Expression, Any]) -> list[Any]:
        """The results, with numbers or arrays for the variables."""
        results = list(results)
        arithmetic: dict[Hashable, Callable] = {
            "product": lambda x, y: x * y,
            "sum": lambda x, y: x + y,
            "difference": lambda x, y: x - y,
            "quotient": lambda x, y: x / y,
        }
        values = {variable.node: value for variable, value in variables.items()}

        def value(x: Value) -> Any:
            if not isinstance(x, Expression):
                return x
            return values[x.node] if x.sign > 0 else -values[x.node]

        for number, operation, operands in self.nodes(results):
            if number not in values:
                function: Any = arithmetic.get(operation, operation)
                values[number] = function(*map(value, operands))
        return [value(x) for x in results]

    def nodes(self, results: Iterable[Value]) -> list[Node]:
        """What the results depend on, operands first."""
        waiting, seen = [x.node for x in results if isinstance(x, Expression)], set()
        while waiting:
            number = waiting.pop()
            if number not in seen:
                seen.add(number)
                waiting += [x.node for x in self._nodes[number][1:] if isinstance(x, Expression)]
        return [Node(number, self._nodes[number][0], self._nodes[number][1:]) for number in sorted(seen)]

    def _enter(self, key: tuple) -> Expression:
        if key not in self._numbers:
            self._numbers[key] = len(self._nodes)
            self._nodes.append(key)
        return Expression(self._numbers[key], 1)

    def _signed(self, x: Value, sign: int) -> Value:
        return x if sign > 0 else self.negative(x)


def _place(x: Value) -> tuple[int, float]:
    """Where an operand comes among others, whatever its sign."""
    return (1, float(x.node)) if isinstance(x, Expression) else (0, abs(x))


def _sign(x: Value) -> int:
    return x.sign if isinstance(x, Expression) else (-1 if x < 0 else 1)


def _bare(x: Value) -> Value:
    return Expression(x.node, 1) if isinstance(x, Expression) else abs(x)
