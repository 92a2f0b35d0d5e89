"""Test CubeMars motors in MIT mode with simulated firmware.

The tests compare payloads of handctl and of the simulated firmware with payloads of the library
TMotorCANControl.
"""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_sim.nodes.cubemars import FULL_SCALE_BY_MOTOR_TYPE, CubemarsNode, FeedbackError
from firmware_sim.programs.drive import SimulatedDriveBench as DriveBench
from firmware_sim.programs.drive_types import drive_spec
from handctl.drives.contract import DriveFaultCause, DrivePhase, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.mit.cubemars import MOTOR_MODEL_RANGES, CubemarsDrive
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.drives.protocol_registry import make_drive
from handctl.drives.robstride import codec as robstride_codec
from handctl.drives.robstride import mit_mode
from handctl.errors import ConfigError
from handctl.runtime.diagnostics.conformance import CheckVerdict, DeviceUnderTest, run_checks
from tests.drives.protocol_bench import ProtocolBench, hand_file, motor_on_bench, servo_torques
from tests.drives.virtual_bench import VirtualBench, make_drive_rig

TORQUE_STEP_N_M = 36.0 / 4095


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[ProtocolBench]:
    new_bench = ProtocolBench(hand_file(tmp_path, ["cubemars"]))
    yield new_bench
    new_bench.simulated_hand.close()


def first_cubemars_node(bench: ProtocolBench) -> CubemarsNode:
    node = bench.simulated_hand.world.nodes[0][0]
    assert isinstance(node, CubemarsNode)
    return node


def test_a_drive_goes_from_silent_to_enabled_to_confirmed_disabled(bench: ProtocolBench) -> None:
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert servo_torques(bench) == [0.0] * 4
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for _ in range(200):
        bench.tick(DriveTarget.ENABLE, 0.05)
    world = bench.simulated_hand.world
    for drive, state in zip(bench.drives, bench.states, strict=True):
        truth = world.plant.motors[drive.name].theta + world.encoder_offset[drive.name]
        assert state.position == pytest.approx(truth, abs=0.01)
        assert state.torque == pytest.approx(0.05, abs=2 * TORQUE_STEP_N_M)
        assert state.temperature == 25.0
    assert servo_torques(bench) == pytest.approx([0.05] * 4, abs=TORQUE_STEP_N_M)
    bench.run_until_phase(DriveTarget.DISABLE, DrivePhase.READY, max_ticks=100)
    assert servo_torques(bench) == [0.0] * 4
    assert [state.misread_frame_count for state in bench.states] == [0] * 4
    assert world.malformed_frame_count == 0


def test_neither_silence_nor_an_answer_with_torque_in_it_confirms_that_it_is_off(
    bench: ProtocolBench,
) -> None:
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for _ in range(100):
        bench.received_frames = []
        bench.tick(DriveTarget.DISABLE)
    assert {state.phase for state in bench.states} == {DrivePhase.ENABLED}
    drive, state = bench.drives[0], bench.states[0]
    pulling_payload = bytes((0x10, 0x80, 0, 0x7F, 0xF9, 0, 30, 0))
    for tick in range(20):
        state = drive.receive(state, Frame(0x10, pulling_payload, 0, 0, bench.k * 2_000_000 + tick))
        state, frames = drive.advance(state, bench.k * 2_000_000 + tick, DriveTarget.DISABLE, 0.0)
        assert state.phase == DrivePhase.ENABLED
        assert frames == drive.torque_cut_frames()


@pytest.mark.parametrize(
    ("feedback_error", "error_text", "fault_cause"),
    [(FeedbackError.HOT, "over-temperature", DriveFaultCause.OVERHEATED),
     (FeedbackError.UNDER_VOLTAGE, "under-voltage", DriveFaultCause.VOLTAGE),
     (FeedbackError.ENCODER, "encoder error", DriveFaultCause.OTHER)],
)  # fmt: skip
def test_an_error_has_a_text_and_ends_only_by_a_clear(
    bench: ProtocolBench,
    feedback_error: FeedbackError,
    error_text: str,
    fault_cause: DriveFaultCause,
) -> None:
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    first_cubemars_node(bench).trip(feedback_error)
    for _ in range(5):
        bench.tick(DriveTarget.ENABLE, 0.05)
    state = bench.states[0]
    assert (state.phase, state.error_text, bench.drives[0].fault_cause(state.error)) == (
        DrivePhase.FAULT,
        error_text,
        fault_cause,
    )
    bench.clear_errors()
    for _ in range(20):
        bench.tick(DriveTarget.POLL)
    assert bench.states[0].phase == DrivePhase.FAULT, "it still has it"
    first_cubemars_node(bench).trip(FeedbackError.NO_ERROR)
    for _ in range(20):
        bench.tick(DriveTarget.ENABLE)
    assert bench.states[0].phase == DrivePhase.FAULT
    bench.clear_errors()
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)


