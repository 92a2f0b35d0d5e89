"""Meshes of a hand's links and palm, for display only.

The meshes of links and palm have neither mass nor contacts in a simulation.
"""

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from handctl.hand.description import Hand
from handctl.hand.digit import Array
from handctl.hand.file.error_text import FileMistake
from handctl.hand.file.mesh_value_types import MESH_SUFFIXES
from handctl.hand.formats.mesh_file import mesh_triangles
from handctl.hand.link_geometry import rotation_of_rpy

PALM_LINK = "palm"
"""Link name of the palm."""
LARGEST_EXTENT_M = 1.0
"""Largest extent of a mesh, and largest distance between a point of the mesh and the origin of the link [m]."""
SMALLEST_EXTENT_M = 0.5e-3
"""Smallest extent of a mesh along its longest side [m]."""
MILLIMETRE_SCALE = 1e-3
"""Factor from the unit of a mesh in millimetres to metres."""
MAX_FILE_BYTES = 16 << 20
"""Largest size of a mesh file [bytes].

A binary STL with the largest allowed number of triangles has 10 MB.
"""


@dataclass(frozen=True, slots=True)
class LinkMesh:
    """Mesh of a link or of the palm, with its placement in the frame of the link.

    Attributes:
        link: name of the link, or ``palm`` for the palm.
        key: key path of the mesh in the resolved content of the hand file.
        file: path of the mesh file as it is written in the hand file.
        scale: factors from the file's unit to metres, for x, y, z.
        position: position of the origin of the mesh in the frame of the link [m].
        rpy_deg: roll, pitch, yaw of the mesh in the frame of the link.
    """

    link: str
    key: str
    file: str
    scale: tuple[float, float, float]
    position: tuple[float, float, float]
    rpy_deg: tuple[float, float, float]

    @property
    def rotation(self) -> Array:
        """Return the rotation (3, 3) of the mesh in the frame of the link."""
        return rotation_of_rpy(*np.radians(self.rpy_deg))

    @property
    def suffix(self) -> str:
        """Return the suffix of the mesh file's name in lower case."""
        return PurePath(self.file).suffix.lower()

    def to_link_frame(self, triangles: Array) -> Array:
        """Transform triangles (n, 3, 3) of the mesh file to the frame of the link, in metres."""
        return np.asarray(triangles * self.scale @ self.rotation.T + self.position)


def meshes_of_hand(hand: Hand) -> tuple[LinkMesh, ...]:
    """Return the meshes of a hand, beginning with the mesh of the palm."""
    mount = hand.mount
    meshes = []
    if mount.palm_mesh:
        pose = (mount.palm_mesh_scale, mount.palm_mesh_position_m, mount.palm_mesh_rpy_deg)
        meshes.append(_link_mesh(PALM_LINK, "mount.palm_mesh", mount.palm_mesh, *pose))
    for digit in hand.digit:
        for i, file in enumerate(digit.link_mesh or ()):
            if file:
                keys = (digit.link_mesh_scale, digit.link_mesh_position_m, digit.link_mesh_rpy_deg)
                pose_of_link = [None if values is None else values[i] for values in keys]
                key = f"digit[{digit.name}].link_mesh[{i}]"
                meshes.append(_link_mesh(f"{digit.name}_link{i + 1}", key, file, *pose_of_link))
    return tuple(meshes)


def _link_mesh(
    link_name: str, key: str, file_path: str, scale: Any, position: Any, rpy_deg: Any
) -> LinkMesh:
    """Return the mesh of a link. For an argument that is None, the function uses a default value."""
    scale = 1.0 if scale is None else scale
    axis_scales = (scale, scale, scale) if isinstance(scale, float) else scale
    return LinkMesh(
        link_name,
        key,
        file_path,
        axis_scales,
        position or (0.0, 0.0, 0.0),
        rpy_deg or (0.0, 0.0, 0.0),
    )


def mesh_mistakes(hand: Hand, folder: Path) -> Iterator[FileMistake]:
    """Yield a mistake for each mesh that cannot be shown or has an implausible size.

    Args:
        hand: description of the hand.
        folder: folder of the hand file.
    """
    triangles: dict[str, Array] = {}
    for mesh in meshes_of_hand(hand):
        try:
            if mesh.file not in triangles:
                triangles[mesh.file] = read_triangles(folder / mesh.file)
        except ValueError as error:
            problem_text, _, expected = str(error).partition("; expected ")
            yield FileMistake(f'"{mesh.file}": {problem_text}', mesh.key, expected)
            continue
        yield from _size_mistakes(mesh, triangles[mesh.file])


