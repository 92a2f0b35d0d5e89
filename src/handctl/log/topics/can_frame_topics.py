"""Topics with the CAN frames of a run, as can_msgs/Frame and ros2_socketcan_msgs/FdFrame."""

import numpy as np
from numpy.typing import NDArray

from handctl.drives.frame import ERROR_FLAG, EXTENDED_FLAG, FDF, REMOTE_FLAG
from handctl.log.cdr import CdrWriter, MessageTemplate, TemplateWriter
from handctl.log.header import RunHeader
from handctl.log.mcap_container import MESSAGE_STRUCT, MessageBlock
from handctl.log.tick_batch import FrameBatch, TickBatch
from handctl.log.topics.message_streams import (
    MessageStamps,
    MessageStream,
    TimeArray,
    TopicRegistry,
)

_ID_MASK = 0x1FFF_FFFF
"""The 29 identifier bits of can_id. The three bits above the identifier are flags, as in SocketCAN."""


def can_frame_template(bus: str) -> MessageTemplate:
    """Return the template of can_msgs/Frame messages for one bus."""
    writer = TemplateWriter()
    writer.put_header(bus)
    writer.put_field("id", "<u4")
    for name in ("is_rtr", "is_extended", "is_error", "dlc"):
        writer.put_field(name, "|u1")
    writer.put_field("data", "|u1", 8)
    return writer.finished_template()


