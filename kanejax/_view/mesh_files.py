"""Reading mesh files of others: STL, OBJ and Collada, by trimesh, and nothing but the file itself."""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from kanejax._errors import ModelFileError
from kanejax._io.xml_text import parsed_xml
from kanejax._view.shape import Rgb, Surface, surface, view_package

FORMATS = {".stl": "stl", ".obj": "obj", ".dae": "dae"}
_MOST_BYTES, _MOST_TRIANGLES = 2**28, 5_000_000


def mesh_surfaces(
    path: Path, matrix: Float[np.ndarray, "3 3"], shift: Float[np.ndarray, "3"], color: Rgb | None
) -> tuple[Surface, ...]:
    """The surfaces of a mesh file, each vertex v of which becomes matrix v + shift.

    Materials and pictures that it names in other files are not read: an OBJ has the given colour, or grey; a Collada file has its
    own colours unless one is given.

    Raises:
        ModelFileError: it is no mesh, has no triangles, or is too large.
    """
    kind = FORMATS.get(path.suffix.lower())
    if kind is None:
        raise ModelFileError(f"{path}: meshes are read from {', '.join(FORMATS)}; convert it")
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ModelFileError(f"{path}: the file has more than {_MOST_BYTES >> 20} MiB; simplify the mesh")
        data = path.read_bytes()
    except OSError as error:
        raise ModelFileError(f"{path}: cannot be read ({error.strerror})") from error
    if kind == "dae":
        _check_collada(data, path)
    trimesh = view_package("trimesh")
    try:
        with warnings.catch_warnings():
            # Of what those packages do themselves in ways that NumPy gives up.
            warnings.simplefilter("ignore")
            # Without a resolver no other file is read.
            options = {"resolver": None, "process": False, "skip_materials": kind == "obj"}
            parts = _parts(trimesh.load_scene(io.BytesIO(data), file_type=kind, **options), color)
    except Exception as error:
        # What is wrong with a file of somebody else may raise anything.
        said = " ".join(str(error).split())[:200]
        raise ModelFileError(f"{path}: the mesh cannot be read ({type(error).__name__}: {said})") from error
    # A mirrored triangle is wound the other way.
    order = slice(None, None, -1 if np.linalg.det(matrix) < 0 else 1)
    surfaces = tuple(surface((triangles @ matrix.T + shift)[:, order], of) for of, triangles in parts.items())
    if not sum(len(each.faces) for each in surfaces):
        raise ModelFileError(f"{path}: the mesh has no triangles")
    return tuple(each for each in surfaces if len(each.faces))


def _parts(scene: Any, color: Rgb | None) -> dict[Rgb, np.ndarray]:
    """Triangles of a scene by colour."""
    found: dict[Rgb, list[np.ndarray]] = {}
    nodes = [scene.graph[node] for node in scene.graph.nodes_geometry]
    if sum(len(scene.geometry[name].faces) for _, name in nodes) > _MOST_TRIANGLES:
        raise ValueError(f"more than {_MOST_TRIANGLES} triangles")
    for transform, name in nodes:
        geometry = scene.geometry[name]
        triangles = np.array(geometry.triangles, float) @ transform[:3, :3].T + transform[:3, 3]
        if not np.all(np.abs(triangles) < 1e9):
            raise ValueError("a vertex is not finite, or a million kilometres away")
        found.setdefault(color or _own_color(geometry), []).append(triangles)
    return {key: np.concatenate(each) for key, each in found.items()}


def _own_color(geometry: Any) -> Rgb:
    material = getattr(geometry.visual, "material", None)
    rgba = getattr(material, "main_color", None)
    if rgba is None:
        rgba = np.array([184, 186, 191, 255])
    red, green, blue = (round(float(value) / 255.0, 4) for value in rgba[:3])
    return red, green, blue


def _check_collada(data: bytes, path: Path) -> None:
    """Refuse entities, and nodes within nodes, which could expand without bound."""
    root = parsed_xml(data, str(path))
    if any(element.tag.rpartition(":")[2].rpartition("}")[2] == "instance_node" for element in root.iter()):
        raise ModelFileError(f"{path}: Collada's <instance_node> is not read; export it without references to nodes")
