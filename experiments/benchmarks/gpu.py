"""Inverse-dynamics evaluations a second on JAX's first device, float32, at batches that fill a GPU.

Runs without mujoco and without the loader: `--write-model PATH` here, `--model PATH` there. As a file of its own:
`python experiments/benchmarks/gpu.py --model arm.json`, with the repository on the path.
"""

import argparse
import dataclasses
import importlib.util
import json
import statistics
import sys
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def prepare_import() -> None:
    """Make kanejax's modules importable: without mujoco, the package's own __init__, which loads the loader, is passed over."""
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
    if importlib.util.find_spec("mujoco") is None and "kanejax" not in sys.modules:
        package = types.ModuleType("kanejax")
        package.__path__ = [str(ROOT / "kanejax")]
        sys.modules["kanejax"] = package


prepare_import()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

from kanejax._dynamics.equations_of_motion import forward_dynamics, inverse_dynamics  # noqa: E402
from kanejax._model.model import Model  # noqa: E402
from kanejax._model.tree import Tree  # noqa: E402

FUNCTIONS: dict[str, Callable] = {"inverse": inverse_dynamics, "forward": forward_dynamics}
TARGET = 1e9


def run(quick: bool) -> None:
    """With the arm of the other benchmarks, and their kind of report."""
    from experiments.benchmarks import robots
    from experiments.benchmarks.harness import Table, report

    on_gpu = jax.devices()[0].platform != "cpu"
    rows = measure(robots.iiwa14().model, [20, 22, 24] if on_gpu and not quick else [16, 18], 5)
    report("gpu", [Table(f"Evaluations a second, iiwa14, float32, {jax.devices()[0].device_kind}", HEADERS, rows)])


HEADERS = ("", "batch", "first call, s", "ms a call", "ns an evaluation", "evaluations a second", "GB/s of states", "target")


def measure(model: Model, exponents: list[int], rounds: int) -> list[tuple]:
    """Rows of the table for batches of powers of two."""
    model = model.astype("float32")
    rows = []
    for name, call in _variants().items():
        for exponent in exponents:
            batch = 2**exponent
            keys = jax.random.split(jax.random.key(0), 3)
            state = [jax.random.uniform(key, (batch, model.nv), jnp.float32, -1.5, 1.5) for key in keys]
            first, seconds = _time(call, (model, *state), rounds)
            rate = batch / seconds
            # Three arrays are read and one is written.
            traffic = 16 * model.nv * rate / 1e9
            verdict = f">= {TARGET:.0e} {'ok' if rate >= TARGET else 'MISSED'}" if name.startswith("inverse") else ""
            rows.append((name, batch, first, 1e3 * seconds, 1e9 / rate, f"{rate:.2e}", traffic, verdict))
    return rows


def _variants() -> dict[str, Callable]:
    """Functions with the batch on the first axis, as the public API has it."""
    variants = {name: jax.jit(jax.vmap(function, (None, 0, 0, 0))) for name, function in FUNCTIONS.items()}

    def weighted(model: Model, q: jax.Array, u: jax.Array, u_dot: jax.Array) -> jax.Array:
        return jnp.sum(inverse_dynamics(model, q, u, u_dot))

    variants["gradient of inverse"] = jax.jit(jax.vmap(jax.grad(weighted, (1, 2, 3)), (None, 0, 0, 0)))
    return variants


def _time(call: Callable, arguments: tuple, rounds: int) -> tuple[float, float]:
    """Seconds of the first call, and the median of the later ones."""
    times = []
    for _ in range(rounds + 2):
        start = time.perf_counter()
        jax.block_until_ready(call(*arguments))
        times.append(time.perf_counter() - start)
    return times[0], statistics.median(times[2:])


def write_model(model: Model, path: Path) -> None:
    """Write the tree and the leaves as JSON."""
    names = [field.name for field in dataclasses.fields(model) if field.name != "tree"]
    leaves = {name: np.asarray(getattr(model, name), float).tolist() for name in names}
    path.write_text(json.dumps({"tree": dataclasses.asdict(model.tree), "leaves": leaves}, indent=1) + "\n")


def read_model(path: Path) -> Model:
    """Read what `write_model` wrote; leaves are float32."""
    record: dict[str, Any] = json.loads(path.read_text())
    tree = Tree(**{name: tuple(values) for name, values in record["tree"].items()})
    return Model(tree=tree, **{name: jnp.asarray(values, jnp.float32) for name, values in record["leaves"].items()})


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write-model", type=Path, help="write the arm to this file, and stop")
    parser.add_argument("--model", type=Path, help="read the arm from this file")
    parser.add_argument("--exponents", type=int, nargs="+", default=[20, 22, 24], help="batches are these powers of two")
    parser.add_argument("--output", type=Path, help="write the results as JSON")
    arguments = parser.parse_args()
    if arguments.write_model:
        from experiments.benchmarks import robots

        write_model(robots.iiwa14().model, arguments.write_model)
        return
    if arguments.model is None:
        parser.error("give --model, or --write-model on a machine with the peers")
    rows = measure(read_model(arguments.model), arguments.exponents, 10)
    device = jax.devices()[0].device_kind
    print(f"{device}, jax {jax.__version__}\n")
    for row in (HEADERS, ["-"] * len(HEADERS), *rows):
        print("| " + " | ".join(f"{x:.4g}" if isinstance(x, float) else str(x) for x in row) + " |")
    if arguments.output:
        record = {"device": device, "jax": jax.__version__, "headers": HEADERS, "rows": rows}
        arguments.output.write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
