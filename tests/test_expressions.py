"""Expressions that occur once: what is folded, what is merged, and that the values stay the same."""

import math
import operator

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from kanejax._expressions import Expression, Graph, Value

KNOWN = (-2.0, -1.0, -0.0, 0.0, 0.5, 1.0, 3.0)
VALUES = (0.7, -1.3, 2.1)
FUNCTIONS = {"total": operator.add, "product": operator.mul, "quotient": operator.truediv, "negative": operator.neg}

leaves = st.one_of(st.sampled_from(KNOWN), st.sampled_from(("x", "y", "z")))
divisors = st.one_of(st.sampled_from([x for x in KNOWN if x]), st.sampled_from(("x", "y", "z")))
trees = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(("total", "product")), inner, inner),
        st.tuples(st.just("quotient"), inner, divisors),
        st.tuples(st.just("negative"), inner),
        st.tuples(st.just("power"), inner, st.integers(0, 3)),
    ),
    max_leaves=25,
)


def entered(graph: Graph, tree, variables) -> Value:
    """The tree as an expression of the graph."""
    if not isinstance(tree, tuple):
        return variables.get(tree, tree)
    name, first, *rest = tree
    operands = rest if name == "power" else [entered(graph, x, variables) for x in rest]
    return getattr(graph, name)(entered(graph, first, variables), *operands)


def direct(tree, values):
    """Its value, and the value with a plus for every minus: the scale of rounding errors."""
    if not isinstance(tree, tuple):
        value = values.get(tree, tree)
        return value, abs(value)
    name, first, *rest = tree
    if name == "power":
        return tuple(x ** rest[0] for x in direct(first, values))
    parts = list(zip(direct(first, values), *(direct(x, values) for x in rest), strict=True))
    value, scale = (FUNCTIONS[name](*part) for part in parts)
    return value, abs(scale)


@settings(max_examples=400, deadline=None, derandomize=True, database=None)
@given(st.lists(trees, min_size=1, max_size=4))
def test_values_stay_the_same(several):
    graph = Graph()
    variables = {name: graph.unknown() for name in "xyz"}
    values = dict(zip("xyz", VALUES, strict=True))
    results = [entered(graph, tree, variables) for tree in several]
    found = graph.evaluate(results, {variables[name]: values[name] for name in "xyz"})
    for value, tree in zip(found, several, strict=True):
        expected, scale = direct(tree, values)
        assume(scale < 1e100)
        assert abs(value - expected) <= 1e-13 * scale


@settings(max_examples=200, deadline=None, derandomize=True, database=None)
@given(trees)
def test_what_is_known_is_not_counted(tree):
    graph = Graph()
    variables = {name: graph.unknown() for name in "xyz"}
    result = entered(graph, tree, variables)
    operations = sum(graph.count([result]).values())
    if not isinstance(result, Expression):
        assert operations == 0
        assert result == pytest.approx(direct(tree, dict(zip("xyz", VALUES, strict=True)))[0], rel=1e-12, abs=1e-12)
    again = entered(graph, tree, variables)
    assert again == result
    assert sum(graph.count([result, again]).values()) == operations


@pytest.mark.parametrize("sign_x", [1, -1])
@pytest.mark.parametrize("sign_y", [1, -1])
@pytest.mark.parametrize("name", ["total", "product", "quotient"])
@pytest.mark.parametrize("y", [None, 0.25, -4.0])
def test_signs(name, sign_x, sign_y, y):
    graph = Graph()
    a, b = graph.unknown(), graph.unknown() if y is None else y
    values = {a: 1.5} | ({b: 8.0} if y is None else {})

    def signed(x, sign):
        return x if sign > 0 else graph.negative(x)

    result = getattr(graph, name)(signed(a, sign_x), signed(b, sign_y))
    assert graph.evaluate([result], values) == [FUNCTIONS[name](sign_x * 1.5, sign_y * (8.0 if y is None else y))]
    flipped = getattr(graph, name)(signed(a, -sign_x), signed(b, sign_y * (-1 if name == "total" else 1)))
    assert flipped == graph.negative(result)
    assert sum(graph.count([result, flipped]).values()) == 1


def test_what_is_one_operation():
    graph = Graph()
    x, y = graph.unknown(), graph.unknown()
    minus = graph.negative
    for same in (
        [graph.total(x, y), graph.total(y, x), graph.total(minus(x), minus(y))],
        [graph.total(x, minus(y)), graph.total(minus(x), y), graph.total(y, minus(x))],
        [graph.product(x, y), graph.product(minus(y), x)],
        [graph.quotient(x, 2.0), graph.product(0.5, x), graph.product(x, -0.5)],
        [graph.quotient(x, y), graph.quotient(minus(x), y)],
        [graph.power(x, 2), graph.product(minus(x), minus(x))],
    ):
        assert sum(graph.count(same).values()) == 1
    different = [graph.total(x, y), graph.total(x, minus(y)), graph.quotient(x, y), graph.quotient(y, x), graph.product(x, x)]
    assert graph.count(different) == {"sum": 1, "difference": 1, "quotient": 2, "product": 1}


def test_what_is_none():
    graph = Graph()
    x = graph.unknown()
    assert graph.product(x, 0.0) == graph.product(-0.0, x) == graph.quotient(0.0, x) == graph.total(x, graph.negative(x)) == 0.0
    assert graph.product(1.0, x) == graph.total(0.0, x) == graph.total(x, -0.0) == graph.power(x, 1) == graph.quotient(x, 1.0) == x
    assert graph.product(x, -1.0) == graph.quotient(x, -1.0) == graph.negative(x)
    assert graph.negative(graph.negative(x)) == x
    assert graph.power(x, 0) == 1.0
    assert graph.total(2.0, 3.0) == graph.product(2.0, 2.5) == graph.quotient(10.0, 2.0) == 5.0


def test_powers_are_products():
    graph = Graph()
    x = graph.unknown()
    for exponent, products in ((2, 1), (3, 2), (4, 2), (5, 3), (7, 4), (8, 3)):
        assert graph.count([graph.power(x, exponent)]) == {"product": products}
    assert graph.count([graph.power(x, -3)]) == {"product": 2, "quotient": 1}


def test_only_what_results_need_is_counted():
    graph = Graph()
    x, y = graph.unknown(), graph.unknown()
    product = graph.product(x, y)
    sine = graph.apply(math.sin, product)
    assert graph.apply(math.sin, product) == sine != graph.apply(math.cos, product)
    graph.apply(math.cos, y)
    total = graph.total(sine, product)
    assert graph.count([total, total, 3.0]) == {"product": 1, math.sin: 1, "sum": 1}
    assert graph.count([x, graph.negative(y), 3.0]) == {}
    assert graph.evaluate([total, graph.negative(sine)], {x: 2.0, y: 3.0}) == [math.sin(6.0) + 6.0, -math.sin(6.0)]


def test_division_by_zero_is_left_to_the_evaluation():
    graph = Graph()
    x = graph.unknown()
    quotients = [graph.quotient(x, 0.0), graph.quotient(1.0, 0.0)]
    with np.errstate(divide="ignore"):
        assert graph.evaluate(quotients[:1], {x: np.float64(-2.0)}) == [-math.inf]
    assert graph.count(quotients) == {"quotient": 2}
