"""The same batch split over two virtual CPU devices, in a process of its own: one XLA:CPU device runs its loop on one thread.

Run as `python -m experiments.benchmarks.sharded inverse|forward float32|float64 BATCH`, with
XLA_FLAGS=--xla_force_host_platform_device_count=2; prints JSON.
"""

import json
import sys
from collections.abc import Callable
from typing import Any

import jax
from jax.sharding import NamedSharding, PartitionSpec

import kanejax as kj
from experiments.benchmarks import peers, robots
from experiments.benchmarks.evaluation import ratios
from experiments.benchmarks.harness import SEED, Candidate, compare, effort

FUNCTIONS = {"inverse": kj.inverse_dynamics, "forward": kj.forward_dynamics}


def split(function: Callable, model: Any, state: tuple) -> tuple[Callable, tuple]:
    """The batched function over all devices, and its arguments where it wants them."""
    mesh = jax.make_mesh((jax.device_count(),), ("batch",))
    whole, parts = PartitionSpec(), PartitionSpec("batch")
    batched = jax.vmap(function, (None, 0, 0, 0))
    specs = (whole, *(parts for _ in state))
    mapped = jax.jit(jax.shard_map(batched, mesh=mesh, in_specs=specs, out_specs=parts))
    placed = jax.device_put(model, NamedSharding(mesh, whole)), *(jax.device_put(x, NamedSharding(mesh, parts)) for x in state)
    return mapped, placed


def main(function: str, dtype: str, batch: int, quick: bool) -> dict[str, Any]:
    """Time one device, two devices and Pinocchio."""
    jax.config.update("jax_enable_x64", dtype == "float64")
    robot = robots.iiwa14()
    at = robots.states(robot, batch, SEED)
    x = at.arrays(dtype)
    state = (x.q, x.u, x.u_dot if function == "inverse" else x.tau)
    model = robot.model.astype(dtype)
    one = jax.jit(jax.vmap(FUNCTIONS[function], (None, 0, 0, 0)))
    two, placed = split(FUNCTIONS[function], model, state)
    peer = peers.pinocchio(robot, at)
    candidates = [
        Candidate("kanejax", lambda: two(*placed), batch),
        Candidate("kanejax on one of them", lambda: one(model, *state), batch),
        Candidate(peer.name, getattr(peer, function), batch),
    ]
    if hasattr(kj, "specialize"):
        frozen = kj.specialize(model)
        special, placed_state = split(lambda _, *rest: FUNCTIONS[function](frozen, *rest), (), state)
        candidates.append(Candidate("kanejax specialized", lambda: special(*placed_state), batch))
    reference = candidates[0].run()
    for candidate in candidates[1:]:
        peers.verify(candidate.name, candidate.run(), reference, 2e-4 if dtype == "float32" else 1e-9)
    return ratios(compare(candidates, effort(quick)))


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1], sys.argv[2], int(sys.argv[3]), "--quick" in sys.argv)))
