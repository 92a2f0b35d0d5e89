"""The simulator in real time: one thread that reads frames, lets the plant follow the clock, and answers at once."""

import select
import socket
import time
from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

from firmware_sim.bus.frame import Frame
from firmware_sim.bus.ports import Port
from firmware_sim.bus.wired import WiredPort
from firmware_sim.faults.socket import FaultSocket
from firmware_sim.pace import Pace
from firmware_sim.priority import Urgency

TURN_NS = 1_000_000
"""The plant follows the clock at least this often [ns of plant time]."""
LATE_NS = 5 * TURN_NS
"""A turn that finds the plant this far behind counts as an overrun [ns of plant time]."""
SLIP_NS = 50_000_000
"""Further behind than this the plant's clock gives up the time that is lost [ns of plant time]."""
ROUNDS = 64
"""Ports are asked at most this often in one turn: a full wire cannot keep the plant from moving."""
REST_S = 0.005
"""Pause after time was given up [s]: whoever waits for this core gets it."""
STRIDE_NS = 4_000_000
"""At most this much plant time is caught up before frames are answered and looked at again [ns]: half a millisecond of
computing, since an answer that comes after the next SYNC is late."""


class Clock(Protocol):
    """What the server asks of time."""

    @property
    def scale(self) -> float:
        """Plant time per wall time."""
        ...

    def now_ns(self) -> int:
        """Return the present plant time, were the plant never late [ns]."""
        ...


@dataclass(frozen=True, slots=True)
class ScaledClock:
    """CLOCK_MONOTONIC times a factor; both sides of the wire compute it alike.

    Attributes:
        scale: plant time per wall time.
    """

    scale: float = 1.0

    def now_ns(self) -> int:
        """Return the present time [ns]."""
        return int(time.monotonic_ns() * self.scale)


class Served(Protocol):
    """What hangs on the buses: a hand, or drives on a bench.

    Attributes:
        t_ns: its clock [ns]. slip_ns: time that it has been told to give up [ns].
        foreign: frames that no node knew.
    """

    slip_ns: int
    foreign: int

    @property
    def t_ns(self) -> int: ...
    @property
    def malformed(self) -> int:
        """Frames that a node could not read."""
        ...

    def receive(self, frame: Frame) -> list[Frame]:
        """Hand a frame to the nodes of its bus; their answers."""
        ...

    def advance(self, t_ns: int) -> None:
        """Let time pass until t_ns, in whole steps."""
        ...

    def reach(self, t_ns: int) -> None:
        """Let time pass until exactly t_ns."""
        ...

    def take_spoken(self) -> list[Frame]:
        """Return what nodes have sent of their own accord since the last call."""
        ...


class Server:
    """Drives a world by a clock and the ports of its buses.

    Attributes:
        pace: how well the world keeps up.
        overruns: turns that found the plant late. slips: how often it gave up lost time.
        running: set to False, from a signal handler too, and ``run`` returns.
    """

    def __init__(
        self,
        world: Served,
        ports: list[Port],
        clock: Clock,
        faults: FaultSocket | None = None,
        urgency: Urgency | None = None,
    ) -> None:
        """Set the server up.

        Args:
            world: what is served, its clock at the present time.
            ports: in the order of the hand's buses.
            clock: that the world follows.
            faults: socket that takes faults and questions.
            urgency: real-time priority; None for a process that stays an ordinary one.
        """
        self._faults, self._urgency = faults, urgency
        self.pace = Pace(world.t_ns)
        self._world, self._ports, self._clock = world, ports, clock
        self.overruns = self.slips = 0
        self.running = True
        self._served = False

    def run(self) -> None:
        """Serve until ``running`` is False."""
        while self.running:
            self.turn()

    def turn(self) -> None:
        """Wait for frames or for the next millisecond, let the plant catch up, answer."""
        ready = self._wait()
        frames = self._receive(ready)
        if frames:
            self._heard()
        self._catch_up(sampled=bool(frames))
        self._answer(frames)
        if self._faults and self._faults.readers()[0] in ready:
            self._faults.serve(self.pace)
        for _ in range(ROUNDS):
            if not (frames := self._receive(())):
                break
            self._answer(frames)

    def _heard(self) -> None:
        """Be quick, and judge the pace, once a host is there: before, nobody waits for the plant."""
        if not self._served:
            self._served = True
            self.pace.begin(self._world.t_ns)
        if self._urgency:
            self._urgency.heard()

    def _receive(self, ready: Collection[socket.socket]) -> list[Frame]:
        return [frame for port in self._ports for frame in port.receive(ready)]

    def _wait(self) -> list[socket.socket]:
        """Return the sockets that are ready by the time the plant is due."""
        due_ns = self._world.t_ns + self._world.slip_ns + TURN_NS
        due_ns = min(due_ns, *(port.due_ns for port in self._ports))
        timeout = max(0.0, (due_ns - self._clock.now_ns()) / self._clock.scale * 1e-9)
        readers = [link for port in self._ports for link in port.readers()]
        readers += self._faults.readers() if self._faults else []
        writers = [link for port in self._ports for link in port.writers()]
        readable, _, _ = select.select(readers, writers, [], timeout)
        return readable

    def _catch_up(self, sampled: bool) -> None:
        """Let the plant follow the clock: to this very instant if there are frames, which sample it."""
        world = self._world
        goal_ns = self._clock.now_ns() - world.slip_ns
        behind_ns = goal_ns - world.t_ns
        if behind_ns > SLIP_NS:
            self._slip(behind_ns)
            return
        self.overruns += behind_ns > LATE_NS
        follow = world.reach if sampled else world.advance
        follow(min(goal_ns, world.t_ns + STRIDE_NS))

    def _slip(self, behind_ns: int) -> None:
        """Give up lost time: plant and watchdogs stood still while this process did not run."""
        self._world.slip_ns += behind_ns
        self.slips += 1
        if self._urgency:
            self._urgency.behind()
        if self._served:
            self.pace.slipped(behind_ns, self._world.t_ns)
        time.sleep(REST_S)

    def _answer(self, frames: list[Frame]) -> None:
        answers: list[list[Frame]] = [[] for _ in self._ports]
        for frame in frames:
            answers[frame.bus] += self._world.receive(frame)
        for frame in self._world.take_spoken():
            answers[frame.bus].append(frame)
        for port, share in zip(self._ports, answers, strict=True):
            if share:
                port.send(share)

    def summary(self) -> dict[str, object]:
        """Return what the run came to, for the truth file and for a person."""
        return {
            "overruns": self.overruns,
            "slips": self.slips,
            "slipped_ns": self._world.slip_ns,
            "foreign_frames": self._world.foreign,
            "malformed_frames": self._world.malformed,
            "lost_frames": sum(port.lost for port in self._ports),
            "wire_load": [round(port.load, 4) for port in self._ports if isinstance(port, WiredPort)],
        }
