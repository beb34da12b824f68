"""Multiplications and additions for six torques, compared with those of Nie's chapter IV, and what they cost in time.

Nie needs 672 multiplications and 404 additions for the Intelledex 605, and quotes four counts for the Stanford arm. Here the
operations are counted on programs, sines and cosines aside, in steps:

- the loop over the links, for a model whose parameters are given when it runs, once for a batch;
- written out for known parameters (`specialize`), without products with zeros and ones and sums with zeros;
- what occurs twice counted once;
- inertias regrouped into base parameters first; this is what `operation_count` finds.

Table 3 of the thesis has links with two equal moments of inertia; so each arm is counted with three different ones as well, and
the Intelledex with the four lengths that the table leaves out. What is counted once is not all computed once by the compiled
program: a value that is kept costs a load and a store. So the same three programs are timed.
"""

import collections
import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

import kanejax as kj
from experiments.benchmarks.harness import Candidate, Effort, compare, ratio
from experiments.thesis import record
from kanejax import _batching
from kanejax._expressions import Expression
from kanejax._model import links
from kanejax._operation_count import written
from kanejax._scalar import barrier, sincos
from kanejax._symbolic import CALLED, CALLS, kernel_program
from kanejax.robots import intelledex_605, rrp_arm, stanford_arm, three_revolute_arm

Pair = tuple[int, int]

NIE: Pair = (672, 404)
"""Multiplications and additions that Nie 1988, chapter IV, states for his equations."""
TORQUE: Pair = (857, 526)
"""Those in the text of his program TORQUE, Appendix 2, with its misprints corrected: squares as products, 9 divisions aside."""
STANFORD_ARM: dict[str, Pair] = {
    "Lagrange": (2195, 1719),
    "Newton-Euler, Walker and Orin": (1541, 1196),
    "Newton-Euler, Hollerbach; Lagrange, Silver": (852, 738),
    "Kane and Levinson 1983, by hand": (646, 394),
}
"""For the Stanford arm: Kane and Levinson 1983, as Nie 1988, chapter IV, quotes them."""
STEPS = ("loop over the links", "written out, zeros and ones left out", "and repetitions merged", "and inertias regrouped")
FUNCTIONS = (kj.inverse_dynamics, kj.forward_dynamics, kj.mass_matrix)
BATCH = 4096
KINDS = {"mul": 0, "integer_pow": 0, "square": 0, "add": 1, "add_any": 1, "sub": 1}


def arms() -> dict[str, kj.Model]:
    """The arms of `kanejax.robots`, with the inertias of their sources and with generic ones."""
    return {
        "intelledex_605": intelledex_605(),
        "intelledex_605, generic": generic(intelledex_605()),
        "intelledex_605, all lengths": generic(intelledex_605(l33=0.05, l43=0.08, l52=0.03, l63=0.12)),
        "stanford_arm": stanford_arm(),
        "stanford_arm, generic": generic(stanford_arm()),
        "three_revolute_arm": three_revolute_arm(),
        "rrp_arm": rrp_arm(load="fused"),
    }


def generic(model: kj.Model) -> kj.Model:
    """The same with three different central principal moments of inertia for each link, and the mass centres where they are."""
    second = np.random.default_rng(record.SEED).uniform(0.01, 0.2, (model.nbody, 3))
    moments = second.sum(1, keepdims=True) - second
    return model.replace(central_inertia=jnp.asarray(moments[:, :, None] * np.eye(3)))


@contextmanager
def not_regrouped() -> Iterator[None]:
    """Within, models are specialized with the inertias of the links as they are."""
    with mock.patch.object(links, "regroup", lambda tree, placements, moments, upright=(): moments):
        yield


def steps(model: kj.Model) -> dict[str, Pair]:
    """Multiplications and additions of inverse dynamics after each step."""
    with not_regrouped():
        plain = as_coded(kj.specialize(model)), kj.operation_count(kj.inverse_dynamics, model)[:2]
    counts = (as_coded(model), *plain, kj.operation_count(kj.inverse_dynamics, model)[:2])
    return dict(zip(STEPS, counts, strict=True))


def as_coded(model: kj.Model | kj.Specialized) -> Pair:
    """Multiplications and additions in the program of inverse dynamics, those of loops as often as they run."""
    state = [jnp.zeros((1, size), model.dtype) for size in (model.nq, model.nv, model.nv)]
    return _in_program(jax.make_jaxpr(jax.vmap(functools.partial(kj.inverse_dynamics, model)))(*state))


