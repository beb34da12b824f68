"""The picture of the UR10e's identification: held-out torques, and errors beside the baselines."""

from collections.abc import Mapping, Sequence

import numpy as np

import kanejax as kj
from experiments.thesis import record

MEASURED, PREDICTED, NOMINAL = "#9aa4b0", "#1f4e79", "#d98c5f"
BARS = ("#d9dee5", "#b9c2cd", "#98a4b3", "#77869a", "#e5c3ae", PREDICTED)
# The part of the recording that is drawn [s].
WINDOW = (4.0, 16.0)


def picture(
    found: kj.Identification, gains: np.ndarray, baselines: Mapping[str, Sequence[float]], ours: np.ndarray
) -> record.Figure:
    """Torques of the first held-out run with their residuals, and the errors of all methods on it."""
    figure = record.Figure(figsize=(15, 11.5), layout="constrained")
    figure.suptitle(
        "A real UR10e, identified from motor currents: torques of a motion that was not fitted", fontsize=16, weight="bold"
    )
    top, bottom = figure.subfigures(2, 1, height_ratios=(2.4, 1.0), squeeze=False).ravel()
    draw_torques(top, found.validation[0], gains, ours)
    draw_errors(bottom.subplots(), {**baselines, "kanejax, consistent": list(ours)})
    return figure


def draw_torques(figure: record.Figure, run: kj.Comparison, gains: np.ndarray, ours: np.ndarray) -> None:
    """Each joint: measured, predicted and nominal torque above, what both leave below."""
    chosen = (run.ts >= WINDOW[0]) & (run.ts <= WINDOW[1])
    ts = run.ts[chosen]
    measured, predicted, nominal = (gains * series[chosen] for series in (run.measured, run.predicted, run.nominal))
    axes = figure.subplots(4, 3, sharex=True, height_ratios=(2, 1, 2, 1))
    for joint in range(measured.shape[1]):
        row, column = 2 * (joint // 3), joint % 3
        upper, lower = axes[row, column], axes[row + 1, column]
        upper.plot(ts, measured[:, joint], color=MEASURED, linewidth=2.2, label="measured current times gain")
        upper.plot(ts, nominal[:, joint], color=NOMINAL, linewidth=1.2, dashes=(4, 2), label="URDF, without friction")
        upper.plot(ts, predicted[:, joint], color=PREDICTED, linewidth=1.3, label="identified")
        upper.set_title(f"joint {joint + 1}: residual {ours[joint]:.1f} % of the torque", loc="left", fontsize=11)
        for series, color in ((nominal, NOMINAL), (predicted, PREDICTED)):
            lower.plot(ts, (measured - series)[:, joint], color=color, linewidth=0.9)
        lower.axhline(0.0, color="#999999", linewidth=0.6)
        for each in (upper, lower):
            each.spines[["top", "right"]].set_visible(False)
            each.margins(x=0.0)
            each.grid(axis="y", color="#ececec", linewidth=0.6)
        if column == 0:
            upper.set_ylabel("torque [N m]")
            lower.set_ylabel("residual [N m]")
    for column in range(3):
        axes[-1, column].set_xlabel("time [s]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)


def draw_errors(axes: record.Axes, methods: Mapping[str, Sequence[float]]) -> None:
    """Bars in groups by joint; the last joint's are far larger and have an axis of their own."""
    width = 0.82 / len(methods)
    last = len(next(iter(methods.values()))) - 1
    other = axes.twinx()
    for place, ((name, values), color) in enumerate(zip(methods.items(), BARS, strict=True)):
        for joint, value in enumerate(values):
            side = other if joint == last else axes
            x = joint + (place - 0.5 * (len(methods) - 1)) * width
            side.bar(x, value, 0.94 * width, color=color, label=name if joint == 0 else None)
            emphasized = place == len(methods) - 1
            side.annotate(
                f"{value:.1f}",
                (x, value),
                (0, 2),
                textcoords="offset points",
                ha="center",
                fontsize=8,
                color=PREDICTED if emphasized else "#777777",
                weight="bold" if emphasized else "normal",
            )
    axes.set_xticks(range(last + 1), [f"joint {joint + 1}" for joint in range(last + 1)])
    axes.set_ylabel("joints 1 to 5: residual [%]")
    other.set_ylabel("joint 6: residual [%]")
    axes.set_ylim(0, 24)
    other.set_ylim(0, 72)
    axes.axvline(last - 0.5, 0.0, 0.88, color="#bbbbbb", linewidth=0.8)
    axes.set_title(
        "Held-out relative residual error; lower is better. Gray and tan: baselines with the same data and protocol",
        loc="left",
        fontsize=11,
    )
    axes.spines["top"].set_visible(False)
    other.spines["top"].set_visible(False)
    axes.legend(frameon=False, loc="upper center", ncols=len(methods), fontsize=9)
