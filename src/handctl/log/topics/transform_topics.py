"""Topics with the transforms between the frames of the hand's links.

With the transforms, a viewer that knows nothing about the kinematics of the hand can show the hand.
"""

import math
import tomllib
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.log.cdr import TemplateWriter
from handctl.log.header import RunHeader
from handctl.log.mcap_container import MessageBlock
from handctl.log.tick_batch import TickBatch, columns_of_fields
from handctl.log.topics.message_streams import MessageStamps, MessageStream, TopicRegistry

TRANSFORM_PERIOD_NS = 20_000_000
"""Interval between messages with transforms [ns]. A rate of 50 Hz is enough for a viewer."""
ROOT_FRAME = "palm"
"""Name of the frame to which all link frames lead back."""
DEFAULT_JOINT_AXIS = (0.0, 0.0, 1.0)
PRISMATIC_JOINT_AXIS = (0.0, 1.0, 0.0)
"""Axes of a hinge, and of a prismatic joint, for which the hand file gives no ``joint_axis``."""


class LinkFrame(NamedTuple):
    """Frame of a link.

    The position and the rotation are relative to the frame of the parent link.

    Attributes:
        parent, child: names of the parent link's frame and of this link's frame.
        position: (3,) origin of the child frame in the parent frame [m].
        rotation: (4,) quaternion (x, y, z, w) of the child frame when the joint angle is zero.
        axis: (3,) joint axis as a unit vector in the child frame.
        joint: index of the joint that moves the link, or -1 if the link is fixed to its parent.
        is_prismatic: True if the link slides along the joint axis.
    """

    parent: str
    child: str
    position: tuple[float, ...]
    rotation: tuple[float, ...]
    axis: tuple[float, ...]
    joint: int
    is_prismatic: bool = False


def quaternion_of_rpy(roll: float, pitch: float, yaw: float) -> tuple[float, ...]:
    """Return the quaternion (x, y, z, w) of extrinsic rotations about the axes x, y and z [rad]."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a / 2), math.cos(a / 2)) for a in (roll, pitch, yaw))
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def link_frames(hand_toml: str) -> list[LinkFrame]:
    """Return the link frames of a hand.

    The names of the frames are `palm`, `<digit>_link<i>` and `<digit>_tip`.
    """
    frames = []
    tips: dict[str, str] = {}
    joint = 0
    for digit in tomllib.loads(hand_toml)["digit"]:
        name = digit["name"]
        lengths = digit["link_length_m"]
        parent = tips[digit["mount_on"]] if "mount_on" in digit else ROOT_FRAME
        position = tuple(map(float, digit["mount_position_m"]))
        rotation = quaternion_of_rpy(*map(math.radians, digit["mount_rpy_deg"]))
        joint_rotations_deg = digit.get("joint_rpy_deg", [(0.0, 0.0, 0.0)] * len(lengths))
        kinds = digit.get("joint_type", ["revolute"] * len(lengths))
        default = [
            PRISMATIC_JOINT_AXIS if kind == "prismatic" else DEFAULT_JOINT_AXIS for kind in kinds
        ]
        axes = digit.get("joint_axis", default)
        for index, length in enumerate(lengths):
            child = f"{name}_link{index + 1}"
            size = math.hypot(*axes[index])
            axis = tuple(component / size for component in axes[index])
            turned_quaternion = multiply_quaternions(
                rotation, quaternion_of_rpy(*map(math.radians, joint_rotations_deg[index]))
            )
            is_prismatic = kinds[index] == "prismatic"
            frames.append(
                LinkFrame(parent, child, position, turned_quaternion, axis, joint, is_prismatic)
            )
            parent = child
            position = (float(length), 0.0, 0.0)
            rotation = (0.0, 0.0, 0.0, 1.0)
            joint += 1
        tips[name] = parent
        frames.append(LinkFrame(parent, f"{name}_tip", position, rotation, DEFAULT_JOINT_AXIS, -1))
    return frames


def multiply_quaternions(
    left_quaternion: tuple[Any, ...], right_quaternion: tuple[Any, ...]
) -> tuple[Any, ...]:
    """Return the product of two quaternions (x, y, z, w). Each component is a number or an array."""
    a, b, c, d = left_quaternion
    x, y, z, w = right_quaternion
    return (
        d * x + a * w + b * z - c * y,
        d * y + b * w + c * x - a * z,
        d * z + c * w + a * y - b * x,
        d * w - a * x - b * y - c * z,
    )


def link_quaternions(link: LinkFrame, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation of a link at joint angles (n,) [rad] as quaternions (x, y, z, w) of shape (n, 4)."""
    if link.is_prismatic:
        q = np.zeros_like(q)
    sine = np.sin(q / 2)
    turn = (*(component * sine for component in link.axis), np.cos(q / 2))
    return np.stack(multiply_quaternions(link.rotation, turn), axis=1)


