"""Figures of an identification: parameters with their intervals, measured and predicted signals, and residuals."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from kanejax._errors import UnknownNameError
from kanejax._identify.report.signals import signal_lines, signal_names, signal_units
from kanejax._identify.result import Comparison, Estimate, Identification
from kanejax._plots.arrays import PlotError
from kanejax._plots.drawing import explain, label_times
from kanejax._plots.fit import FIT_LINES, draw_fit, draw_residuals, draw_spectrum
from kanejax._plots.style import PAPER, new_figure, on_paper, plot_package

if TYPE_CHECKING:
    import matplotlib.axes
    import matplotlib.figure

_WORDS = {"measured": "measured", "nominal": "nominal plant", "predicted": "identified plant"}
_FOUND = {"color": PAPER["predicted"], "marker": "o", "markersize": 5.5, "linestyle": "none"}
_ALONE = {**_FOUND, "linestyle": "-", "linewidth": 1.6}
_COMBINED = {**_FOUND, "markerfacecolor": "white"}
_NOMINAL = {"color": PAPER["nominal"], "marker": "D", "markersize": 5.0, "markerfacecolor": "none", "linestyle": "none"}


@on_paper()
def parameters(found: Identification, names: Iterable[str] | None = None) -> "matplotlib.figure.Figure":
    """Identified parameters with their 95 % intervals beside the nominal values, a panel for each unit.

    Parameters that the data do not determine alone have no interval, and are drawn hollow.

    Args:
        found: what `identify` returned.
        names: of the parameters to draw, by default all.

    Raises:
        PlotError: there are no names.
        UnknownNameError: a parameter was not identified; the message lists those that were.
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    chosen = found.estimates if names is None else tuple(found[name] for name in ((names,) if isinstance(names, str) else names))
    if not chosen:
        raise PlotError("names is empty; give at least one parameter")
    units: dict[str, list[Estimate]] = {}
    for estimate in chosen:
        units.setdefault(estimate.unit, []).append(estimate)
    rows = [len(group) for group in units.values()]
    figure = new_figure(8.0, 0.5 + 0.55 * len(units) + 0.24 * len(chosen))
    everyone = figure.subplots(len(units), 1, squeeze=False, height_ratios=[count + 0.6 for count in rows]).ravel()
    for axes, (unit, group) in zip(everyone, units.items(), strict=True):
        _draw_estimates(axes, unit, group)
    alone = [np.isfinite((each.lower, each.upper)).all() for each in chosen]
    kinds = [("identified, with its 95 % interval", _ALONE)] if any(alone) else []
    kinds += [] if all(alone) else [("identified, not determined alone", _COMBINED)]
    explain(figure, [*kinds, ("nominal", _NOMINAL)])
    return figure


