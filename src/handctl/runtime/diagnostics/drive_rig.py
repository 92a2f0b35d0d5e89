"""One drive alone on a bus, ticked by a clock: what a check of its contract stands on."""

import math
from collections.abc import Callable, Sequence

from handctl.compiled import prepare
from handctl.drives.contract import Drive, DriveState, Phase, Want
from handctl.drives.frame import Frame
from handctl.runtime.buses.contract import Bus
from handctl.runtime.clock import Clock

PERIOD_NS = 5_000_000
SPAN = 4
"""Ticks over which a velocity is taken from positions."""


class DriveRig:
    """A drive, its bus and its clock.

    Attributes:
        drive: immutable. state: what is known of it. k: next tick.
        torque: last one commanded [N m].
        events: what happened to the bus.
        inertia: of the shaft as measured [kg m2]; NaN before.
    """

    def __init__(self, drive: Drive, bus: Bus, clock: Clock) -> None:
        prepare()  # else the first command compiles, and the drive's watchdog does not wait for that
        """Args: drive; its open bus; a clock with PERIOD_NS, which begins now."""
        self.drive, self._bus, self._clock = drive, bus, clock
        self.state: DriveState = drive.initial()
        self.k, self.torque, self.inertia = 0, 0.0, math.nan
        self.events: list[tuple[str, str, int]] = []
        self._positions = [math.nan] * (SPAN + 1)
        clock.begin()

    def take(self, drive: Drive) -> None:
        """Go on with another description of the same drive, from its beginning."""
        self.drive, self.state = drive, drive.initial()

    @property
    def t_ns(self) -> int:
        """Time of the next tick [ns]."""
        return self.k * PERIOD_NS

    @property
    def velocity(self) -> float:
        """From the last positions [rad/s]; NaN before there are enough."""
        return (self._positions[-1] - self._positions[0]) / (SPAN * PERIOD_NS * 1e-9)

    def tick(self, want: Want, torque: float = 0.0, extra: Sequence[Frame] = ()) -> DriveState:
        """One tick; torque [N m] counts while the drive is enabled."""
        self._clock.wait(self.k)
        for frame in self._bus.drain():
            self.state = self.drive.receive(self.state, frame)
        self.state, frames = self.drive.advance(self.state, self.t_ns, want, torque)
        self.torque = torque
        self._bus.send((*frames, *extra))
        self.events += self._bus.take_events()
        self._positions = [*self._positions[1:], self.state.position]
        self.k += 1
        return self.state

    def until(self, want: Want, reached: Callable[[DriveState], bool], for_s: float) -> bool:
        """Tick with no torque until something holds; whether it came to hold in time."""
        return any(reached(self.tick(want)) for _ in range(math.ceil(for_s * 1e9 / PERIOD_NS)))

    def keep(self, want: Want, for_s: float) -> None:
        """Tick for a while with no torque."""
        self.until(want, lambda state: False, for_s)

    def clear(self) -> None:
        """Clear what the drive has latched."""
        self.state, frames = self.drive.clear(self.state)
        self.tick(Want.POLL, extra=frames)

    def cut(self) -> None:
        """Send the frames that take the torque away, and nothing else."""
        self.tick(Want.LISTEN, extra=self.drive.cut())

    def rest(self) -> bool:
        """Bring it back to READY, whatever it is in; whether it came there."""
        self.until(Want.DISABLE, lambda state: state.phase != Phase.ENABLED, 1.0)
        if self.state.phase == Phase.FAULT:
            self.clear()
        return self.until(Want.POLL, lambda state: state.phase == Phase.READY, 3.0)

    def confirm_off(self, watchdog_s: float) -> bool:
        """Disable; if it does not obey, leave it to its watchdog; whether it says that it is off in the end."""
        for silence in (0.0, 3.0 * watchdog_s + 0.2):
            self.keep(Want.LISTEN, silence)
            if self.until(Want.DISABLE, lambda state: state.phase != Phase.ENABLED, 1.0):
                return True
        return False
