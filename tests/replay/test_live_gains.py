"""A log contains the gains that were set during the recorded run, and the identified parameters of the hand.

With the gains and parameters in the log, a re-execution gives the same results to the last bit.
"""

from pathlib import Path

import numpy as np
import pytest
import short_runs

from handctl.core.calibration import Calibration, TendonCalibration
from handctl.core.gains.gains import Gains
from handctl.core.identified_parameters import IdentifiedParameters
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.live_session import JogProgram
from handctl.programs.requests import HoldTensionRequest
from handctl.replay.log_execution import execute_log
from handctl.session.lockstep_simulation import SimulatorSettings, simulate_controller
from handctl.session.run import make_controller, run_lockstep
from handctl.session.run_plan import RunPlan

GAINS_REQUEST = '{"do": "gains", "set": {"motion.force_N": 40.0, "tension.integral_per_s": 6.0}}'


def test_a_run_whose_gains_were_set_repeats(tmp_path: Path) -> None:
    log = tmp_path / "set.mcap"
    requests = {
        300: (GAINS_REQUEST, '{"do": "gains", "set": {"motion.force": 1}}'),
        600: ('{"do": "stop"}',),
    }
    short_runs.record_lockstep_run(
        log, short_runs.short_task(tmp_path), rate_hz=200.0, requests=requests
    )
    with RunLog(log) as record:
        messages = {
            event.event.where: event.event.text
            for event in record.events
            if event.event.name == "gain"
        }
        assert messages == {"motion.force_N": "40.0", "tension.integral_per_s": "6.0"}
        refused_texts = [
            event.event.text for event in record.events if event.event.text.startswith("refused")
        ]
        assert refused_texts == [
            "refused: gains: motion.force: no such gain; expected motion.force_N?"
        ]
        result = execute_log(record)
    assert (result.differing_ticks, result.first_difference) == (0, None)


def identified_calibration(hand: Hand, torque_gain: float) -> Calibration:
    """Return the calibration of a hand whose motor zeros are known.

    The calibration states that the drives make only the fraction ``torque_gain`` of a commanded
    torque.
    """
    calibration = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=3.0, crosstalk_N=0.0)
    identified = IdentifiedParameters(
        names=("torque_gain",), values=(torque_gain,), half_widths=(0.01,), covariance=((1e-4,),)
    )
    return Calibration(
        hand=hand.name,
        identity=hand.identity,
        made="2026-01-01T00:00:00+00:00",
        tendon=dict.fromkeys(hand.tendon_names, calibration),
        identified=dict.fromkeys(hand.tendon_names, identified),
    )


def test_a_run_with_an_identified_hand_repeats_and_its_commands_are_corrected(
    tmp_path: Path,
) -> None:
    """In this test, the drives make 0.8 of each commanded torque.

    The identified parameters contain the torque factor 0.8, so the controller commands 1.25 times
    the torque that the motors must make.
    """
    hand, log = load_hand("jamia"), tmp_path / "identified.mcap"
    plan = RunPlan(hand, Gains(), 500.0, ())
    simulator = SimulatorSettings("jamia", perturb={"torque_constant": 0.8}, homed=True)
    program = JogProgram(HoldTensionRequest(do="hold", tension_N={"index": 8.0}), 0.5)
    with simulator.lockstep_clock(plan.period_ns) as clock:
        run_lockstep(
            plan,
            make_controller(plan, program, identified_calibration(hand, 0.8), True),
            log,
            clock,
        )
    with RunLog(log) as record:
        goal, torque = (
            record.field("motor_torque_goal")[:-1, 0],
            record.field("motor_torque")[1:, 0],
        )
        large_goal_mask = goal > 0.03
        np.testing.assert_allclose(
            np.nanmedian(torque[large_goal_mask] / goal[large_goal_mask]), 1.25, rtol=0.03
        )
        result = execute_log(record)
    assert (result.differing_ticks, result.first_difference) == (0, None)


@pytest.mark.parametrize("torque_gain", [0.72, 1.35])
def test_a_drive_with_identified_torque_error_is_no_fault(torque_gain: float) -> None:
    """A drive with a torque error reports the torque that it would make without the error.

    Earlier defect: the controller compared the reported torque with the torque that the motor must
    make. The reported torque and the torque of the motor differ, so the controller reported the
    fault N14 (a command is not obeyed).
    """
    hand = load_hand("jamia")
    plan = RunPlan(hand, Gains(), 500.0, ())
    program = JogProgram(HoldTensionRequest(do="hold", tension_N={"index": 75.0}), 2.0)
    controller = make_controller(plan, program, identified_calibration(hand, torque_gain), True)
    tension = list[float]()
    simulator = SimulatorSettings("jamia", perturb={"torque_constant": torque_gain}, homed=True)
    state = simulate_controller(
        controller, simulator, lambda entry, out: tension.append(float(out.telemetry.tension[0]))
    )
    assert not state.failure
    assert abs(np.mean(tension[-700:-200]) - 75.0) < 4.0
