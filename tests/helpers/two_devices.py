"""Dynamics over two virtual devices beside one: run as a script, it prints the largest relative error of each case as JSON.

A process of its own, because the number of devices is fixed when JAX starts.
"""

import functools
import json
import os
import sys
import warnings

os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"
warnings.simplefilter("error")

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import mujoco  # noqa: E402
from jax.sharding import AxisType, NamedSharding, PartitionSpec  # noqa: E402

import kanejax as kj  # noqa: E402
from kanejax import _batching  # noqa: E402
from tests import conftest as conftest  # noqa: E402  JAX's settings
from tests.helpers.mechanisms import random_states, random_tree, relative  # noqa: E402

BATCH = 2 * (_batching.CHUNK + 37)  # two chunks on each device, the second one padded
WHOLE, PARTS = PartitionSpec(), PartitionSpec("batch")
ALL = (0, 1, 2, 3)

mj = mujoco.MjModel.from_xml_string(random_tree(5, 2, ("hinge", "slide")))
model = kj.from_mujoco(mj)
states = [jnp.asarray(x) for x in random_states(mj, BATCH)]
models = jax.tree.map(lambda x: jnp.stack([x, 1.1 * x, 0.9 * x]), model)
direction = jax.tree.map(lambda x: jnp.cos(jnp.arange(x.size, dtype=x.dtype)).reshape(x.shape), (model, *states))

inverse, forward = (jax.vmap(f, (None, 0, 0, 0)) for f in (kj.inverse_dynamics, kj.forward_dynamics))
of_models = jax.vmap(inverse, (0, None, None, None), out_axes=1)


def gradients(dynamics):
    """Of a loss that adds up over the batch."""
    return jax.grad(lambda *args: jnp.sum(jnp.sin(dynamics(*args))), ALL)


def gradients_of_masses(dynamics):
    """Of the same loss, with respect to what the batch shares and to what it does not, in a smaller program."""

    def loss(mass, m, *states):
        return jnp.sum(jnp.sin(dynamics(m.replace(mass=mass), *states)))

    return lambda m, *states: jax.grad(loss, (0, 2))(m.mass, m, *states)


def derivative(dynamics):
    """Along one direction in all arguments; of each result."""
    return lambda *args: jax.jvp(dynamics, args, direction)[1]


def of_each_model(dynamics):
    """A batch of functions that add up over a batch."""
    return jax.vmap(dynamics, (0, None, None, None))


def error(found, expected):
    """Relative to the largest number of a leaf, the largest of all leaves."""
    pairs = zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True)
    return max(relative(a, b) for a, b in pairs)


def with_shard_map(check):
    """Cases for `jax.shard_map`, with and without its checks of types."""
    mesh = jax.make_mesh((2,), ("batch",), axis_types=(AxisType.Auto,))
    split = functools.partial(jax.shard_map, mesh=mesh, in_specs=(WHOLE, PARTS, PARTS, PARTS), check_vma=check)
    over, over_forward = split(inverse, out_specs=PARTS), split(forward, out_specs=PARTS)
    expected = jax.jit(gradients(inverse))(model, *states)
    cases = {
        "values": error(jax.jit(over)(model, *states), inverse(model, *states)),
        "gradients": error(jax.jit(gradients(over))(model, *states), expected),
        "derivatives": error(*(jax.jit(derivative(f))(model, *states) for f in (over, inverse))),
        "gradients of forward dynamics": error(*(jax.jit(gradients_of_masses(f))(model, *states) for f in (over_forward, forward))),
    }
    if check:
        two, over_models = [x[:2] for x in states], split(of_models, out_specs=PARTS)
        one_each = split(_first, out_specs=PARTS)
        inside = split(gradients(inverse), out_specs=(WHOLE, PARTS, PARTS, PARTS))
        cases |= {
            "without jit": error(over(model, *states), inverse(model, *states)),
            "one state a device": error(jax.jit(one_each)(model, *two), inverse(model, *two)),
            "gradients inside": error(jax.jit(inside)(model, *states), expected),
            "models by states": error(*(jax.jit(f)(models, *states) for f in (over_models, of_models))),
            "gradients of each model": error(
                *(jax.jit(of_each_model(gradients_of_masses(f)))(models, *states) for f in (over, inverse))
            ),
        }
    return cases


def with_jit(kind):
    """Cases for `jax.jit` of arrays that are split over a mesh; with an explicit one the results are, too."""
    mesh = jax.make_mesh((2,), ("batch",), axis_types=(kind,))
    here = jax.device_put(model, NamedSharding(mesh, WHOLE)), *jax.device_put(states, NamedSharding(mesh, PARTS))
    several = jax.device_put(models, NamedSharding(mesh, WHOLE)), *here[1:]
    expected = inverse(model, *states), jax.jit(gradients(inverse))(model, *states), jax.jit(of_models)(models, *states)
    # Without it JAX 0.12 differentiates no loop over rows of a leaf that is on an explicit mesh.
    with jax.set_mesh(mesh):
        found, slopes, nested = jax.jit(inverse)(*here), jax.jit(gradients(inverse))(*here), jax.jit(of_models)(*several)
    pairs = zip(("values", "gradients", "models by states"), (found, slopes, nested), expected, strict=True)
    cases = {case: error(*pair) for case, *pair in pairs}
    if kind is AxisType.Explicit:
        parts = [*found.addressable_shards, *slopes[1].addressable_shards]
        cases["results in parts"] = float(any(len(part.data) != BATCH // 2 for part in parts))
        text = jax.jit(inverse).lower(*here).compile().as_text() or "all-gather"
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
    print(json.dumps(CASES[sys.argv[1]]()))
