"""Run the experiments: `python -m experiments.thesis [name ...] [--into directory]`; exit code 1 if one fails."""

import argparse
import importlib
import time
import traceback
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

RESULTS = Path(__file__).parents[2] / "results" / "thesis"


class Outcome(NamedTuple):
    """What became of an experiment; `error` is empty if all is well."""

    name: str
    title: str
    seconds: float
    numbers: dict
    error: str


def found() -> list[str]:
    """Names of the modules of this package that have a function `run`."""
    modules = Path(__file__).parent.glob("*.py")
    return sorted(module.stem for module in modules if "\ndef run(" in module.read_text() and module.stem != "__main__")


def attempt(name: str, directory: Path) -> Outcome:
    """Run one; an exception, also in its import, becomes an outcome."""
    title, start = "", time.perf_counter()
    try:
        module = importlib.import_module(f"experiments.thesis.{name}")
        title = (module.__doc__ or "").strip().split("\n")[0].rstrip(".")
        numbers, error = module.run(directory), ""
    except Exception:
        numbers, error = {}, traceback.format_exc(limit=-4)
    return Outcome(name, title, time.perf_counter() - start, numbers, error)


def summary(outcomes: list[Outcome], directory: Path) -> Table:
    """A row an experiment, with the first of its numbers."""
    table = Table(title="Nie 1988, computed with kanejax", caption=f"pictures and numbers: {directory}", title_justify="left")
    for header, style in (("", ""), ("experiment", "bold"), ("what", ""), ("numbers", "cyan"), ("seconds", "dim")):
        table.add_column(header, style=style, justify="right" if header == "seconds" else "left", no_wrap=header == "experiment")
    for outcome in outcomes:
        mark = "[red]FAILED" if outcome.error else "[green]ok"
        figures = outcome.error.strip().splitlines()[-1][:200] if outcome.error else headline(outcome.numbers)
        table.add_row(mark, outcome.name, outcome.title, figures, f"{outcome.seconds:.1f}", end_section=True)
    return table


def headline(numbers: dict, count: int = 6) -> str:
    """The first few plain numbers, one a line."""
    plain = [(name, value) for name, value in numbers.items() if isinstance(value, int | float) and not isinstance(value, bool)]
    return "\n".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in plain[:count])


def main() -> int:
    """Run those that are named, or all; returns the exit code."""
    known = found()
    parser = argparse.ArgumentParser(prog="python -m experiments.thesis", description="Results and claims of Nie 1988.")
    parser.add_argument("names", nargs="*", metavar="name", help=f"one of {', '.join(known)}; all without")
    parser.add_argument("--into", type=Path, default=RESULTS, help="directory for pictures and numbers")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(known):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    names, console, outcomes = arguments.names or known, Console(), []
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("", total=len(names))
        for name in names:
            progress.update(task, description=name)
            outcomes.append(attempt(name, arguments.into))
            progress.console.print(f"{'[red]failed' if outcomes[-1].error else '[green]done'}[/] {name}")
            progress.advance(task)
    for outcome in outcomes:
        if outcome.error:
            console.print(f"\n[bold red]{outcome.name}[/]")
            console.print(outcome.error, markup=False, highlight=False)
    console.print(summary(outcomes, arguments.into))
    return int(any(outcome.error for outcome in outcomes))


if __name__ == "__main__":
    raise SystemExit(main())
