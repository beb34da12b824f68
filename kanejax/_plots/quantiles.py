"""What a batch of motions does, in bands over time."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from kanejax._model.generalized_speeds import AnyModel
from kanejax._plots.arrays import PlotError, batch
from kanejax._plots.drawing import explain, grid_of, label_axes
from kanejax._plots.panels import panels_of
from kanejax._plots.style import PAPER, on_paper

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

_FAINTEST, _STRONGEST = 0.18, 0.42


@on_paper()
def quantiles(
    model: AnyModel,
    paths: Any,
    what: str = "q",
    levels: Sequence[float] = (0.05, 0.25, 0.5, 0.75, 0.95),
    joints: str | Iterable[str] | None = None,
) -> "matplotlib.figure.Figure":
    """Quantiles of a batch of motions over time, a panel for each joint: bands between pairs of levels, a line for the middle one.

    At every time they are those of the motions that reached it; the figure says how many did not reach the end.

    Args:
        model: the mechanism.
        paths: motions with a leading batch axis and the same times, such as `simulate_batch` returns.
        what: "q" for coordinates, "u" for speeds, "tau" for forces.
        levels: increasing, between 0 and 1. The first and the last bound the widest band, and so on inwards; if their number is
            odd, the middle one is drawn as a line.
        joints: names of the joints to draw, by default all.

    Raises:
        PlotError: there is no batch axis, times differ, the motions are not the model's, or levels or `what` mean nothing.
        UnknownNameError: a joint is not in the model; the message lists those that are.
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    at = _checked(levels)
    ts, values = batch(model, paths, what)
    bands = _quantiles(values, at)
    panels = panels_of(model.tree, joints)
    figure, everyone = grid_of(panels)
    for axes, panel in zip(everyone, panels, strict=True):
        quantity = getattr(panel, what)
        for part in range(quantity.columns.start, quantity.columns.stop):
            _draw(axes, ts, bands[..., part], held=values.shape[1] < len(ts))
        label_axes(axes, ts, quantity)
    explain(figure, _names(at))
    figure.suptitle(_count(values), x=0.01, ha="left", fontsize="medium")
    figure.align_ylabels()
    return figure


def _checked(levels: Sequence[float]) -> Float[np.ndarray, " k"]:
    at = np.asarray(levels, float)
    if at.ndim != 1 or not len(at) or not np.all((at >= 0) & (at <= 1)) or not np.all(np.diff(at) > 0):
        raise PlotError(f"levels is {levels}; give increasing numbers between 0 and 1, such as (0.05, 0.5, 0.95)")
    return at


def _quantiles(values: Float[np.ndarray, "batch n k"], at: Float[np.ndarray, " levels"]) -> Float[np.ndarray, "levels n k"]:
    """Of what is finite; nan where nothing is."""
    real = np.where(np.isfinite(values), values, np.nan)
    some = np.isfinite(real).any(axis=0)
    return np.where(some, np.nanquantile(np.where(some, real, 0.0), at, axis=0), np.nan)


def _draw(axes: "matplotlib.axes.Axes", ts: np.ndarray, bands: Float[np.ndarray, "levels n"], held: bool) -> None:
    """The bands of one part, the inner ones stronger."""
    if held:
        bands = np.concatenate((bands, bands[:, -1:]), axis=1)
    pairs = len(bands) // 2
    for i, alpha in enumerate(_alphas(pairs)):
        style = {"color": PAPER["predicted"], "alpha": alpha, "linewidth": 0.0}
        axes.fill_between(ts, bands[i], bands[-1 - i], step="post" if held else None, **style)
    if len(bands) % 2:
        axes.plot(ts, bands[pairs], color=PAPER["predicted"], linewidth=1.6, drawstyle="steps-post" if held else "default")


def _names(at: Float[np.ndarray, " levels"]) -> list[tuple[str, dict[str, Any]]]:
    pairs = len(at) // 2
    middle = "median" if len(at) % 2 and at[pairs] == 0.5 else f"{100 * at[pairs]:g} %"
    found = [(middle, {"color": PAPER["predicted"], "linewidth": 1.6})] if len(at) % 2 else []
    for i, alpha in reversed(list(enumerate(_alphas(pairs)))):
        name = f"{100 * at[i]:g} to {100 * at[-1 - i]:g} %"
        found.append((name, {"color": PAPER["predicted"], "alpha": alpha, "linewidth": 8.0}))
    return found


def _count(values: Float[np.ndarray, "batch n k"]) -> str:
    """How many motions there are, and how many of them end before the last time."""
    early = int(np.sum(~np.isfinite(values[:, -1]).all(axis=-1)))
    return f"{len(values)} motions" + (f", {early} of them end early" if early else "")


def _alphas(pairs: int) -> list[float]:
    return [float(x) for x in np.linspace(_FAINTEST, _STRONGEST, pairs)] if pairs > 1 else [0.3] * pairs