def link_positions(link: LinkFrame, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the origin (n, 3) [m] of a link in the frame of the parent link.

    The joint positions `q` (n,) are in rad or m. A hinge does not move the origin of its link. The
    result for a hinge therefore has a single row.
    """
    if not link.is_prismatic:
        return np.array([link.position])
    x, y, z, w = link.rotation
    # The imaginary part of r a r* is the axis a in the frame of the parent link.
    turned_quaternion = multiply_quaternions(
        multiply_quaternions(link.rotation, (*link.axis, 0.0)), (-x, -y, -z, w)
    )[:3]
    return np.asarray(np.array(link.position) + q[:, None] * np.array(turned_quaternion))


def _transform_stream(channel: int, link_frames: list[LinkFrame]) -> MessageStream:
    """Return the stream of tf2_msgs/TFMessage messages for the given links."""
    writer = TemplateWriter()
    writer.put_length(len(link_frames))
    for index, link in enumerate(link_frames):
        writer.put_header(link.parent)
        writer.put_string(link.child)
        writer.put_field(f"position{index}", "<f8", 3)
        writer.put_field(f"rotation{index}", "<f8", 4)
    return MessageStream(channel, writer.finished_template())


class TfTopics:
    """Topics /tf_static and /tf. The topic /tf_static has a single message, and /tf has 50 messages per second.

    If the angle of a joint is unknown, the rotation of the link at this joint is NaN.
    """

    def __init__(self, header: RunHeader, registry: TopicRegistry) -> None:
        """Register the topics."""
        tree = link_frames(header.hand_toml)
        self._moving, self._fixed_parts = (
            [link for link in tree if (link.joint >= 0) == is_moving] for is_moving in (True, False)
        )
        self._static = _transform_stream(
            registry.register_topic("/tf_static", "tf2_msgs/TFMessage", latched=True),
            self._fixed_parts,
        )
        self._stream = _transform_stream(
            registry.register_topic("/tf", "tf2_msgs/TFMessage"), self._moving
        )
        self._q = columns_of_fields(header)["q"]
        self._last = -1

    def latched_messages(self, stamps: MessageStamps) -> MessageBlock:
        """Return the single message of /tf_static."""
        values: dict[str, NDArray[np.generic]] = {}
        for index, link in enumerate(self._fixed_parts):
            values[f"position{index}"] = np.array([link.position])
            values[f"rotation{index}"] = np.array([link.rotation])
        return self._static.block(stamps, values)

    def blocks(self, batch: TickBatch, stamps: MessageStamps) -> list[MessageBlock]:
        """Return the /tf messages: one for the first tick in each period of 20 ms."""
        periods = batch.t_ns // TRANSFORM_PERIOD_NS
        period_starts = np.flatnonzero(np.diff(periods, prepend=self._last))
        self._last = int(periods[-1])
        if not len(period_starts):
            return []
        q = batch.numbers[period_starts, self._q]
        values: dict[str, NDArray[np.generic]] = {}
        for index, link in enumerate(self._moving):
            values[f"position{index}"] = link_positions(link, q[:, link.joint])
            values[f"rotation{index}"] = link_quaternions(link, q[:, link.joint])
        return [self._stream.block(stamps.select(period_starts), values)]
