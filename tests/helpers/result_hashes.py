"""Hashes of results: run as a script, it prints them as JSON. The number of virtual devices is the first argument.

A process of its own, to compare with another one, and because the number of devices is fixed when JAX starts.
"""

import hashlib
import json
import os
import sys
import warnings

if __name__ == "__main__":
    count = sys.argv[1]
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={count}"
    warnings.simplefilter("error")

import jax
import numpy as np

import kanejax as kj
from tests import conftest as conftest  # JAX's settings
from tests.simulate.conftest import PENDULUM

TS = np.linspace(0.0, 0.4, 3)
COUNT = 64


def hash_of(tree) -> str:
    """One hash of all bits of a tree of arrays."""
    return hashlib.sha256(b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(tree))).hexdigest()


def states(count=COUNT):
    """The first of always the same random states of a pendulum."""
    rng = np.random.default_rng(0)
    q, u = rng.uniform(-1, 1, (COUNT, 2)), rng.uniform(-3, 3, (COUNT, 2))
    return q[:count], u[:count]


def results(model: kj.Model) -> dict[str, str]:
    """Hashes of what is computed once in every process."""
    batch = kj.simulate_batch(model, *states(), TS, batch_size=16, threads=2)
    return {"batch": hash_of((batch.q, batch.u, batch.stats)), "gradient": hash_of(slope(model, *states()))}


@jax.jit
def slope(model: kj.Model, q, u):
    """Gradient of a loss through a batch of trajectories, with respect to the model."""

    def loss(mass):
        heavier = model.replace(mass=mass)
        ends = jax.vmap(lambda q, u: kj.simulate(heavier, q, u, TS, dt0=0.02).q_end)(q, u)
        return (ends**2).sum()

    return jax.grad(loss)(model.mass)


if __name__ == "__main__":
    print(json.dumps(results(kj.load(PENDULUM))))