def read_triangles(path: Path) -> Array:
    """Return the corners of all triangles in a mesh file (n, 3, 3), in the unit of the file.

    Raises:
        ValueError: the file is missing, unreadable, too large, or not a mesh. The error message
            contains the expected kind of file.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise ValueError(
            f"a file of type {path.suffix or 'unknown'}; expected {' or '.join(MESH_SUFFIXES)}"
        )
    return mesh_triangles(_read_file(path), path.suffix)


def _read_file(path: Path) -> bytes:
    """Read the content of a mesh file.

    Raises:
        ValueError: the file is missing, unreadable or too large.
    """
    try:
        if not path.is_file():
            raise ValueError("no such file; expected a file, relative to the hand file")
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ValueError(
                f"{path.stat().st_size / 1e6:.0f} MB; expected at most {MAX_FILE_BYTES / 1e6:.0f} MB"
            )
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}; expected a readable file") from None


def _size_mistakes(mesh: LinkMesh, triangles: Array) -> Iterator[FileMistake]:
    """Check that the size of a mesh and its distance from the link are plausible."""
    points = mesh.to_link_frame(triangles).reshape(-1, 3)
    extent = float((points.max(axis=0) - points.min(axis=0)).max())
    max_distance = float(np.abs(points).max())
    scale_key = mesh.key.rpartition(".")[2].partition("[")[0] + "_scale"
    largest = max(extent, max_distance)
    if not largest <= LARGEST_EXTENT_M:
        problem_text = (
            f"{extent:.3g} m long"
            if extent > LARGEST_EXTENT_M
            else f"{max_distance:.3g} m away from its link"
        )
        could_be_millimetres = (
            largest * MILLIMETRE_SCALE <= LARGEST_EXTENT_M
            and extent * MILLIMETRE_SCALE >= SMALLEST_EXTENT_M
        )
        hint = (
            f"; {scale_key} = {MILLIMETRE_SCALE:g} if the mesh is in millimetres"
            if could_be_millimetres
            else ""
        )
        yield FileMistake(
            f'"{mesh.file}": {problem_text}', mesh.key, f"at most {LARGEST_EXTENT_M:g} m{hint}"
        )
    elif extent < SMALLEST_EXTENT_M:
        problem_text = f"{extent:.3g} m long"
        yield FileMistake(
            f'"{mesh.file}": {problem_text}',
            mesh.key,
            f"at least {SMALLEST_EXTENT_M:g} m; is {scale_key} right?",
        )


def mesh_sizes(hand: Hand, folder: Path) -> dict[str, int]:
    """Return the size [bytes] of each existing mesh file, by the path in the hand file."""
    files = dict.fromkeys(mesh.file for mesh in meshes_of_hand(hand))
    return {file: (folder / file).stat().st_size for file in files if (folder / file).is_file()}


def read_meshes(mesh_files: Iterable[str], folder: Path) -> dict[str, bytes]:
    """Return the content of mesh files, by their paths in the hand file.

    Raises:
        ValueError: a file is missing or unreadable.
    """
    return {file: _read_file(folder / file) for file in dict.fromkeys(mesh_files)}


def exported_meshes(hand: Hand, folder: Path, output_path: Path) -> dict[str, LinkMesh]:
    """Return the meshes of a hand by the name of the link.

    The paths of the meshes are relative to the folder of an exported file.

    Args:
        hand: description of the hand.
        folder: folder of the hand file.
        output_path: folder of the exported file.
    """
    return {
        mesh.link: replace(mesh, file=relative_path(folder / mesh.file, output_path))
        for mesh in meshes_of_hand(hand)
    }


def relative_path(path: Path, folder: Path) -> str:
    """Return a path relative to a folder."""
    return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()


def with_meshes_from(hand_content: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the resolved content of a hand with absolute mesh paths.

    Absolute mesh paths do not depend on the folder of the hand file.

    Args:
        hand_content: content of the hand, from ``Hand.content``.
        folder: folder of the hand file.
    """
    mesh_folder = folder.absolute()
    mount, digits = dict(hand_content["mount"]), []
    if mount.get("palm_mesh"):
        mount["palm_mesh"] = str(mesh_folder / mount["palm_mesh"])
    for digit in hand_content["digit"]:
        files = digit.get("link_mesh")
        digits.append(
            digit | {"link_mesh": [str(mesh_folder / file) if file else "" for file in files]}
            if files
            else digit
        )
    return {**hand_content, "mount": mount, "digit": digits}
