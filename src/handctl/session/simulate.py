"""A controller against the simulated hand in lockstep, put together here and nowhere else.

``simulate`` runs it to its end, a ``Simulation`` goes tick by tick, and ``Simulator.clock`` is for runs with a log.
"""

import math
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from handctl.controller.setup import make_drives, make_sensors
from handctl.controller.state import State
from handctl.controller.tick import Controller
from handctl.core.model import HandModel
from handctl.core.types import IoEvent, Mode, TickIn, TickOut
from handctl.hand.description import Hand
from handctl.hand.load import hand_path
from handctl.programs.program import Program
from handctl.runtime.lockstep import SIMULATED_HAND, LockstepBus, LockstepClock, Peer, load_peer

CHECK_NS = 2_000_000
"""Period of a simulated hand that is built only to see whether it can be [ns]."""


class SimulatedHand(Peer, Protocol):
    """The simulated hand as an object: the other side of the wire, which takes faults.

    Attributes:
        world: plant and nodes, for whoever looks behind the wire.
    """

    world: Any

    def inject(self, text: str) -> None:
        """Let a fault begin."""
        ...

    def fault_states(self) -> list[dict[str, Any]]:
        """Return every fault so far, and what was felt of it."""
        ...

    def truth(self) -> dict[str, list[float]]:
        """Return tensions [N] and torques commanded to the motors [N m], now."""
        ...


@dataclass(frozen=True)
class Simulator:
    """What is on the other side of the wire.

    Attributes:
        hand: packaged name, file, or description.
        scene: packaged name, file or text of one; None for a free hand.
        seed: of noise, slack and encoder offsets.
        perturb: factors on the plant's parameters.
        homed: whether it starts taut, with its encoders at zero.
        truth: file for what really happened; None for none.
        wire: KEY=VALUE words of a simulated wire; None for answers that are never late.
        serials: serial numbers of the drives.
    """

    hand: str | Path | Hand
    scene: str | None = None
    seed: int = 0
    perturb: Mapping[str, float] | None = None
    homed: bool = False
    truth: Path | None = None
    wire: Sequence[str] | None = None
    serials: Sequence[str] = ()

    @contextmanager
    def peer(self, period_ns: int) -> Iterator[SimulatedHand]:
        """Build the simulated hand, and close it with its truth file.

        Args:
            period_ns: length of a tick [ns].

        Raises:
            ConfigError: it cannot be built.
        """
        with tempfile.TemporaryDirectory(prefix="handctl-simulated-") as folder:
            peer = load_peer(
                SIMULATED_HAND,
                hand_path=self._hand_file(Path(folder)),
                scene=self._scene_file(Path(folder)),
                seed=self.seed,
                truth_path=str(self.truth) if self.truth else None,
                perturb=None if self.perturb is None else dict(self.perturb),
                period_ns=period_ns,
                homed=self.homed,
                wire=self.wire,
                serials=self.serials,
            )
        try:
            yield cast(SimulatedHand, peer)
        finally:
            peer.close()

    def check(self) -> None:
        """Build the simulated hand only to see whether it can be; see ``peer``."""
        with self.peer(CHECK_NS):
            pass

    @contextmanager
    def clock(self, period_ns: int) -> Iterator[LockstepClock]:
        """Build the simulated hand and the clock that steps it, for one run or several on end; see ``peer``."""
        with self.peer(period_ns) as peer:
            yield LockstepClock(peer, period_ns)

    @contextmanager
    def against(self, controller: Controller) -> Iterator["Simulation"]:
        """Begin a run of a controller; see ``peer``."""
        with self.peer(round(1e9 * controller.model.period)) as peer:
            yield Simulation.of(controller, peer)

    def _hand_file(self, folder: Path) -> str:
        if not isinstance(self.hand, Hand):
            return str(hand_path(self.hand))
        path = folder / f"{re.sub('[^a-z0-9_]', '_', self.hand.name)}.toml"
        path.write_text(self.hand.to_toml(), "utf-8")
        return str(path)

    def _scene_file(self, folder: Path) -> str | None:
        if self.scene is None or "\n" not in self.scene:
            return self.scene
        path = folder / "scene.toml"
        path.write_text(self.scene, "utf-8")
        return str(path)


