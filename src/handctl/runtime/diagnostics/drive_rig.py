"""Test rig for conformance checks and jogs: one drive on a bus, with ticks from a clock."""

import math
from collections.abc import Callable, Sequence

from handctl.compiled import compile_kernels
from handctl.drives.contract import (
    Drive,
    DrivePhase,
    DriveState,
    DriveTarget,
    is_confirmed_off,
)
from handctl.drives.frame import Frame
from handctl.runtime.buses.contract import Bus
from handctl.runtime.clocks.real_clock import TickClock

PERIOD_NS = 5_000_000
"""Period of a tick [ns]."""
MAX_LISTED_IDS = 8
"""Largest number of identifiers in a message. The replies of a RobStride motor can have a thousand identifiers."""
MAX_SETUP_S = 3.0
"""Longest time of the set-up of a drive [s]."""
SETUP_PHASES = (DrivePhase.SILENT, DrivePhase.CONFIGURING)
"""Phases of a drive's set-up in which the drive has not reported whether it makes torque."""
VELOCITY_WINDOW_TICKS = 4
"""Number of ticks between the two positions from which the velocity is computed."""


def _zero_torque_command(state: DriveState) -> float:
    """Return a torque of zero, which is the idle command in torque mode.

    The idle command is the command that does not move the shaft.
    """
    return 0.0


