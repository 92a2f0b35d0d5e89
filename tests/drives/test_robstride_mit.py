"""Test RobStride motors in MIT mode with simulated firmware.

The tests cover faults, node numbers, and protections that handctl cannot verify.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_sim.bus.frame import Frame as SimFrame
from firmware_sim.nodes.robstride import node as simulated
from firmware_sim.nodes.robstride.mit_mode import RobstrideMitNode
from handctl.drives.contract import DriveFaultCause, DrivePhase, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.protocol_registry import make_drive
from handctl.drives.robstride.mit_mode import READ_FAULTS, RobstrideMitDrive
from handctl.errors import ConfigError
from tests.drives.protocol_bench import ProtocolBench, hand_file, motor_on_bench, servo_torques
from tests.drives.virtual_bench import VirtualBench, make_drive_rig

TORQUE_STEP_N_M = 11.0 / 4095
MILLISECOND_NS = 1_000_000


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[ProtocolBench]:
    new_bench = ProtocolBench(hand_file(tmp_path, ["robstride_mit"]))
    yield new_bench
    new_bench.simulated_hand.close()


def first_robstride_node(bench: ProtocolBench) -> RobstrideMitNode:
    node = bench.simulated_hand.world.nodes[0][0]
    assert isinstance(node, RobstrideMitNode)
    return node


def robstride_mit_drive(**drive_options: object) -> RobstrideMitDrive:
    drive = make_drive(
        motor_on_bench("robstride_mit", 5, 0.8, {"motor_type": "rs05", **drive_options}), 0
    )
    assert isinstance(drive, RobstrideMitDrive)
    return drive


def test_a_drive_goes_from_silent_to_enabled_to_confirmed_disabled(bench: ProtocolBench) -> None:
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for _ in range(200):
        bench.tick(DriveTarget.ENABLE, 0.05)
    world = bench.simulated_hand.world
    for drive, state in zip(bench.drives, bench.states, strict=True):
        truth = world.plant.motors[drive.name].theta + world.encoder_offset[drive.name]
        assert state.position == pytest.approx(truth, abs=0.01)
        assert state.torque == pytest.approx(0.05, abs=2 * TORQUE_STEP_N_M)
        assert state.temperature == pytest.approx(25.0, abs=0.5)
    assert servo_torques(bench) == pytest.approx([0.05] * 4, abs=TORQUE_STEP_N_M)
    bench.run_until_phase(DriveTarget.DISABLE, DrivePhase.READY, max_ticks=100)
    assert servo_torques(bench) == [0.0] * 4
    assert [state.misread_frame_count for state in bench.states] == [0] * 4
    assert world.malformed_frame_count == 0


@pytest.mark.parametrize(
    ("fault_bits", "error_text", "fault_cause"),
    [
        (simulated.OVER_TEMPERATURE_FAULT, "over-temperature", DriveFaultCause.OVERHEATED),
        (simulated.UNDER_VOLTAGE, "under-voltage", DriveFaultCause.VOLTAGE),
        (simulated.OVERLOAD_FAULT, "overload: the shaft is blocked", DriveFaultCause.OTHER),
        (1 << simulated.FAULT_REPORT_SHIFT + 6, "unknown fault bit 14", DriveFaultCause.UNKNOWN),
    ],
)
def test_faults_are_read_before_torque_and_await_a_clear(
    bench: ProtocolBench, fault_bits: int, error_text: str, fault_cause: DriveFaultCause
) -> None:
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    first_robstride_node(bench).trip(fault_bits)
    for _ in range(20):
        bench.tick(DriveTarget.POLL)
    drive, state = bench.drives[0], bench.states[0]
    assert (state.phase, state.error_text) == (DrivePhase.FAULT, error_text)
    assert drive.fault_cause(state.error) == fault_cause
    for _ in range(20):
        bench.tick(DriveTarget.ENABLE)
    assert bench.states[0].phase == DrivePhase.FAULT
    bench.clear_errors()
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)


def test_only_a_disabled_motor_is_asked_for_its_faults(bench: ProtocolBench) -> None:
    """The frame that requests the faults of a RobStride motor would be a motion command for other MIT motors.

    A RobStride motor gets a fault request from handctl only while the motor is disabled.
    """
    fault_requests = []
    for target, phase in (
        (DriveTarget.ENABLE, DrivePhase.ENABLED),
        (DriveTarget.DISABLE, DrivePhase.READY),
    ):
        for _ in range(100):
            phases_before = [state.phase for state in bench.states]
            bench.tick(target)
            read_requests = [frame for frame in bench.sent_frames if frame.data == READ_FAULTS]
            fault_requests += read_requests
            assert not read_requests or DrivePhase.ENABLED not in phases_before
        assert {state.phase for state in bench.states} == {phase}
    for _ in range(20):
        bench.tick(DriveTarget.POLL)
        fault_requests += [frame for frame in bench.sent_frames if frame.data == READ_FAULTS]
    assert fault_requests


def test_feedback_at_the_freezing_point_is_no_fault() -> None:
    drive = robstride_mit_drive()
    state = drive.initial_state()
    feedback_at_zero_degC = bytes((5, 0x80, 0, 0x80, 0x08, 0, 0, 0))
    for k in range(5):
        state, _ = drive.advance(state, k * MILLISECOND_NS, DriveTarget.POLL, 0.0)
        state = drive.receive(
            state, Frame(0x15, feedback_at_zero_degC, 0, 0, k * MILLISECOND_NS + 1)
        )
    assert (state.phase, state.error, state.temperature) == (DrivePhase.READY, 0, 0.0)


@pytest.mark.parametrize(
    ("drive_options", "expected_message"),
    [
        ({"motor_type": "rs02"}, "motor_type"),
        ({"host_id": 5}, "host_id"),
        ({"host_id": 0x80}, "host_id"),
        ({"host_id": True}, "host_id"),
        ({"watchdog": 1}, "watchdog"),
    ],
)
def test_a_wrong_option_is_refused_by_its_path(
    drive_options: dict[str, object], expected_message: str
) -> None:
    with pytest.raises(ConfigError, match=rf"motor\[m\].options.{expected_message}"):
        robstride_mit_drive(**drive_options)


def test_no_numbers_share_an_identifier() -> None:
    """All new RobStride motors have the host number 0.

    On one bus, all RobStride motors with the host number 0 would reply with the same identifier 0.
    """
    assert robstride_mit_drive(host_id=0).node_ids == {0}
    drive = robstride_mit_drive()
    assert (drive.node_ids, drive.host_ids) == ({0x15}, {0x05, 0x105, 0x205})
    assert len(drive.unverified_protections) == 4


def test_a_watchdog_set_before_in_the_private_protocol_removes_the_torque() -> None:
    virtual_bench = VirtualBench("robstride_mit", motor_type="rs05", host_id=0, can_timeout=2000)
    rig = make_drive_rig(virtual_bench, "robstride_mit", 0.5)
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 3.0)
    rig.run_tick(DriveTarget.ENABLE, 0.1)
    assert virtual_bench.bench.motors[0].servo.torque != 0.0
    virtual_bench.advance_time(0.2)
    assert virtual_bench.bench.motors[0].servo.torque == 0.0


def test_numbers_and_protocol_change_by_special_commands() -> None:
    """To each special command, the simulated motor replies with the identity of the motor.

    The drives of handctl never send a special command that changes node number or protocol.
    """
    virtual_bench = VirtualBench("robstride_mit")
    node = virtual_bench.bench.nodes[0]
    assert isinstance(node, RobstrideMitNode)
    for area, code in ((0x33, 0xFA), (0xFD, 0x44), (0x00, 0xFD)):
        (answer,) = node.receive(SimFrame(node.node_id, b"\xff" * 6 + bytes((area, code))), 0) or []
        assert len(answer.data) == 8
    assert (node.node_id, node.host_id, node.next_protocol) == (0x33, 0x44, 0)
