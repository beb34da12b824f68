"""Coordinates, speeds and forces of one joint over time, beside the scene, with a line at the time that is shown."""

from typing import Any

import numpy as np
from jaxtyping import Float

from kanejax._model.tree import COORDINATES, SPEEDS
from kanejax._view.stage import Stage
from kanejax._view.tracks import Track

# Points of a curve: a plot is three hundred pixels wide.
_POINTS = 300
# Colours of Okabe and Ito, which colour-blind eyes tell apart.
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_UNITS = {"revolute": ("rad", "rad/s", "N m"), "prismatic": ("m", "m/s", "N")}


class Plots:
    """Three plots of viser, of a joint that is chosen."""

    def __init__(self, gui: Any, stage: Stage) -> None:
        """Put them into the panel."""
        self._stage, self._joint, self._time = stage, 0, 0.0
        self._x = np.linspace(0.0, max(stage.duration, 1e-9), _POINTS)
        tracks = [*stage.tracks, *([stage.reference] if stage.reference else [])]
        quantities = [name for name in ("q", "u", "tau") if any(getattr(track, name) is not None for track in tracks)]
        with gui.add_folder("plots"):
            self.joint = gui.add_dropdown("joint", stage.scene.model.tree.joint_names)
            self._handles = {name: self._add(gui, name) for name in quantities}
        self.joint.on_update(lambda _: self.choose(self.joint.value))

    def choose(self, joint: str) -> None:
        """Show another joint."""
        self._joint = self._stage.scene.model.tree.joint(joint)
        for name, handle in self._handles.items():
            curves, series = self._curves(name)
            handle.title, handle.series, handle.scales = self._title(name), series, _scales(curves, self._x)
            handle.data = self._data(curves)

    def show_time(self, t: float) -> None:
        """Draw the line at another time."""
        self._time = t
        for name, handle in self._handles.items():
            handle.data = self._data(self._curves(name)[0])

    def _add(self, gui: Any, name: str) -> Any:
        curves, series = self._curves(name)
        return gui.add_uplot(
            self._data(curves),
            series,
            title=self._title(name),
            scales=_scales(curves, self._x),
            legend={"show": False},
            cursor={"drag": {"x": True, "y": False}},
            height=150,
        )

    def _title(self, name: str) -> str:
        kind = self._stage.scene.model.tree.joint_types[self._joint]
        units = _UNITS.get(kind)
        column = ("q", "u", "tau").index(name)
        return f"{name} [{units[column]}]" if units else f"{name} [SI]"

    def _curves(self, name: str) -> tuple[list[Float[np.ndarray, " points"]], tuple[dict[str, Any], ...]]:
        """Values at the times of the plot, and how they are drawn: a colour for each copy, the reference dashed."""
        tree = self._stage.scene.model.tree
        kind = tree.joint_types[self._joint]
        sizes, starts = (COORDINATES, tree.q_start) if name == "q" else (SPEEDS, tree.v_start)
        columns = range(starts[self._joint], starts[self._joint] + sizes[kind])
        curves: list[np.ndarray] = []
        series: list[dict[str, Any]] = [{"label": "time"}]
        drawn: list[tuple[Track, dict[str, Any]]] = [(track, {"width": 1.5}) for track in self._stage.tracks]
        if self._stage.reference is not None:
            drawn.append((self._stage.reference, {"width": 1.5, "dash": (5, 4)}))
        for number, (track, look) in enumerate(drawn):
            times, values = _values(track, name)
            if values is None:
                continue
            for part, column in enumerate(columns):
                color = _COLORS[(number + part) % len(_COLORS)]
                # NaN where the motion has ended.
                curves.append(np.interp(self._x, times, values[:, column], right=np.nan))
                series.append({"label": track.name, "stroke": color, "points": {"show": False}, **look})
        return curves, (*series, {"label": "now", "stroke": "#777777", "width": 1.0, "points": {"show": False}})

    def _data(self, curves: list[np.ndarray]) -> tuple[np.ndarray, ...]:
        """The curves with two more points at the time that is shown, between which the line runs up."""
        low, high = _scales(curves, self._x)["y"]["range"]
        at = int(np.searchsorted(self._x, self._time))
        twice = [self._time, self._time]
        line = np.insert(np.full(_POINTS, np.nan), [at, at], [low, high])
        inserted = [np.insert(curve, [at, at], np.repeat(np.interp(self._time, self._x, curve), 2)) for curve in curves]
        return (np.insert(self._x, [at, at], twice), *inserted, line)


def _values(track: Track, name: str) -> tuple[np.ndarray, Any]:
    times = track.ts if name != "tau" or track.tau_ts is None else track.tau_ts
    return times, getattr(track, name)


def _scales(curves: list[np.ndarray], x: np.ndarray) -> dict[str, Any]:
    """Ranges of the axes: uPlot finds none where there are NaN."""
    finite = np.concatenate([curve[np.isfinite(curve)] for curve in curves] or [np.zeros(1)])
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    margin = 0.05 * (high - low) or max(0.05 * abs(high), 1e-6)
    return {"x": {"time": False, "range": (0.0, float(x[-1]))}, "y": {"range": (low - margin, high + margin)}}
