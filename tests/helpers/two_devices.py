"""Dynamics over two virtual devices beside one: run as a script, it prints the largest relative error of each case as JSON.

A process of its own, because the number of devices is fixed when JAX starts; one for all cases, which share what they expect.
"""

import functools
import json
import os
import warnings
from typing import Any

os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"
warnings.simplefilter("error")

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import mujoco  # noqa: E402
import numpy as np  # noqa: E402
from jax.sharding import AxisType, NamedSharding, PartitionSpec  # noqa: E402

import kanejax as kj  # noqa: E402
from kanejax import _batching  # noqa: E402
from tests import conftest as conftest  # noqa: E402  JAX's settings
from tests.helpers.mechanisms import random_states, random_tree, relative  # noqa: E402

BATCH = 2 * (_batching.CHUNK + 37)  # two chunks on each device, the second one padded
WHOLE, PARTS = PartitionSpec(), PartitionSpec("batch")
# What links have, rows of it; what all share; what speeds have.
LEAVES = ("mass", "gravity", "damping")

mj = mujoco.MjModel.from_xml_string(random_tree(5, 2, ("hinge",), chain=True))
model = kj.from_mujoco(mj)
states = [jnp.asarray(x) for x in random_states(mj, BATCH)]
models = jax.tree.map(lambda x: jnp.stack([x, 1.1 * x, 0.9 * x]), model)
direction = jax.tree.map(lambda x: jnp.cos(jnp.arange(x.size, dtype=x.dtype)).reshape(x.shape), (model, *states))

inverse, forward = (jax.vmap(f, (None, 0, 0, 0)) for f in (kj.inverse_dynamics, kj.forward_dynamics))
of_models = jax.vmap(inverse, (0, None, None, None), out_axes=1)


def gradients(dynamics):
    """Of a loss that adds up over the batch, with respect to what the batch shares and to coordinates; and the results."""

    def loss(leaves, m, *states):
        results = dynamics(m.replace(**leaves), *states)
        return jnp.sum(jnp.sin(results)), results

    def slopes(m, *states):
        return jax.grad(loss, (0, 2), has_aux=True)({name: getattr(m, name) for name in LEAVES}, m, *states)

    return slopes


def derivative(dynamics):
    """The results, and their derivatives along one direction in all arguments."""
    return lambda direction, *args: jax.jvp(dynamics, args, direction)


def of_each_model(dynamics):
    """A batch of functions that add up over a batch."""
    return jax.vmap(dynamics, (0, None, None, None))


def one_by_one(function, *batch):
    """Results for one state after the other, without a batch and on one device."""
    rows = zip(*(np.asarray(x) for x in batch), strict=True)
    return jax.tree.map(lambda *x: np.stack(x), *(function(*row) for row in rows))


def summed(slopes):
    """Gradients of the batch from those of each state."""
    (shared, of_coordinates), results = slopes
    return (jax.tree.map(lambda x: x.sum(0), shared), of_coordinates), results


def expected():
    """All that the cases are compared with."""
    slopes = jax.jit(gradients(kj.inverse_dynamics))
    several = [jax.tree.map(lambda x, i=i: x[i], models) for i in range(3)]
    each = [summed(one_by_one(functools.partial(slopes, m), *states)) for m in several]
    along = jax.jit(derivative(kj.inverse_dynamics))
    of_forward = functools.partial(jax.jit(gradients(kj.forward_dynamics)), model)
    return {
        "gradients": each[0],
        "derivatives": one_by_one(lambda *x: along((direction[0], *x[:3]), model, *x[3:]), *direction[1:], *states),
        "gradients of forward dynamics": summed(one_by_one(of_forward, *states)),
        "models by states": np.stack([results for _, results in each], 1),
        "gradients of each model": jax.tree.map(lambda *x: np.stack(x), *each),
    }


def errors(found, expected):
    """Relative to the largest number of a leaf, the largest of all leaves."""
    pairs = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    return max(relative(a, b) for a, b in pairs)


def with_shard_map(check, expected):
    """Cases for `jax.shard_map`, with and without its checks of types."""
    mesh = jax.make_mesh((2,), ("batch",), axis_types=(AxisType.Auto,))
    split = functools.partial(jax.shard_map, mesh=mesh, in_specs=(WHOLE, PARTS, PARTS, PARTS), check_vma=check)
    over = split(inverse, out_specs=PARTS)
    found: dict[str, Any] = {"derivatives": jax.jit(derivative(over))(direction, model, *states)}
    cases = {}
    if check:
        values, two = expected["gradients"][1], [x[:2] for x in states]
        one_each, over_models = split(_first, out_specs=PARTS), split(of_models, out_specs=PARTS)
        inside = split(gradients(inverse), out_specs=((WHOLE, PARTS), PARTS))
        found |= {
            "gradients": jax.jit(gradients(over))(model, *states),
            "gradients of forward dynamics": jax.jit(gradients(split(forward, out_specs=PARTS)))(model, *states),
            "models by states": jax.jit(over_models)(models, *states),
            "gradients of each model": jax.jit(of_each_model(gradients(over)))(models, *states),
        }
        cases = {
            "without jit": errors(over(model, *states), values),
            "one state a device": errors(jax.jit(one_each)(model, *two), values[:2]),
            "gradients inside": errors(jax.jit(inside)(model, *states), expected["gradients"]),
        }
    return cases | {case: errors(result, expected[case]) for case, result in found.items()}


def with_jit(kind, expected):
    """Cases for `jax.jit` of arrays that are split over a mesh; with an explicit one the results are, too."""
    mesh = jax.make_mesh((2,), ("batch",), axis_types=(kind,))
    here = jax.device_put(model, NamedSharding(mesh, WHOLE)), *jax.device_put(states, NamedSharding(mesh, PARTS))
    several = jax.device_put(models, NamedSharding(mesh, WHOLE)), *here[1:]
    # Without it JAX 0.12 differentiates no loop over rows of a leaf that is on an explicit mesh.
    with jax.set_mesh(mesh):
        program = jax.jit(inverse).lower(*here).compile()
        found, slopes, nested = program(*here), jax.jit(gradients(inverse))(*here), jax.jit(of_models)(*several)
    cases = {
        "values": errors(found, expected["gradients"][1]),
        "gradients": errors(slopes, expected["gradients"]),
        "models by states": errors(nested, expected["models by states"]),
    }
    if kind is AxisType.Explicit:
        parts = [*found.addressable_shards, *slopes[0][1].addressable_shards]
        cases["results in parts"] = float(any(len(part.data) != BATCH // 2 for part in parts))
        text = program.as_text() or "all-gather"
        cases["no traffic"] = float(any(name in text for name in ("all-gather", "all-reduce", "all-to-all", "collective-permute")))
    return cases


def _first(m, q, u, u_dot):
    """Inverse dynamics of one state, outside of `jax.vmap`."""
    return kj.inverse_dynamics(m, q[0], u[0], u_dot[0])[None]


CASES = {
    "checked": functools.partial(with_shard_map, True),
    "unchecked": functools.partial(with_shard_map, False),
    "auto": functools.partial(with_jit, AxisType.Auto),
    "explicit": functools.partial(with_jit, AxisType.Explicit),
}

if __name__ == "__main__":
    known = expected()
    print(json.dumps({how: cases(known) for how, cases in CASES.items()}))
