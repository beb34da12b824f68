"""Coordinates, speeds and forces side by side, a row for each joint."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from kanejax._model.generalized_speeds import AnyModel
from kanejax._plots.arrays import limits_of, series
from kanejax._plots.drawing import draw_limits, draw_series, limits_of_panel
from kanejax._plots.panels import Panel, panels_of
from kanejax._plots.style import PAPER, Colors, new_figure, on_paper

if TYPE_CHECKING:
    import matplotlib.figure

_HEADINGS = {"q": "coordinates", "u": "speeds", "tau": "forces"}
# Inches.
_WIDTH, _ROW, _REST = 10.0, 1.45, 0.7


@on_paper()
def motion(
    model: AnyModel, path: Any, *, limits: Any = None, joints: str | Iterable[str] | None = None
) -> "matplotlib.figure.Figure":
    """Coordinates, speeds and, if the motion has some, forces side by side: a row for each joint, two for a free one.

    This is the picture that `kanejax optimize` writes.

    Args:
        model: the mechanism.
        path: one motion: what `simulate` or `optimize` returns.
        limits: `Limits`, such as those of the task; by default the joints' ranges alone.
        joints: names of the joints to draw, by default all.

    Raises:
        PlotError: there are several motions, or they or the limits are not the model's.
        UnknownNameError: a joint is not in the model; the message lists those that are.
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    panels = panels_of(model.tree, joints)
    figure = new_figure(_WIDTH, motion_height(panels))
    draw_motion(figure, panels, model, path, limits, PAPER)
    return figure


def motion_height(panels: list[Panel]) -> float:
    """Of a figure with these rows, in inches."""
    return _REST + _ROW * len(panels)


def draw_motion(
    figure: "matplotlib.figure.Figure", panels: list[Panel], model: AnyModel, path: Any, limits: Any, colors: Colors
) -> None:
    """Fill an empty figure, see `motion`."""
    found = {field: series(model, path, field, "path") for field in _HEADINGS if field != "tau" or hasattr(path, "tau")}
    pairs = {field: limits_of(model, field, limits) for field in found}
    rows = figure.subplots(len(panels), len(found), sharex=True, squeeze=False)
    for row, panel in zip(rows, panels, strict=True):
        for axes, (field, drawn) in zip(row, found.items(), strict=True):
            quantity = getattr(panel, field)
            draw_series(axes, drawn, quantity, colors)
            pair = limits_of_panel(pairs[field], panel, field)
            draw_limits(axes, drawn.values[:, quantity.columns], pair, colors, inside=bool(quantity.parts))
        row[0].set_title(panel.title, loc="left", fontsize="medium", fontweight="bold")
    for axes, field in zip(rows[0], found, strict=True):
        # A line above the joint's name, which may be long.
        style = {"xy": (0.5, 1.0), "xytext": (0, 20), "xycoords": "axes fraction", "textcoords": "offset points"}
        axes.annotate(_HEADINGS[field], ha="center", va="bottom", color=colors["faint"], **style)
    for axes in rows[-1]:
        axes.set_xlabel("time [s]")
    figure.align_ylabels()
