"""Mesh files of a hand that are stored in a log as attachments.

With the attachments, a machine that lacks the original mesh files can show the meshes of the hand.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from handctl.hand.description import Hand
from handctl.hand.digit import Array
from handctl.hand.formats.link_meshes import (
    LinkMesh,
    mesh_mistakes,
    mesh_sizes,
    meshes_of_hand,
    read_meshes,
)
from handctl.hand.formats.mesh_file import mesh_triangles

MAX_MESH_BYTES = 4 << 20
"""Largest total size of the mesh files in a log [bytes].

If the mesh files of a hand exceed this size in total, the log stores no mesh file.
"""


@dataclass(frozen=True, eq=False)
class AttachedMesh:
    """Mesh of a link, and the content of the mesh file.

    Attributes:
        mesh: placement of the mesh on a link of the hand.
        data: content of the mesh file, as bytes.
        triangles: (n, 3, 3) three corners of each triangle, in the frame of the link [m].
    """

    mesh: LinkMesh
    data: bytes
    triangles: Array


def attachment_name(mesh_file: str) -> str:
    """Return the name of the attachment that contains a mesh file."""
    return f"mesh/{mesh_file}"


def mesh_attachments(hand: Hand, folder: Path) -> tuple[dict[str, bytes], list[str]]:
    """Return the mesh files of a hand as attachments by name, and one line of text for each omitted mesh.

    Args:
        hand: description of the hand.
        folder: folder of the hand file.
    """
    total = sum(mesh_sizes(hand, folder).values())
    if total > MAX_MESH_BYTES:
        sizes = f"{total / 1e6:.1f} MB, more than {MAX_MESH_BYTES / 1e6:.1f} MB"
        return {}, [
            f"the meshes have {sizes}, and are not stored in the log: its views show capsules"
        ]
    mistakes = list(mesh_mistakes(hand, folder))
    mistake_locations = {mistake.where for mistake in mistakes}
    files = [mesh.file for mesh in meshes_of_hand(hand) if mesh.key not in mistake_locations]
    lines = [f"{mistake.where}: {mistake.what}; expected {mistake.right}" for mistake in mistakes]
    return {attachment_name(file): data for file, data in read_meshes(files, folder).items()}, lines


def attached_meshes(
    hand: Hand, attachments: Mapping[str, bytes]
) -> tuple[dict[str, AttachedMesh], list[str]]:
    """Return the meshes in a log by the name of the link, and the names of links whose mesh is missing or damaged.

    Args:
        hand: description of the hand in the log.
        attachments: content of all attachments of the log, by name.
    """
    mesh_by_name: dict[str, AttachedMesh] = {}
    missing_meshes = []
    for mesh in meshes_of_hand(hand):
        data = attachments.get(attachment_name(mesh.file), b"")
        try:
            mesh_by_name[mesh.link] = AttachedMesh(
                mesh, data, mesh.to_link_frame(mesh_triangles(data, mesh.suffix))
            )
        except ValueError:
            missing_meshes.append(mesh.link)
    return mesh_by_name, missing_meshes
