"""The whole stack without a recorder: controller, codec both ways, simulated drives, plant; for ``lockstep.py``."""

import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

from handctl.controller.gains import Gains
from handctl.controller.grasp import TaskProgram
from handctl.controller.setup import make_controller
from handctl.controller.task import load_task
from handctl.controller.types import TickIn
from handctl.hand.load import hand_path, load_hand
from handctl.runtime.lockstep import SIMULATED_HAND, LockstepBus, LockstepClock, load_peer

RATES = {"jamia": 500.0, "jamia11": 200.0}
"""Default rates on one classical bus [Hz]."""
HEAD = 'schema = 1\nname = "benchmark"\ndescription = "for lockstep.py"\n'


@dataclass(frozen=True)
class Free:
    """Fingers that move in the air."""

    scene: ClassVar[str | None] = None
    task: ClassVar[str] = (
        '[[phase]]\nkind = "move"\nname = "out"\nangle_deg = 25.0\nduration_s = 0.5\n'
        '[[phase]]\nkind = "move"\nname = "back"\nangle_deg = 5.0\nduration_s = 0.5\n'
    )
    repeat: ClassVar[int] = 9


@dataclass(frozen=True)
class Grasp:
    """A cylinder on a table, gripped and held."""

    scene: ClassVar[str | None] = "cylinder"
    task: ClassVar[str] = (
        '[[phase]]\nkind = "move"\nname = "preshape"\nduration_s = 0.4\n'
        "angle_deg = { index = 18.0, middle = 18.0, ring = 18.0, thumb = 3.0 }\n"
        '[[phase]]\nkind = "close"\nangle_deg = 85.0\nspeed_deg_s = 120.0\ncontact_tension_N = 14.0\n'
        '[[phase]]\nkind = "hold"\ntension_N = 24.0\nrate_N_per_s = 80.0\nduration_s = 9.0\n'
    )
    repeat: ClassVar[int] = 1


class Stack:
    """A homed hand with its controller, tick by tick.

    Attributes:
        engine: rigid bodies and contact.
        tick: the controller's.
        peer: the other side of the wire.
    """

    def __init__(self, hand: str, rate_hz: float, scene: type[Free | Grasp]) -> None:
        self.period_ns = round(1e9 / rate_hz)
        self.peer = load_peer(
            SIMULATED_HAND,
            hand_path=str(hand_path(hand)),
            scene=scene.scene,
            homed=True,
            period_ns=self.period_ns,
        )
        self.engine = self.peer.world.plant.engine
        with TemporaryDirectory() as folder:
            path = Path(folder) / "task.toml"
            path.write_text(HEAD + scene.task * scene.repeat)
            program = TaskProgram(load_task(path))
        controller = make_controller(load_hand(hand), Gains(), rate_hz, program, None, arm_at_once=True)
        self.tick, self.state = controller.tick, controller.initial()

    def run(self, seconds: float) -> list[float]:
        """So much simulated time [s], from the first tick on; CPU time of each tick [s]."""
        clock = LockstepClock(self.peer, self.period_ns)
        bus, state, tick, period_ns = LockstepBus(clock), self.state, self.tick, self.period_ns
        took, now = [], time.process_time
        for k in range(round(seconds * 1e9) // period_ns):
            before = now()
            late = clock.wait(k)
            state, out = tick(state, TickIn(k, k * period_ns, late, tuple(bus.drain())))
            bus.send(out.frames)
            took.append(now() - before)
        self.state = state
        return took
