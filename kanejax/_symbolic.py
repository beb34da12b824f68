"""Programs of JAX evaluated on expressions in place of numbers, written out: loops of known length, products of matrices, calls.

What is known is evaluated, what moves values about is done to their numbers instead, and the rest is entered into a graph.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Jaxpr, Literal, Primitive

from kanejax import _batching
from kanejax._expressions import Expression, Graph, Value

# One value for each result or operand, where those of all elements of an array do not depend on each other.
ELEMENTWISE = frozenset((
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "logistic", "erf",
    "exp", "exp2", "expm1", "log", "log1p", "pow", "sqrt", "rsqrt", "cbrt", "abs", "sign", "floor", "ceil", "round", "max", "min",
    "clamp", "rem", "eq", "ne", "lt", "le", "gt", "ge", "and", "or", "not", "xor", "is_finite", "select_n", "convert_element_type",
))  # fmt: skip
# What only moves values about.
MOVING = frozenset((
    "broadcast_in_dim", "reshape", "squeeze", "expand_dims", "transpose", "rev", "slice", "split", "concatenate", "stack",
    "unstack", "pad", "dynamic_slice", "dynamic_update_slice", "gather", "scatter",
))  # fmt: skip
# Which of their operands say where to.
PLACES = {"dynamic_slice": slice(1, None), "dynamic_update_slice": slice(2, None), "gather": slice(1, 2), "scatter": slice(1, 2)}
UNCHANGED = frozenset(("optimization_barrier", "stop_gradient", "copy", "copy_p"))
# Programs within a program, and where they are among the parameters.
CALLS = frozenset(
    ("jit", "pjit", "closed_call", "core_call", "remat", "remat2", "checkpoint", "custom_jvp_call", "custom_vjp_call")
)
CALLED = ("jaxpr", "call_jaxpr", "fun_jaxpr")

# Arrays of objects: known numbers and expressions.
Values = np.ndarray


class Elementwise(NamedTuple):
    """An operation that is applied to the elements of arrays."""

    primitive: Primitive
    params: tuple[tuple[str, Any], ...]
    dtypes: tuple[Any, ...]

    def __call__(self, *operands: Any) -> jax.Array:
        """Evaluate, on numbers or arrays of one shape."""
        arrays = [jnp.asarray(x, dtype) for x, dtype in zip(operands, self.dtypes, strict=True)]
        return self.primitive.bind(*jnp.broadcast_arrays(*arrays), **dict(self.params))

    def known(self, *operands: Any) -> float:
        """Evaluate, on known numbers."""
        with jax.ensure_compile_time_eval():
            return float(self(*operands))


class Evaluator:
    """Evaluates programs on arrays of expressions of one graph."""

    def __init__(self) -> None:
        self.graph = Graph()

    def variables(self, shape: tuple[int, ...]) -> Values:
        """An array of new variables."""
        return _filled(shape, [self.graph.unknown() for _ in range(int(np.prod(shape)))])

    def run(self, program: Jaxpr, operands: Sequence[Values]) -> list[Values]:
        """Evaluate a program, whose constants are known.

        Raises:
            NotImplementedError: it has an operation that cannot be written out.
        """
        # A program has its constants with it, or has none.
        inner, constants = getattr(program, "jaxpr", program), getattr(program, "consts", ())
        values = dict(zip(inner.constvars, map(_known, constants), strict=True))
        values |= dict(zip(inner.invars, operands, strict=True))
        for equation in inner.eqns:
            found = [_known(x.val) if isinstance(x, Literal) else values[x] for x in equation.invars]
            values |= dict(zip(equation.outvars, self._evaluate(equation, found), strict=True))
        return [_known(x.val) if isinstance(x, Literal) else values[x] for x in inner.outvars]

    def _evaluate(self, equation: Any, operands: list[Values]) -> list[Values]:
        name, params = equation.primitive.name, equation.params
        if name in UNCHANGED:
            return operands
        if equation.primitive is _batching.kernel_call:
            return self.run(kernel_program(equation), operands)
        if name in CALLS:
            return self.run(next(params[key] for key in CALLED if key in params), operands)
        if name == "platform_index":
            # The form that is for any platform.
            return [_known(params["platforms"].index(None))]
        if name == "cond" and _is_known(operands[0]):
            return self.run(params["branches"][int(operands[0])], operands[1:])
        if all(map(_is_known, operands)):
            numbers = [jnp.asarray(x.astype(variable.aval.dtype)) for x, variable in zip(operands, equation.invars, strict=True)]
            return [_known(x) for x in _bind(equation, numbers)]
        if name == "scan":
            return self._loop(equation, operands)
        if name == "scatter-add":
            return self._added(equation, operands)
        return self._moved(equation, operands) if name in MOVING else [self._arithmetic(equation, operands)]

    def _loop(self, equation: Any, operands: list[Values]) -> list[Values]:
        """A loop of known length. Its operands are constants, what is carried on, and rows of arrays."""
        length, body = equation.params["length"], equation.params["jaxpr"]
        rows = sum(map(_is_longer, equation.invars, body.invars))
        stacked = [x for x, of_step in zip(equation.outvars, body.outvars, strict=True) if _is_longer(x, of_step)]
        first, carries = len(operands) - rows, len(equation.outvars) - len(stacked)
        constants, carry, steps = operands[: first - carries], operands[first - carries : first], {}
        for i in reversed(range(length)) if equation.params["reverse"] else range(length):
            results = self.run(body, [*constants, *carry, *(np.asarray(x[i], object) for x in operands[first:])])
            carry, steps[i] = results[:carries], results[carries:]
        outputs = [[x for i in range(length) for x in steps[i][j].flat] for j in range(len(stacked))]
        return [*carry, *(_filled(x.aval.shape, values) for x, values in zip(stacked, outputs, strict=True))]

    def _moved(self, equation: Any, operands: list[Values]) -> list[Values]:
        """Move the numbers of the values about, and look the values up."""
        table: list[Any] = []
        numbered: list[Any] = []
        for operand in operands:
            numbered.append(jnp.arange(len(table), len(table) + operand.size).reshape(operand.shape))
            table += list(operand.flat)
        where = PLACES.get(equation.primitive.name, slice(0))
        numbered[where] = [_places(equation, *each) for each in zip(operands[where], equation.invars[where], strict=True)]
        return [_filled(np.shape(x), [table[i] for i in np.ravel(x)]) for x in _bind(equation, numbered)]

    def _added(self, equation: Any, operands: list[Values]) -> list[Values]:
        """Updates added to elements of an array, which one of the updates alone adds to zeros shows."""
        array, _, updates = operands
        dtype, places = equation.invars[0].aval.dtype, _places(equation, operands[1], equation.invars[1])
        single = jnp.eye(updates.size, dtype=dtype).reshape(updates.size, *updates.shape)
        landed = jax.vmap(lambda x: equation.primitive.bind(jnp.zeros(array.shape, dtype), places, x, **equation.params))(single)
        totals, added = list(array.flat), list(updates.flat)
        for update, place in np.argwhere(np.asarray(landed).reshape(updates.size, array.size)):
            totals[place] = self.graph.total(totals[place], added[update])
        return [_filled(array.shape, totals)]

    def _arithmetic(self, equation: Any, operands: list[Values]) -> Values:
        name, params, graph = equation.primitive.name, equation.params, self.graph
        if name in ("reduce_sum", "reduce_prod"):
            function, identity = (graph.total, 0.0) if name == "reduce_sum" else (graph.product, 1.0)
            return self._reduced(function, identity, operands[0], params["axes"])
        if name == "dot_general":
            return self._contracted(params["dimension_numbers"], *operands)
        function = self._function(equation)
        return np.asarray(np.frompyfunc(function, len(operands), 1)(*operands), object)

    def _contracted(self, dimensions: Any, x: Values, y: Values) -> Values:
        """Sums of products over axes of both arrays; axes that both share come first."""
        (along_x, along_y), (shared_x, shared_y) = dimensions
        x, rest_x = _in_order(x, shared_x, along_x)
        y, rest_y = _in_order(y, shared_y, along_y)
        common = x.shape[: len(shared_x)]
        size = int(np.prod(common)), int(np.prod(rest_x)), int(np.prod(rest_y))
        products = np.frompyfunc(self.graph.product, 2, 1)(x.reshape(size[0], size[1], 1, -1), y.reshape(size[0], 1, size[2], -1))
        return self._reduced(self.graph.total, 0.0, np.asarray(products, object), 3).reshape(*common, *rest_x, *rest_y)

    @staticmethod
    def _reduced(function: Callable[..., Any], identity: float, array: Values, axes: Any) -> Values:
        return np.asarray(np.frompyfunc(function, 2, 1, identity=identity).reduce(array, axis=axes), object)

    def _function(self, equation: Any) -> Callable[..., Any]:
        """What is done to each element."""
        name, params, graph = equation.primitive.name, equation.params, self.graph
        known: dict[str, Callable[..., Any]] = {
            "mul": graph.product,
            "add": graph.total,
            "add_any": graph.total,
            "sub": lambda x, y: graph.total(x, graph.negative(y)),
            "neg": graph.negative,
            "div": graph.quotient,
            "square": lambda x: graph.product(x, x),
            "integer_pow": lambda x: graph.power(x, params["y"]),
        }
        if name in known:
            return known[name]
        dtypes = tuple(x.aval.dtype for x in equation.invars)
        if name == "convert_element_type" and dtypes[0].kind == np.dtype(params["new_dtype"]).kind:
            return lambda x: x
        if name not in ELEMENTWISE:
            raise _refusal(equation)
        operation = Elementwise(equation.primitive, tuple(sorted(params.items())), dtypes)

        def function(*operands: Value) -> Value:
            if name == "select_n" and not isinstance(operands[0], Expression):
                return operands[1 + int(operands[0])]
            return (
                graph.apply(operation, *operands)
                if any(isinstance(x, Expression) for x in operands)
                else operation.known(*operands)
            )

        return function


def kernel_program(equation: Any) -> Jaxpr:
    """The recursion behind a public function, for a batch without chunks."""
    run = functools.partial(_batching._run, chunk=None, **equation.params)
    return jax.make_jaxpr(run)(*(_shape(x) for x in equation.invars))


def _bind(equation: Any, operands: Sequence[jax.Array]) -> list[jax.Array]:
    """Evaluate one equation on arrays."""
    with jax.ensure_compile_time_eval():
        results = equation.primitive.bind(*operands, **equation.params)
    return list(results) if equation.primitive.multiple_results else [results]


def _places(equation: Any, operand: Values, variable: Any) -> jax.Array:
    """An operand that must be known, as whole numbers."""
    if not _is_known(operand):
        raise _refusal(equation, "at places that depend on the state")
    return jnp.asarray(operand.astype(variable.aval.dtype))


def _refusal(equation: Any, how: str = "") -> NotImplementedError:
    return NotImplementedError(
        f"the operation {equation.primitive.name!r}{how and ' ' + how} cannot be counted; write the function with arithmetic, "
        "elementwise functions, sums and products of arrays, and loops of known length"
    )


def _in_order(array: Values, shared: Sequence[int], along: Sequence[int]) -> tuple[Values, tuple[int, ...]]:
    """The array with the axes `shared` first and `along` last, and the sizes of those between."""
    rest = [i for i in range(array.ndim) if i not in (*shared, *along)]
    return array.transpose(*shared, *rest, *along), tuple(array.shape[i] for i in rest)


def _shape(variable: Any) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(variable.aval.shape, variable.aval.dtype)


def _is_longer(variable: Any, of_step: Any) -> bool:
    """Whether a variable of a loop has a row for each step."""
    return len(variable.aval.shape) > len(of_step.aval.shape)


def _is_known(array: Values) -> bool:
    return not any(isinstance(x, Expression) for x in array.flat)


def _known(value: Any) -> Values:
    array = np.asarray(value)
    return _filled(array.shape, [float(x) for x in array.ravel()])


def _filled(shape: tuple[int, ...], values: Sequence[Any]) -> Values:
    """An array of objects, which NumPy must not look into."""
    filled = np.empty(int(np.prod(shape)), object)
    for i, value in enumerate(values):
        filled[i] = value
    return filled.reshape(shape)
