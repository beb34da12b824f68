"""Shapes as triangles in the axes of a body, and the simple ones among them."""

import importlib
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from kanejax._errors import KanejaxError

Rgb = tuple[float, float, float]
# A light grey, for what has no colour of its own.
GREY: Rgb = (0.72, 0.73, 0.75)
# Below this cosine between two neighbouring triangles the edge between them is sharp.
_CREASE = np.cos(np.radians(35.0))
# Pairs of corners at one point; beyond, such as of a fan of a million triangles, shading is flat.
_MOST_PAIRS = 50_000_000


class ViewError(KanejaxError, ValueError):
    """A robot or its motion cannot be shown as it is asked for."""


class Surface(NamedTuple):
    """Triangles of one colour.

    Attributes:
        vertices: their corners; those of a sharp edge are there once for each of its sides.
        normals: unit vectors across the surface at the vertices.
        faces: three vertices for each triangle.
        color: red, green and blue, from 0 to 1.
        opacity: from 0 to 1.
    """

    vertices: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    faces: Int[np.ndarray, "m 3"]
    color: Rgb = GREY
    opacity: float = 1.0

    def moved(self, rotation: Float[np.ndarray, "3 3"], origin: Float[np.ndarray, "3"]) -> "Surface":
        """The same in other axes."""
        return self._replace(vertices=self.vertices @ rotation.T + origin, normals=self.normals @ rotation.T)


def view_package(module: str) -> Any:
    """Import a module of a package that only pictures need.

    Raises:
        ViewError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ViewError(f"showing a robot needs the package of {module}: pip install 'kanejax[view]'") from error


def surface(triangles: Float[np.ndarray, "m 3 3"], color: Rgb = GREY, opacity: float = 1.0) -> Surface:
    """Triangles, given by their corners, shaded smoothly but for sharp edges; those without area are left out."""
    from scipy import sparse

    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(across, axis=1)
    triangles, across, area = triangles[area > 0], across[area > 0], area[area > 0]
    count = 3 * len(triangles)
    corners = triangles.reshape(count, 3)
    _, first, points = np.unique(_keys(corners), return_index=True, return_inverse=True)
    of_corner = np.repeat(across, 3, axis=0)
    normals = of_corner.copy()
    if np.sum(np.bincount(points).astype(float) ** 2) < _MOST_PAIRS:
        at = sparse.csr_matrix((np.ones(count), (np.arange(count), points)), (count, len(first)))
        pairs = (at @ at.T).tocoo()
        unit = np.repeat(across / area[:, None], 3, axis=0)
        near = np.einsum("ij,ij->i", unit[pairs.row], unit[pairs.col]) > _CREASE
        same = sparse.csr_matrix((np.ones(near.sum()), (pairs.row[near], pairs.col[near])), (count, count))
        normals = same @ of_corner
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    # Corners of one point and one direction are one vertex.
    _, kept, faces = np.unique(_keys(np.column_stack((points, np.round(normals, 3)))), return_index=True, return_inverse=True)
    return Surface(corners[kept], normals[kept], faces.reshape(-1, 3).astype(int), color, opacity)


def box(size: Float[np.ndarray, "3"], **look: Any) -> Surface:
    """A box of these edges around the origin."""
    mesh = view_package("trimesh").creation.box(extents=size)
    return surface(np.array(mesh.triangles), **look)


def ellipsoid(semi_axes: Float[np.ndarray, "3"], **look: Any) -> Surface:
    """An ellipsoid around the origin; of equal semi-axes, a sphere."""
    ball = view_package("trimesh").creation.icosphere(subdivisions=3)
    vertices = np.array(ball.vertices)
    normals = vertices / semi_axes
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return Surface(vertices * semi_axes, normals, np.array(ball.faces, int), **look)


def cylinder(radius: float, length: float, **look: Any) -> Surface:
    """A cylinder along z around the origin."""
    mesh = view_package("trimesh").creation.cylinder(radius=radius, height=length, sections=32)
    return surface(np.array(mesh.triangles), **look)


def capsule(radius: float, length: float, **look: Any) -> Surface:
    """A cylinder of this length along z around the origin, with half a ball at each end."""
    mesh = view_package("trimesh").creation.capsule(radius=radius, height=length, count=(24, 24))
    centred = np.array(mesh.triangles) - np.array([0.0, 0.0, mesh.bounds.mean(0)[2]])
    return surface(centred, **look)


def _keys(rows: Float[np.ndarray, "n k"]) -> np.ndarray:
    """Rows as single values that can be sorted; equal rows have equal values."""
    exact = np.ascontiguousarray(rows + 0.0)
    return exact.view(np.dtype((np.void, exact.dtype.itemsize * exact.shape[1]))).ravel()