def test_missing_drive_limits_are_reported(tmp_path: Path) -> None:
    """An AK80-9 motor obeys commands up to 18 N m, even if the torque limit in the hand file is smaller.

    The motor has no setting for a torque limit. Only the host can keep the torque below the torque
    limit in the hand file.
    """
    protections = " ".join(
        ProtocolBench(hand_file(tmp_path, ["cubemars"])).drives[0].unverified_protections
    )
    for guard in (
        "watchdog",
        "no torque limit",
        "2% of full-scale torque",
        "ranges cannot be read back",
    ):
        assert guard in protections


def test_the_help_names_the_motor_types_of_the_drives() -> None:
    """A command must print its help without importing the code of the drives.

    The help text uses a separate list of protocols and motor types, so that handctl need not import
    the code of the drives.
    """
    ranges = {
        "cubemars": MOTOR_MODEL_RANGES,
        "robstride": robstride_codec.MOTOR_MODEL_RANGES,
        "robstride_mit": mit_mode.MOTOR_MODEL_RANGES,
    }
    listed_ranges = {
        name: traits.motor_types for name, traits in PROTOCOL_TRAITS.items() if traits.motor_types
    }
    assert listed_ranges == {name: tuple(models) for name, models in ranges.items()}


def test_the_manual_s_byte_of_temperature_counts_from_minus_forty() -> None:
    """A temperature byte covers -40 to 215 degC. Source: CubeMars AK Series Actuator Driver Manual, 5.3.

    For CubeMars motors that send the temperature without the offset of 40 degC, a hand file sets
    the option ``temperature_offset_C`` to 0.
    """
    for more_options, temperature in (
        ({}, 45.0),
        ({"temperature_offset_C": 0}, 85.0),
        ({"temperature_offset_C": -40.0}, 45.0),
    ):
        drive = make_drive(
            motor_on_bench("cubemars", 1, 18.0, {"motor_type": "ak80-9"} | more_options), 0
        )
        state = drive.receive(
            drive.initial_state(), Frame(1, bytes((1, 0x80, 0, 0x80, 8, 0, 85, 0)))
        )
        assert state.temperature == temperature


@pytest.mark.parametrize("temperature_offset", [True, "cold", 40])
def test_another_offset_of_temperature_is_refused(temperature_offset: object) -> None:
    with pytest.raises(ConfigError, match="temperature_offset_C") as error_info:
        make_drive(
            motor_on_bench(
                "cubemars",
                1,
                18.0,
                {"motor_type": "ak80-9", "temperature_offset_C": temperature_offset},
            ),
            0,
        )
    assert "-40 or 0" in str(error_info.value)


def test_older_firmware_answers_with_six_bytes(bench: ProtocolBench) -> None:
    for node in bench.simulated_hand.world.nodes[0][:4]:
        node.short = True  # type: ignore[attr-defined]
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    assert math.isnan(bench.states[0].temperature)
    bench.run_until_phase(DriveTarget.DISABLE, DrivePhase.READY)


@pytest.mark.parametrize("torque", [math.nan, math.inf, -math.inf, 0.801, -18.0])
def test_invalid_torque_cannot_be_encoded(bench: ProtocolBench, torque: float) -> None:
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    with pytest.raises(ValueError, match="index_motor"):
        bench.drives[0].advance(bench.states[0], bench.k * 2_000_000, DriveTarget.ENABLE, torque)


