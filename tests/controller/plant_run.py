"""Run a program on the simulated hand in this process, without bus, clock or log."""

import math
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from handctl.core.gains.gains import Gains
from handctl.core.model import HandModel
from handctl.core.types import Event, Mode
from handctl.hand.load import load_hand
from handctl.programs.program import Program
from handctl.session.simulate import Simulator, homed_controller

RATE_HZ = 250.0
GONE_M = 0.05


@cache
def model_of(hand: str) -> HandModel:
    """Return the model of a hand, designed once."""
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

    def events_named(self, name: str) -> list[tuple[float, str]]:
        """Return time and instance of each event with a name."""
        return [(t, event.where) for t, event in self.events if event.name == name]


def run_on_plant(
    hand: str, program: Program, scene: str | None, folder: Path, seconds: float, seed: int = 0, **wrong: float
) -> PlantRun:
    """Let a program run on a homed hand.

    Args:
        hand: packaged name. program: what to do. scene: text of a scene file. folder: for that file.
        seconds: of simulated time; less if the object is gone. seed: of the simulator.
        wrong: factors on the plant's parameters that the controller does not know.
    """
    result = PlantRun()
    with Simulator(hand, scene, seed, wrong, homed=True).against(homed_controller(model_of(hand), program)) as run:
        plant, run.record = run.peer.world.plant, False
        for entry, out in run.ticks(seconds):
            t = entry.k / RATE_HZ
            result.t.append(t)
            result.place.append(plant.engine.object_pose()[:3])
            result.force.append(np.linalg.norm(np.reshape(plant.contact_forces(), (-1, 3)), axis=1))
            result.tension.append(out.telemetry.tension)
            result.cell.append(out.telemetry.tension_raw)
            result.real.append(list(plant.tensions()))
            result.events += [(t, event) for event in out.events]
            gone = math.dist(result.place[-1], result.place[0]) > GONE_M
            if run.state.mode == Mode.RELAX or gone:
                break
    return result
