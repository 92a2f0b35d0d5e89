"""Write the meshes of packaged hands: ``python -m tools.meshes``."""

import sys
from collections.abc import Iterator
from pathlib import Path

from tools.meshes import t42
from tools.meshes.solids import stl

HANDS_FOLDER = Path(__file__).parents[2] / "src" / "handctl" / "hand" / "hands"
"""Folder of the packaged hands."""


def packaged_mesh_files() -> Iterator[tuple[Path, bytes]]:
    """Yield the path and the content of each mesh file."""
    for name, triangles in (
        ("palm", t42.palm_triangles()),
        ("inner", t42.inner_link_triangles()),
        ("outer", t42.outer_link_triangles()),
    ):
        yield HANDS_FOLDER / "t42" / f"{name}.stl", stl(triangles)


def main() -> int:
    """Write all mesh files, and return the exit code."""
    for path, content in packaged_mesh_files():
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
        print(f"{path.relative_to(HANDS_FOLDER.parent)}: {len(content)} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
