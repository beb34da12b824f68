"""The picture of a motion on its page."""

from typing import Any

from kanejax._identify.report.svg import COLORS, report_package
from kanejax._optimize.motion import OptimalMotion
from kanejax._optimize.task import MotionTask
from kanejax._plots.motion import draw_motion, motion_height
from kanejax._plots.panels import panels_of

# Inches.
_WIDTH = 12.0


def motion_figure(task: MotionTask, motion: OptimalMotion) -> Any:
    """A row for each joint, and a column each for coordinates, speeds and forces, in the page's colours."""
    panels = panels_of(task.model.tree)
    figure = report_package("matplotlib.figure").Figure(figsize=(_WIDTH, motion_height(panels)), layout="constrained")
    draw_motion(figure, panels, task.model, motion, task.limits, COLORS)
    return figure


def places(figure: Any) -> list[list[float]]:
    """Left, right, top and bottom of each panel in points from the top left corner, for a figure that was drawn."""
    width, height = 72.0 * figure.get_size_inches()
    boxes = [axes.get_position() for axes in figure.axes]
    return [[round(x, 1) for x in (box.x0 * width, box.x1 * width, (1 - box.y1) * height, (1 - box.y0) * height)] for box in boxes]
