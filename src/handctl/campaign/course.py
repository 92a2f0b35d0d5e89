"""A controller and a simulator in lockstep, tick after tick, in one process: what a scenario branches off from."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from handctl.controller.state import State
from handctl.controller.tick import Controller
from handctl.controller.types import IoEvent, Mode, TickIn, TickOut
from handctl.drives.frame import Frame


class FaultyPeer(Protocol):
    """A simulator in lockstep that takes faults."""

    def step(self, t_ns: int, frames: list[Any]) -> list[Any]:
        """Take the host's frames of the tick that begins at t_ns, answer, and advance one period."""
        ...

    def inject(self, text: str) -> None:
        """Let a fault begin."""
        ...

    def told(self) -> list[dict[str, Any]]:
        """Every fault so far, and what was felt of it."""
        ...

    def truth(self) -> dict[str, list[float]]:
        """Tensions [N] and torques asked of the motors [N m], now."""
        ...


@dataclass
class Course:
    """One run.

    Attributes:
        controller, peer: both sides. period_ns: control period.
        state: of the controller. k: of the next tick.
        kept: what went in and out of every tick, for the log of a failure.
        out: of the last tick.
    """

    controller: Controller
    peer: FaultyPeer
    period_ns: int
    state: State
    k: int = 0
    kept: list[tuple[TickIn, TickOut]] = field(default_factory=list)
    out: TickOut | None = None
    _waiting: list[Frame] = field(default_factory=list)

    @staticmethod
    def of(controller: Controller, peer: FaultyPeer, period_ns: int) -> "Course":
        """A run that begins."""
        return Course(controller, peer, period_ns, controller.initial())

    def tick(
        self, io: tuple[IoEvent, ...] = (), requests: tuple[str, ...] = (), late_ns: int = 0, skip: int = 0
    ) -> TickOut:
        """One tick; ``skip`` deadlines are missed before it."""
        for _ in range(skip):
            self._step([])
        entry = TickIn(self.k, self.k * self.period_ns, late_ns, tuple(self._waiting), io, requests)
        self.state, self.out = self.controller.tick(self.state, entry)
        self.kept.append((entry, self.out))
        self._waiting = []
        self._step(list(self.out.frames))
        return self.out

    def _step(self, frames: list[Frame]) -> None:
        answers = self.peer.step(self.k * self.period_ns, frames)
        self._waiting += [Frame(*answer) for answer in answers]
        self.k += 1

    def until(self, reached: Callable[[TickOut], bool], timeout_s: float) -> bool:
        """Go on until something is so, at most so long; whether it came."""
        for _ in range(round(timeout_s * 1e9 / self.period_ns)):
            out = self.tick()
            if reached(out):
                return True
            if out.mode == Mode.DONE:
                return False
        return False
