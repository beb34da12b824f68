"""What an MJCF has to be seen: the geoms of the groups that MuJoCo shows at first."""

from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from jaxtyping import Float

from kanejax._errors import ModelFileError
from kanejax._io.assets import bodies_and_motion, mujoco_warnings
from kanejax._io.mjcf_files import checked_mjcf, folders_of, permitted_file
from kanejax._io.source import compile_source
from kanejax._view.mesh_files import mesh_surfaces
from kanejax._view.shape import Rgb, Surface, box, capsule, cylinder, ellipsoid, surface

_SHOWN_GROUPS = 3
_GEOM = mujoco.mjtGeom
# Sizes of a geom are half of ours.
_PRIMITIVES = {
    int(_GEOM.mjGEOM_SPHERE): lambda size, **look: ellipsoid(np.repeat(size[:1], 3), **look),
    int(_GEOM.mjGEOM_ELLIPSOID): lambda size, **look: ellipsoid(size, **look),
    int(_GEOM.mjGEOM_BOX): lambda size, **look: box(2.0 * size, **look),
    int(_GEOM.mjGEOM_CYLINDER): lambda size, **look: cylinder(float(size[0]), 2.0 * float(size[1]), **look),
    int(_GEOM.mjGEOM_CAPSULE): lambda size, **look: capsule(float(size[0]), 2.0 * float(size[1]), **look),
}


def mjcf_shapes(root: ElementTree.Element, path: Path, origin: str) -> tuple[list[tuple[int, Surface]], list[str]]:
    """The surfaces of an MJCF file, each with its body's number in MuJoCo and in its axes, and what could not be read.

    Planes and height fields are left out: there is a floor.
    """
    compiled = compile_source(path, strict=False, repair=True, allow_unphysical=True).mj_model
    files = _mesh_files(root, path, origin, compiled.ngeom)
    found: list[tuple[int, Surface]] = []
    problems: list[str] = []
    for geom in range(compiled.ngeom):
        color, opacity = _look(compiled, geom)
        if compiled.geom_group[geom] >= _SHOWN_GROUPS or opacity == 0.0:
            continue
        try:
            parts = _geom(compiled, geom, files.get(geom), color)
        except ModelFileError as error:
            problems.append(f"body {compiled.body(int(compiled.geom_bodyid[geom])).name!r}: {error}")
            continue
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, compiled.geom_quat[geom])
        body, position = int(compiled.geom_bodyid[geom]), compiled.geom_pos[geom]
        found += [(body, part._replace(opacity=opacity).moved(rotation.reshape(3, 3), position)) for part in parts]
    return found, problems


class _MeshFile:
    """A mesh that was not compiled: its file, or why there is none, and how it lies in the geom."""

    def __init__(self, mesh: mujoco.MjsMesh, spec: mujoco.MjSpec, bases: tuple[Path, ...], roots: tuple[Path, ...]) -> None:
        self._name = Path(mesh.file).name if spec.strippath else mesh.file
        self._bases, self._roots = tuple(base / mesh.compiler.meshdir for base in bases), roots
        quaternion, rotation = np.array(mesh.refquat), np.zeros(9)
        mujoco.mju_normalize4(quaternion)
        mujoco.mju_quat2Mat(rotation, quaternion)
        # MuJoCo scales what it has brought into the frame of refpos and refquat.
        self._matrix = np.diag(mesh.scale) @ rotation.reshape(3, 3).T
        self._shift = -self._matrix @ np.array(mesh.refpos)

    def surfaces(self, color: Rgb) -> tuple[Surface, ...]:
        path = permitted_file(self._name, self._bases, self._roots, "a mesh")
        if path is None:
            raise ModelFileError(f"{self._name!r} is not there")
        return mesh_surfaces(path, self._matrix, self._shift, color)


def _mesh_files(root: ElementTree.Element, path: Path, origin: str, ngeom: int) -> dict[int, _MeshFile]:
    """By number of the geom, the files that the dynamics did not need."""
    folders = checked_mjcf(root, folders_of(path), origin)
    with mujoco_warnings():
        spec = mujoco.MjSpec.from_file(str(path.absolute()))
    meshes = {mesh.name: mesh for mesh in spec.meshes if mesh.file}
    geoms = [geom for body, _ in bodies_and_motion(spec) for geom in body.geoms]
    if len(geoms) != ngeom:
        raise ModelFileError(f"{origin}: {len(geoms)} geoms became {ngeom}, so it is not known which has which mesh")
    named = {number: meshes[geom.meshname] for number, geom in enumerate(geoms) if geom.meshname in meshes}
    return {number: _MeshFile(mesh, spec, folders.bases, folders.roots) for number, mesh in named.items()}


def _geom(compiled: mujoco.MjModel, geom: int, file: _MeshFile | None, color: Rgb) -> tuple[Surface, ...]:
    kind = int(compiled.geom_type[geom])
    if kind == int(_GEOM.mjGEOM_MESH):
        return (surface(_compiled_mesh(compiled, int(compiled.geom_dataid[geom])), color),)
    if file is not None:
        return file.surfaces(color)
    if kind not in _PRIMITIVES:
        return ()
    return (_PRIMITIVES[kind](compiled.geom_size[geom].copy(), color=color),)


def _compiled_mesh(compiled: mujoco.MjModel, mesh: int) -> Float[np.ndarray, "m 3 3"]:
    start, count = compiled.mesh_vertadr[mesh], compiled.mesh_vertnum[mesh]
    first, faces = compiled.mesh_faceadr[mesh], compiled.mesh_facenum[mesh]
    return compiled.mesh_vert[start : start + count][compiled.mesh_face[first : first + faces]].astype(float)


def _look(compiled: mujoco.MjModel, geom: int) -> tuple[Rgb, float]:
    material = int(compiled.geom_matid[geom])
    red, green, blue, alpha = (
        float(value) for value in (compiled.geom_rgba[geom] if material < 0 else compiled.mat_rgba[material])
    )
    return (red, green, blue), alpha
