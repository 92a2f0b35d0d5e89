"""Test ODrives that send positions without a request, in addition to the requested positions.

The controller uses only the requested positions.
"""

import os

import numpy as np
import pytest

from handctl.campaign.run_stages import hand_with_protocol
from handctl.core import state_block as s
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller

SIMULATOR_SEEDS = range(20 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 1)
RATE_HZ = 250.0
"""Control rate [Hz].

The drive sends unrequested position messages every 10 ms. At a control rate of 250 Hz, some ticks
fall between two unrequested messages.
"""
MAX_TENSION_SWING_N = 5.0
"""Largest permitted oscillation of a tension in motion [N RMS].

The fault N14b (the tension oscillates) has the limit 8 N.
"""
BENT_ANGLES_DEG = {"index": (20.0, 76.0, 61.0), "middle": (20.0, 76.0, 61.0), "thumb": (40.0, 40.0)}
OPEN_ANGLES_DEG = {"index": (0.0, 0.0, 0.0), "middle": (0.0, 0.0, 0.0), "thumb": (0.0, 0.0)}
BEND_AND_OPEN_TASK = Task.model_validate(
    {
        "schema": 1,
        "name": "bend and open",
        "phase": (
            {"kind": "move", "name": "bend", "angle_deg": BENT_ANGLES_DEG, "duration_s": 0.8},
            {"kind": "move", "name": "open", "angle_deg": OPEN_ANGLES_DEG, "duration_s": 0.8},
        ),
    }
)


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
def test_the_tension_does_not_oscillate_by_late_positions(seed: int) -> None:
    """Reproduce a defect: the tensions of a hand without springs oscillated by 15 N RMS.

    The oscillating tensions ended the default task with the fault N14b (the tension oscillates).
    """
    model = HandModel.from_hand(hand_with_protocol("n_plus_1", "odrive"), Gains(), RATE_HZ)
    with SimulatorSettings(model.hand, None, seed, homed=True).begin_run(
        homed_controller(model, TaskProgram(BEND_AND_OPEN_TASK))
    ) as run:
        run.are_ticks_recorded = False
        largest = 0.0
        for _, out in run.run_ticks(4.0):
            largest = max(largest, float(run.state.tendon[s.MEAN_SQUARE_TENSION_SWING].max()))
            if out.mode == HandMode.RELAX:
                break
        assert not run.state.failure, "the task ends by itself"
        assert np.sqrt(largest) < MAX_TENSION_SWING_N
