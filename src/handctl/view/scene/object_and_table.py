"""Shapes and poses of the object and the table in a simulated run.

The poses of object and table come from the simulator's truth file.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from handctl.errors import LogError
from handctl.report.truth_record import TruthRecord
from handctl.view.scene.chunk_arrays import static_chunk, temporal_chunk
from handctl.view.scene.palette import Colour
from handctl.view.scene.run_info import RunInfo

POSE_PERIOD_NS = 20_000_000
"""Interval between the drawn poses of object and table [ns].

The transforms of the links have the same interval.
"""
SHAPE_COLOURS = {"object": Colour(216, 206, 186), "table": Colour(112, 122, 134)}
POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Names of the truth file's columns with the object's pose.

The components of the quaternion are in Rerun's order.
"""


def object_and_table_chunks(run: RunInfo) -> Iterator[Chunk]:
    """Yield the chunks with the shapes and the poses of object and table.

    If the run has no truth file with shapes, yield no chunks.

    Raises:
        LogError: the truth file names an unknown shape or lacks a column.
    """
    if run.truth is None:
        return
    shape_sections = run.truth.header.get("shapes")
    shapes = shape_sections if isinstance(shape_sections, Mapping) else {}
    offset = run.header.truth_offset_ns
    times = np.arange(int(run.truth.t_ns[0]), int(run.truth.t_ns[-1]), POSE_PERIOD_NS)
    times = times[times >= offset]
    for name in SHAPE_COLOURS.keys() & shapes.keys():
        yield static_chunk(f"/true/{name}", _solid_shape(shapes[name], SHAPE_COLOURS[name]))
        yield static_chunk(f"/true/{name}", rr.CoordinateFrame.columns(frame=[f"true_{name}"]))
        pose_of_shape = _object_pose if name == "object" else _table_pose
        translation, rotation = pose_of_shape(run.truth, shapes[name], times)
        pose = rr.Transform3D.columns(
            translation=translation,
            quaternion=rotation,
            parent_frame=["palm"] * len(times),
            child_frame=[f"true_{name}"] * len(times),
        )
        yield temporal_chunk(f"/true/{name}_pose", times - offset, pose)


def _solid_shape(true_shape: Mapping[str, Any], colour: Colour) -> Any:
    """Convert a shape of the truth file to a Rerun archetype that is drawn as a solid.

    Raises:
        LogError: the kind of shape is unknown.
    """
    x, y, z = (float(extent) for extent in true_shape["size_m"])
    style: dict[str, Any] = {"fill_mode": [rr.components.FillMode.Solid], "colors": [colour]}
    if true_shape["shape"] == "cylinder":
        return rr.Cylinders3D.columns(lengths=[z], radii=[x / 2.0], **style)
    half_sizes = [(x / 2.0, y / 2.0, z / 2.0)]
    if true_shape["shape"] == "sphere":
        return rr.Ellipsoids3D.columns(half_sizes=half_sizes, **style)
    if true_shape["shape"] == "box":
        return rr.Boxes3D.columns(half_sizes=half_sizes, **style)
    raise LogError(
        f"shape {true_shape['shape']!r}", "the simulator's truth", "cylinder, sphere or box"
    )


def _object_pose(
    truth: TruthRecord, object_shape: Mapping[str, Any], times: Any
) -> tuple[Any, Any]:
    """Return the position [m] and the quaternion (x, y, z, w) of the object, with one row for each time."""
    pose = truth.interpolated_columns(
        [f"object/{pose_column}" for pose_column in POSE_COLUMNS], times
    )
    return pose[:, :3], pose[:, 3:]


def _table_pose(truth: TruthRecord, table_shape: Mapping[str, Any], times: Any) -> tuple[Any, Any]:
    """Return the position [m] and the quaternion of the table, with one row for each time.

    The simulated table moves only in the direction in which it sinks, and does not turn. In truth
    files of earlier versions, the table sinks along -z.
    """
    position = np.tile(np.array(table_shape["position_m"], np.float64), (len(times), 1))
    if truth.has_column("support"):
        direction = np.array(table_shape.get("sink_direction", (0.0, 0.0, -1.0)), np.float64)
        position += np.outer(truth.interpolated_column("support", times), direction)
    return position, np.tile((0.0, 0.0, 0.0, 1.0), (len(times), 1))
