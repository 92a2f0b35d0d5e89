"""The main loop of a simulator that runs in real time.

A single thread reads frames, advances the plant to the time of the clock, and answers the frames at
once.
"""

import select
import socket
import time
from collections.abc import Collection
from typing import Protocol

from firmware_sim.bus.bus_ports import BusPort
from firmware_sim.bus.frame import Frame
from firmware_sim.bus.timed_port import TimedPort
from firmware_sim.clock.realtime_priority import RealTimePriority
from firmware_sim.clock.simulation_pace import PaceMeter
from firmware_sim.faults.fault_injection_socket import FaultInjectionSocket

MAX_ADVANCE_INTERVAL_NS = 1_000_000
"""Maximum time from one advance of the plant to the next, as plant time [ns]."""
OVERRUN_DELAY_NS = 5 * MAX_ADVANCE_INTERVAL_NS
"""Smallest delay of the plant behind the clock that counts as an overrun, as plant time [ns]."""
MAX_DELAY_NS = 150_000_000
"""Largest delay of the plant, as plant time [ns].

If the delay of the plant is larger, the clock slips. At a slip of the clock, the plant skips the
lost time.
"""
MAX_READS_PER_TURN = 64
"""Maximum number of reads of the ports in one turn of the main loop.

Because of the limit, a busy bus cannot stop the plant.
"""
CLOCK_SLIP_PAUSE_S = 0.005
"""Pause after a slip of the clock, in which other processes can use the processor core [s]."""
MAX_CATCH_UP_NS = 4_000_000
"""Maximum plant time by which one turn of the main loop advances the plant [ns].

The computation of 4 ms of plant time takes half a millisecond of wall time. In a longer turn, an
answer could come later than the next SYNC.
"""


class ServerClock(Protocol):
    """The clock that determines the plant time of a simulator in real time."""

    @property
    def scale(self) -> float:
        """Return the ratio of plant time to wall time."""
        ...

    def now_ns(self) -> int:
        """Return the time that the plant should reach [ns]."""
        ...

    def sent_tick_count(self) -> int:
        """Return the number of ticks for which the controller has sent all frames.

        The controller uses the same clock as the server.
        """
        ...

    def publish_answered_ticks(self, ticks: int) -> None:
        """Report the number of ticks for which the nodes have answered all frames."""
        ...

    def publish_reached_time(self, t_ns: int) -> None:
        """Report the time that the plant has reached [ns]."""
        ...


class BusNodes(Protocol):
    """The simulated nodes that a server advances: the nodes of a hand, or drives on a test bench.

    Attributes:
        t_ns: present time of the nodes [ns].
        slip_ns: total plant time that was skipped because the plant was behind the clock [ns].
        foreign_frame_count: number of received frames that no node has handled.
    """

    slip_ns: int
    foreign_frame_count: int

    @property
    def t_ns(self) -> int:
        """Return the present time of the nodes [ns]."""
        ...

    @property
    def malformed_frame_count(self) -> int:
        """Return the number of frames that the nodes could not decode."""
        ...

    def receive(self, frame: Frame) -> list[Frame]:
        """Pass a frame to the nodes on the frame's bus, and return the answers of the nodes."""
        ...

    def advance(self, t_ns: int) -> None:
        """Advance the nodes by whole time steps, but not beyond the time ``t_ns``."""
        ...

    def advance_exactly(self, t_ns: int) -> None:
        """Advance the nodes exactly to the time ``t_ns``."""
        ...

    def take_unsolicited_frames(self) -> list[Frame]:
        """Return the unsolicited frames of the nodes since the last call."""
        ...


