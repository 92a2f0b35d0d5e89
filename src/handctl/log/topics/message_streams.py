"""Channels of a log. Many messages of a channel are encoded in one call."""

from dataclasses import dataclass, field

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from handctl.log.cdr import MessageTemplate
from handctl.log.mcap_container import MESSAGE_STRUCT, MessageBlock
from handctl.log.message_types import schema_name, schema_text

TimeArray = NDArray[np.uint64]

_QOS_PROFILE = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: {durability}\n"
    "  deadline: {{sec: 9223372036, nsec: 854775807}}\n  lifespan: {{sec: 9223372036, nsec: 854775807}}\n"
    "  liveliness: 1\n  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}\n"
    "  avoid_ros_namespace_conventions: false\n"
)
"""Quality of service of a channel, in the format of rosbag2.

Durability 1 is transient_local, 2 is volatile.
"""


@dataclass(slots=True)
class TopicRegistry:
    """Registry of all schemas and channels of a log.

    Schemas and channels are numbered in the order of registration.
    """

    schemas: dict[str, Schema] = field(default_factory=dict)
    channels: dict[str, Channel] = field(default_factory=dict)

    def register_topic(
        self, topic: str, message_type: str, latched: bool = False, note: str = ""
    ) -> int:
        """Register a topic, and return the channel id.

        Args:
            topic: name of the topic.
            message_type: message type, for example "sensor_msgs/JointState".
            latched: True for a topic whose single message is written at the start of the run.
            note: note about the topic, which is stored in the metadata of the channel.
        """
        if message_type not in self.schemas:
            number = len(self.schemas) + 1
            data = schema_text(message_type).encode()
            self.schemas[message_type] = Schema(
                id=number, data=data, encoding="ros2msg", name=schema_name(message_type)
            )
        metadata = {"offered_qos_profiles": _QOS_PROFILE.format(durability=1 if latched else 2)}
        if note:
            metadata["note"] = note
        channel = len(self.channels) + 1
        self.channels[topic] = Channel(
            channel, topic, "cdr", metadata, self.schemas[message_type].id
        )
        return channel


@dataclass(frozen=True, slots=True)
class MessageStamps:
    """Log times and sequence numbers of n messages.

    Attributes:
        log_times: (n,) uint64, log times as UNIX times [ns].
        sequence: (n,) uint32, low 32 bits of the tick numbers.
    """

    log_times: TimeArray
    sequence: NDArray[np.uint32]

    def select(self, selection: NDArray[np.intp] | NDArray[np.bool_]) -> "MessageStamps":
        """Return the stamps of the messages that `selection` selects."""
        return MessageStamps(self.log_times[selection], self.sequence[selection])


def single_message_stamps(log_ns: int, k: int) -> MessageStamps:
    """Return the log time and sequence number of a single message.

    Args:
        log_ns: log time of the message [ns].
        k: number of the tick to which the message belongs.
    """
    return MessageStamps(np.array([log_ns], np.uint64), np.array([k & 0xFFFF_FFFF], np.uint32))


def ros_time(t_ns: TimeArray) -> NDArray[np.uint32]:
    """Convert times (n,) [ns] to ROS 2 time stamps (n, 2): whole seconds, and the remaining nanoseconds."""
    return np.stack([t_ns // np.uint64(10**9), t_ns % np.uint64(10**9)], axis=1).astype("<u4")


class MessageStream:
    """Channel whose messages have a constant layout."""

    def __init__(self, channel: int, template: MessageTemplate) -> None:
        """Build the layout of a Message record: a header of 31 bytes, then the template."""
        self._channel = channel
        self._stamps = len(template.stamp_offsets)
        # The opcode 5 marks a Message record. The length counts all bytes after the length field:
        # 22 bytes of the header, and the data.
        self._record = (
            MESSAGE_STRUCT.pack(5, 22 + len(template.data), channel, 0, 0, 0) + template.data
        )
        fields: list[tuple[str, object, int]] = [
            ("sequence", "<u4", 11), ("log", "<u8", 15), ("publish", "<u8", 23),
            *((f"stamp{i}", ("<u4", (2,)), 31 + offset) for i, offset in enumerate(template.stamp_offsets)),
            *((name, (code, (n,)), 31 + offset) for name, (offset, code, n) in template.fields.items()),
        ]  # fmt: skip
        names, formats, offsets = zip(*fields, strict=True)
        self._dtype = np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": len(self._record)}
        )

    def block(
        self,
        stamps: MessageStamps,
        values: dict[str, NDArray[np.generic]],
        measured_ns: TimeArray | None = None,
    ) -> MessageBlock:
        """Encode messages of the channel, and return them as a block.

        Args:
            stamps: log times and sequence numbers of the messages.
            values: values of the variable fields by name, each (n, size of the field).
            measured_ns: (n,) times at which the values were measured [ns]. By default, the log
                times are used.
        """
        number = len(stamps.log_times)
        # All messages begin as copies of the template. In the structured array of the copies, a
        # single assignment writes one field of all messages.
        data = bytearray(self._record) * number
        rows = np.frombuffer(data, self._dtype)
        measured_ns = stamps.log_times if measured_ns is None else measured_ns
        rows["sequence"] = stamps.sequence
        rows["log"] = stamps.log_times
        rows["publish"] = measured_ns
        times = ros_time(measured_ns)
        for index in range(self._stamps):
            rows[f"stamp{index}"] = times
        for name, array in values.items():
            rows[name] = array
        offsets = np.arange(number, dtype=np.uint64) * np.uint64(len(self._record))
        return MessageBlock(self._channel, data, stamps.log_times, offsets)


def variable_length_block(
    channel: int, stamps: MessageStamps, messages: list[bytes]
) -> MessageBlock:
    """Join messages of different lengths to one block."""
    encoded_messages = []
    for sequence, t_ns, message in zip(
        stamps.sequence.tolist(), stamps.log_times.tolist(), messages, strict=True
    ):
        encoded_messages.append(
            MESSAGE_STRUCT.pack(5, 22 + len(message), channel, sequence, t_ns, t_ns) + message
        )
    end_offsets = np.cumsum([0, *map(len, encoded_messages)], dtype=np.uint64)
    return MessageBlock(channel, b"".join(encoded_messages), stamps.log_times, end_offsets[:-1])
