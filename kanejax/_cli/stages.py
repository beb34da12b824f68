"""Progress of an identification: a table of its stages on the terminal, and lines in a file."""

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text


class StageTable:
    """A table that is drawn anew after each round; `shown` says whether it is drawn at all."""

    def __init__(self, stages: tuple[str, ...], say: Callable[[str], None], *, shown: bool) -> None:
        """Begin with stages that wait."""
        self._rows: dict[str, dict[str, Any]] = {
            stage: {"state": "waits", "rounds": 0, "cost": None, "seconds": 0.0} for stage in stages
        }
        self._say, self._begun = say, time.perf_counter()
        self._live = Live(self._table(), console=Console(stderr=True), transient=True) if shown else None

    def __enter__(self) -> "StageTable":
        """Show the table."""
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Take it away."""
        if error is None:
            self._end(*self._rows)
        if self._live is not None:
            self._live.stop()

    def round(self, stage: str, step: Any) -> None:
        """A round of a stage has ended, and so have the stages before."""
        stages = list(self._rows)
        self._end(*stages[: stages.index(stage)])
        row = self._rows[stage]
        row.update(
            state="runs", rounds=row["rounds"] + 1, cost=getattr(step, "cost", None), seconds=time.perf_counter() - self._begun
        )
        self._say(f"{stage}: round {row['rounds']}, cost {_number(row['cost'])}")
        self._draw()

    def _end(self, *stages: str) -> None:
        """Stages have ended, in an earlier process if nothing was seen of them."""
        for stage in stages:
            row, now = self._rows[stage], time.perf_counter()
            if row["state"] == "waits":
                row.update(state="kept")
                self._say(f"{stage}: kept from before")
            elif row["state"] == "runs":
                row.update(state="ended", seconds=now - self._begun)
                self._say(f"{stage}: ended after {row['rounds']} rounds and {row['seconds']:.1f} s")
                self._begun = now
        self._draw()

    def _draw(self) -> None:
        if self._live is not None:
            self._live.update(self._table())

    def _table(self) -> Table:
        table = Table()
        for heading in ("stage", "", "rounds", "cost", "s"):
            table.add_column(heading, justify="left" if heading in ("stage", "") else "right", no_wrap=True)
        running = next((stage for stage, row in self._rows.items() if row["state"] in ("runs", "waits")), None)
        for stage, row in self._rows.items():
            state = Spinner("dots", Text("runs")) if stage == running else Text(row["state"])
            table.add_row(Text(stage), state, str(row["rounds"] or ""), _number(row["cost"]), f"{row['seconds']:.1f}")
        return table


def _number(value: float | None) -> str:
    return "" if value is None else f"{float(value):.7g}"
