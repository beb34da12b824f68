"""What a primitive owes to arrays that are split over several devices, whose types say so.

Under `jax.shard_map` operands that the devices share are cast to values of each device before the call, as JAX does it for
its own functions; the transpose of that cast is the sum over the devices. A batch that is split over an explicit axis of a mesh
is evaluated part by part, without a `shard_map` of the user's (in `jax.set_mesh`, or JAX does not differentiate all loops over the
leaves of a model). Over an axis of type `Auto` types say nothing and only `shard_map` splits the work: there `jax.jit` alone
gathers the batch, and every device computes all of it.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax import lax
from jax.core import ShapedArray
from jax.sharding import NamedSharding, PartitionSpec

# Of operands and the size of the batch.
BatchFunction = Callable[[Sequence[Any], int], list[jax.Array]]


def vary_alike(operands: Sequence[Any]) -> list[Any]:
    """Operands that all vary over every axis of `jax.shard_map` over which one of them does."""
    types = [jax.typeof(x).manual_axis_type for x in operands]
    axes = frozenset[Any]().union(*(t.varying | t.reduced | t.unreduced for t in types))
    alike = list(operands)
    for axis in axes:
        alike = [x if axis in t.varying else lax.pcast(x, axis, to="varying") for x, t in zip(alike, types, strict=True)]
    return alike


def result_type(shape: tuple[int, ...], dtype: Any, operands: Sequence[Any]) -> ShapedArray:
    """The type of a result: on the mesh of the operands, and varying as these do; its own axes are not split."""
    like = next((x for x in operands if not x.sharding.mesh.empty), None)
    if like is None:
        return ShapedArray(shape, dtype)
    sharding = NamedSharding(like.sharding.mesh, PartitionSpec(*(None for _ in shape)))
    return like.update(shape=shape, dtype=dtype, weak_type=False, sharding=sharding)


def is_split(operand: Any, axis: int) -> bool:
    """Whether the type of an operand says that one of its axes is split over devices."""
    spec = jax.typeof(operand).sharding.spec
    return axis < len(spec) and spec[axis] is not None


def call_in_parts(function: BatchFunction, operands: Sequence[Any], batched: Sequence[bool], size: int) -> list[jax.Array]:
    """`function(operands, size)`, whose results have the batch first, as `batched` operands have it.

    If their types say over which axes of a mesh the batch is split, each device computes its part, and the results stay split.
    """
    shardings = [jax.typeof(x).sharding for x in operands]
    split = [s for s, moves in zip(shardings, batched, strict=True) if moves and s.spec[0] is not None]
    if not split:
        return function(operands, size)
    mesh, names = split[0].mesh, split[0].spec[0]
    parts = PartitionSpec(names)
    specs = tuple(parts if moves else PartitionSpec() for moves in batched)
    placed = [jax.sharding.reshard(x, NamedSharding(mesh, spec)) for x, spec in zip(operands, specs, strict=True)]

    def part(*operands: Any) -> list[jax.Array]:
        return function(operands, next(len(x) for x, moves in zip(operands, batched, strict=True) if moves))

    axes = {names} if isinstance(names, str) else set(names)
    return jax.shard_map(part, mesh=mesh, in_specs=specs, out_specs=parts, axis_names=axes)(*placed)
