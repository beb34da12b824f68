"""Batches over two processes with two virtual devices each, beside one device: `python two_processes.py PORT PROCESS`.

The first process prints the largest relative error of each case as JSON. Programs of two processes, as on a cluster: all
that differs there is how they find each other.
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
import numpy as np  # noqa: E402
from jax.experimental.multihost_utils import process_allgather  # noqa: E402

import kanejax as kj  # noqa: E402
from tests import conftest as conftest  # noqa: E402  JAX's settings
from tests.helpers.mechanisms import random_tree, relative  # noqa: E402

ROWS = 8
TS = np.linspace(0.0, 0.2, 3)


def simulated(model, q, u):
    """Ends of adaptive simulations."""
    return jax.vmap(lambda q, u: kj.simulate(model, q, u, TS).q[-1])(q, u)


def simulation_loss(model, q, u):
    """What a fit of simulated motion adds up."""
    return jnp.mean(simulated(model, q, u) ** 2)


def signal_loss(model, q, u):
    """What a fit of inverse dynamics adds up."""
    return jnp.mean(jnp.sin(jax.vmap(kj.inverse_dynamics, (None, 0, 0, 0))(model, q, u, u)) ** 2)


def normal_equations(model, q, u):
    """Of linear least squares for inertia parameters."""
    rows = jax.vmap(kj.regressor, (None, 0, 0, 0))(model, q, u, u).reshape(ROWS, model.nv, -1)
    return jnp.einsum("sji,sjk->ik", rows, rows)


def optimal_costs(model, q, u):
    """Of motions from rest to rest."""

    def cost(q, u):
        return kj.optimal_motion(kj.MotionTask(model, q, q + 0.1 * u, 0.5, kj.costs.torque(), steps=2)).cost

    return jax.vmap(cost)(q, u)


CASES = {
    "simulation": simulated,
    "gradient of simulations": jax.grad(simulation_loss),
    "gradient of inverse dynamics": jax.grad(signal_loss),
    "normal equations": normal_equations,
    "optimal costs": optimal_costs,
}


def main(port: str, process: int) -> None:
    """Compute all cases on the mesh, and once more alone."""
    jax.distributed.initialize(f"localhost:{port}", 2, process)
    random = np.random.default_rng(0)
    model = kj.load(random_tree(3, 1, ("hinge",), chain=True))
    states = random.normal(size=(2, ROWS, model.nv))
    mesh = kj.batch_mesh()
    assert mesh.size == 4
    own = slice(process * ROWS // 2, (process + 1) * ROWS // 2)
    placed = kj.shard_batch((states[0][own], states[1][own]), mesh, local=True)
    errors = {}
    for name, function in CASES.items():
        found = jax.jit(function)(kj.replicate(model, mesh), *placed)
        together = jax.tree.map(functools.partial(process_allgather, tiled=True), found)
        if process == 0:
            alone = jax.jit(function)(model, *states)
            pairs = zip(jax.tree.leaves(together), jax.tree.leaves(alone), strict=True)
            errors[name] = max(relative(a, b) for a, b in pairs if np.size(b))
    if process == 0:
        print(json.dumps(errors))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
