"""ODrives that send their position by themselves beside the requested one: the position of the request counts."""

import os

import numpy as np
import pytest

from handctl.campaign.stage import hand_with_protocol
from handctl.core import block as s
from handctl.core.gains.gains import Gains
from handctl.core.model import HandModel
from handctl.core.types import Mode
from handctl.programs.grasp import TaskProgram
from handctl.programs.task import Task
from handctl.session.simulate import Simulator, homed_controller

SEEDS = range(20 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 1)
RATE_HZ = 250.0
"""Rate whose ticks fall between the drive's own messages, which come every 10 ms."""
SWING_N = 5.0
"""Largest swing of a tension in motion [N]. The fault N14b is at 8 N."""
BENT = {"index": (20.0, 76.0, 61.0), "middle": (20.0, 76.0, 61.0), "thumb": (40.0, 40.0)}
OPEN = {"index": (0.0, 0.0, 0.0), "middle": (0.0, 0.0, 0.0), "thumb": (0.0, 0.0)}
TASK = Task.model_validate(
    {
        "schema": 1,
        "name": "bend and open",
        "phase": (
            {"kind": "move", "name": "bend", "angle_deg": BENT, "duration_s": 0.8},
            {"kind": "move", "name": "open", "angle_deg": OPEN, "duration_s": 0.8},
        ),
    }
)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_tension_does_not_oscillate_by_late_positions(seed: int) -> None:
    """The tensions of a hand without springs swung by 15 N RMS, which ended the default task with N14b."""
    model = HandModel.of(hand_with_protocol("n_plus_1", "odrive"), Gains(), RATE_HZ)
    with Simulator(model.hand, None, seed, homed=True).against(homed_controller(model, TaskProgram(TASK))) as run:
        run.record = False
        largest = 0.0
        for _, out in run.ticks(4.0):
            largest = max(largest, float(run.state.tendon[s.SWING_SQUARE].max()))
            if out.mode == Mode.RELAX:
                break
        assert not run.state.failure, "the task ends by itself"
        assert np.sqrt(largest) < SWING_N
