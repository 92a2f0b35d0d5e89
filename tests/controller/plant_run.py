"""Run a program on the simulated hand inside the process of the test, without a bus, a clock or a log."""

import math
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, TickEvent
from handctl.hand.hand_loading import load_hand
from handctl.programs.program import Program
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller

CONTROL_RATE_HZ = 250.0
LOST_OBJECT_DISTANCE_M = 0.05


@cache
def model_of(hand_name: str) -> HandModel:
    """Return the controller's model of a packaged hand.

    The gains of each hand model are designed once, and later calls return the same model.
    """
    return HandModel.from_hand(load_hand(hand_name), Gains(), CONTROL_RATE_HZ)


@dataclass
class PlantRun:
    """Record of a run: the values of each tick, and all events.

    The values of a tick are the time [s], the position of the object [m], and the contact force on
    each digit [N]. For each tendon, the record also contains the estimated, the measured and the
    true tension [N].
    """

    time_s: list[float] = field(default_factory=list)
    object_position: list[list[float]] = field(default_factory=list)
    digit_contact_force: list[np.ndarray] = field(default_factory=list)
    estimated_tension: list[np.ndarray] = field(default_factory=list)
    measured_tension: list[np.ndarray] = field(default_factory=list)
    true_tension: list[list[float]] = field(default_factory=list)
    events: list[tuple[float, TickEvent]] = field(default_factory=list)

    def events_named(self, event_name: str) -> list[tuple[float, str]]:
        """Return the time [s] and the affected part of the hand, such as a digit, for each event with a given name."""
        return [(time_s, event.where) for time_s, event in self.events if event.name == event_name]


def run_on_plant(
    hand_name: str,
    program: Program,
    scene: str | None,
    scene_folder: Path,
    duration_s: float,
    seed: int = 0,
    **plant_factors: float,
) -> PlantRun:
    """Run a program on a simulated hand whose motor zeros are known.

    Args:
        hand_name: name of a packaged hand.
        program: the program to run.
        scene: text of a scene file.
        scene_folder: folder into which the function writes the scene file.
        duration_s: simulated time [s]. The run ends earlier if the object is lost.
        seed: seed of the simulator.
        plant_factors: factors that multiply parameters of the simulated hand. The controller does
            not know these factors.
    """
    result = PlantRun()
    with SimulatorSettings(hand_name, scene, seed, plant_factors, homed=True).begin_run(
        homed_controller(model_of(hand_name), program)
    ) as run:
        plant, run.are_ticks_recorded = run.simulated_hand.world.plant, False
        for entry, out in run.run_ticks(duration_s):
            t = entry.k / CONTROL_RATE_HZ
            result.time_s.append(t)
            result.object_position.append(plant.engine.object_pose()[:3])
            result.digit_contact_force.append(
                np.linalg.norm(np.reshape(plant.contact_forces(), (-1, 3)), axis=1)
            )
            result.estimated_tension.append(out.telemetry.tension)
            result.measured_tension.append(out.telemetry.tension_raw)
            result.true_tension.append(list(plant.tensions()))
            result.events += [(t, event) for event in out.events]
            is_object_lost = (
                math.dist(result.object_position[-1], result.object_position[0])
                > LOST_OBJECT_DISTANCE_M
            )
            if run.state.mode == HandMode.RELAX or is_object_lost:
                break
    return result
