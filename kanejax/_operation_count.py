"""How many operations a function of a specialized model takes, counted on its program."""

import functools
import inspect
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from kanejax._expressions import Expression, Graph, Value
from kanejax._model.model import Model
from kanejax._model.specialized import Specialized, specialize, whole
from kanejax._symbolic import Elementwise, Evaluator

TRANSCENDENTAL = frozenset((
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "logistic", "erf",
    "exp", "exp2", "expm1", "log", "log1p", "pow", "sqrt", "rsqrt", "cbrt",
))  # fmt: skip


class OperationCount(NamedTuple):
    """Operations on one state, common subexpressions counted once; changes of sign cost nothing.

    Attributes:
        multiplications: products of two unknown values, or of one and a number other than -1, 0 and 1.
        additions: sums and differences.
        divisions: by unknown values.
        transcendentals: sines, cosines, roots and the like.
        others: anything else, such as comparisons and selections.
    """

    multiplications: int
    additions: int
    divisions: int
    transcendentals: int
    others: int


class Written(NamedTuple):
    """A program written out as scalar expressions: its variables, those of all arguments in turn, and its results."""

    graph: Graph
    variables: list[Expression]
    results: list[Value]


def operation_count(function: Callable[..., Any], model: Model | Specialized, *state: Any) -> OperationCount:
    """Count the operations of `function(model, *state)` for one state, with all parameters of the model as constants.

    The parameters are regrouped and the program is written out link by link, as `specialize` has the equations of motion
    compiled; known zeros and ones are folded, and what occurs twice is counted once. What is compiled does not merge all of
    the latter, for values that are kept cost loads and stores. Loops of other functions, such as `poses`, are written out
    for the count alone.

    Args:
        function: such as `inverse_dynamics`, or one made of such functions; of a model, which has no leaves to read here, and of
            arrays of coordinates and speeds.
        model: the mechanism, specialized here; leaves that `specialize` kept are constants all the same.
        state: arrays of the shapes and types of the other arguments; their values do not matter. Left out for arguments
            called q (of size nq), u, u_dot and tau (of size nv).

    Raises:
        ValueError: an argument has another name, and no state is given; or the model is traced.
        NotImplementedError: the program has a loop or an operation that cannot be counted; the message names it.
    """
    graph, _, results = written(function, model, *state)
    kinds = dict.fromkeys(OperationCount._fields, 0)
    for operation, number in graph.count(results).items():
        kinds[_kind(operation)] += number
    return OperationCount(**kinds)


def written(function: Callable[..., Any], model: Model | Specialized, *state: Any) -> Written:
    """The program of which `operation_count` counts the operations."""
    frozen = model if isinstance(model, Specialized) and not model.kept else specialize(whole(model))
    arrays = [jnp.asarray(x) for x in state] if state else _state(function, frozen)
    # A batch of one is written out; a single state would be looped over.
    program = jax.make_jaxpr(jax.vmap(functools.partial(function, frozen)))(*(x[None] for x in arrays))
    evaluator = Evaluator()
    arguments = [evaluator.variables((1, *x.shape)) for x in arrays]
    results = evaluator.run(program, arguments)
    return Written(evaluator.graph, [x for array in arguments for x in array.flat], [x for array in results for x in array.flat])


def _state(function: Callable[..., Any], model: Specialized) -> list[jax.Array]:
    sizes = {"q": model.nq, "u": model.nv, "u_dot": model.nv, "tau": model.nv}
    names = [name for name, p in inspect.signature(function).parameters.items() if p.default is p.empty][1:]
    for name in names:
        if name not in sizes:
            raise ValueError(f"operation_count does not know the size of the argument {name!r}; give the state as arrays")
    return [jnp.zeros(sizes[name], model.dtype) for name in names]


def _kind(operation: Any) -> str:
    arithmetic = {"product": "multiplications", "sum": "additions", "difference": "additions", "quotient": "divisions"}
    if isinstance(operation, Elementwise):
        return "transcendentals" if operation.primitive.name in TRANSCENDENTAL else "others"
    return arithmetic[operation]
