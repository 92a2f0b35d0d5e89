"""Test a simulated run in which a fault stops the hand (reaction HOLD).

In lockstep, no operator can clear the fault, so a time limit must end the run.
"""

from pathlib import Path

import pytest

from handctl.core.gains.gains import Gains
from handctl.errors import DriveError
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.task import load_task
from handctl.programs.task_program import TaskProgram
from handctl.runtime.hold_timeout import MAX_HOLD_S
from handctl.session.lockstep_simulation import SimulatorSettings
from handctl.session.run import make_controller, run_lockstep
from handctl.session.run_plan import RunPlan, default_control_rate
from tests.runtime.processes import MOVE_PHASE, TASK_HEAD


@pytest.mark.timeout(120)
def test_a_run_held_by_a_fault_ends_with_its_reason(tmp_path: Path) -> None:
    """While a fault holds the hand, the task of the run makes no progress.

    Earlier defect: a run in which a fault held the hand never ended.
    """
    task = tmp_path / "bend.toml"
    task.write_text(TASK_HEAD + MOVE_PHASE.format(name="bend", angle=10.0, duration=0.5))
    hand = load_hand("jamia")
    plan = RunPlan(hand, Gains(), default_control_rate(hand), (0.5,))
    log = tmp_path / "held.mcap"
    with SimulatorSettings("jamia", homed=True).lockstep_clock(plan.period_ns) as clock:
        clock.simulator.inject("noise encoder=1 size=0.005")  # type: ignore[attr-defined]
        controller = make_controller(plan, TaskProgram(load_task(task)), None, True)
        with pytest.raises(DriveError, match=r"in lockstep.*held for 5 s by N07 a noisy encoder"):
            run_lockstep(plan, controller, log, clock)
    with RunLog(log) as record:
        assert MAX_HOLD_S < record.times[-1] < 3.0 * MAX_HOLD_S
