"""What a comparison found, as values, as a table and as JSON."""

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, final

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

Quantity = Literal["inverse dynamics", "forward dynamics", "mass matrix", "bias force"]

QUANTITIES: tuple[Quantity, ...] = ("inverse dynamics", "forward dynamics", "mass matrix", "bias force")


@final
@dataclasses.dataclass(frozen=True)
class ValidationRow:
    """Agreement in one quantity, in one data type, with one peer.

    Attributes:
        against: "mujoco" or "pinocchio".
        dtype: "float64" or "float32", of this library's side; the peer computes in float64.
        quantity: one of `QUANTITIES`.
        error: the worst relative error over all states, infinite where a result is not finite; see `validate`.
        median: the median of the states' relative errors.
        tolerance: the greatest error that passes.
        state: number of the worst state.
        condition_number: of the mass matrix in the worst state.
    """

    against: str
    dtype: str
    quantity: Quantity
    error: float
    median: float
    tolerance: float
    state: int
    condition_number: float

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance."""
        return self.error <= self.tolerance

    @property
    def rounding(self) -> float:
        """How far rounding the mass matrix to this data type, and nothing else, can move accelerations, relatively."""
        return self.condition_number * float(np.finfo(self.dtype).eps) / 2

    @property
    def verdict(self) -> str:
        """What the table says: "ok"; "ill-conditioned", forward dynamics over the tolerance, but within `rounding`; or "OVER"."""
        explained = self.quantity == "forward dynamics" and self.error <= self.rounding
        return "ok" if self.passed else "ill-conditioned" if explained else "OVER"


@final
@dataclasses.dataclass(frozen=True)
class ValidationReport:
    """What `validate` found: `print` it, or read `passed` and `rows`.

    Attributes:
        robot: the file's path, or what else was validated.
        nbody: number of bodies, the world not counted.
        nq: number of generalized coordinates.
        nv: number of generalized speeds.
        samples: number of random states.
        seed: of the random numbers.
        rows: the errors.
        notes: what was left out on both sides before comparing, and what differs from the file.
        versions: of the packages compared.
    """

    robot: str
    nbody: int
    nq: int
    nv: int
    samples: int
    seed: int
    rows: tuple[ValidationRow, ...]
    notes: tuple[str, ...]
    versions: Mapping[str, str]

    @property
    def passed(self) -> bool:
        """Whether every error is within its tolerance."""
        return all(row.passed for row in self.rows)

    def worst(self, dtype: str, quantity: Quantity) -> float:
        """The greatest error of a quantity among all peers; NaN where it was not compared.

        Args:
            dtype: "float64" or "float32".
            quantity: of the rows' `quantity`.
        """
        return max((row.error for row in self.rows if (row.dtype, row.quantity) == (dtype, quantity)), default=math.nan)

    def table(self) -> Table:
        """A table for `rich.print`."""
        peers = {"mujoco": "MuJoCo", "pinocchio": "Pinocchio"}
        compared = list(dict.fromkeys(row.against for row in self.rows))
        against = " and ".join(peers[peer] for peer in compared)
        title = f"{Path(self.robot).name}: {self.nbody} bodies, {self.nv} speeds, {self.samples} random states, against {against}"
        notes = list(self.notes)
        if any(row.verdict == "ill-conditioned" for row in self.rows):
            notes.append(
                "ill-conditioned: over tolerance, but rounding can change accelerations by cond(M) x 1.1e-16 (float32: 6e-8)"
            )
        table = Table(title=Text(title), title_justify="left", caption=Text("\n".join(notes)), caption_justify="left")
        for heading in (*(["against"] if len(compared) > 1 else []), "type", "quantity"):
            table.add_column(heading, no_wrap=True)
        for heading in ("worst", "median", "limit", "cond(M)", ""):
            table.add_column(heading, justify="right", no_wrap=True)
        for row in self.rows:
            numbers = (row.error, row.median, row.tolerance, row.condition_number)
            color = {"ok": "green", "OVER": "bold red"}.get(row.verdict, "yellow")
            cells = (*([peers[row.against]] if len(compared) > 1 else []), row.dtype, row.quantity)
            table.add_row(*cells, *(f"{number:.1e}" for number in numbers), f"[{color}]{row.verdict}")
        return table

    def to_json(self) -> str:
        """The report as JSON; an infinite error is the string "Infinity"."""
        return json.dumps(self.as_dict(), indent=1)

    def as_dict(self) -> dict[str, Any]:
        """The report as dictionaries, lists, strings and numbers that JSON has."""
        rows = [{**dataclasses.asdict(row), "verdict": row.verdict} for row in self.rows]
        return _strict_numbers({"passed": self.passed, **dataclasses.asdict(self), "rows": rows})

    def __str__(self) -> str:
        """The table as text."""
        console = Console(width=110, no_color=True, highlight=False)
        with console.capture() as capture:
            console.print(self.table())
        return capture.get()


def _strict_numbers(value: Any) -> Any:
    """Replace what JSON has no number for by strings."""
    if isinstance(value, float) and not math.isfinite(value):
        return {math.inf: "Infinity", -math.inf: "-Infinity"}.get(value, "NaN")
    if isinstance(value, Mapping):
        return {key: _strict_numbers(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strict_numbers(item) for item in value]
    return value
