"""Batches over several devices and processes: a mesh of all devices, and where the arrays of a batch lie."""

import math
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

BATCH = "batch"


def batch_mesh(devices: Sequence[Any] | None = None) -> Mesh:
    """A mesh of one axis, "batch", over devices; by default all of all processes.

    The axis is of type `Auto`: under plain `jax.jit` each device then evaluates its rows of a batch, and gradients with respect to
    what all rows share are added up over the devices.

    Args:
        devices: such as `jax.local_devices()`.

    Returns:
        The mesh, for `shard_batch` and `replicate`.
    """
    devices = jax.devices() if devices is None else list(devices)
    return Mesh(np.array(devices), (BATCH,), axis_types=(AxisType.Auto,))


def shard_batch(batch: Any, mesh: Mesh, *, local: bool = False) -> Any:
    """Spread arrays over the devices of a mesh, each device getting as many rows of them as the others.

    Args:
        batch: arrays with a leading batch axis, or a pytree of them. Without `local` every process gives all rows, the same.
        mesh: from `batch_mesh`, or with any other axes, over all of which rows are spread.
        local: whether each process gives only its own rows, which together make the batch in the order of the processes.

    Returns:
        The same as arrays of JAX that lie on the mesh.

    Raises:
        ValueError: rows cannot be shared out equally.
    """
    sharding = NamedSharding(mesh, PartitionSpec(mesh.axis_names))
    parts = len(sharding.addressable_devices) if local else mesh.size
    shapes = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(batch)}
    if len(shapes) != 1 or () in shapes:
        raise ValueError(f"a batch needs one leading axis of the same length everywhere, but has {sorted(shapes)}")
    ((rows,),) = shapes
    if rows % parts:
        more = parts * math.ceil(rows / parts)
        raise ValueError(f"{rows} rows cannot be shared out equally to {parts} devices; give {rows - rows % parts} or {more}")

    def placed(leaf: Any) -> jax.Array:
        if local:
            return jax.make_array_from_process_local_data(sharding, np.asarray(leaf))
        return jax.make_array_from_callback(np.shape(leaf), sharding, lambda index: np.asarray(leaf[index]))

    return jax.tree.map(placed, batch)


def replicate(shared: Any, mesh: Mesh) -> Any:
    """Copy what all rows share, such as a model, to each device of a mesh; every process gives the same.

    Args:
        shared: arrays, or a pytree of them.
        mesh: from `batch_mesh`, or any other.

    Returns:
        The same as arrays of JAX that lie on the mesh.
    """
    sharding = NamedSharding(mesh, PartitionSpec())

    def placed(leaf: Any) -> jax.Array:
        return jax.make_array_from_callback(np.shape(leaf), sharding, lambda index: np.asarray(leaf)[index])

    return jax.tree.map(placed, shared)
