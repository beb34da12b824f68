"""Pictures by casting rays at triangles: no screen, no graphics card, and the same picture each time."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from kanejax._view.camera import Camera
from kanejax._view.shape import Surface, view_package

SKY, HORIZON = np.array([0.80, 0.86, 0.92]), np.array([0.97, 0.98, 0.99])
_FLOOR, _LINE = np.array([0.93, 0.935, 0.94]), np.array([0.74, 0.76, 0.78])
# Towards the lamp, over the shoulder of the camera: right, up and back.
_LAMP = np.array([-0.45, 0.75, 0.55])
_SHADOW = 0.42
# Pixels that differ by more from a neighbour are cast again, in so many rows and columns.
_CONTRAST, _FINER = 0.03, 3
# Of translucent surfaces behind one another, so many are seen.
_LAYERS = 6


class Floor(NamedTuple):
    """A horizontal floor at a height [m], with lines so far apart."""

    height: float
    spacing: float


class _Solid(NamedTuple):
    """Triangles that rays can be cast at, with what is needed to shade them."""

    embree: Any
    corner_normals: Float[np.ndarray, "m 3 3"]
    colors: Float[np.ndarray, "m 3"]
    opacity: Float[np.ndarray, " m"]


class _Hits(NamedTuple):
    """What each ray met first."""

    met: Bool[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 3"]
    color: Float[np.ndarray, "n 3"]
    opacity: Float[np.ndarray, " n"]


def picture(
    surfaces: Sequence[Surface], camera: Camera, size: tuple[int, int], floor: Floor
) -> UInt8[np.ndarray, "rows columns 3"]:
    """A picture of surfaces in world axes, of so many columns and rows; edges are smooth.

    Light comes from the left above the camera, and casts shadows. Translucent ones cast none.
    """
    solid = _solid([each for each in surfaces if each.opacity >= 1.0])
    glass = _solid([each for each in surfaces if each.opacity < 1.0])
    width, height = size
    rows, columns = (index.ravel().astype(float) for index in np.mgrid[0:height, 0:width])

    def colors(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return _colors(solid, glass, camera, camera.rays(x, y, size), floor, size)

    found = colors(columns + 0.5, rows + 0.5)
    edges = np.flatnonzero(_edges(found.reshape(height, width, 3)))
    offsets = (np.arange(_FINER) + 0.5) / _FINER
    fine = [colors(columns[edges] + dx, rows[edges] + dy) for dy in offsets for dx in offsets]
    found[edges] = sum(fine) / len(fine)
    return np.round(255.0 * np.clip(found, 0.0, 1.0)).astype(np.uint8).reshape(height, width, 3)


def _solid(surfaces: Sequence[Surface]) -> _Solid | None:
    if not sum(len(each.faces) for each in surfaces):
        return None
    scenes, meshes = view_package("embreex.rtcore_scene"), view_package("embreex.mesh_construction")
    embree = scenes.EmbreeScene()
    triangles = np.concatenate([each.vertices[each.faces] for each in surfaces])
    meshes.TriangleMesh(embree, triangles.astype(np.float32))
    counts = [len(each.faces) for each in surfaces]
    return _Solid(
        embree,
        np.concatenate([each.normals[each.faces] for each in surfaces]),
        np.repeat(np.array([each.color for each in surfaces]), counts, axis=0),
        np.repeat(np.array([each.opacity for each in surfaces]), counts),
    )


def _cast(solid: _Solid | None, origins: Float[np.ndarray, "n 3"], rays: Float[np.ndarray, "n 3"]) -> _Hits:
    count = len(rays)
    if solid is None:
        nothing = np.zeros((count, 3))
        return _Hits(np.zeros(count, bool), np.full(count, np.inf), nothing, nothing, np.zeros(count))
    hit = solid.embree.run(origins.astype(np.float32), rays.astype(np.float32), output=True)
    met = hit["primID"] >= 0
    face = np.maximum(hit["primID"], 0)
    # Of rays that meet nothing Embree says anything.
    b, c = (np.where(met, hit[key].astype(float), 0.0)[:, None] for key in ("u", "v"))
    corners = solid.corner_normals[face]
    normal = (1.0 - b - c) * corners[:, 0] + b * corners[:, 1] + c * corners[:, 2]
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-12)[:, None]
    # Surfaces are seen from both sides: triangles of others are wound either way.
    normal = np.where(np.einsum("ij,ij->i", normal, rays)[:, None] > 0.0, -normal, normal)
    return _Hits(met, np.where(met, hit["tfar"].astype(float), np.inf), normal, solid.colors[face], solid.opacity[face])


def _colors(
    solid: _Solid | None,
    glass: _Solid | None,
    camera: Camera,
    rays: Float[np.ndarray, "n 3"],
    floor: Floor,
    size: tuple[int, int],
) -> Float[np.ndarray, "n 3"]:
    """The colour that comes along each ray."""
    right, up, forward = camera.axes
    lamp = _LAMP @ np.array([right, up, -forward])
    lamp = np.array([*lamp[:2], max(lamp[2], 0.6)])
    lamp /= np.linalg.norm(lamp)
    origins = np.broadcast_to(camera.position, rays.shape)
    hits = _cast(solid, origins, rays)
    color, on_floor = _surroundings(camera, rays, floor, size)
    distance = np.minimum(hits.distance, on_floor)
    color[hits.met] = _shaded(hits.color[hits.met], hits.normal[hits.met], rays[hits.met], lamp)
    below = hits.distance > on_floor
    _below, lit = np.flatnonzero(np.isfinite(distance)), np.ones(len(rays))
    points = camera.position + distance[_below, None] * rays[_below]
    normals = np.where(below[_below, None], np.array([0.0, 0.0, 1.0]), hits.normal[_below])
    lit[_below[_in_shadow(solid, points, normals, lamp, np.linalg.norm(camera.target - camera.position))]] = 0.0
    facing = np.where(below, 1.0, np.clip(4.0 * (hits.normal @ lamp), 0.0, 1.0))
    color *= (1.0 - _SHADOW * (1.0 - lit) * np.where(below, _fade(on_floor, camera), facing))[:, None]
    return _veiled(color, glass, camera, rays, distance, lamp)


def _veiled(
    color: np.ndarray, glass: _Solid | None, camera: Camera, rays: np.ndarray, distance: np.ndarray, lamp: np.ndarray
) -> Float[np.ndarray, "n 3"]:
    """Colours behind what is translucent and nearer than `distance`: the first few layers of it."""
    left, veil = np.ones(len(rays)), np.zeros_like(color)
    at, begin = np.arange(len(rays)), np.zeros(len(rays))
    length = float(np.linalg.norm(camera.target - camera.position))
    # What coincides with something solid, such as a reference that is kept to, would show through in patches.
    distance = distance - 1e-3 * length
    for _ in range(_LAYERS if glass is not None else 0):
        hits = _cast(glass, camera.position + begin[at, None] * rays[at], rays[at])
        seen = hits.met & (begin[at] + hits.distance < distance[at])
        at, hits = at[seen], _Hits(*(each[seen] for each in hits))
        veil[at] += (left[at] * hits.opacity)[:, None] * _shaded(hits.color, hits.normal, rays[at], lamp)
        left[at] *= 1.0 - hits.opacity
        # On from behind the surface.
        begin[at] += hits.distance + 1e-4 * length
    return veil + left[:, None] * color


def _shaded(color: np.ndarray, normal: np.ndarray, rays: np.ndarray, lamp: np.ndarray) -> np.ndarray:
    """Light of the lamp and of the sky, and a soft gloss."""
    direct = np.clip(normal @ lamp, 0.0, None)
    sky = 0.5 + 0.5 * normal[:, 2]
    halfway = lamp - rays
    halfway /= np.linalg.norm(halfway, axis=1)[:, None]
    gloss = np.clip(np.einsum("ij,ij->i", normal, halfway), 0.0, 1.0) ** 40
    return color * (0.34 + 0.16 * sky + 0.54 * direct)[:, None] + 0.12 * (gloss * (direct > 0))[:, None]


def _in_shadow(
    solid: _Solid | None, points: np.ndarray, normals: np.ndarray, lamp: np.ndarray, length: float
) -> Bool[np.ndarray, " n"]:
    if solid is None or not len(points):
        return np.zeros(len(points), bool)
    # Off the surface by what float32 cannot tell apart, or a surface would cast shadows on itself.
    origins = (points + 2e-4 * length * normals).astype(np.float32)
    rays = np.broadcast_to(lamp, points.shape).astype(np.float32)
    return np.asarray(solid.embree.run(origins, rays, query="OCCLUDED")) >= 0


def _fade(distance: Float[np.ndarray, " n"], camera: Camera) -> Float[np.ndarray, " n"]:
    """From 1 near the target to 0 far behind it."""
    near = float(np.linalg.norm(camera.target - camera.position))
    return np.where(np.isfinite(distance), np.exp(-((np.minimum(distance, 1e6 * near) / (2.6 * near)) ** 4)), 0.0)


def _surroundings(camera: Camera, rays: np.ndarray, floor: Floor, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Colours of sky and floor, and how far the floor is along each ray."""
    up = np.clip(rays[:, 2:], 0.0, 1.0) ** 0.6
    color = (1.0 - up) * HORIZON + up * SKY
    slope = rays[:, 2]
    height = camera.position[2] - floor.height
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where((slope < -1e-9) & (height > 0.0), height / -slope, np.inf)
    on = np.flatnonzero(np.isfinite(distance))
    places = camera.position[:2] + distance[on, None] * rays[on, :2]
    # How much floor a pixel covers: lines become as faint as they are thin in it.
    pixel = distance[on] * camera.field_of_view / size[1] / np.maximum(-slope[on], 0.05)
    width = 0.012 * floor.spacing
    off = np.abs(places / floor.spacing - np.round(places / floor.spacing)) * floor.spacing
    soft = np.maximum(pixel, 1e-12)[:, None]
    lines = np.clip((width + soft - off) / soft, 0.0, 1.0) * np.minimum(1.0, width / soft + 0.15)
    line = np.max(lines, axis=1)[:, None]
    fade = _fade(distance[on], camera)[:, None]
    color[on] = fade * (line * _LINE + (1.0 - line) * _FLOOR) + (1.0 - fade) * HORIZON
    return color, distance


def _edges(colors: Float[np.ndarray, "rows columns 3"]) -> Bool[np.ndarray, "rows columns"]:
    """Pixels that differ from one beside or below them, and these."""
    found = np.zeros(colors.shape[:2], bool)
    down = np.abs(np.diff(colors, axis=0)).max(2) > _CONTRAST
    across = np.abs(np.diff(colors, axis=1)).max(2) > _CONTRAST
    found[1:] |= down
    found[:-1] |= down
    found[:, 1:] |= across
    found[:, :-1] |= across
    return found
