"""Lines of quantities over time in a panel, and their limits."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from kanejax._plots.arrays import Series
from kanejax._plots.panels import Panel, Quantity
from kanejax._plots.style import LIMIT_LINE, LINES, REFERENCE_LINE, Colors, new_figure, plot_package

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

_PARTS = ("predicted", "second", "third", "fourth")
# Inches: the width of a figure, the height of its panels, and what title and time take.
_WIDTH, _HEIGHT, _REST = 9.0, 1.65, 0.7


def grid_of(panels: Sequence[Panel]) -> "tuple[matplotlib.figure.Figure, list[matplotlib.axes.Axes]]":
    """A figure with a panel each over the same time, row by row, with the panels' titles."""
    columns = 1 if len(panels) < 4 else 2 if len(panels) < 15 else 3
    rows = -(-len(panels) // columns)
    figure = new_figure(_WIDTH, _REST + _HEIGHT * rows)
    everyone = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for unused in everyone[len(panels) :]:
        unused.remove()
    shown = list(everyone[: len(panels)])
    for axes, panel in zip(shown, panels, strict=True):
        axes.set_title(panel.title, loc="left", fontsize="medium", fontweight="bold")
    label_times(shown, columns)
    return figure, shown


def label_times(shown: "Sequence[matplotlib.axes.Axes]", columns: int) -> None:
    """Numbers under the last panel of each column, and what they are under those of the last row."""
    for axes in shown[-columns:]:
        axes.tick_params(labelbottom=True)
    for axes in shown[(len(shown) - 1) // columns * columns :]:
        axes.set_xlabel("time [s]")


def draw_series(axes: "matplotlib.axes.Axes", found: Series, quantity: Quantity, colors: Colors) -> None:
    """Every part over time; held values as steps."""
    ts, values = found.ts, found.values[:, quantity.columns]
    style: dict[str, Any] = {"linewidth": 1.4}
    if found.is_held:
        values, style = np.concatenate((values, values[-1:])), {**style, "drawstyle": "steps-post"}
    if len(ts) == 1:
        style["marker"] = "o"
    for part, column in enumerate(values.T):
        name = quantity.parts[part] if quantity.parts else "_"
        axes.plot(ts, column, color=colors[_PARTS[part]], linestyle=LINES[part], label=name, **style)
    label_axes(axes, ts, quantity)
    if quantity.parts:
        style = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.0, "frameon": False}
        axes.legend(ncols=len(quantity.parts), fontsize="small", handlelength=1.8, columnspacing=1.0, **style)


def draw_reference(axes: "matplotlib.axes.Axes", found: Series, quantity: Quantity) -> None:
    """What the lines should be."""
    for column in found.values[:, quantity.columns].T:
        axes.plot(found.ts, column, label="_", **REFERENCE_LINE)


def label_axes(axes: "matplotlib.axes.Axes", ts: Float[np.ndarray, " n"], quantity: Quantity) -> None:
    """The unit, all of the time, and a few numbers."""
    axes.set_ylabel(quantity.unit)
    if ts[0] < ts[-1]:
        axes.set_xlim(float(ts[0]), float(ts[-1]))
    axes.locator_params(axis="y", nbins=4)
    axes.locator_params(axis="x", nbins=6)


def draw_limits(
    axes: "matplotlib.axes.Axes",
    values: Float[np.ndarray, "..."],
    pair: Float[np.ndarray, "2 k"] | None,
    colors: Colors,
    *,
    inside: bool = False,
) -> bool:
    """Lines where limits are near, and words where they are so far off that the motion would look flat.

    Args:
        axes: the panel.
        values: all that is drawn.
        pair: least and greatest values, infinite where there is none.
        colors: by what they stand for.
        inside: whether words are put inside of the panel, because a legend is above it.

    Returns:
        Whether there is a line.
    """
    real = values[np.isfinite(values)]
    low, high = (float(real.min()), float(real.max())) if real.size else (0.0, 0.0)
    # What stands still is drawn as a line, not its rounding errors.
    room = max(high - low, 1e-3 * max(abs(low), abs(high)), 1e-6)
    shown, far = [low, high], []
    for limit in sorted(set() if pair is None else {float(each) for each in np.ravel(pair) if np.isfinite(each)}):
        if low - 1.5 * room <= limit <= high + 1.5 * room:
            axes.axhline(limit, color=colors["nominal"], **LIMIT_LINE)
            shown.append(limit)
        else:
            far.append(limit)
    span = max(shown) - min(shown)
    margin = 0.08 * max(span, room) + 0.5 * max(room - span, 0.0)
    axes.set_ylim(min(shown) - margin, max(shown) + margin)
    if far:
        _write_limits(axes, far, colors["nominal"], inside, below=max(far) < low)
    return len(shown) > 2


def _write_limits(axes: "matplotlib.axes.Axes", limits: list[float], color: str, inside: bool, below: bool) -> None:
    """Limits in words: above the panel, or inside of it at the end where they would be."""
    text = ("limit " if len(limits) == 1 else "limits ") + ", ".join(_number(each) for each in limits)
    height, vertical = (0.0, "bottom") if inside and below else (1.0, "top" if inside else "bottom")
    axes.annotate(
        text,
        xy=(1.0, height),
        xycoords="axes fraction",
        xytext=(-2, -2 if vertical == "top" else 2),
        textcoords="offset points",
        ha="right",
        va=vertical,
        fontsize="x-small",
        color=color,
    )


def limits_of_panel(pair: Float[np.ndarray, "2 nv"] | None, panel: Panel, field: str) -> Float[np.ndarray, "2 k"] | None:
    """Of the quantity of a panel; coordinates have some only where there is one, as limits are by speeds."""
    if pair is None or (field == "q" and not panel.plain):
        return None
    return pair[:, panel.u.columns]


def explain(figure: "matplotlib.figure.Figure", names: Sequence[tuple[str, dict[str, Any]]]) -> None:
    """A legend above all panels, of lines with these styles."""
    if names:
        line = plot_package("matplotlib.lines").Line2D
        handles = [line([], [], **{**style, "label": name}) for name, style in names]
        figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), frameon=False, fontsize="small")


def _number(value: float) -> str:
    fix = plot_package("matplotlib.ticker").Formatter.fix_minus
    return fix(f"{float(f'{value:.4g}'):g}")
