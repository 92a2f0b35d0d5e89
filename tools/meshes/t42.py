"""Compute the meshes of the hand t42 in millimetres: palm, inner link and outer link.

Three kinds of dimensions come from t42.toml: the lengths of the links, the distance between the
fingers, and the cross-section of 16 x 18 mm. All other dimensions were chosen freely.
"""

import numpy as np

from tools.meshes.solids import Array, along_x, disc_outline, prism_triangles

INNER_LENGTH_MM = 62.551
"""Distance between the two joints of a finger [mm]."""
OUTER_LENGTH_MM = 48.0
"""Distance of the fingertip from the outer joint [mm]."""
HALF_WIDTH_MM = 9.0
"""Half of the width of a link along the joint axis [mm]."""
MOUNT_DISTANCE_MM = 26.0
"""Distance of a finger's first joint from the middle of the palm [mm]."""


def inner_link_triangles() -> Array:
    """Return the mesh of the inner link: knuckle, bar, pad on the closing side, and two cheeks at the outer joint."""
    bar = [(2.0, -7.0), (INNER_LENGTH_MM - 14.0, -6.0), (INNER_LENGTH_MM - 10.0, -4.0), (INNER_LENGTH_MM - 10.0, 3.5),
        (INNER_LENGTH_MM - 13.0, 5.0),
           (2.0, 6.5)]  # fmt: skip
    pad = [(12.0, 4.0), (INNER_LENGTH_MM - 15.0, 4.0), (INNER_LENGTH_MM - 17.0, 8.0), (14.0, 8.0)]
    cheek = [(INNER_LENGTH_MM - 18.0, -5.5), (INNER_LENGTH_MM, -6.0), (INNER_LENGTH_MM + 5.0, -3.5),
        (INNER_LENGTH_MM + 6.0, 0.0), (INNER_LENGTH_MM + 5.0, 3.5),
             (INNER_LENGTH_MM, 6.0), (INNER_LENGTH_MM - 18.0, 4.5)]  # fmt: skip
    return np.vstack([
        prism_triangles(disc_outline((0.0, 0.0), 8.0), -5.5, 5.5, 0.8),
        prism_triangles(bar, -HALF_WIDTH_MM, HALF_WIDTH_MM, 1.5),
        prism_triangles(pad, -HALF_WIDTH_MM + 1.0, HALF_WIDTH_MM - 1.0, 1.0),
        prism_triangles(cheek, -HALF_WIDTH_MM, -HALF_WIDTH_MM + 2.5, 0.5),
        prism_triangles(cheek, HALF_WIDTH_MM - 2.5, HALF_WIDTH_MM, 0.5),
        prism_triangles(disc_outline((INNER_LENGTH_MM, 0.0), 2.5), -HALF_WIDTH_MM - 0.8, HALF_WIDTH_MM + 0.8, 0.4),
    ])  # fmt: skip


def outer_link_triangles() -> Array:
    """Return the mesh of the outer link: a knuckle, a bar that narrows to the tip, and a pad on the closing side."""
    bar = [(3.0, -5.5), (26.0, -5.0), (OUTER_LENGTH_MM - 8.0, -3.0), (OUTER_LENGTH_MM - 2.0, 0.5),
        (OUTER_LENGTH_MM, 3.5), (OUTER_LENGTH_MM - 1.5, 5.5),
           (OUTER_LENGTH_MM - 6.0, 6.5), (8.0, 6.0), (3.0, 4.5)]  # fmt: skip
    pad = [
        (9.0, 4.0),
        (OUTER_LENGTH_MM - 3.0, 4.5),
        (OUTER_LENGTH_MM - 4.5, 7.5),
        (OUTER_LENGTH_MM - 9.0, 8.0),
        (12.0, 7.8),
    ]
    return np.vstack([
        prism_triangles(disc_outline((0.0, 0.0), 6.0), -5.8, 5.8, 0.8),
        prism_triangles(bar, -HALF_WIDTH_MM + 0.5, HALF_WIDTH_MM - 0.5, 1.5),
        prism_triangles(pad, -HALF_WIDTH_MM + 1.2, HALF_WIDTH_MM - 1.2, 1.0),
    ])  # fmt: skip


def palm_triangles() -> Array:
    """Return the mesh of the palm: a block between the fingers, a foot, and two cheeks at each first joint."""
    block = [(-30.0, -15.0), (-2.0, -15.0), (0.0, -13.0), (0.0, 13.0), (-2.0, 15.0), (-30.0, 15.0)]
    foot = [(-38.0, -33.0), (-36.0, -37.0), (-14.0, -37.0), (-11.0, -33.0), (-11.0, 33.0), (-14.0, 37.0), (-36.0, 37.0),
            (-38.0, 33.0)]  # fmt: skip
    triangle_groups = [
        prism_triangles(block, -17.0, 17.0, 1.5),
        prism_triangles(foot, -17.0, 17.0, 2.0),
    ]
    triangle_groups.append(
        along_x(prism_triangles(disc_outline((0.0, 0.0), 24.0, 36), -48.0, -36.0, 1.5))
    )
    for y in (-MOUNT_DISTANCE_MM, MOUNT_DISTANCE_MM):
        cheek = [(-20.0, y - 8.5), (0.0, y - 8.0), (5.5, y - 5.5), (8.0, y), (5.5, y + 5.5), (0.0, y + 8.0),
                 (-20.0, y + 8.5)]  # fmt: skip
        triangle_groups += [
            prism_triangles(cheek, -9.5, -6.2, 0.6),
            prism_triangles(cheek, 6.2, 9.5, 0.6),
        ]
        triangle_groups.append(prism_triangles(disc_outline((0.0, y), 3.0), -10.5, 10.5, 0.5))
    return np.vstack(triangle_groups)
