"""A program against the simulated hand in this process, without bus, clock or log."""

import math
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from firmware_sim.rig import Rig
from handctl.controller.gains import Gains
from handctl.controller.model import HandModel
from handctl.controller.program import Program
from handctl.controller.setup import make_drives, make_sensors
from handctl.controller.tick import Controller
from handctl.controller.types import Event, Mode, TickIn
from handctl.drives.frame import Frame
from handctl.hand.load import hand_path, load_hand

RATE_HZ = 250.0
PERIOD_NS = round(1e9 / RATE_HZ)
GONE_M = 0.05


@cache
def model_of(hand: str) -> HandModel:
    """A hand's model; designed once."""
    return HandModel.of(load_hand(hand), Gains(), RATE_HZ)


@dataclass
class PlantRun:
    """What happened, a row a tick: time [s], object [m], contact force on each digit [N], estimated tension,
    load cells and true tension [N]; and all events."""

    t: list[float] = field(default_factory=list)
    place: list[list[float]] = field(default_factory=list)
    force: list[np.ndarray] = field(default_factory=list)
    tension: list[np.ndarray] = field(default_factory=list)
    cell: list[np.ndarray] = field(default_factory=list)
    real: list[list[float]] = field(default_factory=list)
    events: list[tuple[float, Event]] = field(default_factory=list)

    def told(self, name: str) -> list[tuple[float, str]]:
        """When and where events of a name were told."""
        return [(t, event.where) for t, event in self.events if event.name == name]


def run_on_plant(
    hand: str, program: Program, scene: str | None, folder: Path, seconds: float, seed: int = 0
) -> PlantRun:
    """Let a program run on a homed hand.

    Args:
        hand: packaged name. program: what to do. scene: text of a scene file. folder: for that file.
        seconds: of simulated time; less if the object is gone. seed: of the simulator.
    """
    if scene is not None:
        (folder / "scene.toml").write_text(scene)
        scene = str(folder / "scene.toml")
    model = model_of(hand)
    zeros = np.zeros(model.tendon_count)
    controller = Controller.of(model, make_drives(model.hand), make_sensors(model.hand), program, zeros, zeros)
    rig = Rig(str(hand_path(hand)), scene=scene, seed=seed, period_ns=PERIOD_NS, homed=True)
    plant, state, frames, result = rig.world.plant, controller.initial(), (), PlantRun()
    for k in range(round(seconds * RATE_HZ)):
        state, out = controller.tick(state, TickIn(k, k * PERIOD_NS, frames=frames))
        result.t.append(k / RATE_HZ)
        result.place.append(plant.engine.object_pose()[:3])
        result.force.append(np.linalg.norm(np.reshape(plant.contact_forces(), (-1, 3)), axis=1))
        result.tension.append(out.telemetry.tension)
        result.cell.append(out.telemetry.tension_raw)
        result.real.append(list(plant.tensions()))
        result.events += [(k / RATE_HZ, event) for event in out.events]
        gone = math.dist(result.place[-1], result.place[0]) > GONE_M
        if state.mode in (Mode.RELAX, Mode.DONE) or gone:
            break
        frames = tuple(Frame(*reply) for reply in rig.step(k * PERIOD_NS, out.frames))
    return result
