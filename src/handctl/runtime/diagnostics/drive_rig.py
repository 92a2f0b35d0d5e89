"""Test rig for the conformance checks: one drive on a bus, with ticks from a clock."""

import math
from collections.abc import Callable, Sequence

from handctl.compiled import prepare
from handctl.drives.contract import Drive, DriveState, DriveTarget, Phase
from handctl.drives.frame import Frame
from handctl.runtime.buses.contract import Bus
from handctl.runtime.clocks.real import Clock

PERIOD_NS = 5_000_000
"""Period of a tick [ns]."""
VELOCITY_TICKS = 4
"""Number of ticks for the computation of the velocity from positions."""


def _no_torque(state: DriveState) -> float:
    """Return the command of a drive at rest that controls its torque."""
    return 0.0


class DriveRig:
    """Drive with its bus and clock.

    Attributes:
        drive: immutable description of the drive.
        state: state of the drive.
        k: number of the next tick.
        torque: last commanded torque [N m].
        events: events of the bus.
        inertia: measured inertia of the shaft [kg m2]. NaN before the measurement.
        idle_command: command that moves nothing. In position mode it contains the present position.
    """

    def __init__(self, drive: Drive, bus: Bus, clock: Clock) -> None:
        """Start the clock.

        Args:
            drive: description of the drive.
            bus: open bus of the drive.
            clock: clock with period PERIOD_NS, not started yet.
        """
        prepare()  # otherwise the first command would be compiled, and the watchdog of the drive would expire
        self.drive = drive
        self._bus = bus
        self._clock = clock
        self.state: DriveState = drive.initial()
        self.k = 0
        self.torque = 0.0
        self.inertia = math.nan
        self.events: list[tuple[str, str, int]] = []
        self.idle_command: Callable[[DriveState], float] = _no_torque
        self._positions = [math.nan] * (VELOCITY_TICKS + 1)
        clock.start()

    def take(self, drive: Drive) -> None:
        """Continue with another description of the same drive, from the initial state."""
        self.drive = drive
        self.state = drive.initial()

    @property
    def t_ns(self) -> int:
        """Return the time of the next tick [ns]."""
        return self.k * PERIOD_NS

    @property
    def velocity(self) -> float:
        """Return the velocity from the last positions [rad/s], NaN while there are too few positions."""
        return (self._positions[-1] - self._positions[0]) / (VELOCITY_TICKS * PERIOD_NS * 1e-9)

    def tick(self, target: DriveTarget, torque: float | None = None, extra: Sequence[Frame] = ()) -> DriveState:
        """Run one tick and return the state after it.

        Args:
            target: requested state of the drive.
            torque: command, used while the drive is enabled [N m], None for ``idle_command``.
            extra: further frames to send.
        """
        self._clock.wait(self.k)
        for frame in self._bus.drain():
            self.state = self.drive.receive(self.state, frame)
        if torque is None:
            torque = self.idle_command(self.state)
        self.state, frames = self.drive.advance(self.state, self.t_ns, target, torque)
        self.torque = torque
        self._bus.send((*frames, *extra))
        self.events += self._bus.take_events()
        self._positions = [*self._positions[1:], self.state.position]
        self.k += 1
        return self.state

    def until(self, target: DriveTarget, reached: Callable[[DriveState], bool], for_s: float) -> bool:
        """Run ticks without torque until a condition is true.

        Returns False after the time limit [s].
        """
        return any(reached(self.tick(target)) for _ in range(math.ceil(for_s * 1e9 / PERIOD_NS)))

    def keep(self, target: DriveTarget, for_s: float) -> None:
        """Run ticks without torque for a time [s]."""
        self.until(target, lambda state: False, for_s)

    def clear(self) -> None:
        """Clear the latched faults of the drive."""
        self.state, frames = self.drive.clear(self.state)
        self.tick(DriveTarget.POLL, extra=frames)

    def cut(self) -> None:
        """Send only the frames that remove the torque."""
        self.tick(DriveTarget.LISTEN, extra=self.drive.cut())

    def release(self) -> None:
        """Send the frames for the regular end of a run."""
        self.tick(DriveTarget.LISTEN, extra=self.drive.release_frames(self.state))

    def rest(self) -> bool:
        """Bring the drive to READY from any phase. Returns True if the drive has reached READY."""
        self.until(DriveTarget.DISABLE, lambda state: state.phase != Phase.ENABLED, 1.0)
        if self.state.phase == Phase.FAULT:
            self.clear()
        return self.until(DriveTarget.POLL, lambda state: state.phase == Phase.READY, 3.0)

    def confirm_off(self, watchdog_s: float) -> bool:
        """Disable the drive, and return True if the drive reports off.

        A drive that does not obey is disabled again after a silence that lets the watchdog expire.
        """
        for silence in (0.0, 3.0 * watchdog_s + 0.2):
            self.keep(DriveTarget.LISTEN, silence)
            if self.until(DriveTarget.DISABLE, lambda state: state.phase != Phase.ENABLED, 1.0):
                return True
        return False
