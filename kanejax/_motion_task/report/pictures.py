"""Coordinates, speeds and forces of a motion over time, with their limits."""

import contextlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from kanejax._identify.report.numbers import number
from kanejax._identify.report.svg import COLORS, drawing, report_package
from kanejax._model.tree import COORDINATES, SPEEDS
from kanejax._optimize.motion import OptimalMotion
from kanejax._optimize.task import MotionTask

UNITS = {"revolute": ("rad", "rad/s", "N m"), "prismatic": ("m", "m/s", "N"), "ball": ("", "rad/s", "N m"), "free": ("", "", "")}
_PAPER = {
    "ink": "#1b1f24",
    "faint": "#8c959f",
    "grid": "#e3e6ea",
    "measured": "#9aa3ad",
    "predicted": "#0b62b0",
    "nominal": "#c4620a",
}
_HEADINGS = ("coordinates", "speeds", "forces")
# Of several lines in one panel.
_LINES = ("solid", (0, (4, 1.5)), (0, (1.5, 1.5)), (0, (5, 1, 1, 1)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)), (0, (1, 3)))


def motion_figure(task: MotionTask, motion: OptimalMotion, colors: dict[str, str] = COLORS) -> Any:
    """A row for each joint, and a column each for coordinates, speeds and forces."""
    tree = task.model.tree
    figure = report_package("matplotlib.figure").Figure(figsize=(12.0, 0.7 + 1.45 * tree.njoint), layout="constrained")
    rows = figure.subplots(tree.njoint, 3, sharex=True, squeeze=False)
    ts, steps = np.asarray(motion.ts), np.append(np.asarray(motion.ts)[:-1], motion.ts[-1])
    for joint, (name, kind) in enumerate(zip(tree.joint_names, tree.joint_types, strict=True)):
        q = slice(tree.q_start[joint], tree.q_start[joint] + COORDINATES[kind])
        v = slice(tree.v_start[joint], tree.v_start[joint] + SPEEDS[kind])
        limits = [None if COORDINATES[kind] > 1 else task.limits.q, task.limits.u, task.limits.tau]
        held = np.concatenate((motion.tau, motion.tau[-1:]))
        for axes, values, pair, unit in zip(
            rows[joint], (motion.q[:, q], motion.u[:, v], held[:, v]), limits, UNITS[kind], strict=True
        ):
            is_force = axes is rows[joint, 2]
            for line, column in zip(_LINES, np.asarray(values).T, strict=False):
                style = {"drawstyle": "steps-post"} if is_force else {}
                axes.plot(steps if is_force else ts, column, color=colors["predicted"], linestyle=line, linewidth=1.4, **style)
            _draw_limits(axes, np.asarray(values), None if pair is None else np.asarray(pair)[:, v], colors)
            axes.set_ylabel(unit)
            axes.set_xlim(0.0, float(ts[-1]))
            axes.locator_params(axis="y", nbins=4)
            axes.locator_params(axis="x", nbins=6)
        rows[joint, 0].set_title(name, loc="left", fontsize="medium", fontweight="bold")
    for axes, heading in zip(rows[0], _HEADINGS, strict=True):
        axes.set_title(heading, fontsize="medium", color=colors["faint"])
    for axes in rows[-1]:
        axes.set_xlabel("time [s]")
    figure.align_ylabels()
    return figure


def panels(figure: Any) -> list[list[float]]:
    """Left, right, top and bottom of each panel in points from the top left corner, for a figure that was drawn."""
    width, height = 72.0 * figure.get_size_inches()
    boxes = [axes.get_position() for axes in figure.axes]
    return [[round(x, 1) for x in (box.x0 * width, box.x1 * width, (1 - box.y1) * height, (1 - box.y0) * height)] for box in boxes]


@contextlib.contextmanager
def on_paper() -> Iterator[dict[str, str]]:
    """Within, figures are made with the page's style in colours of their own, which are given."""
    matplotlib = report_package("matplotlib")
    of_page = {color: _PAPER[name] for name, color in COLORS.items()}
    with drawing():
        settings = {
            key: of_page[value] for key, value in matplotlib.rcParams.items() if isinstance(value, str) and value in of_page
        }
        with matplotlib.rc_context({**settings, **dict.fromkeys(("figure.facecolor", "savefig.facecolor"), "white")}):
            yield _PAPER


def _draw_limits(axes: Any, values: np.ndarray, pair: np.ndarray | None, colors: dict[str, str]) -> None:
    """Lines where limits are near, and words where they are so far off that the motion would look flat."""
    low, high = float(values.min()), float(values.max())
    room = max(high - low, 1e-6 * max(abs(low), abs(high)), 1e-9)
    shown, far = [low, high], []
    for limit in sorted(set() if pair is None else {float(each) for each in np.ravel(pair) if np.isfinite(each)}):
        if low - 1.5 * room <= limit <= high + 1.5 * room:
            axes.axhline(limit, color=colors["nominal"], linewidth=1.0, linestyle=(0, (4, 2)))
            shown.append(limit)
        else:
            far.append(limit)
    span = max(shown) - min(shown)
    margin = 0.08 * max(span, room)
    axes.set_ylim(min(shown) - margin, max(shown) + margin)
    if far:
        text = ("limit " if len(far) == 1 else "limits ") + ", ".join(number(each, 3) for each in far)
        where = {"xy": (1.0, 1.0), "xytext": (-2, 2), "xycoords": "axes fraction", "textcoords": "offset points"}
        axes.annotate(text, ha="right", va="bottom", fontsize="x-small", color=colors["nominal"], **where)
