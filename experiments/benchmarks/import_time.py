"""What `import kanejax` takes beside `import jax, equinox`, each in a new interpreter."""

import subprocess
import sys

from experiments.benchmarks.harness import Candidate, Table, at_most, compare, effort, least_ratio, ratio, report

TARGET = 1.5
_FLOOR = "jax, equinox"


def run(quick: bool) -> None:
    """Time interpreters that import one thing and end."""
    names = ("sys", "jax", _FLOOR, "kanejax")
    timings = compare([Candidate(name, lambda name=name: _imported(name)) for name in names], effort(quick))
    rows = []
    for name in names:
        times = ratio(timings, name, _FLOOR)
        verdict = at_most(times, TARGET) if name == "kanejax" else ""
        rows.append((name, timings[name].median, times, least_ratio(timings, name, _FLOOR), verdict))
    report("import_time", [Table("a new interpreter and one import", ("import", "s", "times", "least/least", "target"), rows)])


def _imported(name: str) -> None:
    subprocess.run([sys.executable, "-c", f"import {name}"], check=True)
