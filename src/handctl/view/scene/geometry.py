"""Shapes of the hand, solid and in the colours of their digits."""

from collections.abc import Iterator

import rerun as rr
from rerun.chunk import Chunk

from handctl.view.scene import palette
from handctl.view.scene.arrow import static
from handctl.view.scene.subject import Subject

_SHAPES: dict[str, type[rr.Boxes3D] | type[rr.Cylinders3D] | type[rr.Ellipsoids3D]] = {
    "Boxes3D": rr.Boxes3D,
    "Cylinders3D": rr.Cylinders3D,
    "Ellipsoids3D": rr.Ellipsoids3D,
}
"""Rerun's archetypes for the geometry of a URDF."""


def entity(path: str) -> str:
    """Return /hand/<link>/<part> for /<robot>/visual_geometries/<link>/<part>."""
    return "/hand/" + path.split("/visual_geometries/", 1)[1]


def solid(chunk: Chunk, subject: Subject) -> Iterator[Chunk]:
    """Yield a part of the hand from the log's URDF, as a solid. Rerun draws wire frames by default."""
    path = entity(chunk.entity_path)
    yield chunk.with_entity_path(path)
    link = path.split("/")[2]
    kinds = {field.name.split(":")[0] for field in chunk.to_record_batch().schema}
    for kind, shape in _SHAPES.items():
        if kind in kinds:
            look = shape.columns(fill_mode=[rr.components.FillMode.Solid], colors=[colour(link, subject)])
            yield static(path, look)


def colour(link: str, subject: Subject) -> palette.Colour:
    """Return the colour of a link: that of its digit, lighter towards the tip."""
    known = {
        f"{digit.name}_link{i + 1}": shade
        for index, digit in enumerate(subject.hand.digit)
        for i, shade in enumerate(palette.shades(index, len(digit.joints)))
    }
    return known.get(link, palette.PALM)
