"""One measurement of `scale`, in a process of its own, whose memory and devices are its own: prints JSON.

`python -m experiments.benchmarks.scale_part store COUNT FOLDER` writes a data set; `... mesh ROWS PROCESSES PROCESS PORT` simulates
as many trajectories on each of the devices that XLA_FLAGS asks for; `... disk FOLDER` writes chunks with nothing to simulate.
"""

import json
import os
import resource
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np

import kanejax as kj
from experiments.benchmarks import robots
from experiments.benchmarks.harness import SEED

TS = np.linspace(0.0, 1.0, 11)
CHUNK = 1024


def study(count: int) -> Any:
    """Swings of an arm of seven joints with randomised links and friction, from anywhere."""
    parameters = {"density": kj.Randomized(), "damping": kj.Randomized(kj.distributions.Uniform(0.0, 1.0), "added")}
    return kj.Study(robots.iiwa14().model, TS, count, parameters=parameters, seed=SEED)


def store(count: int, folder: Path) -> dict[str, Any]:
    """Seconds and memory of a data set, after a small one that compiles."""
    begun = time.perf_counter()
    kj.write_study(study(256), folder / "small.zarr", chunk=CHUNK)
    first, peak = time.perf_counter() - begun, _peak()
    begun = time.perf_counter()
    kj.write_study(study(count), folder / "runs.zarr", chunk=CHUNK)
    seconds = time.perf_counter() - begun
    size = sum(file.stat().st_size for file in (folder / "runs.zarr").rglob("*") if file.is_file())
    return {"seconds": seconds, "first": first, "more_memory": _peak() - peak, "peak": _peak(), "size": size}


def mesh(rows: int, processes: int, process: int, port: int) -> dict[str, Any]:
    """Seconds to simulate `rows` on each device, by one program that is split over all of them."""
    if processes > 1:
        jax.distributed.initialize(f"localhost:{port}", processes, process)
    mesh = kj.batch_mesh()
    model = robots.iiwa14().model
    drawn = study(rows * mesh.size).rows(0, rows * mesh.size)
    placed = kj.shard_batch((drawn.q0, drawn.u0), mesh)
    model = kj.replicate(model, mesh)
    run = jax.jit(lambda model, q, u: jax.vmap(lambda q, u: kj.simulate(model, q, u, TS, dt0=0.01).q_end)(q, u))
    jax.block_until_ready(run(model, *placed))
    samples = []
    for _ in range(5):
        begun = time.perf_counter()
        jax.block_until_ready(run(model, *placed))
        samples.append(time.perf_counter() - begun)
    return {"seconds": statistics.median(samples), "devices": mesh.size}


def disk(folder: Path) -> dict[str, Any]:
    """Bytes a second of chunks that are written to a store, and of one file of as many bytes."""
    from kanejax._dataset.attributes import layout_of
    from kanejax._dataset.store import Store, create

    made, chunks = study(32 * CHUNK), 32
    layout = layout_of(made)
    create(folder / "disk.zarr", layout, CHUNK, {})
    opened = Store(folder / "disk.zarr", layout, CHUNK)
    random = np.random.default_rng(SEED)
    arrays = {
        name: random.integers(0, 100, (CHUNK, *array.shape[1:])).astype(array.dtype)
        for name, array in layout.items()
        if array.values is None
    }
    size = sum(array.nbytes for array in arrays.values())
    begun = time.perf_counter()
    for chunk in range(chunks):
        opened.write(chunk, arrays)
    ours = time.perf_counter() - begun
    content = b"".join(array.tobytes() for array in arrays.values())
    begun = time.perf_counter()
    for chunk in range(chunks):
        with (folder / f"plain{chunk}").open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    plain = time.perf_counter() - begun
    return {"bytes": size * chunks, "store": size * chunks / ours, "plain": size * chunks / plain}


def _peak() -> int:
    """Most memory [bytes] so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    what, *rest = sys.argv[1:]
    if what == "store":
        found = store(int(rest[0]), Path(rest[1]))
    elif what == "mesh":
        found = mesh(*map(int, rest))
    else:
        found = disk(Path(rest[0]))
    print(json.dumps(found))
