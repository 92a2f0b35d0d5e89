"""Types of the values that the mesh keys of a hand file can have."""

from pathlib import PurePath
from typing import Annotated, Any

from handctl.hand.file.quantities import Checked, Range, in_range, number_or_list, validation_error

SUFFIXES = (".stl", ".obj")
"""Endings of mesh files that the viewer and MuJoCo both read."""
LARGEST_SCALE = 1000.0
"""Largest factor from the unit of a mesh to metres."""
SMALLEST_SCALE = 1e-6
"""Smallest factor from the unit of a mesh to metres."""


def _check_mesh_file(value: Any) -> str:
    """Return the value if it is a valid path of a mesh file. An empty string means no mesh."""
    printable = isinstance(value, str) and value.isprintable()
    if not printable or (value and PurePath(value).suffix.lower() not in SUFFIXES):
        raise validation_error(f'a file of type {" or ".join(SUFFIXES)}, or "" for none')
    return str(value)


MeshFile = Annotated[
    str, Checked(_check_mesh_file, {"type": "string", "pattern": r"^(|.*\.([sS][tT][lL]|[oO][bB][jJ]))$"})
]
MeshScale = Annotated[
    float | tuple[float, float, float],
    number_or_list(Range(SMALLEST_SCALE, LARGEST_SCALE), Range(-LARGEST_SCALE, LARGEST_SCALE), 3),
]
MeshPosition = Annotated[float, in_range(-1.0, 1.0, "m", "in metres?")]