def encode_fd_frame(bus: str, t_ns: int, can_id: int, payload: bytes) -> bytes:
    """Encode a CAN FD frame as ros2_socketcan_msgs/FdFrame."""
    writer = CdrWriter()
    writer.put_number("I", t_ns // 10**9)
    writer.put_number("I", t_ns % 10**9)
    writer.put_string(bus)
    writer.put_length(can_id & _ID_MASK)
    writer.data += bytes((bool(can_id & EXTENDED_FLAG), bool(can_id & ERROR_FLAG), len(payload)))
    writer.put_length(len(payload))
    writer.data += payload
    return writer.finished_message()


class _DirectionTopics:
    """Topics for the frames of one direction: rx (received by the host) or tx (sent by the host)."""

    def __init__(self, buses: tuple[str, ...], registry: TopicRegistry, direction: str) -> None:
        self._buses = (*buses, "unknown")
        self._channel = registry.register_topic(f"/can/{direction}", "can_msgs/Frame")
        self._fd_channel = registry.register_topic(
            f"/can/{direction}_fd", "ros2_socketcan_msgs/FdFrame"
        )
        self._streams = [
            MessageStream(self._channel, can_frame_template(bus)) for bus in self._buses
        ]

    def blocks(
        self, frames: FrameBatch, stamps: MessageStamps, measured_ns: TimeArray
    ) -> list[MessageBlock]:
        """Return the given frames as blocks of messages.

        Args:
            frames: frames of many ticks.
            stamps: log times of the frames.
            measured_ns: publish times and header stamps of the messages [ns].
        """
        if not len(frames.frames):
            return []
        fd = (frames.frames["flags"] & FDF) != 0
        bus = np.minimum(frames.frames["bus"], len(self._buses) - 1).astype(np.intp)
        blocks = []
        if not fd.all():
            blocks.append(
                self._classical_messages(
                    frames.frames[~fd], bus[~fd], stamps.select(~fd), measured_ns[~fd]
                )
            )
        if fd.any():
            blocks.append(self._long_messages(frames, bus, fd, stamps, measured_ns))
        return blocks

    def _classical_messages(
        self,
        frames: NDArray[np.void],
        bus: NDArray[np.intp],
        stamps: MessageStamps,
        measured_ns: TimeArray,
    ) -> MessageBlock:
        """Return a message for each of the given classical CAN frames.

        The messages have the order of the frames.
        """
        bus_indices = np.unique(bus)
        if len(bus_indices) == 1:
            return self._streams[int(bus_indices[0])].block(
                stamps, _frame_values(frames), measured_ns
            )
        records: list[bytes] = [b""] * len(frames)
        # The template of a message contains the name of the bus. If there are several buses, the
        # messages of each bus are made separately, and then sorted into the order of the frames.
        for bus_index in bus_indices.tolist():
            indexes = np.flatnonzero(bus == bus_index)
            block = self._streams[bus_index].block(
                stamps.select(indexes), _frame_values(frames[indexes]), measured_ns[indexes]
            )
            size = len(block.data) // len(indexes)
            for index, start in zip(indexes.tolist(), range(0, len(block.data), size), strict=True):
                records[index] = block.data[start : start + size]
        return _join_records(self._channel, stamps.log_times, records)

    def _long_messages(
        self,
        frames: FrameBatch,
        bus: NDArray[np.intp],
        is_fd: NDArray[np.bool_],
        stamps: MessageStamps,
        measured_ns: TimeArray,
    ) -> MessageBlock:
        """Return a message for each CAN FD frame among the given frames."""
        records = []
        remaining_data = memoryview(frames.long_data)
        columns = [frames.frames[name].tolist() for name in ("can_id", "length")]
        data = frames.frames["data"].tobytes()
        sequence_numbers = stamps.sequence.tolist()
        log_times_ns = stamps.log_times.tolist()
        publish_times_ns = measured_ns.tolist()
        # `remaining_data` contains the payload bytes after the eighth byte of those frames that have
        # not been encoded yet. Classical frames have at most eight payload bytes.
        for index, (can_id, length) in enumerate(zip(*columns, strict=True)):
            extra_bytes = max(length - 8, 0)
            payload = data[8 * index : 8 * index + min(length, 8)] + bytes(
                remaining_data[:extra_bytes]
            )
            remaining_data = remaining_data[extra_bytes:]
            if is_fd[index]:
                message = encode_fd_frame(
                    self._buses[bus[index]], publish_times_ns[index], can_id, payload
                )
                size = 22 + len(message)
                channel = self._fd_channel
                records.append(
                    MESSAGE_STRUCT.pack(
                        5,
                        size,
                        channel,
                        sequence_numbers[index],
                        log_times_ns[index],
                        publish_times_ns[index],
                    )
                    + message
                )
        return _join_records(self._fd_channel, stamps.log_times[is_fd], records)


def _join_records(channel: int, log_times: TimeArray, records: list[bytes]) -> MessageBlock:
    """Join the given Message records to one block, in their order."""
    end_offsets = np.cumsum([0, *map(len, records)], dtype=np.uint64)
    return MessageBlock(channel, b"".join(records), log_times, end_offsets[:-1])


def _frame_values(frames: NDArray[np.void]) -> dict[str, NDArray[np.generic]]:
    """Return the values of the variable fields of can_msgs/Frame messages."""
    can_id = frames["can_id"]
    scalar_values = {
        "id": can_id & _ID_MASK,
        "is_rtr": (can_id & REMOTE_FLAG) != 0,
        "is_extended": (can_id & EXTENDED_FLAG) != 0,
        "is_error": (can_id & ERROR_FLAG) != 0,
        "dlc": frames["length"],
    }
    return {name: value[:, None] for name, value in scalar_values.items()} | {
        "data": frames["data"]
    }


class CanTopics:
    """Topics of the CAN frames: /can/rx and /can/tx for classical frames, /can/rx_fd and /can/tx_fd for CAN FD frames.

    The log time of a message is the time of the tick. The header stamp and the publish time of a
    message are the time of the frame.
    """

    def __init__(self, header: RunHeader, registry: TopicRegistry) -> None:
        """Register the topics for received and sent frames."""
        self._rx, self._tx = (
            _DirectionTopics(header.buses, registry, direction) for direction in ("rx", "tx")
        )
        self._offset = header.offset_ns

    def blocks(self, batch: TickBatch, stamps: MessageStamps) -> list[MessageBlock]:
        """Return a message for each frame in a batch of ticks.

        The time of a sent frame is the start of the tick.
        """
        send_times_ns = (batch.t_ns + batch.late_ns)[batch.sent.tick_indexes]
        blocks = []
        for direction, frames, t_ns in (
            (self._rx, batch.received, batch.received.frames["t_ns"]),
            (self._tx, batch.sent, send_times_ns),
        ):
            measured_times_ns = np.maximum(t_ns + self._offset, 0).astype(np.uint64)
            blocks += direction.blocks(
                frames, stamps.select(frames.tick_indexes), measured_times_ns
            )
        return blocks
