"""The simulator in real time: one thread reads frames, advances the plant to the clock, and answers at once."""

import select
import socket
import time
from collections.abc import Collection
from typing import Protocol

from firmware_sim.bus.frame import Frame
from firmware_sim.bus.ports import Port
from firmware_sim.bus.timed_port import TimedPort
from firmware_sim.faults.socket import FaultSocket
from firmware_sim.pace import Pace
from firmware_sim.priority import RealTimePriority

MAX_TURN_NS = 1_000_000
"""Maximum time between two advances of the plant [ns of plant time]."""
OVERRUN_NS = 5 * MAX_TURN_NS
"""Delay of the plant that counts as an overrun [ns of plant time]."""
MAX_DELAY_NS = 150_000_000
"""Delay of the plant at which its clock slips by the lost time [ns of plant time]."""
MAX_READS_PER_TURN = 64
"""Maximum reads of the ports in one turn. The limit keeps a full wire from stopping the plant."""
SLIP_PAUSE_S = 0.005
"""Pause after a slip [s], which leaves the core to other processes."""
MAX_CATCH_UP_NS = 4_000_000
"""Maximum plant time that one turn catches up [ns].

Computing this time takes half a millisecond. In a longer turn an answer could be later than the
next SYNC.
"""


class ServerClock(Protocol):
    """Clock of the server."""

    @property
    def scale(self) -> float:
        """Return the plant time per wall time."""
        ...

    def now_ns(self) -> int:
        """Return the target time of the plant [ns]."""
        ...

    def ticks_sent(self) -> int:
        """Return the number of ticks whose frames a controller on the same clock has sent."""
        ...

    def note_answered(self, ticks: int) -> None:
        """Report that all frames of a number of ticks are answered."""
        ...

    def note_reached(self, t_ns: int) -> None:
        """Report the time that the plant has reached [ns]."""
        ...


class Served(Protocol):
    """Nodes on the buses: the nodes of a hand, or drives on a bench.

    Attributes:
        t_ns: clock of the nodes [ns].
        slip_ns: time by which the simulation is behind the wall clock and which it does not catch up [ns].
        foreign: frames that no node handled.
    """

    slip_ns: int
    foreign: int

    @property
    def t_ns(self) -> int:
        """Return the clock of the nodes [ns]."""
        ...

    @property
    def malformed(self) -> int:
        """Return the number of frames that a node could not decode."""
        ...

    def receive(self, frame: Frame) -> list[Frame]:
        """Pass a frame to the nodes of its bus and return the answers."""
        ...

    def advance(self, t_ns: int) -> None:
        """Advance to t_ns in whole steps."""
        ...

    def reach(self, t_ns: int) -> None:
        """Advance to exactly t_ns."""
        ...

    def take_unsolicited(self) -> list[Frame]:
        """Return the unsolicited frames since the last call."""
        ...


