"""Test the re-execution of the ticks in a log.

The re-execution of an unchanged log gives results that are equal to the last bit. If an output of
the re-execution differs from the log, the test checks that the command finds the first tick with a
difference.
"""

import math
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.controller.run_setup import RunSetup, make_controller
from handctl.core.calibration import Calibration, TendonCalibration
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import TickIn, TickOut
from handctl.errors import IncomparableError, LogError
from handctl.hand.hand_loading import load_hand
from handctl.log.code_identity import code_identity
from handctl.log.read.reader import RunLog
from handctl.programs.commission import CommissionProgram
from handctl.programs.live_session import JogProgram, LiveProgram
from handctl.programs.program import Program
from handctl.programs.requests import HoldTensionRequest, MoveDigitsRequest
from handctl.replay import controller_rebuild as rebuilding
from handctl.replay.commands_with_other_gains import (
    CommandCollector,
    command_differences,
    draw_commands,
)
from handctl.replay.controller_rebuild import logged_gains, rebuild_controller
from handctl.replay.log_execution import execute_log, is_within_tolerance, relative_error
from handctl.replay.tick_difference import (
    TelemetryColumns,
    are_outputs_equal,
    differing_fields,
    distance_in_ulps,
)

GOLDEN_LOG_NAMES = ("jamia-grasp", "jamia-lost", "jamia-fault", "jamia11-grasp")


def test_a_fresh_run_with_faults_and_requests_repeats_to_the_last_bit(
    recorded_grasp_log: Path,
) -> None:
    with RunLog(recorded_grasp_log) as log:
        texts = " ".join(event.event.text for event in log.events)
        assert "asked: stop" in texts
        assert "B17 some nodes do not hear" in texts
        result = execute_log(log)
        assert result.ticks == len(log) > 300
    assert (
        result.differing_ticks,
        result.different_decisions,
        result.first_difference,
        result.largest_difference,
    ) == (
        0,
        0,
        None,
        None,
    )
    assert is_within_tolerance(result, 0.0)
    assert result.real_time_factor > 0


@pytest.mark.parametrize("log_name", GOLDEN_LOG_NAMES)
def test_golden_logs_decide_the_same_within_1e_9(golden_folder: Path, log_name: str) -> None:
    """Compare golden logs and their re-execution with a relative tolerance of 1e-9.

    The last bits of a result can differ between the present processor and the processor that
    recorded the golden logs.
    """
    with RunLog(golden_folder / f"{log_name}.mcap") as log:
        assert not log.warning
        result = execute_log(log)
        assert result.ticks == len(log) > 300
    assert result.different_decisions == 0, result.first_difference
    assert is_within_tolerance(result, 1e-9), result.largest_difference


def test_one_bit_of_a_gain_is_found_at_the_first_tick_with_an_effect(
    recorded_grasp_log: Path,
) -> None:
    """The test changes the integral gain of the tension loop.

    The integral gain has an effect from the first tick in which the tendons are tightened.
    """
    with RunLog(recorded_grasp_log) as log:
        gains = logged_gains(log)
        changed_gain = math.nextafter(gains.tension.integral_per_s, math.inf)
        other_gains = gains.model_copy(
            update={"tension": gains.tension.model_copy(update={"integral_per_s": changed_gain})}
        )
        result = execute_log(log, other_gains)
        starts = {change.name: change.k for change in log.phases}
    assert result.first_difference is not None
    assert starts["tighten"] <= result.first_difference.k < starts["preshape"]
    assert result.largest_difference is not None
    assert 0 < relative_error(result.largest_difference) < 1e-9


def test_a_changed_byte_of_the_log_is_named(recorded_grasp_log: Path) -> None:
    with RunLog(recorded_grasp_log) as log:
        controller, columns = rebuild_controller(log), TelemetryColumns.from_header(log.header)
        logged, numbers = next(zip(log.ticks(), log.packed_telemetry(), strict=True))
        _, out = controller.tick(controller.initial_state(), logged.tick_in)
        assert are_outputs_equal(logged, numbers, out)
        assert list(differing_fields(columns, logged, numbers, out)) == []
        changed_numbers = np.frombuffer(numbers, "<f8").copy()
        field_index = columns.field_names.index("tension")
        changed_numbers[field_index] = np.nextafter(changed_numbers[field_index], np.inf)
        (difference,) = differing_fields(columns, logged, changed_numbers.tobytes(), out)
        assert (difference.k, difference.field, difference.name, difference.ulps) == (
            0,
            "tension",
            log.header.tendons[0],
            1,
        )
        (difference,) = differing_fields(columns, logged._replace(phase="else"), numbers, out)
        assert (difference.field, difference.logged, difference.computed) == (
            "phase",
            "else",
            out.phase,
        )
        tick_with_other_hash = logged._replace(state_hash=bytes(8))
        assert [
            differing_field.field
            for differing_field in differing_fields(columns, tick_with_other_hash, numbers, out)
        ] == ["state_hash"]


@given(st.floats(allow_nan=False, max_value=1e308, min_value=-1e308))
def test_ulps_count_the_floats_between_two_values(value: float) -> None:
    above = math.nextafter(value, math.inf)
    assert distance_in_ulps(value, value) == 0
    assert distance_in_ulps(value, above) == distance_in_ulps(above, value) == 1
    assert distance_in_ulps(value, math.nextafter(above, math.inf)) == 2


def test_both_zeros_have_distance_0_in_ulps() -> None:
    assert distance_in_ulps(0.0, -0.0) == 0
    assert distance_in_ulps(5e-324, -5e-324) == 2


