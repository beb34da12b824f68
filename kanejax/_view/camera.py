"""Where a scene is seen from."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Of a long lens, which bends shapes little; from top to bottom of the picture.
FIELD_OF_VIEW = np.radians(32.0)
AZIMUTH, ELEVATION = 40.0, 18.0


class Camera(NamedTuple):
    """A camera, upright, in world axes.

    Attributes:
        position: of its eye [m].
        target: the point in the middle of the picture.
        field_of_view: angle from top to bottom [rad].
    """

    position: Float[np.ndarray, "3"]
    target: Float[np.ndarray, "3"]
    field_of_view: float = FIELD_OF_VIEW

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Unit vectors to the right, up, and towards the target, as rows."""
        forward = self.target - self.position
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        # Straight down, the x axis points to the right.
        right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-6 else np.array([1.0, 0.0, 0.0])
        return np.array([right, np.cross(right, forward), forward])

    def rays(self, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], size: tuple[int, int]) -> Float[np.ndarray, "n 3"]:
        """Unit vectors through points of a picture of so many columns and rows, counted from its upper left corner."""
        width, height = size
        half = np.tan(0.5 * self.field_of_view)
        across, up = (2.0 * x - width) / height * half, (height - 2.0 * y) / height * half
        right, upward, forward = self.axes
        rays = across[:, None] * right + up[:, None] * upward + forward
        return rays / np.linalg.norm(rays, axis=1)[:, None]

    def pixels(self, points: Float[np.ndarray, "n 3"], size: tuple[int, int]) -> Float[np.ndarray, "n 2"]:
        """Where points are in such a picture."""
        width, height = size
        right, up, depth = self.axes @ (points - self.position).T
        scale = 0.5 * height / (np.tan(0.5 * self.field_of_view) * depth)
        return np.stack((0.5 * width + scale * right, 0.5 * height - scale * up), 1)


def camera_around(
    points: Float[np.ndarray, "n 3"],
    aspect: float,
    *,
    azimuth: float = AZIMUTH,
    elevation: float = ELEVATION,
    distance: float | None = None,
) -> Camera:
    """A camera that sees all of these points, from as near as it can, with a margin.

    Args:
        points: what is to be seen.
        aspect: width of the picture over its height.
        azimuth: around the vertical, from the x axis towards the y axis [degrees].
        elevation: above the horizon [degrees].
        distance: from the middle of the picture [m], in place of the least.
    """
    alpha, beta = np.radians(azimuth), np.radians(elevation)
    outward = np.array([np.cos(beta) * np.cos(alpha), np.cos(beta) * np.sin(alpha), np.sin(beta)])
    middle = 0.5 * (points.min(0) + points.max(0))
    right, up, forward = Camera(middle + outward, middle).axes
    x, y, z = np.array([right, up, forward]) @ (points - middle).T
    half = np.tan(0.5 * FIELD_OF_VIEW)
    aside, far = _fitted(x, z, half * aspect)
    above, farther = _fitted(y, z, half)
    target = middle + aside * right + above * up
    away = max(1.1 * max(far, farther) if distance is None else distance, 1e-3)
    return Camera(target + away * outward, target)


def _fitted(x: Float[np.ndarray, " n"], z: Float[np.ndarray, " n"], slope: float) -> tuple[float, float]:
    """Where to stand, aside and how far, so that points at x and depth z lie between two lines of this slope."""
    one, other = float(np.max(x - slope * z)), float(np.max(-x - slope * z))
    return 0.5 * (one - other), 0.5 * (one + other) / slope
