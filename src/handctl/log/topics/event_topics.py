"""Topics with one message for each log line, and for each change of gains, grasp phase, mode or reaction to faults."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import GAIN_EVENT, HandMode
from handctl.log.cdr import CdrWriter
from handctl.log.header import RunHeader
from handctl.log.mcap_container import MessageBlock
from handctl.log.message_types import OTHER_PHASE_NUMBER, PHASE_NUMBERS
from handctl.log.tick_batch import TickBatch
from handctl.log.tick_record import TickRecord
from handctl.log.topics.message_streams import MessageStamps, TopicRegistry, variable_length_block
from handctl.programs.requests import is_routine_request, request_text
from handctl.safety.safety_action import SafetyAction

LOG_LEVEL_NUMBERS = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
"""Number of each level of a log line in rcl_interfaces/Log."""
_DOUBLE_PARAMETER_TYPE = 3
_STRING_PARAMETER_TYPE = 4
"""The values of rcl_interfaces/ParameterType that messages about gains contain."""


def _writer_with_time_stamp(t_ns: int) -> CdrWriter:
    """Return a CDR writer whose message begins with a time stamp."""
    writer = CdrWriter()
    writer.put_number("I", t_ns // 10**9)
    writer.put_number("I", t_ns % 10**9)
    return writer


def encode_rosout(t_ns: int, level_name: str, name: str, text: str) -> bytes:
    """Encode a line of the log as rcl_interfaces/Log."""
    writer = _writer_with_time_stamp(t_ns)
    writer.put_number("B", LOG_LEVEL_NUMBERS.get(level_name, LOG_LEVEL_NUMBERS["error"]))
    writer.put_string(name)
    writer.put_string(text)
    writer.put_string("")
    writer.put_string("")
    writer.put_length(0)
    return writer.finished_message()


def _append_parameter(writer: CdrWriter, name: str, value: str) -> None:
    """Append a gain as rcl_interfaces/Parameter.

    A gain whose text is a number is written as a double.
    """
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    writer.put_string(name)
    is_number = not math.isnan(number)
    writer.put_number("B", _DOUBLE_PARAMETER_TYPE if is_number else _STRING_PARAMETER_TYPE)
    writer.put_number("B", 0)
    writer.put_number("q", 0)
    writer.put_number("d", number if is_number else 0.0)
    writer.put_string("" if is_number else value)
    # The five array fields of a ParameterValue are left empty.
    for _ in range(5):
        writer.put_length(0)


def encode_parameter_event(
    t_ns: int, new_gains: dict[str, str], changed_gains: dict[str, str]
) -> bytes:
    """Encode new and changed gains as rcl_interfaces/ParameterEvent.

    A gain whose text is a number is written as a double.
    """
    writer = _writer_with_time_stamp(t_ns)
    writer.put_string("/handctl")
    for group in (new_gains, changed_gains):
        writer.put_length(len(group))
        for name, value in group.items():
            _append_parameter(writer, name, value)
    writer.put_length(0)
    return writer.finished_message()


def encode_enum_message(t_ns: int, number: int, name: str) -> bytes:
    """Encode a value of an enumeration as message handctl_msgs/GraspPhase, Mode or Action: header, number and name."""
    writer = _writer_with_time_stamp(t_ns)
    writer.put_string("")
    writer.put_number("B", number)
    writer.put_string(name)
    return writer.finished_message()


def _changed_indexes(
    timed_values: list[tuple[int, str]], last_value: tuple[int, str] | None
) -> list[int]:
    """Return the index of each value that differs from the previous value."""
    previous_values = [last_value, *timed_values[:-1]]
    return [index for index, value in enumerate(timed_values) if value != previous_values[index]]


class EventTopics:
    """Topics for events and changes.

    Events are written as log lines. The other topics report changes of the grasp phase, the mode,
    the reaction to faults, and the gains.
    """

    def __init__(self, header: RunHeader, registry: TopicRegistry) -> None:
        """Register the topics."""
        self._gains = header.gains
        self._rosout = registry.register_topic("/rosout", "rcl_interfaces/Log")
        self._parameters = registry.register_topic(
            "/parameter_events", "rcl_interfaces/ParameterEvent"
        )
        self._phase = registry.register_topic("/grasp/phase", "handctl_msgs/GraspPhase")
        self._mode = registry.register_topic("/controller/mode", "handctl_msgs/Mode")
        self._action = registry.register_topic("/safety/action", "handctl_msgs/Action")
        self._last: dict[int, tuple[int, str]] = {}

    def latched_messages(self, stamps: MessageStamps) -> list[MessageBlock]:
        """Return the messages with the gains that are used at the start of the run."""
        message = encode_parameter_event(int(stamps.log_times[0]), self._gains, {})
        return [variable_length_block(self._parameters, stamps, [message])] if self._gains else []

    def blocks(self, batch: TickBatch, stamps: MessageStamps) -> list[MessageBlock]:
        """Return the messages for the events and changes in a batch of ticks."""
        modes = [HandMode(number) for number in batch.mode.tolist()]
        actions = [SafetyAction(number) for number in batch.action.tolist()]
        lanes: list[tuple[int, list[tuple[int, str]]]] = [
            (
                self._phase,
                [(PHASE_NUMBERS.get(phase, OTHER_PHASE_NUMBER), phase) for phase in batch.phases],
            ),
            (self._mode, [(mode.value, mode.name.lower()) for mode in modes]),
            (self._action, [(action.value, action.name.lower()) for action in actions]),
        ]
        blocks = []
        for channel, states in lanes:
            changed_indexes = _changed_indexes(states, self._last.get(channel))
            messages = [
                encode_enum_message(int(stamps.log_times[index]), *states[index])
                for index in changed_indexes
            ]
            blocks.append(
                variable_length_block(
                    channel, stamps.select(_index_array(changed_indexes)), messages
                )
            )
            self._last[channel] = states[-1]
        return [block for block in [*blocks, *self._line_messages(batch, stamps)] if block.data]

    def _line_messages(self, batch: TickBatch, stamps: MessageStamps) -> list[MessageBlock]:
        """Return one message for each log line of a batch, and one message for each tick in which gains change."""
        line_indexes: list[int] = []
        lines: list[bytes] = []
        gain_indexes = []
        gains = []
        for index, tick in batch.ticks_with_events.items():
            t_ns = int(stamps.log_times[index])
            for level, name, text in _rosout_lines(tick):
                line_indexes.append(index)
                lines.append(encode_rosout(t_ns, level, f"handctl.{name}", text))
            text_by_bus = {
                event.where: event.text for event in tick.events if event.name == GAIN_EVENT
            }
            if text_by_bus:
                gain_indexes.append(index)
                gains.append(encode_parameter_event(t_ns, {}, text_by_bus))
        return [
            variable_length_block(self._rosout, stamps.select(_index_array(line_indexes)), lines),
            variable_length_block(
                self._parameters, stamps.select(_index_array(gain_indexes)), gains
            ),
        ]


def _index_array(values: list[int]) -> NDArray[np.intp]:
    """Return a list of indices as an integer array. numpy would convert an empty list to a float array."""
    return np.array(values, np.intp)


def _rosout_lines(tick: TickRecord) -> Iterator[tuple[str, str, str]]:
    """Yield the level, the name and the text of each log line of a tick."""
    for io_event in tick.tick_in.io_events:
        number = f" ({io_event.number})" if io_event.number != 1 else ""
        yield "warn", "io", " ".join(filter(None, (io_event.kind, io_event.where))) + number
    for request in tick.tick_in.requests:
        # The log lines do not contain the targets that clients stream, because these targets have a
        # topic of their own.
        if not is_routine_request(request):
            yield "info", "request", request_text(request)
    for event in tick.events:
        yield event.level, event.name, f"{event.where}: {event.text}" if event.where else event.text