def _in_program(program: Any) -> Pair:
    counts = np.zeros(2, int)
    for equation in getattr(program, "jaxpr", program).eqns:
        name, params = equation.primitive.name, equation.params
        if equation.primitive is _batching.kernel_call:
            counts += _in_program(kernel_program(equation))
        elif name == "scan":
            counts += params["length"] * np.array(_in_program(params["jaxpr"]))
        elif name in CALLS and params.get("name") != sincos.__name__:
            counts += _in_program(next(params[key] for key in CALLED if key in params))
        elif name in KINDS:
            counts[KINDS[name]] += int(np.prod(equation.outvars[0].aval.shape))
    return int(counts[0]), int(counts[1])


def merged(model: kj.Model) -> Callable[..., jax.Array]:
    """Inverse dynamics, a function of q, u and u_dot, in which every value that `operation_count` counts is computed once."""
    graph, variables, results = written(kj.inverse_dynamics, model)
    nodes = graph.nodes(results)
    uses = collections.Counter(x.node for node in nodes for x in node.operands if isinstance(x, Expression))
    functions: dict[Any, Callable] = {
        "product": lambda x, y: x * y,
        "sum": lambda x, y: x + y,
        "difference": lambda x, y: x - y,
        "sin": lambda x: sincos(x)[0],
        "cos": lambda x: sincos(x)[1],
    }

    def kernel(*state: jax.Array) -> tuple[jax.Array]:
        values = dict(zip((x.node for x in variables), (row for rows in state for row in rows), strict=True))

        def value(x: float | Expression) -> Any:
            if not isinstance(x, Expression):
                return x
            return values[x.node] if x.sign > 0 else -values[x.node]

        for number, operation, operands in nodes:
            if number not in values:
                name = operation if isinstance(operation, str) else operation.primitive.name  # type: ignore[attr-defined]
                found = functions[name](*map(value, operands))
                values[number] = barrier(found) if uses[number] > 1 else found
        return (jnp.stack([value(x) for x in results]),)

    return lambda *state: _batching.call(kernel, (), state)[0]


def times(level: Effort) -> dict[str, float]:
    """Of inverse dynamics of the Intelledex 605 in float32, an evaluation in a batch: relative to what `specialize` compiles, the
    median over turns; and in nanoseconds, the least.
    """
    model = intelledex_605().astype(jnp.float32)
    with not_regrouped():
        plain = kj.specialize(model)
    programs = {
        "loop": functools.partial(kj.inverse_dynamics, model),
        "not_regrouped": functools.partial(kj.inverse_dynamics, plain),
        "compiled": functools.partial(kj.inverse_dynamics, kj.specialize(model)),
        "merged": merged(model),
    }
    state = np.random.default_rng(record.SEED).normal(size=(3, BATCH, model.nv)).astype(np.float32)
    q, u, u_dot = map(jnp.asarray, state)
    batched = {name: jax.jit(jax.vmap(program)) for name, program in programs.items()}
    tau = {name: np.asarray(program(q, u, u_dot)) for name, program in batched.items()}
    scale = np.abs(tau["loop"]).max(axis=0)
    for name, values in tau.items():
        record.require(bool(np.all(np.abs(values - tau["loop"]) < 2e-5 * scale)), f"{name} computes the same torques")
    timings = compare([Candidate(name, functools.partial(f, q, u, u_dot), BATCH) for name, f in batched.items()], level)
    ratios = {f"time_{name}_over_compiled": ratio(timings, name, "compiled") for name in programs if name != "compiled"}
    return ratios | {f"nanoseconds_{name}": 1e9 * min(timing.samples) for name, timing in timings.items()}


def run(directory: Path) -> dict:
    """Count and time; fails unless the counts are far below those of the thesis, and the programs that are timed agree."""
    models = arms()
    by_step = {name: steps(models[name]) for name in models if name.startswith(("intelledex", "stanford"))}
    counts = {name: {f.__name__: list(kj.operation_count(f, model)) for f in FUNCTIONS} for name, model in models.items()}
    six = {name: by_step[name][STEPS[-1]] for name in ("intelledex_605", "stanford_arm")}
    timing = times(Effort(15, 0.1))
    numbers = {f"{name}_{kind}": six[name][i] for name in six for i, kind in enumerate(("multiplications", "additions"))}
    numbers |= {name: value for name, value in timing.items() if "over" in name} | timing
    numbers |= {
        "inverse_dynamics_by_step": {name: {step: list(pair) for step, pair in each.items()} for name, each in by_step.items()},
        "multiplications_additions_divisions_transcendentals_others": counts,
        "nie_intelledex_605": list(NIE),
        "torque_as_printed": list(TORQUE),
        "quoted_stanford_arm": {name: list(pair) for name, pair in STANFORD_ARM.items()},
    }
    Console().print(_table(by_step))
    Console().print(_robots(counts))
    record.save(directory, "operation_counts", _picture(by_step, timing))
    record.write(directory, "operation_counts", numbers)
    for name, bound in (("intelledex_605", NIE), ("stanford_arm", STANFORD_ARM["Kane and Levinson 1983, by hand"])):
        for kind in (name, f"{name}, generic"):
            found = by_step[kind][STEPS[-1]]
            record.require(found[0] < bound[0] / 4 and found[1] < bound[1] / 3, f"{kind}: {found} is far below {bound}")
    return numbers