class Server:
    """The loop that drives a world by a clock and by the ports of its buses.

    Attributes:
        pace: pace of the world.
        overruns: turns in which the plant was late.
        slips: slips of the plant's clock.
        running: False ends ``run``. A signal handler may set it.
    """

    def __init__(
        self,
        world: Served,
        ports: list[Port],
        clock: ServerClock,
        faults: FaultSocket | None = None,
        priority: RealTimePriority | None = None,
    ) -> None:
        """Set up the server.

        Args:
            world: nodes to serve, at the present time.
            ports: ports in the order of the hand's buses.
            clock: clock that the world follows.
            faults: socket of faults and requests, None without.
            priority: real-time priority, None for an ordinary process.
        """
        self._faults = faults
        self._priority = priority
        self.pace = Pace(world.t_ns, time_scale=clock.scale)
        self._world = world
        self._ports = ports
        self._clock = clock
        self.overruns = self.slips = 0
        self.running = True
        self._served = False

    def run(self) -> None:
        """Serve until ``running`` is False."""
        while self.running:
            self.turn()

    def turn(self) -> None:
        """Wait for frames or for the next millisecond, advance the plant, and answer."""
        ready = self._wait()
        frames = self._receive(ready)
        if frames:
            self._note_host()
        self._catch_up(sampled=bool(frames))
        self._answer(frames)
        if self._faults and self._faults.readers()[0] in ready:
            self._faults.serve(self.pace)
        for _ in range(MAX_READS_PER_TURN):
            if not (frames := self._receive(())):
                break
            self._answer(frames)
        self._note_progress()

    def _note_progress(self) -> None:
        """Report answered ticks and the time of the plant to a controller on the same clock."""
        self._clock.note_reached(self._world.t_ns + self._world.slip_ns)
        # The number is read first: frames that arrive between the two calls belong to a later tick.
        ticks = self._clock.ticks_sent()
        if ticks and not self._ready_links(0.0):
            self._clock.note_answered(ticks)

    def _note_host(self) -> None:
        """Take the real-time priority, and measure the pace from the first frame of a host."""
        if not self._served:
            self._served = True
            self.pace.restart(self._world.t_ns)
        if self._priority:
            self._priority.note_host_frames()

    def _receive(self, ready: Collection[socket.socket]) -> list[Frame]:
        """Receive the frames of all ports."""
        return [frame for port in self._ports for frame in port.receive(ready)]

    def _wait(self) -> list[socket.socket]:
        """Wait until a socket is ready or the plant is due.

        Returns:
            The sockets that are ready for reading.
        """
        # The world's clock is behind the wall clock by the time lost by slips.
        due_ns = self._world.t_ns + self._world.slip_ns + MAX_TURN_NS
        due_ns = min(due_ns, *(port.due_ns for port in self._ports))
        return self._ready_links(max(0.0, (due_ns - self._clock.now_ns()) / self._clock.scale * 1e-9))

    def _ready_links(self, timeout_s: float) -> list[socket.socket]:
        """Return the sockets that are ready for reading, after at most timeout_s."""
        readers = [link for port in self._ports for link in port.readers()]
        readers += self._faults.readers() if self._faults else []
        writers = [link for port in self._ports for link in port.writers()]
        readable, _, _ = select.select(readers, writers, [], timeout_s)
        return readable

    def _catch_up(self, sampled: bool) -> None:
        """Advance the plant to the clock.

        Args:
            sampled: True to reach the exact time, because frames sample the plant.
        """
        world = self._world
        target_ns = self._clock.now_ns() - world.slip_ns
        behind_ns = target_ns - world.t_ns
        if behind_ns > MAX_DELAY_NS:
            self._slip(behind_ns)
            return
        self.overruns += behind_ns > OVERRUN_NS
        follow = world.reach if sampled else world.advance
        follow(min(target_ns, world.t_ns + MAX_CATCH_UP_NS))

    def _slip(self, behind_ns: int) -> None:
        """Give up lost time. Plant and watchdogs stood still while this process did not run."""
        self._world.slip_ns += behind_ns
        self.slips += 1
        if self._priority:
            self._priority.note_slip()
        if self._served:
            self.pace.slipped(behind_ns, self._world.t_ns)
        time.sleep(SLIP_PAUSE_S)

    def _answer(self, frames: list[Frame]) -> None:
        """Answer frames and send unsolicited frames."""
        answers: list[list[Frame]] = [[] for _ in self._ports]
        for frame in frames:
            answers[frame.bus] += self._world.receive(frame)
        for frame in self._world.take_unsolicited():
            answers[frame.bus].append(frame)
        for port, batch in zip(self._ports, answers, strict=True):
            if batch:
                port.send(batch)

    def summary(self) -> dict[str, object]:
        """Return the counts of the run, for the truth file and the last line."""
        return {
            "overruns": self.overruns,
            "slips": self.slips,
            "slipped_ns": self._world.slip_ns,
            "foreign_frames": self._world.foreign,
            "malformed_frames": self._world.malformed,
            "lost_frames": sum(port.lost for port in self._ports),
            "wire_load": [round(port.load, 4) for port in self._ports if isinstance(port, TimedPort)],
        }
