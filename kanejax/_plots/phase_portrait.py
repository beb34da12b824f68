"""Speed over coordinate."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from kanejax._model.generalized_speeds import AnyModel
from kanejax._plots.arrays import PlotError, limits_of, several
from kanejax._plots.drawing import explain
from kanejax._plots.panels import plain_joint
from kanejax._plots.style import LIMIT_LINE, PAPER, SEVERAL, new_figure, on_paper, plot_package

if TYPE_CHECKING:
    import matplotlib.figure


@on_paper()
def phase_portrait(model: AnyModel, paths: Any, joint: str, *, labels: Iterable[str] | None = None) -> "matplotlib.figure.Figure":
    """Speed over coordinate of one joint, a line for each motion, which begins at a circle and ends at a dot.

    Args:
        model: the mechanism.
        paths: one motion, several in a list, or one with a leading batch axis, such as `simulate_batch` returns.
        joint: name of a revolute or prismatic joint.
        labels: what to call the motions in a legend.

    Raises:
        PlotError: motions are not the model's, there are more or fewer labels than motions, or the model has chosen speeds.
        UnknownNameError: there is no joint of that name with one coordinate; the message lists those there are.
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    panel = plain_joint(model.tree, joint)
    motions = list(zip(several(model, paths, "q"), several(model, paths, "u"), strict=True))
    names = None if labels is None else list(labels)
    if names is not None and len(names) != len(motions):
        raise PlotError(f"labels has {len(names)} names, but there are {len(motions)} motions; give one each")
    figure = new_figure(6.4, 5.0)
    axes = figure.subplots()
    colors = _colors(len(motions))
    for number, (q, u) in enumerate(motions):
        x, y = q.values[:, panel.q.columns.start], u.values[:, panel.u.columns.start]
        style = {"color": colors[number], "linewidth": 1.4 if len(motions) < 20 else 0.8}
        axes.plot(x, y, label=f"motion {number}" if names is None else names[number], **style)
        reached = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
        if len(reached) and len(motions) < 20:
            first, last = reached[0], reached[-1]
            axes.plot(x[first], y[first], "o", color=colors[number], markerfacecolor="white", markersize=6, label="_")
            axes.plot(x[last], y[last], "o", color=colors[number], markersize=5, label="_")
    pair = limits_of(model, "q", None)
    assert pair is not None
    _draw_ranges(axes, pair[:, panel.u.columns.start])
    axes.set_title(joint, loc="left", fontsize="medium", fontweight="bold")
    axes.set_xlabel(f"coordinate [{panel.q.unit}]")
    axes.set_ylabel(f"speed [{panel.u.unit}]")
    if names is not None:
        explain(figure, [(name, {"color": color, "linewidth": 1.4}) for name, color in zip(names, colors, strict=True)])
    return figure


def _colors(count: int) -> list:
    """As many as there are motions: of few those that are told apart best, of many a scale."""
    if count <= len(SEVERAL):
        return [PAPER[name] for name in SEVERAL[:count]]
    scale = plot_package("matplotlib").colormaps["viridis"]
    return [scale(0.9 * number / (count - 1)) for number in range(count)]


def _draw_ranges(axes: Any, pair: np.ndarray) -> None:
    """Lines at the ends of the joint's range that the motions come near."""
    low, high = axes.get_xlim()
    for limit in pair:
        if low - 0.5 * (high - low) <= limit <= high + 0.5 * (high - low):
            axes.axvline(float(limit), color=PAPER["nominal"], label="_", **LIMIT_LINE)
