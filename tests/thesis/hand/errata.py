"""The amounts that experiments/errata.md states, for the tests that measure them."""

from pathlib import Path

ERRATA = Path(__file__).parents[3] / "experiments" / "errata.md"


def stated() -> dict[str, list[float]]:
    """The numbers in the last columns of each row of the tables, by the text of the first column."""
    amounts: dict[str, list[float]] = {}
    for line in ERRATA.read_text().splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        numbers = [float(cell) for cell in cells if _is_number(cell)]
        if numbers:
            amounts[cells[0]] = numbers
    return amounts


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
