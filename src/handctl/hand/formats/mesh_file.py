"""Triangles of mesh files in the formats binary STL and OBJ.

handctl needs the triangles only to check meshes. MuJoCo and the viewer read the mesh files
themselves.
"""

from itertools import pairwise

import numpy as np

from handctl.hand.digit import Array

STL_HEADER = 84
"""Length of the header of a binary STL, including the number of triangles [bytes].

Source: the STL format.
"""
STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
"""Record of a triangle in a binary STL."""
MAX_TRIANGLES = 200_000
"""Largest number of triangles of a mesh. Source: MuJoCo refuses an STL with more triangles."""


def mesh_triangles(file_content: bytes, file_suffix: str) -> Array:
    """Return the corners of all triangles of a mesh (n, 3, 3), in the unit of the file.

    Args:
        file_content: content of the file.
        file_suffix: suffix of the file's name, ``.stl`` or ``.obj``.

    Raises:
        ValueError: the content of the file is not a mesh of the given format, is empty, or is too
            large. The error message describes the expected content.
    """
    triangles = (
        _stl_triangles(file_content)
        if file_suffix.lower() == ".stl"
        else _obj_triangles(file_content)
    )
    if not len(triangles):
        raise ValueError("no triangles; expected a mesh with at least one")
    if len(triangles) > MAX_TRIANGLES:
        raise ValueError(f"{len(triangles)} triangles; expected at most {MAX_TRIANGLES}")
    if not np.isfinite(triangles).all():
        raise ValueError("a corner that is not finite; expected finite coordinates")
    return triangles


def _stl_triangles(file_content: bytes) -> Array:
    """Return the triangles of a mesh in the format binary STL."""
    count = (
        int.from_bytes(file_content[80:STL_HEADER], "little")
        if len(file_content) >= STL_HEADER
        else 0
    )
    size = STL_HEADER + count * STL_TRIANGLE.itemsize
    if len(file_content) < STL_HEADER or len(file_content) != size:
        if file_content.lstrip()[:5].lower() == b"solid":
            raise ValueError(
                "an STL in text form; expected a binary STL, which MuJoCo reads as well"
            )
        problem_text = f"{len(file_content)} bytes" + (
            f" for {count} triangles" if len(file_content) >= STL_HEADER else ""
        )
        raise ValueError(
            f"{problem_text}; expected a binary STL of {STL_HEADER} bytes and {STL_TRIANGLE.itemsize} a triangle"
        )
    records = np.frombuffer(file_content, STL_TRIANGLE, count, STL_HEADER)
    return records["corners"].astype(np.float64)


def _obj_triangles(file_content: bytes) -> Array:
    """Return the triangles of a mesh in the format OBJ.

    A face with more than three corners is divided into a fan of triangles.
    """
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(file_content.decode("utf-8", "replace").splitlines(), 1):
        words = line.split()
        try:
            if words[:1] == ["v"]:
                vertices.append([float(word) for word in words[1:4]])
                if len(vertices[-1]) != 3:
                    raise ValueError
            elif words[:1] == ["f"]:
                # An OBJ file contains each corner in the form v, v/vt, v//vn or v/vt/vn. A negative
                # vertex number counts backwards from the last vertex in the file.
                vertex_numbers = [int(word.split("/")[0]) for word in words[1:]]
                corners = [
                    corner - 1 if corner > 0 else len(vertices) + corner
                    for corner in vertex_numbers
                ]
                if len(corners) < 3 or 0 in vertex_numbers or min(corners) < 0:
                    raise ValueError
                faces += [
                    (corners[0], first_corner, second_corner)
                    for first_corner, second_corner in pairwise(corners[1:])
                ]
        except ValueError:
            raise ValueError(
                f"line {number} is {line.strip()[:40]!r}; expected an OBJ with v and f lines"
            ) from None
    vertex_positions = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    corners_of_faces = np.array(faces, dtype=np.int64).reshape(-1, 3)
    if corners_of_faces.max(initial=-1) >= len(vertex_positions):
        problem_text = f"a face with vertex {corners_of_faces.max() + 1} of {len(vertex_positions)}"
        raise ValueError(f"{problem_text}; expected faces with vertices of this file")
    return np.asarray(vertex_positions[corners_of_faces])
