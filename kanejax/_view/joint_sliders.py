"""A slider for each joint, where there is no motion to be shown."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from kanejax._model.model import Model
from kanejax._view.scene import reference_coordinates

# Where a joint has no range: half a turn or a metre to either side.
_REACH = {"revolute": np.pi, "prismatic": 1.0}


class JointSliders:
    """Sliders within the ranges of the joints; of balls and free bodies the components of position and rotation vector."""

    def __init__(self, gui: Any, model: Model, moved: Callable[[Float[np.ndarray, " nq"]], None]) -> None:
        """Put them into the panel; `moved` is called with the coordinates after each change."""
        self._model, self._moved, self._rest = model, moved, reference_coordinates(model)
        self.handles: dict[str, Any] = {}
        tree = model.tree
        with gui.add_folder("joints"):
            for joint, (name, kind) in enumerate(zip(tree.joint_names, tree.joint_types, strict=True)):
                if kind in _REACH:
                    low, high = interval(model, joint, _REACH[kind])
                    self._add(gui, name, low, high, float(self._rest[tree.q_start[joint]]))
                    continue
                for axis in ("x", "y", "z") if kind == "free" else ():
                    self._add(gui, f"{name} {axis}", -1.0, 1.0, 0.0)
                for axis in ("rx", "ry", "rz"):
                    self._add(gui, f"{name} {axis}", -np.pi, np.pi, 0.0)
            gui.add_button("reference posture").on_click(lambda _: self.reset())

    def coordinates(self) -> Float[np.ndarray, " nq"]:
        """What the sliders stand for."""
        tree, q = self._model.tree, self._rest.copy()
        for name, kind, start in zip(tree.joint_names, tree.joint_types, tree.q_start, strict=True):
            if kind in _REACH:
                q[start] = self.handles[name].value
                continue
            if kind == "free":
                q[start : start + 3] += [self.handles[f"{name} {axis}"].value for axis in ("x", "y", "z")]
                start += 3
            vector = [self.handles[f"{name} {axis}"].value for axis in ("rx", "ry", "rz")]
            rest = Rotation.from_quat(self._rest[start : start + 4], scalar_first=True)
            q[start : start + 4] = (rest * Rotation.from_rotvec(vector)).as_quat(scalar_first=True)
        return q

    def reset(self) -> None:
        """Back to the reference posture."""
        tree = self._model.tree
        at_rest = {
            name: float(self._rest[start])
            for name, kind, start in zip(tree.joint_names, tree.joint_types, tree.q_start, strict=True)
            if kind in _REACH
        }
        for name, handle in self.handles.items():
            handle.value = at_rest.get(name, 0.0)

    def _add(self, gui: Any, label: str, low: float, high: float, value: float) -> None:
        # An empty range has a slider that does not move.
        step = max((high - low) / 1000.0, 1e-9)
        if high - low > 0.1:
            # Inwards to what one reads.
            low, high = np.ceil(1e3 * low) / 1e3, np.floor(1e3 * high) / 1e3
        handle = gui.add_slider(label, float(low), float(high), float(step), float(np.clip(value, low, high)))
        handle.on_update(lambda _: self._moved(self.coordinates()))
        self.handles[label] = handle


def interval(model: Model, joint: int, reach: float) -> tuple[float, float]:
    """The range of a joint, as far as it is bounded; around the reference where it is not."""
    low, high = (float(limit) for limit in model.joint_range[joint])
    rest = float(reference_coordinates(model)[model.tree.q_start[joint]])
    return (low if np.isfinite(low) else rest - reach), (high if np.isfinite(high) else rest + reach)