class BusServer:
    """The main loop of the simulator.

    The loop advances the simulated nodes to the time of a clock. The loop exchanges frames through
    the ports of the buses.

    Attributes:
        pace: measured pace of the simulation.
        overruns: number of turns in which the plant was more than ``OVERRUN_DELAY_NS`` behind the
            clock.
        slips: number of slips of the clock, in which the plant has skipped lost time.
        running: True while ``run`` serves the buses. A signal handler sets the attribute to False
            to end ``run``.
    """

    def __init__(
        self,
        world: BusNodes,
        ports: list[BusPort],
        clock: ServerClock,
        faults: FaultInjectionSocket | None = None,
        priority: RealTimePriority | None = None,
    ) -> None:
        """Set up the server.

        Args:
            world: simulated nodes to serve. The time of the nodes must equal the present time of
                the clock.
            ports: one port for each bus, in the order of the hand's buses.
            clock: clock that the nodes follow.
            faults: socket for faults and other requests, or None for a server without this socket.
            priority: real-time priority of the process, or None for a process with ordinary
                priority.
        """
        self._faults = faults
        self._priority = priority
        self.pace = PaceMeter(world.t_ns, time_scale=clock.scale)
        self._world = world
        self._ports = ports
        self._clock = clock
        self.overruns = self.slips = 0
        self.running = True
        self._has_host = False

    def run(self) -> None:
        """Serve the buses until the attribute ``running`` is False."""
        while self.running:
            self.serve_once()

    def serve_once(self) -> None:
        """Wait until frames arrive or the next millisecond begins.

        After the wait, the method advances the plant, and sends the answers of the nodes to the
        received frames.
        """
        ready_sockets = self._wait_for_sockets()
        frames = self._receive_frames(ready_sockets)
        if frames:
            self._register_host()
        self._advance_plant(is_exact=bool(frames))
        self._send_answers(frames)
        if self._faults and self._faults.read_sockets()[0] in ready_sockets:
            self._faults.serve(self.pace)
        for _ in range(MAX_READS_PER_TURN):
            if not (frames := self._receive_frames(())):
                break
            self._send_answers(frames)
        self._publish_progress()

    def _publish_progress(self) -> None:
        """Report the number of answered ticks and the plant time to a controller that shares the server's clock."""
        self._clock.publish_reached_time(self._world.t_ns + self._world.slip_ns)
        # The number of ticks must be read before the sockets are checked. Frames that arrive
        # between the reading of the number and the check of the sockets then belong to a later
        # tick.
        ticks = self._clock.sent_tick_count()
        if ticks and not self._readable_sockets(0.0):
            self._clock.publish_answered_ticks(ticks)

    def _register_host(self) -> None:
        """Request real-time priority for this process, because a host has sent frames.

        When the first frame of a host arrives, also restart the measurement of the pace (plant time
        per wall time).
        """
        if not self._has_host:
            self._has_host = True
            self.pace.restart(self._world.t_ns)
        if self._priority:
            self._priority.request_priority()

    def _receive_frames(self, ready_sockets: Collection[socket.socket]) -> list[Frame]:
        """Receive the frames of all ports."""
        return [frame for port in self._ports for frame in port.receive(ready_sockets)]

    def _wait_for_sockets(self) -> list[socket.socket]:
        """Wait until a socket is ready or the plant must advance.

        Returns:
            The sockets that are ready for reading.
        """
        # The time of the nodes is behind the wall clock by the total time that clock slips have
        # lost.
        due_ns = self._world.t_ns + self._world.slip_ns + MAX_ADVANCE_INTERVAL_NS
        due_ns = min(due_ns, *(port.due_ns for port in self._ports))
        return self._readable_sockets(
            max(0.0, (due_ns - self._clock.now_ns()) / self._clock.scale * 1e-9)
        )

    def _readable_sockets(self, timeout_s: float) -> list[socket.socket]:
        """Wait for at most ``timeout_s``, and return the sockets that are ready for reading."""
        readers = [link for port in self._ports for link in port.read_sockets()]
        readers += self._faults.read_sockets() if self._faults else []
        writers = [link for port in self._ports for link in port.write_sockets()]
        readable, _, _ = select.select(readers, writers, [], timeout_s)
        return readable

    def _advance_plant(self, is_exact: bool) -> None:
        """Advance the plant to the time of the clock.

        Args:
            is_exact: True to reach the time of the clock exactly. The exact time is necessary if
                answers to frames contain readings of the plant.
        """
        world = self._world
        target_ns = self._clock.now_ns() - world.slip_ns
        behind_ns = target_ns - world.t_ns
        if behind_ns > MAX_DELAY_NS:
            self._skip_lost_time(behind_ns)
            return
        self.overruns += behind_ns > OVERRUN_DELAY_NS
        advance_world = world.advance_exactly if is_exact else world.advance
        advance_world(min(target_ns, world.t_ns + MAX_CATCH_UP_NS))

    def _skip_lost_time(self, behind_ns: int) -> None:
        """Skip the time by which the plant is behind the clock (a slip of the clock).

        The plant and the watchdogs of the drives do not advance by the skipped time.
        """
        self._world.slip_ns += behind_ns
        self.slips += 1
        if self._priority:
            self._priority.count_clock_slip()
        if self._has_host:
            self.pace.count_slip(behind_ns, self._world.t_ns)
        time.sleep(CLOCK_SLIP_PAUSE_S)

    def _send_answers(self, frames: list[Frame]) -> None:
        """Send the answers to frames, and all frames that nodes send without a request."""
        answer_frames: list[list[Frame]] = [[] for _ in self._ports]
        for frame in frames:
            answer_frames[frame.bus] += self._world.receive(frame)
        for frame in self._world.take_unsolicited_frames():
            answer_frames[frame.bus].append(frame)
        for port, batch in zip(self._ports, answer_frames, strict=True):
            if batch:
                port.send(batch)

    def summary(self) -> dict[str, object]:
        """Return the counts of a run, such as the number of overruns.

        The program writes the counts into the truth file (the record of the true plant state), and
        prints the counts in its last line.
        """
        return {
            "overruns": self.overruns,
            "slips": self.slips,
            "slipped_ns": self._world.slip_ns,
            "foreign_frames": self._world.foreign_frame_count,
            "malformed_frames": self._world.malformed_frame_count,
            "lost_frames": sum(port.lost_frame_count for port in self._ports),
            "wire_load": [
                round(port.load, 4) for port in self._ports if isinstance(port, TimedPort)
            ],
        }