@dataclass
class Simulation:
    """One run of a controller against a simulated hand, tick by tick.

    Attributes:
        controller, peer: both sides.
        period_ns: control period [ns].
        state: of the controller.
        k: number of the next tick.
        out: of the last tick; None before the first.
        kept: what came in and went out of every tick, if ``keep``.
        keep: whether to keep it.
    """

    controller: Controller
    peer: SimulatedHand
    period_ns: int
    state: State
    k: int = 0
    out: TickOut | None = None
    kept: list[tuple[TickIn, TickOut]] = field(default_factory=list)
    keep: bool = True

    @staticmethod
    def of(controller: Controller, peer: SimulatedHand) -> "Simulation":
        """Begin a run."""
        return Simulation(controller, peer, round(1e9 * controller.model.period), controller.initial())

    def __post_init__(self) -> None:
        self._clock = LockstepClock(self.peer, self.period_ns)
        self._bus = LockstepBus(self._clock)

    def tick(
        self, io: tuple[IoEvent, ...] = (), requests: tuple[str, ...] = (), late_ns: int = 0, skip: int = 0
    ) -> TickOut:
        """Run one tick, and the simulated hand up to the next.

        Args:
            io: events of buses and host.
            requests: of the operator.
            late_ns: lateness of the tick [ns].
            skip: deadlines that are missed before it.
        """
        for _ in range(skip):
            self._step()
        _, out = self._decide(io, requests, late_ns)
        self._step()
        return out

    def ticks(self, limit_s: float = math.inf) -> Iterator[tuple[TickIn, TickOut]]:
        """Run ticks until the controller is done; the simulated hand stands at the time of the tick that is yielded.

        Args:
            limit_s: end of the run if the controller is not done before [s].
        """
        while self.k * self.period_ns < limit_s * 1e9:
            entry, out = self._decide((), (), 0)
            yield entry, out
            if out.mode == Mode.DONE:
                return
            self._step()

    def until(self, reached: Callable[[TickOut], bool], timeout_s: float) -> bool:
        """Run until something is so, at most for some time [s]; whether it came."""
        for _ in range(round(timeout_s * 1e9 / self.period_ns)):
            out = self.tick()
            if reached(out):
                return True
            if out.mode == Mode.DONE:
                return False
        return False

    def _decide(self, io: tuple[IoEvent, ...], requests: tuple[str, ...], late_ns: int) -> tuple[TickIn, TickOut]:
        frames = self._bus.drain()
        wires = tuple(IoEvent(*event) for event in self._bus.take_events())
        entry = TickIn(self.k, self.k * self.period_ns, late_ns, frames, wires + io, requests)
        self.state, self.out = self.controller.tick(self.state, entry)
        if self.keep:
            self.kept.append((entry, self.out))
        self._bus.send(self.out.frames)
        return entry, self.out

    def _step(self) -> None:
        self.k += 1
        self._clock.wait(self.k)


def homed_controller(model: HandModel, program: Program, hand: Hand | None = None) -> Controller:
    """Put the controller of a homed hand together, in which nothing has to be tared.

    Args:
        model: with its gains designed.
        program: to run.
        hand: whose drives and sensors there are, if not the model's.
    """
    there, nothing = hand or model.hand, np.zeros(model.tendon_count)
    return Controller(model, make_drives(there), make_sensors(there), program, nothing, nothing)


def simulate(
    controller: Controller,
    simulator: Simulator,
    see: Callable[[TickIn, TickOut], None] = lambda entry, out: None,
    limit_s: float = math.inf,
) -> State:
    """Run a controller to its end against a simulated hand.

    Args:
        controller: with its program.
        simulator: what is on the other side of the wire.
        see: takes each tick.
        limit_s: end of the run if the controller is not done before [s].

    Returns:
        the controller's last state.
    """
    with simulator.against(controller) as run:
        run.keep = False
        for entry, out in run.ticks(limit_s):
            see(entry, out)
        return run.state
