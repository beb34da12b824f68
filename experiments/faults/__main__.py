"""Run the experiments: `python -m experiments.faults [name ...] [--into directory]`; exit code 1 if one fails."""

import argparse
import importlib
import time
import traceback
from pathlib import Path

from rich.console import Console

RESULTS = Path(__file__).parents[2] / "results" / "faults"
NAMES = ("trouble", "energy_drift", "single_precision", "determinism")


def attempt(name: str, into: Path, console: Console) -> bool:
    """Run one, and say how it went; an exception, also in its import, is a failure."""
    console.rule(f"[bold]{name}")
    begin = time.perf_counter()
    try:
        importlib.import_module(f"experiments.faults.{name}").run(into)
    except Exception:
        console.print(traceback.format_exc(limit=-4), markup=False, highlight=False)
        console.print(f"[bold red]failed[/]: {name}, {time.perf_counter() - begin:.0f} s")
        return False
    console.print(f"[green]done[/]: {name}, {time.perf_counter() - begin:.0f} s")
    return True


def main() -> int:
    """Run those that are named, or all; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m experiments.faults", description="Numerical trouble, measured.")
    parser.add_argument("names", nargs="*", metavar="name", help=f"one of {', '.join(NAMES)}; all without")
    parser.add_argument("--into", type=Path, default=RESULTS, help="directory for numbers and tables")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(NAMES):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    console = Console()
    done = [attempt(name, arguments.into, console) for name in arguments.names or NAMES]
    console.print(f"numbers and tables: {arguments.into}")
    return int(not all(done))


if __name__ == "__main__":
    raise SystemExit(main())
