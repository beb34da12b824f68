"""Cost against batch size and number of bodies, as tables and a plot."""

from collections.abc import Callable

import jax

import kanejax as kj
from experiments.benchmarks import robots
from experiments.benchmarks.harness import RESULTS, SEED, Candidate, Effort, Table, compare, effort, report

FUNCTIONS = {"inverse": kj.inverse_dynamics, "forward": kj.forward_dynamics}
BODIES = (2, 3, 5, 7, 10, 14, 20, 28, 40)
BATCH = 4096
Points = dict[str, list[tuple[int, float]]]


def run(quick: bool) -> None:
    """Measure, tabulate and plot nanoseconds an evaluation."""
    level = effort(quick)._replace(rounds=3 if quick else 7)
    over_batch: Points = {}
    for dtype in ("float32", "float64"):
        for function in FUNCTIONS:
            over_batch[f"{function}, {dtype}"] = against_batch(function, dtype, quick, level)
    over_bodies: Points = {}
    for kind, make in (("chain", robots.chain), ("tree", robots.tree)):
        for function in FUNCTIONS:
            over_bodies[f"{function}, {kind}"] = against_bodies(function, make, quick, level)
    tables = [
        _table("Nanoseconds an evaluation against batch size, iiwa14", "batch", over_batch),
        _table(f"Nanoseconds an evaluation against the number of bodies, batch {BATCH}, float32", "bodies", over_bodies),
    ]
    report("scaling", tables)
    _plot(over_batch, over_bodies)


def against_batch(function: str, dtype: str, quick: bool, level: Effort) -> list[tuple[int, float]]:
    """(batch size, nanoseconds) from one state to a million."""
    robot = robots.iiwa14()
    sizes = (1, 10, 100, 1000, 10_000, 100_000, 1_000_000) if quick else (*(4**k for k in range(10)), 1_000_000)
    with jax.enable_x64(dtype == "float64"):
        return [(size, _nanoseconds(robot, function, dtype, size, level)) for size in sizes]


def against_bodies(function: str, make: Callable[[int], robots.Robot], quick: bool, level: Effort) -> list[tuple[int, float]]:
    """(number of bodies, nanoseconds) for random mechanisms, float32."""
    return [(count, _nanoseconds(make(count), function, "float32", BATCH, level)) for count in (BODIES[::2] if quick else BODIES)]


def _nanoseconds(robot: robots.Robot, function: str, dtype: str, batch: int, level: Effort) -> float:
    x = robots.states(robot, batch, SEED).arrays(dtype)
    model = robot.model.astype(dtype)
    call = jax.jit(jax.vmap(FUNCTIONS[function], (None, 0, 0, 0)))
    last = x.u_dot if function == "inverse" else x.tau
    timings = compare([Candidate("it", lambda: call(model, x.q, x.u, last), batch)], level)
    return timings["it"].nanoseconds


def _table(title: str, label: str, points: Points) -> Table:
    first = next(iter(points.values()))
    rows = [(x, *(series[i][1] for series in points.values())) for i, (x, _) in enumerate(first)]
    return Table(title, (label, *points), rows)


def _plot(over_batch: Points, over_bodies: Points) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    for label, series in over_batch.items():
        left.loglog(*zip(*series, strict=True), "o-", ms=3, label=label)
    left.set(xlabel="batch size", ylabel="ns an evaluation", title="KUKA iiwa 14, 7 joints")
    for label, series in over_bodies.items():
        right.plot(*zip(*series, strict=True), "o-", ms=3, label=label)
    title = f"random mechanisms, batch {BATCH}, float32"
    right.set(xlabel="bodies", ylabel="ns an evaluation", title=title, xlim=(0, None), ylim=(0, None))
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
    figure.savefig(RESULTS / "scaling.png", dpi=150)
    plt.close(figure)
