"""Make convex prisms with chamfered edges, and convert them to binary STL."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STL_HEADER = b"made by python -m tools.meshes"
"""Text at the start of the 80-byte header of each STL file."""


def disc_outline(centre: tuple[float, float], radius: float, sides: int = 24) -> Array:
    """Return the corners of a regular polygon in counter-clockwise order, as an array (sides, 2)."""
    angles = 2.0 * math.pi * np.arange(sides) / sides
    return np.asarray(np.array(centre) + radius * np.column_stack((np.cos(angles), np.sin(angles))))


def prism_triangles(
    outline: Sequence[Sequence[float]] | Array, low: float, high: float, chamfer: float
) -> Array:
    """Return the triangles of a prism along z with chamfered ends, as an array (triangles, 3, 3).

    Args:
        outline: corners of a convex polygon in x and y, (m, 2), counter-clockwise.
        low: smallest z of the prism.
        high: largest z of the prism.
        chamfer: width of the chamfer along z. In x and y, the chamfer has at most this width.
    """
    corners = np.asarray(outline, dtype=np.float64)
    middle = corners.mean(axis=0)
    inset = middle + (corners - middle) * (
        1.0 - chamfer / np.linalg.norm(corners - middle, axis=1, keepdims=True)
    )
    layers = [(inset, low), (corners, low + chamfer), (corners, high - chamfer), (inset, high)]
    rings = [np.column_stack((ring, np.full(len(ring), z))) for ring, z in layers]
    triangles = []
    for i in range(len(corners)):
        j = (i + 1) % len(corners)
        for below, above in pairwise(rings):
            triangles += [(below[i], below[j], above[j]), (below[i], above[j], above[i])]
        if 0 < i < len(corners) - 1:
            triangles += [
                (rings[0][0], rings[0][j], rings[0][i]),
                (rings[-1][0], rings[-1][i], rings[-1][j]),
            ]
    return np.array(triangles)


def along_x(triangles: Array) -> Array:
    """Rotate triangles so that their z axis becomes the x axis.

    The x axis becomes the y axis, and the y axis becomes the z axis.
    """
    return triangles[..., [2, 0, 1]]


def stl(triangles: Array) -> bytes:
    """Convert an array of triangles (triangles, 3, 3) to a binary STL."""
    records = np.zeros(
        len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    )
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    records["normal"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    records["corners"] = triangles
    return STL_HEADER.ljust(80, b"\0") + len(records).to_bytes(4, "little") + records.tobytes()
