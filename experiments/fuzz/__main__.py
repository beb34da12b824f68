"""Load hostile inputs: `python -m experiments.fuzz [--inputs 12000] [--seed 0] [--into folder]`; exit code 1 if one goes wrong.

Every input loads, or is refused with an error that the library names; no process dies, hangs, or takes much memory, no file outside
of the input's folder changes what is loaded, and none is written. Reproducible by seed; --into keeps the inputs that go wrong.
"""

import argparse
import collections
import json
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from experiments.fuzz.cases import SHARES, case
from experiments.fuzz.workers import Worker


class Finding(NamedTuple):
    """An input that went wrong."""

    kind: str
    seed: int
    outcome: str
    finding: str


class Tally(NamedTuple):
    """Outcomes by kind, what went wrong, and the costliest inputs."""

    outcomes: dict[str, collections.Counter]
    findings: list[Finding]
    seconds: dict[str, float]
    megabytes: dict[str, float]


def run(inputs: int, seed: int, kinds: list[str], limit: float) -> Tally:
    """Load `inputs` of `kinds`, in a process of their own."""
    shares = np.array([SHARES[kind] for kind in kinds], float)
    drawn = np.random.default_rng(seed).choice(len(kinds), inputs, p=shares / shares.sum())
    tally = Tally({kind: collections.Counter() for kind in kinds}, [], dict.fromkeys(kinds, 0.0), dict.fromkeys(kinds, 0.0))
    worker = Worker(limit)
    try:
        for number, index in enumerate(track(drawn, "inputs", console=Console(stderr=True))):
            kind, own_seed = kinds[index], seed * 10_000_000 + number
            outcome, finding, seconds, megabytes = worker.judged(kind, own_seed)
            tally.outcomes[kind][outcome] += 1
            tally.seconds[kind] = max(tally.seconds[kind], seconds)
            tally.megabytes[kind] = max(tally.megabytes[kind], megabytes)
            if finding:
                tally.findings.append(Finding(kind, own_seed, outcome, finding))
    finally:
        worker.close()
    return tally


def table(tally: Tally) -> Table:
    """A row for each kind."""
    shown = Table(title="Hostile input")
    for header in ("input", "inputs", "loaded", "refused", "with", "longest [s]", "most memory [MB]", "findings"):
        shown.add_column(header, justify="left" if header in ("input", "with") else "right")
    for kind, outcomes in tally.outcomes.items():
        errors = {name: count for name, count in outcomes.most_common() if name != "loaded"}
        with_errors = ", ".join(f"{name} {count}" for name, count in errors.items())
        findings = sum(finding.kind == kind for finding in tally.findings)
        numbers = (str(outcomes.total()), str(outcomes["loaded"]), str(sum(errors.values())), with_errors)
        shown.add_row(kind, *numbers, f"{tally.seconds[kind]:.2f}", f"{tally.megabytes[kind]:.0f}", str(findings))
    return shown


def keep(findings: list[Finding], folder: Path) -> None:
    """Write the inputs that went wrong."""
    for finding in findings:
        made = case(finding.kind, finding.seed)
        into = folder / f"{finding.kind.replace(' ', '_')}_{finding.seed}"
        for name, data in made.files.items():
            path = into / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        into.mkdir(parents=True, exist_ok=True)
        (into / "finding.json").write_text(json.dumps({**finding._asdict(), "options": repr(made.options)}, indent=1))


def main() -> int:
    """Run; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m experiments.fuzz", description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--inputs", type=int, default=12_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", choices=list(SHARES), default=list(SHARES), metavar="kind", help=", ".join(SHARES))
    parser.add_argument("--limit", type=float, default=30.0, help="seconds that an input may take")
    parser.add_argument("--into", type=Path, help="folder for inputs that go wrong")
    arguments = parser.parse_args()
    start = time.perf_counter()
    tally = run(arguments.inputs, arguments.seed, arguments.kinds, arguments.limit)
    console = Console(width=180)
    console.print(table(tally))
    for finding in tally.findings:
        console.print(f"{finding.kind} {finding.seed}: {finding.outcome}: {finding.finding}", markup=False)
    console.print(
        f"{arguments.inputs} inputs of seed {arguments.seed} in {time.perf_counter() - start:.0f} s, {len(tally.findings)} findings"
    )
    if arguments.into:
        keep(tally.findings, arguments.into)
    return int(bool(tally.findings))


if __name__ == "__main__":
    raise SystemExit(main())
