"""Rotation matrices and quaternions in NumPy, for tables that are read once."""

import numpy as np


def rotation_about(axis: int, angle: float) -> np.ndarray:
    """Rotation matrix about a coordinate axis; exact at multiples of a right angle."""
    quarters = angle / (np.pi / 2)
    sine, cosine = np.sin(angle), np.cos(angle)
    if abs(quarters - np.round(quarters)) < 1e-15:
        sine, cosine = np.round(sine), np.round(cosine)
    turn = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn[i, i] = turn[j, j] = cosine
    turn[i, j], turn[j, i] = -sine, sine
    return turn


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """Quaternion (w, x, y, z) of a rotation matrix, without loss of digits at any angle."""
    # With quaternion p of unit length, this matrix is 4 p p^T - 1; its largest column is the best conditioned.
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    products = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    ) + np.eye(4)
    largest = products[:, np.argmax(np.diag(products))]
    return largest / np.linalg.norm(largest)
