"""From a JAX function of a few numbers to C: its jaxpr, scalar by scalar, loops unrolled, everything that is known folded."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

# A C expression for each elementwise operation; {T} is the floating-point type, {S} the suffix of its functions.
OPERATIONS = {
    "add": "{0} + {1}",
    "add_any": "{0} + {1}",
    "sub": "{0} - {1}",
    "mul": "{0} * {1}",
    "div": "{0} / {1}",
    "neg": "-{0}",
    "sin": "sin{S}({0})",
    "cos": "cos{S}({0})",
    "sqrt": "sqrt{S}({0})",
    "rsqrt": "1 / sqrt{S}({0})",
    "square": "{0} * {0}",
    "abs": "fabs{S}({0})",
    "round": "rint{S}({0})",
    "and": "{0} & {1}",
    "eq": "{0} == {1}",
    "lt": "{0} < {1}",
    "gt": "{0} > {1}",
    "select_n": "{0} ? {2} : {1}",
}
INLINED = ("jit", "pjit", "custom_jvp_call", "custom_vjp_call", "closed_call", "core_call")
# Operations that only move numbers, and which operands hold them; the others are indices. None: all.
MOVES: dict[str, tuple[int, ...] | None] = {
    **dict.fromkeys(("slice", "squeeze", "reshape", "broadcast_in_dim", "transpose", "rev", "copy"), (0,)),
    **dict.fromkeys(("gather", "dynamic_slice", "split"), (0,)),
    **dict.fromkeys(("concatenate", "stack"), None),
    "dynamic_update_slice": (0, 1),
    "scatter": (0, 2),
}
# Parameters this close to -1, 0 or 1 are what a quarter turn leaves of them.
ROUNDING = 1e-7


class Program:
    """Lines of C, each `type name = expression;`, and the scalars of the results: names or numbers.

    Unless `frozen`, the known operands of kanejax's kernels are variables p0, p1, ..., with their values in `parameters`.
    """

    def __init__(self, dtype: str, frozen: bool) -> None:
        self.type = {"float64": "double", "float32": "float"}[dtype]
        self.frozen = frozen
        self.parameters: list[float] = []
        self.lines: list[str] = []
        self.results: list[np.ndarray] = []

    def emit(self, template: str, operands: list[Any], kind: str) -> str:
        """Add a line; return the name of its value."""
        name = f"t{len(self.lines)}"
        suffix = "f" if self.type == "float" else ""
        expression = template.format(*(self.literal(x) for x in operands), T=self.type, S=suffix)
        self.lines.append(f"const {kind} {name} = {expression};")
        return name

    def literal(self, x: Any) -> str:
        """A name, or a number in C."""
        if isinstance(x, str):
            return x
        if isinstance(x, bool | np.bool_ | int | np.integer):
            return str(int(x))
        return f"({self.type})({float(x)!r})"


def scalar_program(function: Callable, dtype: str, inputs: dict[str, int], frozen: bool = True) -> Program:
    """Trace `function` of one vector for each of `inputs`, name and size, and write it out; `q[3]` becomes q3."""
    program = Program(dtype, frozen)
    closed = jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct((size,), dtype) for size in inputs.values()))
    arguments = [np.array([f"{name}{i}" for i in range(size)], object) for name, size in inputs.items()]
    program.results = _evaluate(program, closed.jaxpr, closed.consts, arguments)
    return program


def _evaluate(program: Program, jaxpr: Any, constants: list, arguments: list[np.ndarray]) -> list[np.ndarray]:
    values: dict[Any, np.ndarray] = {}

    def read(atom: Any) -> np.ndarray:
        return values[atom] if not hasattr(atom, "val") else _known(atom.val)

    values.update(zip(jaxpr.constvars, map(_known, constants), strict=True))
    values.update(zip(jaxpr.invars, arguments, strict=True))
    for equation in jaxpr.eqns:
        results = _apply(program, equation, [read(atom) for atom in equation.invars])
        values.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _known(value: Any) -> np.ndarray:
    array = np.asarray(value)
    known = np.empty(array.shape, object)
    known[...] = array.tolist() if array.shape else array.item()
    return known


def _is_known(array: np.ndarray) -> bool:
    return not any(isinstance(x, str) for x in array.flat)


def _apply(program: Program, equation: Any, operands: list[np.ndarray]) -> list[np.ndarray]:
    name, params = equation.primitive.name, equation.params
    shapes = [variable.aval for variable in equation.outvars]
    if name in INLINED:
        inner = params.get("jaxpr", params.get("call_jaxpr"))
        return _evaluate(program, getattr(inner, "jaxpr", inner), getattr(inner, "consts", []), operands)
    if name == "optimization_barrier":
        return operands
    if name == "platform_index":
        # The branches of lax.platform_dependent: the one for the CPU.
        return [_known(next(i for i, platforms in enumerate(params["platforms"]) if platforms is None or "cpu" in platforms))]
    if name == "cond":
        # The guard of sines and cosines against huge arguments is left out: the last branch is the one for "true".
        index = operands[0].item()
        branch = params["branches"][index if isinstance(index, int) else -1]
        return _evaluate(program, branch.jaxpr, branch.consts, operands[1:])
    if name in ("reduce_and", "reduce_or"):
        return [np.full(shapes[0].shape, "guard", object)]
    if name == "scan":
        return _unroll(program, equation, operands)
    if name == "kanejax_kernel":
        operands = [_parameters(program, x) for x in operands]
        inner = jax.make_jaxpr(params["kernel"])(*(atom.aval for atom in equation.invars))
        return _evaluate(program, inner.jaxpr, inner.consts, operands)
    if all(_is_known(x) for x in operands):
        avals = [atom.aval for atom in equation.invars]
        arrays = [jnp.asarray(x.tolist(), aval.dtype).reshape(aval.shape) for x, aval in zip(operands, avals, strict=True)]
        results = equation.primitive.bind(*arrays, **params)
        return [_known(x) for x in (results if equation.primitive.multiple_results else [results])]
    if name in MOVES:
        return _move(equation, operands)
    if name in ("convert_element_type", "integer_pow"):
        exponent = params.get("y", 1)
        template = " * ".join(["{0}"] * exponent) if exponent > 1 else ("(" + _kind(program, shapes[0].dtype) + ")({0})")
    else:
        template = OPERATIONS[name]
    kind = _kind(program, shapes[0].dtype)
    folded = np.vectorize(lambda *x: _fold(program, name, template, list(x), kind), otypes=[object])
    return [np.asarray(folded(*operands), object)]


def _kind(program: Program, dtype: Any) -> str:
    return program.type if jnp.issubdtype(dtype, jnp.floating) else "int"


def _parameters(program: Program, operand: np.ndarray) -> np.ndarray:
    """An operand of a kernel, if it is known: rounded, or as variables."""
    if program.frozen or not _is_known(operand):
        return np.asarray(np.vectorize(_rounded, otypes=[object])(operand), object)
    names = [f"p{len(program.parameters) + i}" for i in range(operand.size)]
    program.parameters += operand.reshape(-1).tolist()
    return np.array(names, object).reshape(operand.shape)


def _rounded(x: Any) -> Any:
    if isinstance(x, str) or abs(x - round(x)) > ROUNDING or abs(x) > 2:
        return x
    return float(round(x))


def _unroll(program: Program, equation: Any, operands: list[np.ndarray]) -> list[np.ndarray]:
    """Write out a scan, turn by turn."""
    params, body = equation.params, equation.params["jaxpr"]
    # The carry keeps its rank in the body, what is scanned over loses an axis.
    kept = sum(a.aval.ndim == b.aval.ndim for a, b in zip(equation.outvars, body.jaxpr.outvars, strict=True))
    first = sum(a.aval.ndim == b.aval.ndim for a, b in zip(equation.invars, body.jaxpr.invars, strict=True))
    fixed, carry, rows = operands[: first - kept], operands[first - kept : first], operands[first:]
    length = params["length"]
    collected: list[list[np.ndarray]] = [[]] * length
    for i in reversed(range(length)) if params["reverse"] else range(length):
        here = [np.asarray(x[i], object) for x in rows]
        results = _evaluate(program, body.jaxpr, body.consts, [*fixed, *carry, *here])
        carry, collected[i] = results[: len(carry)], results[len(carry) :]
    return [*carry, *(_stacked(x) for x in zip(*collected, strict=True))]


def _stacked(rows: tuple[np.ndarray, ...]) -> np.ndarray:
    whole = np.empty((len(rows), *rows[0].shape), object)
    for i, row in enumerate(rows):
        whole[i] = row if row.ndim else row.item()
    return whole


def _fold(program: Program, name: str, template: str, x: list[Any], kind: str) -> Any:
    if name == "mul" and any(not isinstance(f, str) and f == 0 for f in x):
        return 0.0
    for i, other in ((0, 1), (1, 0)):
        if name in ("mul", "add", "add_any") and not isinstance(x[i], str) and x[i] == (1 if name == "mul" else 0):
            return x[other]
    if name == "select_n" and not isinstance(x[0], str):
        return x[1 + int(x[0])]
    if name == "sub" and not isinstance(x[1], str) and x[1] == 0:
        return x[0]
    return program.emit(template, x, kind)


def _move(equation: Any, operands: list[np.ndarray]) -> list[np.ndarray]:
    """An operation that only moves numbers: carried out on their indices."""
    held = MOVES[equation.primitive.name]
    held = tuple(range(len(operands))) if held is None else held
    pool = np.concatenate([operands[i].reshape(-1) for i in held])
    arguments, start = [], 0
    for i, x in enumerate(operands):
        if i in held:
            arguments.append(jnp.arange(start, start + x.size, dtype=jnp.int32).reshape(x.shape))
            start += x.size
        else:
            arguments.append(jnp.asarray(x.tolist(), jnp.int32).reshape(x.shape))
    params = {**equation.params, **({"fill_value": None} if "fill_value" in equation.params else {})}
    moved = equation.primitive.bind(*arguments, **params)
    return [np.asarray(pool[np.asarray(x)], object) for x in (moved if equation.primitive.multiple_results else [moved])]