@on_paper()
def torque_fit(
    found: Identification, run: str | Comparison | None = None, joints: str | Iterable[str] | None = None
) -> "matplotlib.figure.Figure":
    """Measured signals beside those that the identified and the nominal plant predict, and below each what is left of it.

    Args:
        found: what `identify` returned.
        run: a run, or its name; those that were held out are looked at first. By default the first one that was held out, or, if
            none was, the first that was fitted; the figure says which.
        joints: names of the joints to draw, by default all whose signals count in this run.

    Raises:
        PlotError: no signal that is asked for counts in this run.
        UnknownNameError: a joint or run is not there; the message lists those that are.
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    shown, title = _run(found, run)
    signals = _signals(found, shown, joints)
    columns = 1 if len(signals) < 4 else 2
    rows = -(-len(signals) // columns)
    figure = new_figure(9.0, 0.8 + (2.2 if columns == 1 else 2.5) * rows)
    figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    everyone = figure.subplots(2 * rows, columns, sharex=True, squeeze=False, height_ratios=(2, 1) * rows)
    names, units, below = signal_names(found), signal_units(found), []
    for place in range(rows * columns):
        upper, lower = everyone[2 * (place // columns) : 2 * (place // columns) + 2, place % columns]
        if place >= len(signals):
            upper.remove()
            lower.remove()
            continue
        signal = signals[place]
        lines = signal_lines(shown, signal)
        draw_fit(upper, shown.ts, *lines, PAPER)
        draw_residuals(lower, shown.ts, *lines, PAPER)
        upper.set_title(names[signal], loc="left", fontsize="medium", fontweight="bold")
        upper.set_ylabel(units[signal])
        lower.set_ylabel("residual")
        below.append(lower)
    label_times(below, columns)
    explain(figure, [(_WORDS[kind], {"color": PAPER[kind], **style}) for kind, style in FIT_LINES.items()])
    figure.align_ylabels()
    return figure


@on_paper()
def residuals(
    found: Identification, run: str | Comparison | None = None, joints: str | Iterable[str] | None = None
) -> "matplotlib.figure.Figure":
    """What is left of measured signals over time, and the amplitude density of what was left of those that were fitted.

    Flat densities are those of white noise; peaks and slopes are motion that the plant does not explain.

    Args:
        found: what `identify` returned.
        run: whose residuals are drawn over time, as for `torque_fit`.
        joints: names of the joints to draw, by default all whose signals count in this run.

    Raises:
        PlotError: no signal that is asked for counts in this run.
        UnknownNameError: a joint or run is not there; the message lists those that are.
        ImportError: matplotlib is not installed; the message says how to install it.
    """
    shown, title = _run(found, run)
    signals = _signals(found, shown, joints)
    figure = new_figure(9.0, 0.9 + 1.7 * len(signals))
    figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    rows = figure.subplots(len(signals), 2, sharex="col", squeeze=False, width_ratios=(1.6, 1))
    names, units = signal_names(found), signal_units(found)
    for (left, right), signal in zip(rows, signals, strict=True):
        draw_residuals(left, shown.ts, *signal_lines(shown, signal), PAPER)
        left.set_title(names[signal], loc="left", fontsize="medium", fontweight="bold")
        left.set_ylabel(units[signal])
        draw_spectrum(right, found.noise.frequency, found.noise.density[:, signal], units[signal], PAPER)
        _plain_frequencies(right)
    for right in rows[:-1, 1]:
        right.set_xlabel("")
    rows[0, 1].set_title("spectrum, of the runs that were fitted", loc="left", fontsize="medium")
    rows[-1, 0].set_xlabel("time [s]")
    explain(figure, [(_WORDS[kind], {"color": PAPER[kind]}) for kind in ("nominal", "predicted")])
    figure.align_ylabels()
    return figure


def _plain_frequencies(axes: "matplotlib.axes.Axes") -> None:
    """Numbers at 1, 2, 5, 10, ... Hz: a run seldom spans many powers of ten."""
    ticker = plot_package("matplotlib.ticker")
    axes.xaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")


def _draw_estimates(axes: "matplotlib.axes.Axes", unit: str, group: list[Estimate]) -> None:
    for row, estimate in enumerate(group):
        determined = bool(np.isfinite((estimate.lower, estimate.upper)).all())
        if determined:
            axes.plot(
                (estimate.lower, estimate.upper), (row, row), color=PAPER["predicted"], linewidth=1.6, marker="|", label="interval"
            )
        axes.plot([estimate.nominal], [row], label="nominal", **_NOMINAL)
        axes.plot([estimate.value], [row], label="identified", **(_FOUND if determined else _COMBINED))
    axes.set_yticks(range(len(group)), [estimate.name for estimate in group])
    axes.set_ylim(len(group) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(unit.replace("^2", "\u00b2"), labelpad=1.0)


def _run(found: Identification, run: str | Comparison | None) -> tuple[Comparison, str]:
    """The run, and what to call it."""
    everyone = [*((each, "held out") for each in found.validation), *((each, "fitted") for each in found.training)]
    for each, use in everyone:
        if run is None or each is run or each.name == run:
            return each, f"{each.name}, {use}"
    if isinstance(run, str):
        raise UnknownNameError("run", run, dict.fromkeys(each.name for each, _ in everyone))
    if run is None:
        raise PlotError("this identification has no runs")
    count = f"{len(everyone)} run{'' if len(everyone) == 1 else 's'}"
    raise PlotError(f"run {run.name!r} is not of this identification, which has {count}; give one of these, or its name")


def _signals(found: Identification, run: Comparison, joints: str | Iterable[str] | None) -> list[int]:
    """Those of the joints that count at some time."""
    tree = found.plant.model.tree
    names = tree.joint_names if joints is None else (joints,) if isinstance(joints, str) else tuple(joints)
    wanted = [v for name in names for v in np.flatnonzero(tree.speed_joints == tree.joint(name))]
    counting = [int(v) for v in wanted if np.any(run.weight[:, v] > 0)]
    if not counting:
        raise PlotError(
            f"no signal of {', '.join(map(repr, names))} counts in run {run.name!r}; choose other joints or another run"
        )
    return counting
