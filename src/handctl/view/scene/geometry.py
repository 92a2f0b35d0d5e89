"""Shapes of the hand's links, drawn as solids in the colours of the digits."""

from collections.abc import Iterator

import rerun as rr
from rerun.chunk import Chunk

from handctl.digit_colours import colour_numbers
from handctl.hand.link_frames import quaternion_of_rotation
from handctl.view.scene import palette
from handctl.view.scene.chunk_arrays import static_chunk
from handctl.view.scene.run_info import RunInfo

_SHAPE_ARCHETYPES: dict[str, type[rr.Boxes3D] | type[rr.Cylinders3D] | type[rr.Ellipsoids3D]] = {
    "Boxes3D": rr.Boxes3D,
    "Cylinders3D": rr.Cylinders3D,
    "Ellipsoids3D": rr.Ellipsoids3D,
}
"""Rerun's archetypes for the shapes in a URDF file, by name."""


MESH_MEDIA_TYPES = {".stl": "model/stl", ".obj": "model/obj"}
"""Media type of each kind of mesh file, by suffix."""


def entity_path(path: str) -> str:
    """Convert a path of Rerun's URDF reader to the path that the dashboard uses.

    The path /<robot>/visual_geometries/<link>/<part> becomes /hand/<link>/<part>.
    """
    return "/hand/" + path.split("/visual_geometries/", 1)[1]


def solid_shape_chunks(chunk: Chunk, run: RunInfo) -> Iterator[Chunk]:
    """Yield the chunks that draw a part of the hand as a solid.

    The shape of the part comes from the URDF in the log. For a link with a mesh, nothing is
    yielded.

    Without the chunks of this function, Rerun would draw the shapes of a URDF as wire frames.
    """
    path = entity_path(chunk.entity_path)
    link = path.split("/")[2]
    if link in run.meshes:
        return
    yield chunk.with_entity_path(path)
    archetypes = {field.name.split(":")[0] for field in chunk.to_record_batch().schema}
    for archetype, shape in _SHAPE_ARCHETYPES.items():
        if archetype in archetypes:
            style = shape.columns(
                fill_mode=[rr.components.FillMode.Solid], colors=[link_colour(link, run)]
            )
            yield static_chunk(path, style)


def mesh_chunks(run: RunInfo) -> Iterator[Chunk]:
    """Yield the chunks that draw the meshes of the links and the palm.

    The path of a mesh is /hand/<link>/mesh. The mesh is drawn in the frame of the link.
    """
    for link, attached in run.meshes.items():
        mesh = attached.mesh
        path = f"/hand/{link}/mesh"
        mesh_columns = rr.Asset3D.columns(
            blob=[attached.data],
            media_type=[MESH_MEDIA_TYPES[mesh.suffix]],
            albedo_factor=[link_colour(link, run)],
        )
        yield static_chunk(path, mesh_columns)
        pose = rr.InstancePoses3D.columns(
            translations=[mesh.position],
            quaternions=[quaternion_of_rotation(mesh.rotation)],
            scales=[mesh.scale],
        )
        yield static_chunk(path, pose)
        yield static_chunk(path, rr.CoordinateFrame.columns(frame=[link]))


def link_colour(link_name: str, run: RunInfo) -> palette.Colour:
    """Return the colour of a link.

    A link has the colour of its digit. Links near the tip have a lighter colour.
    """
    colours = {
        f"{digit.name}_link{i + 1}": joint_colour
        for index, digit in zip(colour_numbers(run.hand.digit_names), run.hand.digit, strict=True)
        for i, joint_colour in enumerate(palette.joint_colours(index, len(digit.joints)))
    }
    return colours.get(link_name, palette.PALM_COLOUR)
