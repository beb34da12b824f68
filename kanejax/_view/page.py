"""A stage in the browser: viser's nodes for everything that is drawn, and what moves them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from kanejax._model.tree import WORLD
from kanejax._view.camera import FIELD_OF_VIEW, camera_around
from kanejax._view.ray_cast import HORIZON, SKY
from kanejax._view.scene import BONE_COLOR, REFERENCE_COLOR, Fixed, Postures, visible
from kanejax._view.shape import Rgb, ellipsoid
from kanejax._view.stage import GHOST_OPACITY, THIN, Stage, floor_height, grid_spacing, moved_off

# Shapes in front of ellipsoids and mass centres that are asked for.
_GLASSY = 0.35
_CENTER_COLOR = (0.8, 0.0, 0.45)


class Page:
    """The nodes of a stage: those of a copy are below `/copy0` and so on, those of a body below its frame."""

    def __init__(self, server: Any, stage: Stage) -> None:
        """Put everything into the scene of a `viser.ViserServer`, at the beginning of the motion."""
        self._scene, self._stage, self._server = server.scene, stage, server
        self._offsets = stage.offsets()
        self._bodies: list[list[Any]] = []
        self._ghosts: list[list[Any]] = []
        self._layers: dict[str, list[Any]] = {"shapes": [], "ellipsoids": [], "stand-ins": [], "frames": [], "centers": []}
        self._lines: list[Any] = []
        self._reference: list[Any] = []
        for copy in range(stage.copies):
            self._add_copy(f"/copy{copy}", self._offsets[copy])
        self._add_floor()
        self.show_layers(shapes=True, ellipsoids=False, frames=False, centers=False)
        self.move(stage.coordinates(0.0), None if stage.reference is None else stage.ghost_coordinates(0.0))

    def move(self, q: Float[np.ndarray, "copies nq"], reference: Float[np.ndarray, "copies nq"] | None) -> None:
        """Bring the copies, and their ghosts, to these coordinates."""
        placed = self._stage.scene.postures(q)
        ghosts = None if reference is None else self._stage.scene.postures(reference)
        with self._server.atomic():
            self._place(self._bodies, placed)
            if ghosts is not None:
                self._place(self._ghosts, ghosts)
            for copy, line in enumerate(self._lines):
                line.points = self._bones(moved_off(placed, self._offsets), copy)

    def show_layers(self, *, shapes: bool, ellipsoids: bool, frames: bool, centers: bool) -> None:
        """Show and hide; what stands in for shapes goes with them."""
        for name, shown in (
            ("shapes", shapes),
            ("stand-ins", shapes),
            ("ellipsoids", ellipsoids),
            ("frames", frames),
            ("centers", centers),
        ):
            for handle in self._layers[name]:
                handle.visible = shown
        for handle in self._layers["shapes"]:
            handle.opacity = _GLASSY if ellipsoids or centers else None
        for handle in self._layers["stand-ins"]:
            # The same ellipsoids and frames are in the other layers.
            handle.visible = shapes
        for line in self._lines:
            line.visible = shapes

    def show_reference(self, shown: bool) -> None:
        """Show and hide the ghosts."""
        for handle in self._reference:
            handle.visible = shown

    def node_pose(self, copy: int, body: int) -> tuple[np.ndarray, np.ndarray]:
        """Quaternion and position of a body's node, as it was sent to the browser."""
        handle = self._bodies[copy][body]
        return np.array(handle.wxyz), np.array(handle.position)

    def _add_copy(self, root: str, offset: np.ndarray) -> None:
        scene, tree = self._stage.scene, self._stage.scene.model.tree
        self._scene.add_frame(root, show_axes=False, position=offset)
        names = [f"{root}/{number} {name.replace('/', '_')}" for number, name in enumerate(tree.body_names)]
        self._bodies.append([self._scene.add_frame(name, show_axes=False) for name in names])
        # Of the world, in place of a body's name, its copy.
        names.append(root)
        bare = set(scene.bare)
        self._layers["shapes"] += self._add_surfaces(scene.shapes, names, "shape")
        plain = tuple(each for each in scene.ellipsoids if each.body not in bare)
        stand_ins = tuple(each for each in scene.ellipsoids if each.body in bare)
        self._layers["ellipsoids"] += self._add_surfaces(plain, names, "ellipsoid")
        self._layers["stand-ins"] += self._add_surfaces(stand_ins, names, "ellipsoid")
        for body in range(tree.nbody):
            self._layers["stand-ins" if body in bare else "frames"].append(self._add_axes(f"{names[body]}/axes"))
        for body, com in enumerate(np.asarray(scene.model.com, float)):
            if float(scene.model.mass[body]) > 0.0:
                ball = Fixed(body, ellipsoid(np.full(3, 2.0 * THIN * scene.size), color=_CENTER_COLOR).moved(np.eye(3), com))
                self._layers["centers"] += self._add_surfaces((ball,), names, "center")
        if scene.bones:
            points = np.zeros((len(scene.bones), 2, 3), np.float32)
            width = 2.0 * THIN * scene.size
            self._lines.append(self._scene.add_line_segments(f"{root} bones", points, _bytes(BONE_COLOR), thickness=width))
        if self._stage.reference is not None:
            self._add_ghost(f"{root} reference", offset)

    def _add_ghost(self, root: str, offset: np.ndarray) -> None:
        scene = self._stage.scene
        self._reference.append(self._scene.add_frame(root, show_axes=False, position=offset))
        names = [f"{root}/{number}" for number in range(scene.model.nbody)]
        self._ghosts.append([self._scene.add_frame(name, show_axes=False) for name in names])
        shown = tuple(each for each in visible(scene) if each.body != WORLD)
        look = {"color": REFERENCE_COLOR, "opacity": GHOST_OPACITY}
        self._add_surfaces(tuple(Fixed(body, each._replace(**look)) for body, each in shown), names, "ghost")

    def _add_surfaces(self, fixed: Sequence[Fixed], names: list[str], kind: str) -> list[Any]:
        return [
            self._scene.add_mesh_simple(
                f"{names[body]}/{kind}{number}",
                each.vertices.astype(np.float32),
                each.faces.astype(np.uint32),
                color=_bytes(each.color),
                opacity=each.opacity if each.opacity < 1.0 else None,
                side="double",
                cast_shadow=each.opacity >= 1.0,
            )
            for number, (body, each) in enumerate(fixed)
        ]

    def _add_axes(self, name: str) -> Any:
        length = 8.0 * THIN * self._stage.scene.size
        return self._scene.add_frame(name, axes_length=length, axes_radius=0.06 * length, origin_color=_bytes(BONE_COLOR))

    def _add_floor(self) -> None:
        points, size = self._stage.outline(self._offsets), self._stage.scene.size
        spacing = grid_spacing(size)
        self._scene.set_up_direction("+z")
        self._scene.add_grid(
            "/floor",
            cell_size=spacing,
            section_size=4.0 * spacing,
            infinite_grid=True,
            cell_color=_bytes((0.86, 0.87, 0.88)),
            section_color=_bytes((0.76, 0.77, 0.79)),
            fade_distance=12.0 * float(np.linalg.norm(np.ptp(points, axis=0))),
            position=(0.0, 0.0, floor_height(points)),
            shadow_opacity=0.2,
        )
        # The sky of the films.
        up = np.linspace(1.0, 0.0, 64)[:, None, None]
        sky = np.broadcast_to(up * SKY + (1.0 - up) * HORIZON, (64, 4, 3))
        self._scene.set_background_image(np.round(255.0 * sky).astype(np.uint8), format="png")
        camera = camera_around(points, 1.2)
        initial = self._server.initial_camera
        initial.position, initial.look_at, initial.fov = camera.position, camera.target, float(FIELD_OF_VIEW)

    def _place(self, copies: list[list[Any]], placed: Postures) -> None:
        for copy, handles in enumerate(copies):
            if handles:
                quaternions = Rotation.from_matrix(placed.rotation[copy]).as_quat(scalar_first=True)
                for handle, wxyz, position in zip(handles, quaternions, placed.origin[copy], strict=True):
                    handle.wxyz, handle.position = wxyz, position

    def _bones(self, placed: Postures, copy: int) -> Float[np.ndarray, "n 2 3"]:
        pairs = np.array(self._stage.scene.bones, int)
        return placed.origin[copy][pairs].astype(np.float32)


def _bytes(color: Rgb) -> tuple[int, int, int]:
    red, green, blue = (round(255 * part) for part in color)
    return red, green, blue
