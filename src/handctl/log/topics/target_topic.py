"""Topic with the targets that clients stream to the hand, in the order of arrival."""

from collections.abc import Iterator

import numpy as np

from handctl.core.tick_types import StreamTarget, TickRequest
from handctl.log.cdr import CdrWriter
from handctl.log.header import RunHeader
from handctl.log.mcap_container import MessageBlock
from handctl.log.tick_batch import TickBatch
from handctl.log.topics.message_streams import MessageStamps, TopicRegistry, variable_length_block
from handctl.programs.requests import (
    OpenStreamRequest,
    is_stream_target,
    parse_request,
    parse_target,
)


class TargetTopic:
    """Topic with a message for each streamed target.

    Malformed targets appear only in the topic `/tick`, and not here.
    """

    def __init__(self, header: RunHeader, registry: TopicRegistry) -> None:
        """Register the topic."""
        self._offset_ns = header.offset_ns
        self._channel = registry.register_topic("/stream/target", "handctl_msgs/StreamTarget")
        self._names: dict[str, tuple[str, ...]] = {}

    def blocks(self, batch: TickBatch, stamps: MessageStamps) -> list[MessageBlock]:
        """Return a message for each streamed target in a batch of ticks."""
        tick_indices = list[int]()
        messages = list[bytes]()
        for index, tick in batch.ticks_with_events.items():
            for target in self._stream_targets(tick.tick_in.requests):
                tick_indices.append(index)
                messages.append(self._target_message(int(stamps.log_times[index]), target))
        if not messages:
            return []
        return [
            variable_length_block(
                self._channel, stamps.select(np.array(tick_indices, np.intp)), messages
            )
        ]

    def _stream_targets(self, requests: tuple[TickRequest, ...]) -> Iterator[StreamTarget]:
        """Yield those requests of a tick that are streamed targets.

        A streamed target contains values without names. The request that opened the stream contains
        the names of the values.
        """
        for request in requests:
            if isinstance(request, StreamTarget) or is_stream_target(request):
                if (target := parse_target(request)) is not None:
                    yield target
                continue
            open_stream_request = parse_request(request)
            if isinstance(open_stream_request, OpenStreamRequest):
                self._names[open_stream_request.stream] = open_stream_request.names

    def _target_message(self, log_ns: int, target: StreamTarget) -> bytes:
        """Encode a streamed target as a handctl_msgs/StreamTarget message."""
        names = self._names.get(target.stream, ())
        age_s = (log_ns - self._offset_ns - target.sent_ns) / 1e9
        writer = CdrWriter()
        writer.put_number("I", log_ns // 10**9)
        writer.put_number("I", log_ns % 10**9)
        writer.put_string("")
        writer.put_string(target.stream)
        writer.put_number("q", target.number)
        writer.put_number("d", age_s)
        writer.put_strings(names if len(names) == len(target.values) else ())
        writer.put_length(len(target.values))
        for value in target.values:
            writer.put_number("d", value)
        return writer.finished_message()
