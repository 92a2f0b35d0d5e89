"""Test control rates whose period is no multiple of the simulator's time step.

At any control rate, the simulated readings have no jitter, and the innovations of the filter have
the predicted variance.
"""

from functools import cache

import numpy as np
import pytest

from handctl.controller.run_setup import make_controller
from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import HandMode, TickEvent
from handctl.document import validate_content
from handctl.hand.hand_loading import load_hand
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings
from tests.conftest import NIGHTLY

CONTROL_RATES_HZ = (250.0, 300.0, 333.0, 400.0, 450.0, 500.0, 640.0, 1000.0)
SIMULATOR_SEEDS = range(20 if NIGHTLY else 1)
HANDS_AND_RATES = [(hand, rate) for hand in ("jamia", "jamia11") for rate in CONTROL_RATES_HZ]
SAMPLED_HANDS_AND_RATES = [("jamia", 300.0), ("jamia", 640.0), ("jamia11", 450.0)]
BACK_AND_FORTH_TASK = {
    "schema": 1,
    "name": "to and fro",
    "phase": [
        {"kind": "move", "name": f"to {angle}", "angle_deg": angle, "duration_s": duration_s}
        for angle, duration_s in ((25.0, 0.5), (5.0, 0.25), (30.0, 0.15))
    ],
}


@cache
def make_back_and_forth_controller(hand_name: str, rate_hz: float) -> Controller:
    """Return a controller at ``rate_hz`` that moves every digit of a hand to and fro."""
    program = TaskProgram(validate_content(BACK_AND_FORTH_TASK, Task, "test"))
    return make_controller(load_hand(hand_name), Gains(), rate_hz, program, None, arm_at_once=True)


def mean_nis_and_events(hand_name: str, rate_hz: float, seed: int) -> tuple[float, list[TickEvent]]:
    """Return the mean NIS during a free motion, and all events named ``estimate`` or ``fault``.

    The mean NIS is averaged over all tendons and ticks. NIS is the normalised innovation squared
    per degree of freedom.
    """
    nis: list[np.ndarray] = []
    events: list[TickEvent] = []
    with SimulatorSettings(hand_name, seed=seed, homed=True).begin_run(
        make_back_and_forth_controller(hand_name, rate_hz)
    ) as run:
        for _, out in run.run_ticks(3.0):
            events += [event for event in out.events if event.name in ("estimate", "fault")]
            if out.mode == HandMode.ACTIVE:
                nis.append(out.telemetry.nis)
    assert len(nis) > rate_hz, events
    return float(np.nanmean(nis)) / 2.0, events


@pytest.mark.parametrize(
    ("hand_name", "rate_hz"), HANDS_AND_RATES if NIGHTLY else SAMPLED_HANDS_AND_RATES
)
def test_innovations_have_their_predicted_variance_at_any_rate(
    hand_name: str, rate_hz: float
) -> None:
    """Reproduce a defect: the simulator sampled its sensors up to 0.5 ms early.

    At 300, 450 and 640 Hz, sampling too early made the mean normalised innovation squared 3 to 5
    instead of 1.
    """
    for seed in SIMULATOR_SEEDS:
        nis, events = mean_nis_and_events(hand_name, rate_hz, seed)
        assert 0.7 < nis < 1.3, (seed, nis)
        assert not events, (seed, events)
