"""Value types of the keys for meshes in a hand file."""

from pathlib import PurePath
from typing import Annotated, Any

from handctl.hand.file.quantity_types import (
    CheckedType,
    NumberRange,
    number_in_range,
    number_or_list,
    validation_error,
)

MESH_SUFFIXES = (".stl", ".obj")
"""File name endings of the mesh formats that both the viewer and MuJoCo read."""
LARGEST_MESH_SCALE = 1000.0
"""Largest factor from the unit of a mesh to metres."""
SMALLEST_MESH_SCALE = 1e-6
"""Smallest factor from the unit of a mesh to metres."""


def _check_mesh_file(value: Any) -> str:
    """Return the value if it is a valid path of a mesh file. An empty string is also valid."""
    is_printable = isinstance(value, str) and value.isprintable()
    if not is_printable or (value and PurePath(value).suffix.lower() not in MESH_SUFFIXES):
        raise validation_error(f'a file of type {" or ".join(MESH_SUFFIXES)}, or "" for none')
    return str(value)


MeshFile = Annotated[
    str,
    CheckedType(
        _check_mesh_file, {"type": "string", "pattern": r"^(|.*\.([sS][tT][lL]|[oO][bB][jJ]))$"}
    ),
]
MeshScale = Annotated[
    float | tuple[float, float, float],
    number_or_list(
        NumberRange(SMALLEST_MESH_SCALE, LARGEST_MESH_SCALE),
        NumberRange(-LARGEST_MESH_SCALE, LARGEST_MESH_SCALE),
        3,
    ),
]
MeshPosition = Annotated[float, number_in_range(-1.0, 1.0, "m", "in metres?")]
