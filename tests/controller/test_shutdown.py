"""Test that, after an exception in a tick, drives get disable commands until each drive has confirmed the command."""

from pathlib import Path

import pytest

from handctl.campaign.run_stages import homed_run
from handctl.controller.shutdown import shutdown_step
from handctl.core.tick_types import HandMode
from handctl.drives.contract import DrivePhase
from handctl.drives.frame import Frame
from handctl.hand.hand_loading import load_hand
from tests.drives.protocol_bench import OPTIONS_TEXT_BY_PROTOCOL, hand_file

PERIOD_NS = 2_000_000


@pytest.mark.parametrize("with_broken_drive", [False, True])
@pytest.mark.parametrize("protocol", sorted(OPTIONS_TEXT_BY_PROTOCOL))
def test_shutdown_waits_until_each_motor_reports_off(
    protocol: str, with_broken_drive: bool, tmp_path: Path
) -> None:
    hand = load_hand(str(hand_file(tmp_path, [protocol])))
    with homed_run(hand, 500.0, 1) as hand_run:
        assert hand_run.run_until(lambda out: out.mode == HandMode.ACTIVE, 3.0), (
            hand_run.state.failure
        )
        hand_run.simulated_hand.step(
            hand_run.k * PERIOD_NS, list(hand_run.controller.torque_cut_frames())
        )
        state, frames, enabled = shutdown_step(
            hand_run.controller, hand_run.state, hand_run.k * PERIOD_NS, []
        )
        assert enabled == tuple(motor.name for motor in hand.motor), "nothing was heard yet"
        if with_broken_drive:
            hand_run.simulated_hand.inject("off node=index_motor")
        for k in range(hand_run.k + 1, hand_run.k + 251):
            heard_frames = [
                Frame(*answer)
                for answer in hand_run.simulated_hand.step(k * PERIOD_NS, list(frames))
            ]
            state, frames, enabled = shutdown_step(
                hand_run.controller, state, (k + 1) * PERIOD_NS, heard_frames
            )
            if not enabled:
                break
        assert enabled == (("index_motor",) if with_broken_drive else ())
        torques = hand_run.simulated_hand.truth()["torque"]
        assert torques[1:] == [0.0] * 3


@pytest.mark.parametrize("drive_phase", [DrivePhase.SILENT, DrivePhase.CONFIGURING])
@pytest.mark.parametrize("protocol", ["mit", "cia402"])
def test_shutdown_after_arming_waits_for_a_drive_that_is_being_set_up_again(
    protocol: str, drive_phase: DrivePhase, tmp_path: Path
) -> None:
    """After an exception, the shutdown waits until each drive has reported that it is disabled.

    The mode DISARM also waits until each drive has reported that it is disabled.
    """
    hand = load_hand(str(hand_file(tmp_path, [protocol])))
    with homed_run(hand, 500.0, 1) as hand_run:
        assert hand_run.run_until(lambda out: out.mode == HandMode.ARMING, 3.0), (
            hand_run.state.failure
        )
        state = hand_run.state.copy()
        drive = hand_run.controller.drives[0]
        restarted_drive_state = drive.initial_state()._replace(phase=drive_phase)
        hand_run.controller.store_drive_state(state, 0, restarted_drive_state)
        _, _, enabled = shutdown_step(hand_run.controller, state, hand_run.k * PERIOD_NS, [])
        assert drive.name in enabled


@pytest.mark.parametrize("mode", [HandMode.SILENT, HandMode.INVENTORY, HandMode.DONE])
@pytest.mark.parametrize("protocol", sorted(OPTIONS_TEXT_BY_PROTOCOL))
def test_shutdown_does_not_wait_for_drives_that_were_never_set_up(
    protocol: str, mode: HandMode, tmp_path: Path
) -> None:
    hand = load_hand(str(hand_file(tmp_path, [protocol])))
    with homed_run(hand, 500.0, 1) as hand_run:
        state = hand_run.controller.initial_state()
        state.mode = mode
        state, _, enabled = shutdown_step(hand_run.controller, state, PERIOD_NS, [])
        assert enabled == ()
        _, _, enabled = shutdown_step(hand_run.controller, state, 2 * PERIOD_NS, [])
        assert enabled == ()