def test_checks_that_need_a_reported_state_are_not_made() -> None:
    virtual_bench = VirtualBench("cubemars")
    rig = make_drive_rig(virtual_bench, "cubemars", 0.1)
    checks = list(run_checks(DeviceUnderTest(rig, 0.1, 0.05)))
    assert [check for check in checks if check.verdict is CheckVerdict.FAILED] == []
    settings, dead_host, cut = (
        check for check in checks if check.verdict is CheckVerdict.NOT_CHECKED
    )
    assert settings.name == "identifies itself, takes its settings and reads them back"
    assert dead_host.name == "disables itself when the host falls silent, and stays off"
    assert "has no watchdog" in dead_host.reason
    assert cut.name == "is cut at once, and cleared on command only"
    assert "has no report of the drive's state" in cut.reason
    assert rig.confirm_disabled(0.05)
    assert virtual_bench.bench.motors[0].servo.torque == 0.0


def test_a_motor_that_does_not_disable_is_detected() -> None:
    virtual_bench = VirtualBench("cubemars", "deaf")
    rig = make_drive_rig(virtual_bench, "cubemars", 0.5)
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 1.0)
    virtual_bench.bench.motors[0].servo.kd = 1.0
    virtual_bench.bench.motors[0].omega = 8.0
    rig.run_until(DriveTarget.DISABLE, lambda state: False, 0.02)
    assert rig.state.phase == DrivePhase.ENABLED


@pytest.mark.parametrize("motor_model", FULL_SCALE_BY_MOTOR_TYPE)
def test_host_and_simulator_have_the_same_ranges(motor_model: str) -> None:
    assert tuple(MOTOR_MODEL_RANGES[motor_model]) == FULL_SCALE_BY_MOTOR_TYPE[motor_model]
    assert DriveBench([drive_spec("mit", 1, motor_model)]).receive(Frame(1, b"\xff" * 7 + b"\xfc"))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("drive_options", "expected_message"),
    [
        ({}, "ak80-9"),
        ({"motor_type": "ak1"}, "ak80-9"),
        ({"motor_type": "ak80-9", "reply_id": 3}, "unknown key"),
    ],
)
def test_options_that_make_no_motor_are_refused(
    drive_options: dict[str, object], expected_message: str
) -> None:
    with pytest.raises(ConfigError, match=expected_message):
        make_drive(motor_on_bench("cubemars", 1, 0.8, drive_options), 0)
    with pytest.raises(ConfigError, match="at most 18"):
        make_drive(motor_on_bench("cubemars", 1, 20.0, {"motor_type": "ak80-9"}), 0)


def test_tmotorcancontrol_decodes_the_same_values() -> None:
    """TMotorCANControl decodes the right values from commands of handctl and from replies of the simulated motor."""
    mit_can = pytest.importorskip("TMotorCANControl.mit_can")
    manager = object.__new__(mit_can.CAN_Manager)
    mit_can.CAN_Manager.__del__ = lambda self: None
    sent: list[bytes] = []
    manager.send_MIT_message = lambda _, data: sent.append(bytes(data))
    drive = make_drive(motor_on_bench("cubemars", 1, 18.0, {"motor_type": "ak80-9"}), 0)
    assert isinstance(drive, CubemarsDrive)
    for torque in (-18.0, -1.0, 0.3, 18.0):
        manager.MIT_controller(1, "AK80-9", 0.0, 0.0, 0.0, 0.0, torque)
        (command,) = drive.torque_frames(torque)
        own_code, other_code = (int.from_bytes(data, "big") for data in (command.data, sent[-1]))
        assert own_code >> 12 & 0xFFFFFF == other_code >> 12 & 0xFFFFFF == 0, "no gains"
        assert abs((own_code & 0xFFF) - (other_code & 0xFFF)) <= 1
    bench = DriveBench([drive_spec("mit", 1, "ak80-9")])
    bench.motors[0].theta = 1.25
    (answer,) = bench.receive(Frame(1, b"\xff" * 7 + b"\xfc"))  # type: ignore[arg-type]
    decoded_reply = manager.parse_MIT_message(answer.data, "AK80-9")
    assert (decoded_reply.temperature, decoded_reply.error) == (25 + 40, 0), (
        "this client forgets that byte 6 counts from -40 degC"
    )
    assert decoded_reply.position == pytest.approx(1.25, abs=1e-3)
    assert decoded_reply.current == pytest.approx(0.0, abs=2 * TORQUE_STEP_N_M)
