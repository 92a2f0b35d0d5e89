"""Test that no module is imported during a tick.

The import of a module takes up to 0.3 s. A tick with an import would be so long that the run would
end with the fault H03 (the host stalled).
"""

import subprocess
import sys

import pytest

IMPORT_CHECK_SCRIPT = """
import json, sys
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.hand.hand_loading import load_hand
from handctl.programs.live_session import LiveProgram
from handctl.session.run_plan import RunPlan
from handctl.session.run import make_controller
from handctl.session.lockstep_simulation import SimulatorSettings

hand = load_hand(sys.argv[1])
controller = make_controller(RunPlan(hand, Gains(), 200.0, ()), LiveProgram(), None, True)
digit = hand.digit_names[0]
follow = {"kind": "follow", "name": "f", "time_s": [0.0, 0.1, 0.2], "angle_deg": {digit: [20.0, 21.0, 20.0]}}
requests = [
    {"do": "move", "angle_deg": {digit: 20.0}, "duration_s": 0.2},
    {"do": "hold", "tension_N": {digit: 8.0}},
    {"do": "stream", "stream": "s", "space": "digit", "names": [digit], "rate_Hz": 50, "interpolation": "linear"},
    {"do": "stream_end", "stream": "s"},
    {"do": "grasp", "task": {"schema": 1, "name": "x", "phase": [follow]}},
    {"do": "stop"},
]
with SimulatorSettings(hand.name, homed=True).begin_run(controller) as run:
    run.run_tick()  # the loop warms up with one tick
    before = set(sys.modules)
    assert run.run_until(lambda out: out.phase == "live", 10.0)
    for request in requests:
        run.run_tick(requests=(json.dumps({"client": "one", **request}),))
        for _ in range(60):
            run.run_tick()
print(*sorted(set(sys.modules) - before))
"""

GRASP_SCRIPT = """
import sys
from handctl.campaign.run_stages import homed_run
from handctl.hand.hand_loading import load_hand

with homed_run(load_hand(sys.argv[1]), 200.0, 0) as run:
    run.run_tick()
    before = set(sys.modules)
    assert run.run_until(lambda out: out.phase == "hold", 10.0)
print(*sorted(set(sys.modules) - before))
"""


def run_script(program_text: str, hand_name: str) -> list[str]:
    """Run a program in a separate process, and return the words that the program prints."""
    result = subprocess.run(
        [sys.executable, "-c", program_text, hand_name], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.split()


@pytest.mark.parametrize("hand", ["jamia", "n_plus_1"])
def test_no_tick_imports_a_module(hand: str) -> None:
    """Reproduce a defect: the first tick of a task's phase ``follow`` imported 202 modules of scipy.

    The import of the 202 modules took 0.3 s.
    """
    assert run_script(IMPORT_CHECK_SCRIPT, hand) == []


@pytest.mark.parametrize("hand", ["jamia", "jamia11"])
def test_no_tick_of_a_grasp_imports_a_module(hand: str) -> None:
    """Reproduce a defect: a tick of a closing hand imported daqp.

    The package daqp was imported when the tensions of tendons were allocated within limits for the
    first time.
    """
    assert run_script(GRASP_SCRIPT, hand) == []