def _table(by_step: dict[str, dict[str, Pair]]) -> Table:
    table = Table(title="Inverse dynamics: multiplications / additions", title_justify="left", show_lines=True)
    for header in ("", *STEPS):
        table.add_column(header, justify="right" if header else "left")
    for name, each in by_step.items():
        table.add_row(name, *(f"{each[step][0]} / {each[step][1]}" for step in STEPS))
    quoted = "; ".join(f"{name} {pair[0]} / {pair[1]}" for name, pair in STANFORD_ARM.items())
    stated = f"Nie 1988: {NIE[0]} / {NIE[1]} for the Intelledex 605, {TORQUE[0]} / {TORQUE[1]} in TORQUE as printed"
    table.caption = f"{stated}.\nQuoted for the Stanford arm: {quoted}."
    return table


def _robots(counts: dict[str, dict[str, list[int]]]) -> Table:
    table = Table(title="Multiplications / additions / divisions", title_justify="left")
    table.add_column("")
    for function in FUNCTIONS:
        table.add_column(function.__name__, justify="right")
    for name, each in counts.items():
        table.add_row(name, *(" / ".join(map(str, each[function.__name__][:3])) for function in FUNCTIONS))
    return table


def _picture(by_step: dict[str, dict[str, Pair]], timing: dict[str, float]) -> record.Figure:
    title = "Operations for six torques, sines and cosines aside, and the time they take"
    figure, axes = record.figure_of(1, 3, size=(16.5, 4.8), title=title)
    ours = [f"kanejax: {STEPS[0]}", *(f"... {step}" for step in STEPS[1:])]
    intelledex = {"Nie 1988, stated": NIE, "TORQUE, as printed": TORQUE}
    intelledex |= dict(zip(ours, by_step["intelledex_605"].values(), strict=True))
    stanford = {name.replace("; ", ";\n"): pair for name, pair in STANFORD_ARM.items()}
    stanford["kanejax, generic inertias"] = by_step["stanford_arm, generic"][STEPS[-1]]
    stanford["kanejax, Paul's data"] = by_step["stanford_arm"][STEPS[-1]]
    _draw_counts(axes[0], "Intelledex 605, Table 3 of Nie 1988", intelledex, theirs=2)
    _draw_counts(axes[1], "Stanford arm; others' counts as quoted by Nie 1988", stanford, theirs=4)
    _draw_times(axes[2], timing)
    return figure


def _draw_counts(axes: record.Axes, title: str, rows: dict[str, Pair], theirs: int) -> None:
    """A pair of bars a row; the first rows, paler, are other people's."""
    places = np.arange(len(rows))
    for i, kind in enumerate(("multiplications", "additions")):
        values = [pair[i] for pair in rows.values()]
        bars = axes.barh(places + 0.2 * (2 * i - 1), values, 0.38, color=record.COLORS[i])
        axes.bar_label(bars, padding=3, fontsize=8)
        for bar in bars[:theirs]:
            bar.set_alpha(0.5)
        axes.plot([], [], color=record.COLORS[i], linewidth=7, label=kind)
    axes.set(yticks=places, yticklabels=list(rows), xlabel="operations")
    axes.set_title(title, fontsize=10)
    axes.set_xlim(0, 1.18 * max(max(pair) for pair in rows.values()))
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
    axes.legend(frameon=False, loc="lower right", fontsize=8)


def _draw_times(axes: record.Axes, timing: dict[str, float]) -> None:
    rows = {
        "loop": "loop over the links",
        "not_regrouped": "written out",
        "compiled": "and inertias regrouped\n(specialize)",
        "merged": "and each value\ncomputed once",
    }
    values = [timing.get(f"time_{name}_over_compiled", 1.0) for name in rows]
    bars = axes.barh(list(rows.values()), values, 0.6, color=record.COLORS[2])
    axes.bar_label(bars, [f"{value:.2f}" for value in values], padding=3, fontsize=8)
    axes.set(xlabel="time, relative to specialize", xlim=(0, 1.2 * max(values)))
    axes.set_title(f"Intelledex 605, float32, batch of {BATCH}", fontsize=10)
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
