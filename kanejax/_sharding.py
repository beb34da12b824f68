"""What a primitive owes to arrays that are split over several devices.

In a program of several devices where XLA decides what is split, the axes of the mesh being of type `Auto`, every device
evaluates its part of the batch by the program of one device, and sums over the batch are added up at the end.
Under `jax.shard_map` operands that the devices share are cast to values of each device before the call, as JAX does it for
its own functions; the transpose of that cast is the sum over the devices. A batch that is split over an explicit axis of a mesh
is evaluated part by part, without a `shard_map` of the user's (in `jax.set_mesh`, or JAX does not differentiate all loops over the
leaves of a model).
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax import lax
from jax._src import dispatch, sharding_impls
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import mlir
from jax.sharding import AxisType, NamedSharding, PartitionSpec

# Of operands and the size of the batch.
BatchFunction = Callable[[Sequence[Any], int], list[jax.Array]]
# Of operands one by one.
ListFunction = Callable[..., list[jax.Array]]


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


def needs_devices(primitive: Primitive) -> None:
    """Have JAX say to the lowering of a primitive which devices there are."""
    dispatch.prim_requires_devices_during_lowering.add(primitive)


def over_mesh(
    context: mlir.LoweringRuleContext, function: ListFunction, size: int, batched: Sequence[bool], summed: Sequence[bool]
) -> ListFunction:
    """The same function, as one that each device of a program evaluates for its part of the batch.

    The batch is split over all axes of the mesh: what is split otherwise, XLA moves first. In programs of one device, inside of
    `jax.shard_map`, or where the devices do not divide the batch, it is the function itself.

    Args:
        context: of the lowering.
        function: of operands that have the batch first, as `batched` says; its results have it too, or are sums over it.
        size: of the batch.
        batched: which operands have the batch.
        summed: which results are sums.
    """
    axes = context.module_context.axis_context
    mesh = axes.abstract_mesh if isinstance(axes, sharding_impls.ShardingContext) else None
    if mesh is None or mesh.size == 1 or size % mesh.size or set(mesh.axis_types) != {AxisType.Auto}:
        return function
    names = mesh.axis_names

    def part(*operands: jax.Array) -> list[jax.Array]:
        return [lax.psum(x, names) if adds else x for x, adds in zip(function(*operands), summed, strict=True)]

    alike, split = PartitionSpec(), PartitionSpec(names)
    given = tuple(split if moves else alike for moves in batched)
    return jax.shard_map(part, mesh=mesh, in_specs=given, out_specs=[alike if adds else split for adds in summed], check_vma=False)
