"""Compare real robots with MuJoCo and Pinocchio: `make validate`.

Every URDF of example-robot-data (repaired where its numbers are impossible, mimic joints set free), dm_control's suite and MuJoCo's
humanoid, at random states, in float64 and float32. Prints the worst case of each robot and writes results/validate_robots.json,
which holds what is done when it is interrupted, and the same as a page, validate_robots.md. Exit code 1 if a robot is over
tolerance beyond what its conditioning explains.
"""

import argparse
import fnmatch
import importlib.metadata
import importlib.util
import json
import os
import platform
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import jax
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

import kanejax as kj

ROOT = Path(__file__).parents[1]
PAGE = """# Every robot against MuJoCo and Pinocchio

Largest relative errors over {samples} random states of each robot, made by `make validate`: inverse dynamics (ID), forward
dynamics (FD), mass matrix (M) and bias force, in float64 and float32. URDFs of example-robot-data with impossible inertias repaired
and mimic joints set free, compared with MuJoCo and Pinocchio; dm_control's suite and MuJoCo's humanoid, compared with MuJoCo.
An error is relative to the largest component. cond(M) is the condition number of the mass matrix, the largest of the states
with the worst errors: "ill-conditioned" robots are over tolerance (1e-11; FD 1e-9; float32 1e-4) by no more than that explains.

{rows}

Not compared:

{reasons}

Versions: {versions}.
"""
QUANTITIES = ("inverse dynamics", "forward dynamics", "mass matrix", "bias force")


class Robot(NamedTuple):
    """A file, and its name in tables."""

    name: str
    path: Path


def robots(console: Console) -> Iterator[Robot]:
    """Find the files in installed packages, which need not be importable."""
    for package, folder, suffix in (
        ("example-robot-data", "example-robot-data/robots/", ".urdf"),
        ("dm-control", "dm_control/suite/", ".xml"),
        ("mujoco-mjx", "mujoco/mjx/test_data/humanoid/humanoid", ".xml"),
    ):
        try:
            files = importlib.metadata.files(package) or []
        except importlib.metadata.PackageNotFoundError:
            console.print(f"[bold red]SKIPPED: {package} is not installed[/]; pip install --no-deps {package}")
            continue
        for file in sorted(files, key=str):
            _, found, rest = file.as_posix().partition(folder)
            if found and file.suffix == suffix and "common/" not in rest:
                name = {"example-robot-data": rest, "dm-control": f"suite/{rest}"}.get(package, "mujoco/humanoid.xml")
                yield Robot(name, Path(str(file.locate())))


def compare(robot: Robot, samples: int, seed: int) -> dict:
    """One record: the report, or why there is none."""
    start = time.perf_counter()
    peers = ["mujoco"]
    if robot.path.suffix == ".urdf" and importlib.util.find_spec("pinocchio"):
        peers.append("pinocchio")
    try:
        report = kj.validate(robot.path, samples=samples, seed=seed, against=peers, strict=False, repair=True)
        record = report.as_dict()
    except kj.KanejaxError as error:
        record = {"error": f"{type(error).__name__}: {error}".replace(str(robot.path), robot.path.name)}
    finally:
        # A hundred robots' programs would fill the memory; those on disk stay.
        jax.clear_caches()
    return {**record, "robot": robot.name, "seconds": round(time.perf_counter() - start, 2)}


def verdict(record: dict) -> str:
    """The worst verdict of a robot's rows."""
    if "error" in record:
        return "not compared"
    found = {row["verdict"] for row in record["rows"]}
    return next(label for label in ("OVER", "ill-conditioned", "ok") if label in found)


HEADINGS = (
    "robot",
    "nv",
    *(f"{dtype} {short}" for dtype in ("f64", "f32") for short in ("ID", "FD", "M", "bias")),
    "cond(M)",
    "verdict",
)


def cells(record: dict) -> list[str]:
    """One row of the table: the worst errors among all peers, and the worst conditioning of these states."""
    if "error" in record:
        return [record["robot"], *[""] * (len(HEADINGS) - 2), verdict(record)]
    rows = record["rows"]
    worst = [
        max(number(r["error"]) for r in rows if (r["dtype"], r["quantity"]) == (dtype, q))
        for dtype in ("float64", "float32")
        for q in QUANTITIES
    ]
    condition = max(number(r["condition_number"]) for r in rows)
    return [record["robot"], str(record["nv"]), *(f"{x:.0e}" for x in (*worst, condition)), verdict(record)]


