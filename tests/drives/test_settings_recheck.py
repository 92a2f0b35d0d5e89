"""Test drives that lose their settings while they are enabled.

The controller reads the torque limit and the watchdog of a drive again while the drive is enabled.
"""

import os
from itertools import pairwise

import pytest

from handctl.campaign.fault_matrix import ALL_PROTOCOLS, FREE_MOTION_STAGE
from handctl.campaign.run_stages import advance_to_stage, hand_with_protocol, homed_run
from handctl.core.tick_types import HandMode
from handctl.drives import readback
from handctl.drives.contract import DriveFaultCause, DrivePhase, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.mit import codec
from handctl.drives.mit.drive import MitDrive
from handctl.drives.mit.progress import MitProgress
from handctl.session.run_plan import default_control_rate

TICK_NS = 2_000_000
SIMULATOR_SEEDS = range(20) if os.environ.get("HANDCTL_NIGHTLY") == "1" else (1,)


def enabled_mit_drive(node_id: int) -> tuple[MitDrive, object]:
    """Return an enabled MIT drive and its state."""
    drive = MitDrive(
        "m", 0, node_id, node_id + 0x100, codec.MotorRanges(12.5, 50.0, 0.8), 1, 0.0, 1000
    )
    check = readback.first_recheck(node_id, 0)
    state = drive.initial_state()._replace(
        phase=DrivePhase.ENABLED,
        recheck=check,
        protocol_state=MitProgress(is_configured=True, is_enable_sent=True),
    )
    return drive, state


def run_drive_with_registers(
    drive: MitDrive,
    state,
    tick_count: int,
    register_values: dict[int, float],
    motor_is_heard: bool = True,
):
    """Run a drive whose motor replies to torque commands and register requests.

    Return the final state of the drive, and all register requests. A register request is given by
    its tick and its register.
    """
    requests = []
    feedback = bytes((codec.ENABLED << 4 | drive.node_id & 0xF, 0x80, 0, 0x7F, 0xF7, 0xFF, 25, 25))
    for k in range(tick_count):
        state, frames = drive.advance(state, k * TICK_NS, DriveTarget.ENABLE, 0.1)
        if state.phase != DrivePhase.ENABLED:
            break
        for frame in frames:
            answer = feedback
            if frame.can_id == codec.BROADCAST_ID:
                register = frame.data[3]
                requests.append((k, register))
                answer = frame.data[:4] + codec.register_bytes(register, register_values[register])
                if not motor_is_heard:
                    continue
            state = drive.receive(state, Frame(drive.reply_id, answer, 0, 0, k * TICK_NS + 1000))
    return state, requests


CORRECT_REGISTERS = {codec.TIMEOUT: 1000, codec.TMAX: 0.8}


@pytest.mark.parametrize("node_id", [1, 11, 0x11, 0x1F])
def test_two_registers_are_read_by_turns_and_feedback_goes_on(node_id):
    """A reply that contains a register is not decoded as feedback.

    The first byte alone does not distinguish a reply that contains a register from the feedback of
    an enabled motor.
    """
    drive, state = enabled_mit_drive(node_id)
    state, requests = run_drive_with_registers(drive, state, 2001, CORRECT_REGISTERS)
    assert [register for _, register in requests] == [codec.TIMEOUT, codec.TMAX] * 4
    assert {b - a for (a, _), (b, _) in pairwise(requests)} == {250}
    assert state.phase == DrivePhase.ENABLED
    assert state.feedback_count == 2001
    assert state.misread_frame_count == 0


def test_no_two_of_eleven_motors_ask_in_one_tick():
    ticks = [
        run_drive_with_registers(*enabled_mit_drive(node_id), 260, CORRECT_REGISTERS)[1][0][0]
        for node_id in range(1, 12)
    ]
    assert len(set(ticks)) == 11


@pytest.mark.parametrize("changed_registers", [{codec.TIMEOUT: 0}, {codec.TMAX: 10.0}])
@pytest.mark.parametrize("node_id", [2, 0x12])
def test_a_lost_register_is_a_mismatch_within_a_second(node_id, changed_registers):
    drive, state = enabled_mit_drive(node_id)
    state, requests = run_drive_with_registers(
        drive, state, 600, CORRECT_REGISTERS | changed_registers
    )
    assert state.phase == DrivePhase.FAULT
    assert drive.fault_cause(state.error) == DriveFaultCause.SETTING_MISMATCH
    assert "while enabled" in state.error_text
    assert requests[-1][0] <= 500


def test_requests_without_answer_end_in_a_fault_and_a_few_do_not():
    drive, state = enabled_mit_drive(3)
    few, _ = run_drive_with_registers(
        drive, state, 250 * (readback.RECHECK_TRIES - 1), CORRECT_REGISTERS, motor_is_heard=False
    )
    assert few.phase == DrivePhase.ENABLED
    many, requests = run_drive_with_registers(
        drive, state, 250 * (readback.RECHECK_TRIES + 1), CORRECT_REGISTERS, motor_is_heard=False
    )
    assert many.phase == DrivePhase.FAULT
    assert "not answered while enabled" in many.error_text
    assert len(requests) == readback.RECHECK_TRIES - 1


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
@pytest.mark.parametrize("protocol", sorted(set(ALL_PROTOCOLS) - {"moteus"}))
def test_a_hand_whose_drive_lost_its_settings_is_cut(protocol, seed):
    hand = hand_with_protocol("jamia", protocol)
    with homed_run(hand, default_control_rate(hand), seed) as hand_run:
        advance_to_stage(hand_run, FREE_MOTION_STAGE)
        hand_run.simulated_hand.inject(f"forget node={hand.motor[seed % 4].name}")
        end_s = hand_run.k * hand_run.period_ns * 1e-9 + 1.01
        assert hand_run.run_until(lambda out: out.mode == HandMode.CUT, 1.02)
        assert hand_run.k * hand_run.period_ns * 1e-9 <= end_s
        latched_faults = {(mark.id, mark.part_name) for mark in hand_run.state.latched_faults}
        assert latched_faults == {("N12", hand.motor[seed % 4].name)}


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
def test_a_hand_whose_moteus_lost_its_settings_relaxes(seed):
    """A moteus that has lost its settings can make another torque than commanded.

    If the controller notices the wrong torque before it reads the settings again, the first fault
    is N14 (a command is not obeyed).
    """
    hand = hand_with_protocol("jamia", "moteus")
    with homed_run(hand, default_control_rate(hand), seed) as hand_run:
        advance_to_stage(hand_run, FREE_MOTION_STAGE)
        motor = hand.motor[seed % 4].name
        hand_run.simulated_hand.inject(f"forget node={motor}")
        assert hand_run.run_until(lambda out: out.mode in (HandMode.RELAX, HandMode.CUT), 1.02)
        latched_faults = {(mark.id, mark.part_name) for mark in hand_run.state.latched_faults}
        assert latched_faults <= {("N12", motor), ("N14", motor)}
        assert latched_faults
