"""Readings of the drives, load cells and joint encoders of a hand, while no drive makes torque.

Every drive is polled as in the mode READY of a run. The poll configures the drive, reads its
settings back, and requests its feedback. No function in this module requests the state ENABLE.
``DriveTarget.POLL`` disables a drive that is enabled.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from handctl.drives.cia404.amplifier import AmplifierState
from handctl.drives.contract import Drive, DrivePhase, DriveState, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.sensors.contract import SensorInterface
from handctl.drives.signals import SignalQuantity, SignalTable
from handctl.runtime.buses.contract import Bus
from handctl.runtime.clocks.real_clock import TickClock
from handctl.runtime.diagnostics.bus_scan import collect_frames

LISTEN_DURATION_S = 0.5
"""Time for which this host listens for another host, before it sends the first frame [s]."""
STALE_AFTER_S = 0.5
"""Age above which a reading is too old to be shown [s]."""


class SensorReading(NamedTuple):
    """Reading of a load cell [N] or of a joint encoder [rad].

    Attributes:
        value: latest value that the node has sent, with no tare subtracted, or NaN before the first
            frame.
        t_ns: time at which the latest value was received [ns], or -1 before the first frame.
    """

    value: float = math.nan
    t_ns: int = -1

    def value_at(self, t_ns: int) -> float:
        """Return the value, or NaN if the value is older than ``STALE_AFTER_S`` at the time ``t_ns`` [ns]."""
        return (
            self.value if self.t_ns >= 0 and t_ns - self.t_ns <= STALE_AFTER_S * 1e9 else math.nan
        )


def is_saturated(tension: float, cell_range: tuple[float, float]) -> bool:
    """Return True if the reading of a load cell [N] is at an end of its range [N], as after a break of the wire."""
    return not cell_range[0] < tension < cell_range[1] and not math.isnan(tension)


@dataclass
class BusWatch:
    """Poll of all drives and sensors of a hand. During the poll, no drive produces torque.

    Attributes:
        drives: drives of the hand.
        sensors: sensor node of the hand. A hand without sensors has a sensor node without frames.
        buses: open buses, in the order of the hand file.
        clock: clock that has been started. The host polls all nodes once in each period of the
            clock.
        period_ns: period of the clock [ns].
        states: state of each drive.
        amplifiers: state of each load-cell amplifier.
        tensions: reading of each load cell, by the index of the tendon.
        angles: reading of each joint encoder, by the index of the joint.
        k: number of the next tick.
    """

    drives: Sequence[Drive]
    sensors: SensorInterface
    buses: Sequence[Bus]
    clock: TickClock
    period_ns: int
    states: list[DriveState] = field(init=False)
    amplifiers: list[AmplifierState] = field(init=False)
    tensions: dict[int, SensorReading] = field(init=False)
    angles: dict[int, SensorReading] = field(init=False)
    k: int = 0

    def __post_init__(self) -> None:
        """Initialise the states of all drives and load-cell amplifiers, and the readings of all sensors."""
        self.states = [drive.initial_state() for drive in self.drives]
        node = self.sensors
        self.amplifiers = [amplifier.initial_state() for amplifier in node.amplifiers]
        self._tables = [SignalTable(message) for message in node.messages]
        self._group = {can_id: group for group, can_id in enumerate(node.ids)}
        cells, encoders = node.channels[: node.tension_frames], node.channels[node.tension_frames :]
        self.tensions = {index: SensorReading() for channels in cells for index in channels}
        self.angles = {index: SensorReading() for channels in encoders for index in channels}

    def find_other_host(
        self,
        duration_s: float = LISTEN_DURATION_S,
        listen_function: Callable[[Bus, float, list[Frame]], None] = collect_frames,
    ) -> str:
        """Listen for a time [s], and return the identifier of the first frame from another host.

        If no other host has sent a frame, the returned text is empty.
        """
        own_identifiers = {
            (drive.bus, can_id) for drive in self.drives for can_id in drive.host_ids
        }
        own_identifiers |= {(self.sensors.bus, can_id) for can_id in self.sensors.host_ids}
        seen_frames: list[Frame] = []
        for bus in self.buses:
            listen_function(bus, duration_s / len(self.buses), seen_frames)
        return next(
            (
                f"{frame.can_id:#x}"
                for frame in seen_frames
                if (frame.bus, frame.can_id) in own_identifiers
            ),
            "",
        )

    def run_tick(self) -> None:
        """Wait for the next tick, process all received frames, and send the requests of the tick.

        If the host is late and misses ticks, the host skips the missed ticks, and does not execute
        them later.
        """
        self.k += self.clock.wait(self.k) // self.period_ns
        for bus in self.buses:
            for frame in bus.drain():
                self._receive(frame)
        now_ns = self.clock.now_ns()
        sync_frames = [self.sensors.sync(self.k)] if self.sensors.ids else []
        for n, drive in enumerate(self.drives):
            self.states[n], frames = drive.advance(self.states[n], now_ns, DriveTarget.POLL, 0.0)
            sync_frames += frames
        for i, amplifier in enumerate(self.sensors.amplifiers):
            self.amplifiers[i], frames = amplifier.advance(
                self.amplifiers[i], now_ns, DriveTarget.POLL
            )
            sync_frames += frames
        self._send(sync_frames)
        self.k += 1

    def send_release(self) -> None:
        """Send each drive its release frames, which say that this host has ended.

        The host must send no frames after this call.
        """
        pairs = zip(self.drives, self.states, strict=True)
        self._send([frame for drive, state in pairs for frame in drive.release_frames(state)])

    def silent_motors(self) -> list[str]:
        """Return the names of the motors whose latest feedback is older than ``STALE_AFTER_S``."""
        now = self.clock.now_ns()
        return [
            drive.name
            for drive, age in zip(self.drives, self.ages_s(now), strict=True)
            if not age <= STALE_AFTER_S
        ]

    def ages_s(self, now_ns: int) -> list[float]:
        """Return the age of each drive's latest feedback [s].

        For a drive that has sent no feedback, the age is infinite.
        """
        times = [state.feedback_t_ns for state in self.states]
        return [(now_ns - t_ns) * 1e-9 if t_ns >= 0 else math.inf for t_ns in times]

    def _receive(self, frame: Frame) -> None:
        """Process a received frame.

        First, every load-cell amplifier processes the frame. If the frame contains sensor readings,
        this object then stores the readings in ``tensions`` or ``angles``. A frame without sensor
        readings is processed by every drive.
        """
        group = self._group.get(frame.can_id, -1) if frame.bus == self.sensors.bus else -1
        for i, amplifier in enumerate(self.sensors.amplifiers):
            self.amplifiers[i] = amplifier.receive(self.amplifiers[i], frame)
            if (
                group in self.sensors.amplifier_frame_ranges[i]
                and self.amplifiers[i].phase != DrivePhase.READY
            ):
                return  # until the amplifier has been set up, the unit of its readings is unknown
        if group < 0:
            for n, drive in enumerate(self.drives):
                self.states[n] = drive.receive(self.states[n], frame)
            return
        if len(frame.data) != self.sensors.lengths[group]:
            return
        table = self._tables[group]
        kinds = [signal.quantity for signal in table.message.signals]
        kinds_and_values = zip(kinds, table.unpack(frame.data), strict=True)
        # If the load is too large, an amplifier may send NaN. A reading of NaN is set to the low
        # end of the range of the load cell, so that it counts as saturated.
        low = self.sensors.cell_range[0]
        values = [
            low if math.isnan(value) else value
            for kind, value in kinds_and_values
            if kind != SignalQuantity.COUNTER
        ]
        reading_by_channel = self.tensions if group < self.sensors.tension_frames else self.angles
        for index, value in zip(self.sensors.channels[group], values, strict=True):
            reading_by_channel[index] = SensorReading(value, frame.t_ns)

    def _send(self, frames: Sequence[Frame]) -> None:
        """Send each frame on its bus."""
        for index, bus in enumerate(self.buses):
            bus.send([frame for frame in frames if frame.bus == index])
            bus.take_events()
