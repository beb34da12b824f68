"""The inverse dynamics of the arm as C compiled by gcc: what a compiler makes of the same expression.

With its constants frozen, and with all parameters of the links as arguments.
"""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

import kanejax as kj
from experiments.benchmarks import peers, robots
from experiments.benchmarks.evaluation import TOLERANCE, kanejax_candidates
from experiments.benchmarks.harness import SEED, Candidate, Table, at_most, compare, effort, least_ratio, ratio, report
from experiments.benchmarks.scalar_program import Program, scalar_program

FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp")
TARGET = 1.3
INPUTS = ("q", "u", "a")


def run(quick: bool) -> None:
    """Compare with gcc on one and two threads, in three layouts."""
    if shutil.which("gcc") is None:
        print("no gcc on this machine: not measured")
        return
    rows, details = [], []
    for batch in (4096,) if quick else (4096, 65536):
        for dtype in ("float32", "float64"):
            with jax.enable_x64(dtype == "float64"):
                timings, lines = measure(dtype, batch, quick)
            details.append({"batch": batch, "dtype": dtype, "lines": lines, "timings": {k: t.record for k, t in timings.items()}})
            for name, timing in timings.items():
                row: tuple = (f"{batch}, {dtype}: {name}", timing.nanoseconds)
                special = "kanejax specialized" if "kanejax specialized" in timings else "kanejax"
                times = ratio(timings, special, name)
                verdict = at_most(times, TARGET) if "1 thread" in name and "frozen" in name else ""
                rows.append((*row, times, least_ratio(timings, special, name), verdict))
    own = "specialized kanejax" if special == "kanejax specialized" else "kanejax"
    report("gcc", [Table("Inverse dynamics, iiwa14, as C", ("", "ns", f"{own} over it", "least/least", "target"), rows)], details)


def measure(dtype: str, batch: int, quick: bool) -> tuple[dict, dict]:
    """Time C and kanejax on the same states, once they agree."""
    robot = robots.iiwa14()
    at = robots.states(robot, batch, SEED)
    candidates = kanejax_candidates("inverse", robot, at, dtype)
    reference = np.asarray(candidates[0].run(), float)
    frozen, traced = inverse_program(robot, dtype, True), inverse_program(robot, dtype, False)
    for label, program, layout in (
        ("frozen, columns", frozen, "columns"),
        ("frozen, rows", frozen, "rows"),
        ("frozen, rows in blocks", frozen, "blocks"),
        ("traced, rows in blocks", traced, "blocks"),
    ):
        function = compiled(program, robot.model.nv, layout)
        for threads in (1, peers.THREADS):
            call, result = bound(function, at, np.array(program.parameters, dtype), layout, threads)
            call()
            name = f"gcc {label}, {threads} thread{'s' * (threads > 1)}"
            peers.verify(name, result.T if layout == "columns" else result, reference, TOLERANCE[dtype])
            candidates.append(Candidate(name, call, batch))
    return compare(candidates, effort(quick)), {"frozen": len(frozen.lines), "traced": len(traced.lines)}


def inverse_program(robot: robots.Robot, dtype: str, frozen: bool) -> Program:
    """The recursion, its loop over the links unrolled."""
    model = robot.model.astype(dtype)

    def inverse(q: jax.Array, u: jax.Array, a: jax.Array) -> jax.Array:
        return kj.inverse_dynamics(model, q, u, a)

    return scalar_program(inverse, dtype, dict.fromkeys(INPUTS, robot.model.nv), frozen)


def compiled(program: Program, size: int, layout: str) -> Callable:
    """Compile the program over a batch.

    `columns` has one contiguous array a scalar, `rows` one row a state, as the public API; `blocks` has rows, and turns
    some of them at a time into columns, as the public API does inside.
    """
    place = {"columns": "{k} * n + i", "rows": "i * {size} + {k}", "blocks": "[{k}][i]"}[layout]
    places = [place.format(k=k, size=size) for k in range(size)]
    if layout == "blocks":
        loads = [f"const T {name}{k} = {name}_{places[k]};" for name in INPUTS for k in range(size)]
        stores = [f"out_{places[k]} = {program.literal(x)};" for k, x in enumerate(program.results[0])]
    else:
        loads = [f"const T {name}{k} = {name}[{places[k]}];" for name in INPUTS for k in range(size)]
        stores = [f"out[{places[k]}] = {program.literal(x)};" for k, x in enumerate(program.results[0])]
    loads += [f"const T p{k} = p[{k}];" for k in range(len(program.parameters))]
    body = "\n      ".join([*loads, *program.lines, *stores])
    each = f"for (long i = 0; i < m; i++) for (int k = 0; k < {size}; k++)"
    turns = "\n    ".join(f"{each} {name}_[k][i] = {name}[(start + i) * {size} + k];" for name in INPUTS)
    blocks = f"""
  #pragma omp parallel for num_threads(threads) schedule(static)
  for (long start = 0; start < n; start += BLOCK) {{
    T {", ".join(f"{name}_[{size}][BLOCK]" for name in (*INPUTS, "out"))};
    const long m = n - start < BLOCK ? n - start : BLOCK;
    {turns}
    #pragma omp simd
    for (long i = 0; i < m; i++) {{
      {body}
    }}
    {each} out[(start + i) * {size} + k] = out_[k][i];
  }}"""
    whole = f"""
  #pragma omp parallel for simd num_threads(threads) schedule(static)
  for (long i = 0; i < n; i++) {{
      {body}
  }}"""
    source = f"""#include <math.h>
#define T {program.type}
#define BLOCK 256
// The guard of sines and cosines against huge arguments: there are none.
#define guard 1
void run(long n, int threads, {", ".join(f"const T *restrict {name}" for name in (*INPUTS, "p"))}, T *restrict out) {{
{blocks if layout == "blocks" else whole}
}}
"""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        (path / "program.c").write_text(source)
        subprocess.run(["gcc", *FLAGS, "-fPIC", "-shared", "program.c", "-o", "program.so", "-lm"], cwd=path, check=True)
        return ctypes.CDLL(str(path / "program.so")).run


def bound(function: Callable, at: robots.States, parameters: np.ndarray, layout: str, threads: int) -> tuple[Callable, np.ndarray]:
    """The call on given states, and the array it writes."""
    arrays = [np.ascontiguousarray((x.T if layout == "columns" else x).astype(parameters.dtype)) for x in (at.q, at.u, at.u_dot)]
    result = np.zeros_like(arrays[1])
    pointers = [ctypes.c_void_p(x.ctypes.data) for x in (*arrays, parameters, result)]

    def call(keep: list = [*arrays, parameters, result]) -> None:  # noqa: B006
        function(ctypes.c_long(len(at.q)), ctypes.c_int(threads), *pointers)

    return call, result
