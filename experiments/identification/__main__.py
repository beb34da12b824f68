"""Run the experiments: `python -m experiments.identification [name ...] [--quick]`; exit code 1 if one fails."""

import argparse
import importlib
import time
import traceback
from pathlib import Path

from rich.console import Console

RESULTS = Path(__file__).parents[2] / "results" / "identification"
NAMES = ("excitation", "simulated_arm", "ur10e")


def attempt(name: str, quick: bool, into: Path, console: Console) -> bool:
    """Run one, and say how it went; an exception, also in its import, is a failure."""
    console.rule(f"[bold]{name}")
    begin = time.perf_counter()
    try:
        module = importlib.import_module(f"experiments.identification.{name}")
        # The design of a motion has no short form.
        module.run(into) if name == "excitation" else module.run(quick, into)
    except Exception:
        console.print(traceback.format_exc(limit=-4), markup=False, highlight=False)
        console.print(f"[bold red]failed[/]: {name}, {time.perf_counter() - begin:.0f} s")
        return False
    console.print(f"[green]done[/]: {name}, {time.perf_counter() - begin:.0f} s")
    return True


def main() -> int:
    """Run those that are named, or all; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m experiments.identification", description="Identification of robots.")
    parser.add_argument("names", nargs="*", metavar="name", help=f"one of {', '.join(NAMES)}; all without")
    parser.add_argument("--quick", action="store_true", help="fewer recordings and variants: for a look, not for figures")
    parser.add_argument("--into", type=Path, default=RESULTS, help="directory for pictures and numbers")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(NAMES):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(NAMES)}")
    console = Console()
    done = [attempt(name, arguments.quick, arguments.into, console) for name in arguments.names or NAMES]
    console.print(f"pictures and numbers: {arguments.into}")
    return int(not all(done))


if __name__ == "__main__":
    raise SystemExit(main())
