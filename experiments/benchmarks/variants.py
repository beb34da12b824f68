"""Inverse and forward dynamics by how much of the model is constant, with XLA's vectors and with those of 512 bits."""

import jax

import kanejax as kj
from experiments.benchmarks import robots
from experiments.benchmarks.harness import SEED, Candidate, Table, compare, effort, ratio, report

FUNCTIONS = {"inverse": kj.inverse_dynamics, "forward": kj.forward_dynamics}
INERTIAS = ("mass", "com", "central_inertia")
WIDE = {"xla_cpu_prefer_vector_width": 512}
BATCH = 4096


def run(quick: bool) -> None:
    """Time both functions in both data types."""
    rows = []
    for dtype in ("float32", "float64"):
        for function in FUNCTIONS:
            with jax.enable_x64(dtype == "float64"):
                timings = compare(candidates(function, dtype), effort(quick))
            for kind in ("all parameters", "inertias kept", "specialized"):
                nanoseconds = (timings[kind].nanoseconds, timings[f"{kind}, wide"].nanoseconds)
                gains = (ratio(timings, kind, f"{kind}, wide"), ratio(timings, "all parameters", kind))
                rows.append((f"{function}, {dtype}: {kind}", *nanoseconds, *gains))
    headers = ("", "ns an evaluation", "512 bits", "faster by", "over all parameters")
    report("variants", [Table(f"Constants and vector width, iiwa14, batch {BATCH}", headers, rows)])


def candidates(function: str, dtype: str) -> list[Candidate]:
    """All parameters traced, all but the inertias constant, and all constant, each with narrow and wide vectors."""
    robot = robots.iiwa14()
    x = robots.states(robot, BATCH, SEED).arrays(dtype)
    model = robot.model.astype(dtype)
    last = x.u_dot if function == "inverse" else x.tau
    models = {"all parameters": model, "inertias kept": kj.specialize(model, INERTIAS), "specialized": kj.specialize(model)}
    batched = jax.vmap(FUNCTIONS[function], (None, 0, 0, 0))
    found = []
    for kind, one in models.items():
        for label, options in ((kind, {}), (f"{kind}, wide", WIDE)):
            call = jax.jit(batched, compiler_options=options)
            found.append(Candidate(label, lambda call=call, one=one: call(one, x.q, x.u, last), BATCH))
    return found