def make_calibration(hand_name: str) -> Calibration:
    hand = load_hand(hand_name)
    rows = {
        name: TendonCalibration(tare_N=0.1 * i, zero_rad=-0.3 * i, answer_N=3.0, crosstalk_N=0.0)
        for i, name in enumerate(hand.tendon_names)
    }
    return Calibration(
        hand=hand.name, identity=hand.identity, made="2026-01-01T00:00:00Z", tendon=rows
    )


@pytest.mark.parametrize(
    "program",
    [
        LiveProgram(),
        CommissionProgram(),
        JogProgram(MoveDigitsRequest(do="move", angle_deg={"index": 0.1}, duration_s=1 / 3), 0.7),
        JogProgram(HoldTensionRequest(do="hold", tension_N={"thumb": 7.7}), 1.1),
    ],
    ids=["live", "commission", "jog angle", "jog tension"],
)
def test_every_program_is_rebuilt_from_its_setup(program: Program) -> None:
    hand, gains, rate = load_hand("jamia"), Gains(), 333.3
    first_controller = make_controller(
        hand, gains, rate, program, make_calibration("jamia"), arm_at_once=False
    )
    text = RunSetup.from_controller(first_controller, rate).model_dump_json(by_alias=True)
    rebuilt_controller = RunSetup.model_validate_json(text).controller(hand, gains)
    assert rebuilt_controller.program == program
    assert rebuilt_controller.arm_at_once is False
    assert rebuilt_controller.model.period == first_controller.model.period
    assert rebuilt_controller.tare_tensions.tobytes() == first_controller.tare_tensions.tobytes()
    assert rebuilt_controller.motor_zeros.tobytes() == first_controller.motor_zeros.tobytes()
    assert rebuilt_controller.initial_state().digest() == first_controller.initial_state().digest()


def test_a_log_without_a_setup_is_refused_in_one_line(recorded_grasp_log: Path) -> None:
    with RunLog(recorded_grasp_log) as log:
        attachments = {
            name: data for name, data in log.header.attachments.items() if name != "setup.json"
        }
        log.header = replace(log.header, attachments=attachments)
        with pytest.raises(LogError, match=r"no setup\.json"):
            execute_log(log)
        log.header = replace(
            log.header, attachments=attachments | {"setup.json": b'{"rate_hz": "\x1b[31m"}'}
        )
        with pytest.raises(LogError, match=r"setup\.json cannot be read") as caught:
            rebuilding.rebuild_controller(log)
    assert "\x1b" not in str(caught.value)


@pytest.mark.parametrize(
    ("recorded_gains", "expected_message"),
    [
        (
            '{"motion": {"softness_m": 1.0}}',
            r"gains\.json cannot be read: motion softness_m: Extra inputs",
        ),
        (
            '{"schema": 2}',
            r"gains\.json cannot be read: schema: Input should be less than or equal to 1",
        ),
    ],
    ids=["a gain that is gone", "a later schema"],
)
def test_gains_of_another_version_are_refused_in_one_line_with_both(
    recorded_grasp_log: Path, recorded_gains: str, expected_message: str
) -> None:
    with RunLog(recorded_grasp_log) as log:
        metadata = log.header.metadata
        assert metadata["code"] == code_identity()
        log.header = replace(
            log.header,
            attachments=log.header.attachments | {"gains.json": recorded_gains.encode()},
            metadata=metadata | {"version": "0.0.9", "code": "0123456789ab"},
        )
        with pytest.raises(IncomparableError, match=expected_message) as caught:
            execute_log(log)
    assert "written by handctl 0.0.9, code 0123456789ab" in str(caught.value)
    assert f"handctl {version('handctl')}, code {code_identity()}" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_other_gains_give_other_commands_and_a_figure(
    recorded_grasp_log: Path, tmp_path: Path
) -> None:
    with RunLog(recorded_grasp_log) as log:
        gains = logged_gains(log)
        stiff_gains = gains.model_copy(
            update={"motion": gains.motion.model_copy(update={"position_error_m": 3e-4})}
        )
        commands = CommandCollector()
        execute_log(log, stiff_gains, commands.add_tick)
        ticks = commands.comparable_ticks(log)
        differences = command_differences(log, commands, ticks)
        assert commands.motor_torques.shape == log.field("motor_torque_goal").shape
        draw_commands(tmp_path / "change.png", log, commands, ticks, "a run with other gains")
    assert all(size["peak"] > 0.01 for size in differences["motor_torque_N_m"].values())
    assert (tmp_path / "change.png").read_bytes().startswith(b"\x89PNG")


def test_the_observer_gets_every_tick(recorded_grasp_log: Path) -> None:
    ticks: list[tuple[int, bytes]] = []

    def record_state_hash(tick_input: TickIn, tick_output: TickOut) -> None:
        ticks.append((tick_input.k, tick_output.state_hash))

    with RunLog(recorded_grasp_log) as log:
        execute_log(log, observer=record_state_hash)
        assert ticks == [(tick.tick_in.k, tick.state_hash) for tick in log.ticks()]


def test_replay_execute_imports_no_bus(recorded_grasp_log: Path) -> None:
    code = (
        "import sys; from handctl.cli.main import main; code = main(sys.argv[1:]);"
        "bad = [n for n in sys.modules if n == 'can' or n.startswith(('can.', 'firmware_sim'))"
        " or n.split('.')[:2] == ['handctl', 'runtime']];"
        "print(bad, file=sys.stderr); sys.exit(code or 9 * bool(bad))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "replay", "execute", str(recorded_grasp_log)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "0 differ" in done.stdout
