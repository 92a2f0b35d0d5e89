"""Topics for the diagnostics of motors, buses and controller, and for the motor temperatures."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import HandMode
from handctl.drives.contract import DrivePhase
from handctl.log.cdr import CdrWriter, MessageTemplate, TemplateWriter
from handctl.log.header import RunHeader
from handctl.log.mcap_container import MessageBlock
from handctl.log.tick_batch import TickBatch, columns_of_fields
from handctl.log.topics.message_streams import (
    MessageStamps,
    MessageStream,
    TopicRegistry,
    variable_length_block,
)
from handctl.log.topics.transform_topics import ROOT_FRAME
from handctl.safety.safety_action import SafetyAction

TEMPERATURE_PERIOD_NS = 200_000_000
"""Interval between the temperature messages of a motor [ns]."""
DIAGNOSTICS_PERIOD_NS = 1_000_000_000
"""Interval between diagnostics messages [ns]."""
OK_LEVEL = 0
WARN_LEVEL = 1
ERROR_LEVEL = 2
"""Levels of diagnostic_msgs/DiagnosticStatus."""

_LEVEL_BY_DRIVE_PHASE = {
    DrivePhase.READY: OK_LEVEL,
    DrivePhase.ENABLED: OK_LEVEL,
    DrivePhase.FAULT: ERROR_LEVEL,
}


@dataclass(frozen=True, slots=True)
class DiagnosticStatus:
    """Content of a diagnostic_msgs/DiagnosticStatus."""

    level: int
    name: str
    text: str
    hardware: str
    values: dict[str, str] = field(default_factory=dict)


def encode_diagnostic_array(t_ns: int, statuses: list[DiagnosticStatus]) -> bytes:
    """Encode a diagnostic_msgs/DiagnosticArray."""
    writer = CdrWriter()
    writer.put_number("I", t_ns // 10**9)
    writer.put_number("I", t_ns % 10**9)
    writer.put_string("")
    writer.put_length(len(statuses))
    for status in statuses:
        writer.put_number("B", status.level)
        writer.put_string(status.name)
        writer.put_string(status.text)
        writer.put_string(status.hardware)
        writer.put_length(len(status.values))
        for key, value in status.values.items():
            writer.put_string(key)
            writer.put_string(value)
    return writer.finished_message()


def temperature_template() -> MessageTemplate:
    """Return the template of a sensor_msgs/Temperature message with unknown variance.

    The `frame_id` of the message is the name of the palm's frame, because the motors are mounted
    behind the palm. The topic /tf must contain the frame of the message. Otherwise the viewer Rerun
    would find several root frames and show no hand.
    """
    writer = TemplateWriter()
    writer.put_header(ROOT_FRAME)
    writer.put_field("temperature", "<f8")
    writer.put_field("variance", "<f8")
    return writer.finished_template()


class HealthTopics:
    """Topics for the status of motors, buses and controller, and for the motor temperatures.

    A status message is written every second. A status message is also written when the mode, the
    safety action or the state of a drive changes.
    """

    def __init__(self, header: RunHeader, registry: TopicRegistry) -> None:
        """Register the topics."""
        self._header = header
        self._columns = columns_of_fields(header)
        self._diagnostics = registry.register_topic(
            "/diagnostics", "diagnostic_msgs/DiagnosticArray"
        )
        self._temperatures = [
            MessageStream(
                registry.register_topic(
                    f"/actuator/{motor}/temperature", "sensor_msgs/Temperature"
                ),
                temperature_template(),
            )
            for motor in header.motors
        ]
        self._last_temperature = -1
        self._last = (np.full(0, -1.0), -1)
        self._frames = np.zeros((len(header.buses), 2), np.int64)
        self._io_events: dict[str, int] = {}

    def blocks(self, batch: TickBatch, stamps: MessageStamps) -> list[MessageBlock]:
        """Return the status and temperature messages of a batch of ticks."""
        blocks = self._temperature_blocks(batch, stamps)
        status_ticks = self._status_ticks(batch)
        messages: list[bytes] = []
        start = 0
        for index in [*status_ticks.tolist(), len(batch.k) - 1]:
            self._count_frames(batch, start, index + 1)
            if len(messages) < len(status_ticks):
                messages.append(
                    encode_diagnostic_array(
                        int(stamps.log_times[index]), self._statuses(batch, index)
                    )
                )
            start = index + 1
        if messages:
            blocks.append(
                variable_length_block(self._diagnostics, stamps.select(status_ticks), messages)
            )
        return blocks

    def _temperature_blocks(self, batch: TickBatch, stamps: MessageStamps) -> list[MessageBlock]:
        """Return the temperature messages.

        A temperature message has the values of the first tick in an interval of
        TEMPERATURE_PERIOD_NS.
        """
        periods = batch.t_ns // TEMPERATURE_PERIOD_NS
        period_starts = np.flatnonzero(np.diff(periods, prepend=self._last_temperature))
        self._last_temperature = int(periods[-1])
        if not len(period_starts):
            return []
        values = batch.numbers[period_starts, self._columns["motor_temperature"]]
        period_stamps = stamps.select(period_starts)
        return [
            stream.block(period_stamps, {"temperature": values[:, [index]]})
            for index, stream in enumerate(self._temperatures)
        ]

    def _status_ticks(self, batch: TickBatch) -> NDArray[np.intp]:
        """Return the indices of the ticks in ``batch`` that get a status message in the log."""
        # NaN does not equal NaN. Without this line, an unknown state of a drive would look like a
        # change in every tick.
        phases = np.nan_to_num(batch.numbers[:, self._columns["drive_phase"]], nan=-1.0)
        state = np.column_stack([batch.mode, batch.action, phases])
        last_state, last_period = self._last
        previous_state = last_state if len(last_state) else np.full(state.shape[1], -1.0)
        periods = batch.t_ns // DIAGNOSTICS_PERIOD_NS
        has_changed = (np.diff(state, axis=0, prepend=previous_state[None, :]) != 0).any(axis=1)
        self._last = state[-1], int(periods[-1])
        return np.flatnonzero(has_changed | (np.diff(periods, prepend=last_period) != 0))

    def _count_frames(self, batch: TickBatch, first_tick: int, tick_end: int) -> None:
        """Add the frames and io events of the ticks with the indices `first_tick` to `tick_end` - 1 to the counts."""
        for direction, frames in enumerate((batch.received, batch.sent)):
            first_row, end_row = np.searchsorted(frames.tick_indexes, (first_tick, tick_end))
            bus = np.bincount(frames.frames["bus"][first_row:end_row], minlength=len(self._frames))
            self._frames[:, direction] += bus[: len(self._frames)]
        for index in range(first_tick, tick_end):
            tick = batch.ticks_with_events.get(index)
            for event in tick.tick_in.io_events if tick else ():
                key = " ".join(filter(None, (event.kind, event.where)))
                self._io_events[key] = self._io_events.get(key, 0) + event.number

    def _statuses(self, batch: TickBatch, tick_index: int) -> list[DiagnosticStatus]:
        """Return the status of controller, buses and motors at a tick."""
        action = SafetyAction(int(batch.action[tick_index]))
        level = (
            OK_LEVEL
            if action == SafetyAction.PASS
            else WARN_LEVEL
            if action < SafetyAction.RELAX
            else ERROR_LEVEL
        )
        mode = HandMode(int(batch.mode[tick_index])).name.lower()
        values = {
            "action": action.name.lower(),
            "phase": batch.phases[tick_index],
            "cycle": str(int(batch.k[tick_index])),
        }
        controller = DiagnosticStatus(
            level, "handctl: controller", mode, "handctl", values | self._count_texts()
        )
        return [controller, *self._bus_statuses(), *self._motor_statuses(batch.numbers[tick_index])]

    def _count_texts(self) -> dict[str, str]:
        """Return a text with the number of io events for each event name."""
        return {f"io {name}": str(number) for name, number in self._io_events.items()}

    def _bus_statuses(self) -> list[DiagnosticStatus]:
        """Return the diagnostic status of each bus."""
        return [
            DiagnosticStatus(
                OK_LEVEL,
                f"handctl: bus {bus}",
                "frames",
                bus,
                {"received": str(received_count), "sent": str(sent_count)},
            )
            for bus, (received_count, sent_count) in zip(
                self._header.buses, self._frames.tolist(), strict=True
            )
        ]

    def _motor_statuses(self, telemetry_row: NDArray[np.float64]) -> list[DiagnosticStatus]:
        """Return the diagnostic status of each motor."""
        statuses = []
        fields = (
            "motor_position",
            "motor_velocity",
            "motor_torque",
            "motor_temperature",
            "motor_age",
        )
        values_of_field = {
            name: telemetry_row[self._columns[name]] for name in (*fields, "drive_phase")
        }
        for index, motor in enumerate(self._header.motors):
            number = values_of_field["drive_phase"][index]
            is_valid = number in set(DrivePhase)
            phase = DrivePhase(int(number)) if is_valid else DrivePhase.SILENT
            values = {
                name.removeprefix("motor_"): f"{values_of_field[name][index]:.6g}"
                for name in fields
            }
            level = _LEVEL_BY_DRIVE_PHASE.get(phase, WARN_LEVEL)
            statuses.append(
                DiagnosticStatus(
                    level, f"handctl: motor {motor}", phase.name.lower(), motor, values
                )
            )
        return statuses