def table(records: list[dict]) -> Table:
    """The rows of all robots, for the terminal."""
    table = Table(title="worst relative errors: inverse dynamics, forward dynamics, mass matrix, bias force", title_justify="left")
    for heading in HEADINGS:
        table.add_column(heading, justify="left" if heading == "robot" else "right", no_wrap=True)
    for record in records:
        *texts, label = cells(record)
        color = {"ok": "green", "OVER": "bold red"}.get(label, "yellow")
        table.add_row(*(Text(text) for text in texts), Text(label, color))
    return table


def markdown(records: list[dict], samples: int) -> str:
    """The same as a page."""
    lines = [f"| {' | '.join(row)} |" for row in (HEADINGS, ["---"] * len(HEADINGS), *map(cells, records))]
    reasons = [f"- {record['robot']}: {record['error']}" for record in records if "error" in record]
    return PAGE.format(
        samples=samples,
        rows="\n".join(lines),
        reasons="\n".join(reasons),
        versions=", ".join(f"{name} {version}" for name, version in _versions().items()),
    )


def number(value: float | str) -> float:
    """A number from JSON, where infinity is a string."""
    return float(value)


def save(path: Path, records: list[dict], samples: int, seed: int, complete: bool) -> None:
    """Write the results so far; the file is whole at any time."""
    head = {"samples": samples, "seed": seed, "complete": complete, "kanejax": kj.__version__, "python": platform.python_version()}
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps({**head, "device": str(jax.devices()[0]), "versions": _versions(), "robots": records}, indent=1))
    partial.replace(path)
    path.with_suffix(".md").write_text(markdown(records, samples))


def _versions() -> dict[str, str | None]:
    packages = ("jax", "jaxlib", "numpy", "mujoco", "pin", "example-robot-data", "dm-control", "mujoco-mjx")
    return {package: _version(package) for package in packages}


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--robots", default="*", metavar="PATTERN", help="only robots whose name matches, such as 'panda*' or 'suite/*'"
    )
    parser.add_argument("--samples", type=int, default=1000, help="random states for each robot (default 1000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "validate_robots.json")
    options = parser.parse_args()
    # Most of the time goes into compiling; robots of one topology, and later runs, share programs.
    jax.config.update("jax_compilation_cache_dir", os.environ.get("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".cache" / "jax")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)
    console = Console(width=None if sys.stdout.isatty() else 180)
    patterns = [form for pattern in options.robots.split(",") for form in (pattern, f"*/{pattern}")]
    chosen = [robot for robot in robots(console) if any(fnmatch.fnmatch(robot.name, pattern) for pattern in patterns)]
    if not chosen:
        console.print(Text(f"no robot matches {options.robots!r}"))
        return 2
    records: list[dict] = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    interrupted = False
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("", total=len(chosen))
        try:
            for robot in chosen:
                progress.update(task, description=robot.name[-40:])
                records.append(compare(robot, options.samples, options.seed))
                save(options.out, records, options.samples, options.seed, complete=len(records) == len(chosen))
                progress.advance(task)
                if not sys.stderr.isatty():
                    print(
                        f"{len(records)}/{len(chosen)} {robot.name}: {verdict(records[-1])}, {records[-1]['seconds']} s",
                        file=sys.stderr,
                        flush=True,
                    )
        except KeyboardInterrupt:
            interrupted = True
    console.print(table(records))
    for record in records:
        if "error" in record:
            console.print(Text(f"not compared: {record['robot']}: {record['error']}"), soft_wrap=True)
    counts = {
        label: sum(verdict(record) == label for record in records) for label in ("ok", "ill-conditioned", "OVER", "not compared")
    }
    summary = ", ".join(f"{count} {label}" for label, count in counts.items())
    console.print(Text(f"{len(records)} of {len(chosen)} robots, {options.samples} states each: {summary}; see {options.out}"))
    return 130 if interrupted else int(counts["OVER"] > 0)


if __name__ == "__main__":
    sys.exit(main())
