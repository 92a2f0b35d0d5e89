"""Test ODrives that send positions unasked in addition to the requested ones. Only the requested positions count."""

import os

import numpy as np
import pytest

from handctl.campaign.run_stages import hand_with_protocol
from handctl.core import block as s
from handctl.core.gains.gains import Gains
from handctl.core.model import HandModel
from handctl.core.types import Mode
from handctl.programs.grasp import TaskProgram
from handctl.programs.task import Task
from handctl.session.simulate import SimulatorSettings, homed_controller

SEEDS = range(20 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 1)
RATE_HZ = 250.0
"""Control rate [Hz]. Its ticks fall between the drive's unasked messages, which come every 10 ms."""
SWING_N = 5.0
"""Largest permitted oscillation of a tension in motion [N RMS]. The limit of the fault N14b is 8 N."""
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
    """Regression: the tensions of a hand without springs oscillated by 15 N RMS.

    This ended the default task with N14b.
    """
    model = HandModel.of(hand_with_protocol("n_plus_1", "odrive"), Gains(), RATE_HZ)
    with SimulatorSettings(model.hand, None, seed, homed=True).begin_run(
        homed_controller(model, TaskProgram(TASK))
    ) as run:
        run.record_ticks = False
        largest = 0.0
        for _, out in run.run_ticks(4.0):
            largest = max(largest, float(run.state.tendon[s.SWING_SQUARE].max()))
            if out.mode == Mode.RELAX:
                break
        assert not run.state.failure, "the task ends by itself"
        assert np.sqrt(largest) < SWING_N