class DriveRig:
    """Drive with its bus and clock.

    Attributes:
        drive: immutable description of the drive.
        state: state of the drive after the last tick.
        k: number of the next tick.
        missed_ticks: number of ticks that were skipped directly before the last tick because the
            host was late.
        drive_events: all events of the bus so far.
        inertia: measured inertia of the shaft [kg m2], or NaN before the measurement.
        idle_command: function that takes the state of the drive, and returns the command that does
            not move the shaft. In position mode, for example, the idle command is the present
            position.
    """

    def __init__(self, drive: Drive, bus: Bus, clock: TickClock) -> None:
        """Start the clock.

        Args:
            drive: description of the drive.
            bus: open bus of the drive.
            clock: clock with period PERIOD_NS, not started yet.
        """
        # The following call makes numba compile the code before the first tick. A compilation in
        # the first tick would delay the tick, and the watchdog of the drive would expire.
        compile_kernels()
        self.drive = drive
        self._bus = bus
        self._clock = clock
        self.state: DriveState = drive.initial_state()
        self.k = 0
        self.missed_ticks = 0
        self.inertia = math.nan
        self.drive_events: list[tuple[str, str, int]] = []
        self.idle_command: Callable[[DriveState], float] = _zero_torque_command
        self._positions = [(0, math.nan)] * (VELOCITY_WINDOW_TICKS + 1)
        clock.start()

    def replace_drive(self, drive: Drive) -> None:
        """Replace the description of the drive by another description of the same drive.

        With the other description, the drive starts again in its initial state.
        """
        self.drive = drive
        self.state = drive.initial_state()

    @property
    def t_ns(self) -> int:
        """Return the time of the next tick [ns]."""
        return self.k * PERIOD_NS

    @property
    def velocity_rad_s(self) -> float:
        """Return the velocity of the shaft, computed from the latest positions [rad/s].

        While too few positions are known, the velocity is NaN.
        """
        (first_time_ns, first_position), *_, (last_time_ns, last_position) = self._positions
        # After missed ticks, the time between two positions is longer than a tick.
        return (last_position - first_position) / (
            max(last_time_ns - first_time_ns, VELOCITY_WINDOW_TICKS * PERIOD_NS) * 1e-9
        )

    def run_tick(
        self, target: DriveTarget, command: float | None = None, extra_frames: Sequence[Frame] = ()
    ) -> DriveState:
        """Run one tick, and return the state of the drive after this tick.

        If the host is late by whole periods, the missed ticks are skipped, and are not executed
        later.

        Args:
            target: requested state of the drive.
            command: command to the enabled drive, in the unit of ``Drive.command_limit``. If
                ``command`` is None, ``idle_command`` computes the command.
            extra_frames: further frames to send in this tick.
        """
        self.missed_ticks = self._clock.wait(self.k) // PERIOD_NS
        self.k += self.missed_ticks
        for frame in self._bus.drain():
            self.state = self.drive.receive(self.state, frame)
        if command is None:
            command = self.idle_command(self.state)
        self.state, frames = self.drive.advance(self.state, self.t_ns, target, command)
        self._bus.send((*frames, *extra_frames))
        self.drive_events += self._bus.take_events()
        self._positions = [
            *self._positions[1:],
            (self.state.feedback_t_ns, self.state.position),
        ]
        self.k += 1
        return self.state

    def run_until(
        self, target: DriveTarget, is_condition_met: Callable[[DriveState], bool], timeout_s: float
    ) -> bool:
        """Run ticks with the idle command until the drive's state fulfils the condition ``is_condition_met``.

        The idle command does not move the shaft. If the state does not fulfil the condition within
        ``timeout_s`` [s], return False. The timeout counts only executed ticks. If missed ticks
        counted too, a late host would give the drive too few ticks for its answers.
        """
        return any(
            is_condition_met(self.run_tick(target))
            for _ in range(math.ceil(timeout_s * 1e9 / PERIOD_NS))
        )

    def run_for(self, target: DriveTarget, duration_s: float) -> None:
        """Run ticks with the idle command for a given time [s]."""
        self.run_until(target, lambda state: False, duration_s)

    def reason_not_ready(self) -> str:
        """Return the reason why the drive has not reached the phase READY.

        The reason is an error, missing answers, or the present phase of the drive's set-up.
        """
        if self.state.error_text:
            return self.state.error_text
        if self.state.phase != DrivePhase.SILENT:
            return f"stays in {self.state.phase.name}"
        # In an identifier of SocketCAN, the bits 29 to 31 are flags.
        ids = sorted(self.drive.node_ids)
        ids_text = ", ".join(f"0x{number & 0x1FFFFFFF:03X}" for number in ids[:MAX_LISTED_IDS])
        omitted_count_text = (
            f" or {len(ids) - MAX_LISTED_IDS} others" if len(ids) > MAX_LISTED_IDS else ""
        )
        return f"no reply; expected frames with the identifier {ids_text}{omitted_count_text}"

    def clear_faults(self) -> None:
        """Clear the latched faults of the drive."""
        self.state, frames = self.drive.clear(self.state)
        self.run_tick(DriveTarget.POLL, extra_frames=frames)

    def cut_torque(self) -> None:
        """Run a tick that sends only the frames that remove the torque of the drive."""
        self.run_tick(DriveTarget.LISTEN, extra_frames=self.drive.torque_cut_frames())

    def send_release(self) -> None:
        """Run a tick that sends only the frames for the regular end of a run."""
        self.run_tick(DriveTarget.LISTEN, extra_frames=self.drive.release_frames(self.state))

    def set_up_drive(self) -> bool:
        """Bring the drive into the phase READY from any other phase.

        Return True if the drive has reached the phase READY.
        """
        self.run_until(DriveTarget.DISABLE, lambda state: state.phase != DrivePhase.ENABLED, 1.0)
        if self.state.phase == DrivePhase.FAULT:
            self.clear_faults()
        return self.run_until(
            DriveTarget.POLL, lambda state: state.phase == DrivePhase.READY, MAX_SETUP_S
        )

    def confirm_disabled(self, watchdog_s: float) -> bool:
        """Disable the drive, and return True if the drive reports that it is disabled.

        If no frame of the drive was ever received, the drive does not count as disabled. Another
        host may have enabled a drive of which no frame was received. If the drive does not obey the
        disable command, the host sends no frames until the watchdog of the drive has expired. After
        the watchdog has expired, the host disables the drive again.
        """
        for silence_s in (0.0, 3.0 * watchdog_s + 0.2):
            self.run_for(DriveTarget.LISTEN, silence_s)
            if self.run_until(DriveTarget.DISABLE, is_confirmed_off, 1.0):
                return True
        return self.state.phase in SETUP_PHASES and self._is_disabled_after_setup()

    def _is_disabled_after_setup(self) -> bool:
        """Set up a drive from the beginning, and disable it.

        Return True if the drive reports that it is disabled. A CiA 402 drive reports its power
        state in a process data object. The content of the process data object is known only after
        the set-up.
        """
        self.replace_drive(self.drive)
        return self.run_until(
            DriveTarget.POLL,
            lambda state: state.phase not in SETUP_PHASES,
            MAX_SETUP_S,
        ) and self.run_until(DriveTarget.DISABLE, is_confirmed_off, 1.0)
