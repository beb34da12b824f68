"""One primitive behind every public dynamics function, so that `jax.vmap` and `jax.grad` of it stay fast.

Plain vmap of a recursion evaluates each scalar for the whole batch. Beyond a few thousand states a scalar leaves the
cache, and the run time becomes that of main memory. Here the batching rule runs the recursion over chunks that stay
in the cache (on a CPU; elsewhere over the whole batch at once), with the batch as the last, contiguous axis. Derivatives are
the same primitive again: of the linearised function, and of its transpose, which recomputes what it needs for one chunk
instead of storing it for all, and adds up the gradients of what the batch shares. Many directions at one point share what
depends on the point alone, so that Jacobians cost a fraction of their columns.

What is batched are kernels and their derivatives, see `_kernels`.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from kanejax._kernels import Arrays, Fan, Function, Shapes, Tangent, copied_operands, of_shared
from kanejax._sharding import (
    call_in_parts,
    is_split,
    needs_devices,
    over_mesh,
    result_type,
    vary_alike,
)

CHUNK = 256
# Chunks of whole vectors, or LLVM takes up to ten times as long; of an odd number of 16 still twice as long.
VECTOR = 32


def call(function: Callable[..., Arrays], static: tuple, operands: Arrays) -> list[jax.Array]:
    """Evaluate `function(*static, *operands)`, a tuple of arrays, under any transformation; `static` must be hashable."""
    return _bind(*operands, kernel=Function(function, static), size=None, batched=(), summed=())


def _of_one(operands: Sequence[Any], batched: tuple) -> Shapes:
    """Shapes without the batch axis, which comes first where there is one."""
    moving = batched or (False,) * len(operands)
    return tuple(jax.ShapeDtypeStruct(x.shape[moves:], x.dtype) for x, moves in zip(operands, moving, strict=True))


def _run(*operands: jax.Array, kernel: Any, size: int | None, batched: tuple, summed: tuple, chunk: int | None) -> list[jax.Array]:
    """Evaluate a call: unbatched, or with the batch on the first axis of operands that are `batched` and results not `summed`."""
    if size is None:
        return list(kernel(*operands))
    # On one of several devices it is a part of the batch.
    size = next(len(x) for x, moves in zip(operands, batched, strict=True) if moves)
    if chunk is not None:
        chunk = max(chunk // kernel.width // VECTOR, 1) * VECTOR
    if chunk is None or size <= chunk:
        return _run_chunk(operands, kernel, size, batched, summed)
    pieces = -(-size // chunk)
    length = -(-size // (pieces * VECTOR)) * VECTOR
    pieces = -(-size // length)
    linear = kernel.linear_operands(len(operands))

    def cut(i: int, x: jax.Array) -> jax.Array:
        if spare := pieces * length - size:
            # Copies of the last state can only make numbers that it makes itself; zero cotangents keep them out of sums.
            filling = jnp.zeros_like(x[-1:]) if i in linear else x[-1:]
            x = jnp.concatenate((x, jnp.broadcast_to(filling, (spare, *x.shape[1:]))))
        return x.reshape(pieces, length, *x.shape[1:])

    rows = [cut(i, x) for i, (x, moves) in enumerate(zip(operands, batched, strict=True)) if moves]

    def piece(total: list[jax.Array], rows: list[jax.Array]) -> tuple[list[jax.Array], list[jax.Array]]:
        moving = iter(rows)
        here = [next(moving) if moves else x for x, moves in zip(operands, batched, strict=True)]
        results = _run_chunk(here, kernel, length, batched, summed)
        sums = [r for r, adds in zip(results, summed, strict=True) if adds]
        return [t + r for t, r in zip(total, sums, strict=True)], [r for r, adds in zip(results, summed, strict=True) if not adds]

    of_one = kernel.shapes(_of_one(operands, batched))
    zeros = [jnp.zeros(x.shape, x.dtype) for x, adds in zip(of_one, summed, strict=True) if adds]
    sums, columns = lax.scan(piece, zeros, rows)
    totals, columns = iter(sums), iter([c.reshape(-1, *c.shape[2:])[:size] for c in columns])
    return [next(totals) if adds else next(columns) for adds in summed]


def _run_chunk(operands: Any, kernel: Any, size: int, batched: tuple, summed: tuple) -> list[jax.Array]:
    """Evaluate with the batch moved from the first axis to the last and back."""
    inner = [jnp.moveaxis(x, 0, -1) if moves else x[..., None] for x, moves in zip(operands, batched, strict=True)]
    # Barriers keep the transpositions out of the kernel's loops, which would not vectorise with them.
    inner = lax.optimization_barrier(inner)
    for owner in copied_operands(kernel, len(inner), summed):
        if not batched[owner]:
            inner[owner] = jnp.broadcast_to(inner[owner], (*inner[owner].shape[:-1], size))
    results = lax.optimization_barrier(kernel(*inner))
    return [
        jnp.sum(r, -1) if adds else jnp.moveaxis(jnp.broadcast_to(r, (*r.shape[:-1], size)), -1, 0)
        for r, adds in zip(results, summed, strict=True)
    ]


kernel_call = Primitive("kanejax_kernel")
kernel_call.multiple_results = True
needs_devices(kernel_call)


def _bind(*operands: Any, **params: Any) -> list[jax.Array]:
    """Call the primitive."""
    return kernel_call.bind(*vary_alike(operands), **params)


@kernel_call.def_impl
def _evaluate(*operands: Any, **params: Any) -> list[jax.Array]:
    return _compiled(tuple(sorted(params.items(), key=lambda item: item[0])))(*operands)


@functools.lru_cache(maxsize=1024)
def _compiled(params: tuple) -> Callable[..., list[jax.Array]]:
    return jax.jit(functools.partial(_bind, **dict(params)))


@kernel_call.def_abstract_eval
def _shapes(*operands: Any, kernel: Any, size: int | None, batched: tuple, summed: tuple) -> list[Any]:
    of_one = kernel.shapes(_of_one(operands, batched))
    if size is None:
        return [result_type(x.shape, x.dtype, operands) for x in of_one]
    return [result_type(x.shape if adds else (size, *x.shape), x.dtype, operands) for x, adds in zip(of_one, summed, strict=True)]


def _batch(operands: tuple, dims: tuple, *, kernel: Any, size: int | None, batched: tuple, summed: tuple) -> tuple:
    length = next(x.shape[d] for x, d in zip(operands, dims, strict=True) if d is not None)
    if _is_fan(operands, dims, kernel, length):
        return _fan_out(operands, dims, length, kernel=kernel, size=size, batched=batched, summed=summed)
    if size is not None:
        return _batch_again(operands, dims, length, kernel=kernel, size=size, batched=batched, summed=summed)
    moving = tuple(d is not None for d in dims)
    first = [jnp.moveaxis(x, d, 0) if moves else x for x, d, moves in zip(operands, dims, moving, strict=True)]
    summed = (False,) * len(kernel.shapes(_of_one(first, moving)))

    def bind(operands: Sequence[Any], size: int) -> list[jax.Array]:
        return _bind(*operands, kernel=kernel, size=size, batched=moving, summed=summed)

    results = call_in_parts(bind, first, moving, length)
    return results, (0,) * len(results)


def _is_fan(operands: tuple, dims: tuple, kernel: Any, length: int) -> bool:
    """Whether these are directions at one point, so few that they fit into a chunk side by side, and on one device."""
    if isinstance(kernel, Function) or any(d is not None for d in dims[: kernel.count]):
        return False
    split = any(d is not None and is_split(x, d) for x, d in zip(operands, dims, strict=True))
    return not split and 0 < length * kernel.width <= CHUNK


def _fan_out(operands: tuple, dims: tuple, length: int, *, kernel: Any, size: int | None, batched: tuple, summed: tuple) -> tuple:
    """Directions come first for each state."""
    moving = batched or (False,) * len(operands)
    given = [x if d is None else jnp.moveaxis(x, d, int(inner)) for x, d, inner in zip(operands, dims, moving, strict=True)]
    fan = Fan(kernel, tuple(i for i, d in enumerate(dims) if d is not None), length)
    results = _bind(*given, kernel=fan, size=size, batched=batched, summed=summed)
    return results, tuple(int(size is not None and not adds) for adds in summed) if summed else (0,) * len(results)


def _batch_again(operands: tuple, dims: tuple, length: int, *, kernel: Any, size: int, batched: tuple, summed: tuple) -> tuple:
    """A batch of batches is one batch, of everything that moves in either."""
    moving = tuple(b or d is not None for b, d in zip(batched, dims, strict=True))
    flat = []
    for x, d, inner, moves in zip(operands, dims, batched, moving, strict=True):
        if moves:
            x = x[None] if d is None else jnp.moveaxis(x, d, 0)
            x = x if inner else x[:, None]
            x = jnp.broadcast_to(x, (length, size, *x.shape[2:])).reshape(length * size, *x.shape[2:])
        flat.append(x)

    def bind(operands: Sequence[Any], size: int) -> list[jax.Array]:
        return _bind(*operands, kernel=kernel, size=size, batched=moving, summed=(False,) * len(summed))

    results = call_in_parts(bind, flat, moving, length * size)
    results = [r.reshape(length, size, *r.shape[1:]) for r in results]
    return [jnp.sum(r, 1) if adds else r for r, adds in zip(results, summed, strict=True)], (0,) * len(results)


def _differentiate(primals: tuple, tangents: tuple, *, kernel: Any, size: int | None, batched: tuple, summed: tuple) -> tuple:
    results = _bind(*primals, kernel=kernel, size=size, batched=batched, summed=summed)
    varied = tuple(i for i, t in enumerate(tangents) if not isinstance(t, ad.Zero))
    moving = (*batched, *(batched[i] for i in varied)) if size is not None else ()
    derivative = Tangent(kernel, varied, len(primals))
    given = [ad.instantiate_zeros(tangents[i]) for i in varied]
    changes = _bind(*primals, *given, kernel=derivative, size=size, batched=moving, summed=summed)
    return results, changes


def _transpose(cotangents: list, *operands: Any, kernel: Any, size: int | None, batched: tuple, summed: tuple) -> list:
    unknown = [i for i, x in enumerate(operands) if ad.is_undefined_primal(x)]
    if isinstance(kernel, Function) or not all(i >= kernel.count for i in unknown):
        raise NotImplementedError(f"{kernel} is not linear in operands {unknown}")
    primals, moving = operands[: kernel.count], batched[: kernel.count]
    given = [ad.instantiate_zeros(c) for c in cotangents]
    flipped, wanted = kernel.transposed(tuple(unknown), len(operands), len(given))
    adds = ()
    if size is not None:
        moving = (*moving, *(not adds for adds in summed))
        adds = tuple(not batched[i] for i in wanted)
    results = _bind(*primals, *given, kernel=flipped, size=size, batched=moving, summed=adds)
    first = [int(size is not None and batched[i]) for i in wanted]
    results = [of_shared(kernel, i, x, axis) for i, x, axis in zip(wanted, results, first, strict=True)]
    found = dict(zip(wanted, results, strict=True))
    return [found[i] if i in unknown else None for i in range(len(operands))]


def _lowering(chunk: int | None) -> Callable[..., Any]:
    """How to compile a call, with chunks of the batch or without."""

    def lower(context: mlir.LoweringRuleContext, *operands: Any, **params: Any) -> Any:
        # Types that say over which axes numbers vary have done their work, and the loops would have to repeat them.
        types: Sequence[Any] = context.avals_in
        plain = [ShapedArray(x.shape, x.dtype) for x in types]
        evaluate = functools.partial(_run, chunk=chunk, **params)
        if params["size"] is not None:
            evaluate = over_mesh(context, evaluate, params["size"], params["batched"], params["summed"])
        return mlir.lower_fun(evaluate, multiple_results=True)(context.replace(avals_in=plain), *operands)

    return lower


batching.primitive_batchers[kernel_call] = _batch
ad.primitive_jvps[kernel_call] = _differentiate
ad.primitive_transposes[kernel_call] = _transpose
mlir.register_lowering(kernel_call, _lowering(chunk=None))
mlir.register_lowering(kernel_call, _lowering(chunk=CHUNK), platform="cpu")
