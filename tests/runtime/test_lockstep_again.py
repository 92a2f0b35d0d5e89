"""Test two consecutive runs on one lockstep clock, with drives of each protocol.

At the start of the second run, the drives are in the final state of the first run.
"""

from pathlib import Path

import pytest

from handctl.core.gains.gains import Gains
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from handctl.drives.protocol_registry import PROTOCOL_ENTRIES
from handctl.hand.hand_loading import load_hand
from handctl.programs.task import load_task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings
from handctl.session.run import make_controller, run_lockstep
from handctl.session.run_plan import RunPlan, default_control_rate
from tests.drives.protocol_bench import hand_file
from tests.runtime.processes import MOVE_PHASE, TASK_HEAD

RUN_COUNT = 2


PROTOCOL_CASES = [
    ("cia402", None),  # in this protocol, the drives still get frames after they were disabled
    *(
        pytest.param(name, None, marks=pytest.mark.nightly)
        for name in sorted(PROTOCOL_ENTRIES)
        if name != "cia402"
    ),
    *(pytest.param(name, [], marks=pytest.mark.nightly) for name in VERIFIABLE_PROTOCOLS),
]


@pytest.mark.parametrize(("protocol", "wire_words"), PROTOCOL_CASES)
def test_a_run_after_another_one_finds_drives_that_were_disarmed(
    protocol: str, wire_words: list[str] | None, tmp_path: Path
) -> None:
    path = hand_file(tmp_path, [protocol])
    task = tmp_path / "short.toml"
    task.write_text(TASK_HEAD + MOVE_PHASE.format(name="bend", angle=10.0, duration=0.1))
    hand = load_hand(path)
    rate = default_control_rate(hand)
    plan = RunPlan(hand, Gains(), rate, (0.5,))
    failures = []
    with SimulatorSettings(path, homed=True, wire=wire_words).lockstep_clock(
        plan.period_ns
    ) as clock:
        for number in range(RUN_COUNT):
            controller = make_controller(plan, TaskProgram(load_task(task)), None, True)
            failures.append(
                run_lockstep(plan, controller, tmp_path / f"{number}.mcap", clock).state.failure
            )
    assert failures == [""] * RUN_COUNT
