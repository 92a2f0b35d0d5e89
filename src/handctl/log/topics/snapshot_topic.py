"""Topic with snapshots of the controller's state, two for each second of a run.

With a snapshot, the controller can execute the ticks after the snapshot again.
"""

import struct
from typing import NamedTuple

from handctl.log.cdr import CdrWriter
from handctl.log.mcap_container import MessageBlock
from handctl.log.topics.message_streams import (
    TopicRegistry,
    single_message_stamps,
    variable_length_block,
)

SNAPSHOT_TOPIC = "/controller/snapshot"
SNAPSHOT_PERIOD_NS = 500_000_000
"""Interval between snapshots [ns].

Processes that execute a log again start at the snapshots. With longer intervals, the parts of a
short log would be unequal.
"""
_SNAPSHOT_HEAD_STRUCT = struct.Struct("<4xII8xqI")
"""Layout of a message's start: encapsulation, stamp, empty frame_id with padding, tick number, length of the data."""


class ControllerSnapshot(NamedTuple):
    """State of the controller after a tick.

    Attributes:
        k: number of the tick.
        data: encoded state of the controller, see `controller.state_snapshot`.
    """

    k: int
    data: bytes


class SnapshotTopic:
    """Topic with the snapshots of the controller's state."""

    def __init__(self, registry: TopicRegistry) -> None:
        """Register the topic."""
        self._channel = registry.register_topic(SNAPSHOT_TOPIC, "handctl_msgs/Snapshot")

    def block(self, t_ns: int, snapshot: ControllerSnapshot) -> MessageBlock:
        """Return the message that contains a snapshot.

        Args:
            t_ns: log time of the tick [ns].
            snapshot: the snapshot to encode.
        """
        writer = CdrWriter()
        writer.put_number("I", t_ns // 10**9)
        writer.put_number("I", t_ns % 10**9)
        writer.put_string("")
        writer.put_number("q", snapshot.k)
        writer.put_length(len(snapshot.data))
        return variable_length_block(
            self._channel,
            single_message_stamps(t_ns, snapshot.k),
            [writer.finished_message() + snapshot.data],
        )


def decode_snapshot(message: bytes) -> ControllerSnapshot:
    """Decode a message that contains a snapshot.

    Raises:
        struct.error: the message is too short.
        ValueError: the data end before the end of the snapshot.
    """
    _, _, k, length = _SNAPSHOT_HEAD_STRUCT.unpack_from(message)
    data = message[_SNAPSHOT_HEAD_STRUCT.size : _SNAPSHOT_HEAD_STRUCT.size + length]
    if len(data) != length:
        raise ValueError("a snapshot that ends early")
    return ControllerSnapshot(k, data)
