"""How everything looks: colours by what they stand for, and matplotlib's settings.

A figure on paper has colours of its own and an opaque background, which a dark notebook leaves readable. A page of HTML hands in
placeholders for colours, in whose place it puts its own.
"""

import contextlib
import importlib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import matplotlib.figure

Colors = Mapping[str, str]

# Blue, orange, green and pink of Okabe and Ito, told apart by colour-blind readers too; the first two darker, for thin lines.
PAPER: Colors = {
    "ink": "#1b1f24",
    "faint": "#8c959f",
    "grid": "#e3e6ea",
    "measured": "#9aa3ad",
    "predicted": "#0b62b0",
    "nominal": "#c4620a",
    "second": "#009e73",
    "third": "#cc5a9b",
    "fourth": "#5b6570",
}
"""Ink and lines of axes; measured, predicted (or plain) and nominal (or limiting) values; further parts of one quantity."""

LINES = ("solid", (0, (4, 1.5)), (0, (1.5, 1.5)), (0, (5, 1, 1, 1)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)), (0, (1, 3)))
"""Of several parts in one panel."""
LIMIT_LINE = {"linewidth": 1.0, "linestyle": (0, (4, 2))}
"""Of limits, which have the colour of nominal values."""
REFERENCE_LINE = {"color": PAPER["ink"], "linewidth": 1.1, "linestyle": (0, (4, 2.5))}
"""Of what a motion should be."""
SEVERAL = ("predicted", "nominal", "second", "third", "fourth")
"""Of several motions."""


def settings(colors: Colors, background: str) -> dict[str, Any]:
    """What matplotlib is told: sizes, and colours of all but the curves."""
    return {
        "font.size": 10,
        "axes.edgecolor": colors["faint"],
        "axes.labelcolor": colors["ink"],
        "axes.titlecolor": colors["ink"],
        "text.color": colors["ink"],
        "xtick.color": colors["faint"],
        "ytick.color": colors["faint"],
        "xtick.labelcolor": colors["ink"],
        "ytick.labelcolor": colors["ink"],
        "grid.color": colors["grid"],
        "grid.linewidth": 0.8,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.unicode_minus": True,
        "axes.linewidth": 0.8,
        "lines.linewidth": 1.2,
        "lines.solid_joinstyle": "round",
        "figure.facecolor": background,
        "axes.facecolor": background,
        "savefig.facecolor": background,
    }


@contextlib.contextmanager
def on_paper() -> Iterator[None]:
    """Within, figures are made for paper, whatever style the user has set.

    Raises:
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    with plot_package("matplotlib.style").context(["default", settings(PAPER, "white")]):
        yield


def new_figure(width: float, height: float) -> "matplotlib.figure.Figure":
    """An empty figure of so many inches. It belongs to nobody: there is no pyplot, which would keep it and open windows."""
    # Only here, as it needs matplotlib.
    from kanejax._plots.figure import PaperFigure

    return PaperFigure(figsize=(width, height), layout="constrained")


def plot_package(name: str) -> Any:
    """Import a package that only figures need.

    Raises:
        ImportError: it is not installed; the message says how to install it.
    """
    return needed_package(name, "kanejax.plots", "plots")


def needed_package(name: str, user: str, extra: str) -> Any:
    """Import a package that an extra installs.

    Raises:
        ImportError: it is not installed; the message says who needs it, and how to install it.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise ImportError(f"{user} needs the package {package}: pip install 'kanejax[{extra}]'", name=package) from error
