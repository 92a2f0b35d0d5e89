"""Test that a calibration is used only for the hand that it belongs to.

The serial numbers of the hand's drives identify the hand.
"""

import datetime
import json
import tomllib

import pytest

from handctl.cli.console.motion_confirmation import announce_motion
from handctl.cli.console.plan import make_plan
from handctl.cli.main import main
from handctl.core.tick_types import HandMode
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.live_session import JogProgram
from handctl.programs.requests import MoveDigitsRequest
from handctl.runtime.clocks.lockstep import SIMULATED_HAND_ENTRY, LockstepClock, load_simulator
from handctl.session.calibration import (
    find_calibration,
    load_calibration,
    previous_identified_parameters,
    run_commissioning,
    write_calibration,
)
from handctl.session.run import make_controller, run_lockstep
from tests.drives.protocol_bench import hand_file

FIRST_SERIALS, SECOND_SERIALS = ("0x4000",), ("0x8000",)
MOVE_GOAL = {"do": "move", "angle_deg": {"index": 5.0}, "duration_s": 0.2}


class CalibratedBench:
    """A simulated hand in virtual time, and the settings (``plan``) of all runs with this hand."""

    def __init__(self, work_folder, hand, serials=()):
        import argparse

        from handctl.cli.console.options import add_run_options

        parser = argparse.ArgumentParser()
        add_run_options(parser, is_bus_required=False)
        self.args = parser.parse_args(["--hand", str(hand), "--json"])
        self.plan, self.work_folder = make_plan(self.args, lockstep=True), work_folder
        self.peer = load_simulator(
            SIMULATED_HAND_ENTRY,
            hand_path=str(hand),
            period_ns=self.plan.period_ns,
            serials=serials,
        )
        self.clock = LockstepClock(self.peer, self.plan.period_ns)

    def runner(self, plan, controller, log):
        return run_lockstep(plan, controller, log, self.clock)

    def commission(self, name):
        calibration, _ = run_commissioning(
            self.plan, self.work_folder / f"{name}.mcap", self.runner
        )
        return calibration

    def jog(self, calibration, name):
        program = JogProgram(MoveDigitsRequest.model_validate(MOVE_GOAL), 0.4)
        controller = make_controller(self.plan, program, calibration, True)
        return self.runner(self.plan, controller, self.work_folder / f"{name}.mcap")


def mode_texts(log):
    with RunLog(log) as run:
        return [event.event.text for event in run.events if event.event.name == "mode"]


@pytest.mark.parametrize("protocols", [[name] for name in VERIFIABLE_PROTOCOLS], ids="+".join)
def test_the_second_hand_of_a_design_is_not_armed_with_the_first_one_s_calibration(
    work_folder, protocols
):
    """Reproduce a defect: a hand was armed with the calibration of another hand of the same design.

    Two hands of one design were used in one folder. handctl applied the load-cell tares and encoder
    zeros of the first hand to the second hand.
    """
    hand = hand_file(work_folder, protocols)
    first_bench, second_bench = (
        CalibratedBench(work_folder, hand, FIRST_SERIALS),
        CalibratedBench(work_folder, hand, SECOND_SERIALS),
    )
    calibration = first_bench.commission("first")
    assert set(calibration.drive) == {motor.name for motor in load_hand(str(hand)).motor}
    assert not any(text.startswith("node") for text in calibration.drive.values())
    path = work_folder / "c.toml"
    write_calibration(path, calibration)
    assert load_calibration(path, first_bench.plan.hand) == calibration, (
        "the calibration is stored without changes"
    )
    calibration = load_calibration(path, first_bench.plan.hand)
    assert first_bench.jog(calibration, "again").state.failure == ""
    outcome = second_bench.jog(calibration, "other")
    assert outcome.state.mode == HandMode.DONE
    assert not outcome.state.unconfirmed_motors
    assert (
        "the calibration is of another hand, give that of this hand or commission it"
        in outcome.state.failure
    )
    for name, text in calibration.drive.items():
        assert f"{name} is drive " in outcome.state.failure
        assert f"but was calibrated with drive {text}" in outcome.state.failure
    assert "\n" not in outcome.state.failure
    assert [text.partition(":")[0] for text in mode_texts(work_folder / "other.mcap")][
        -1
    ] == "READY -> DONE", "the hand was not armed"
    for bench in (first_bench, second_bench):
        bench.peer.close()


def test_replaced_drive_is_named_before_arming(work_folder):
    hand = hand_file(work_folder, ["mit"])
    motor = load_hand(str(hand)).motor[0].name
    bench_before, bench_after = (
        CalibratedBench(work_folder, hand, FIRST_SERIALS),
        CalibratedBench(work_folder, hand, (*FIRST_SERIALS, f"{motor}=0x77")),
    )
    failure = bench_after.jog(bench_before.commission("before"), "after").state.failure
    assert failure.startswith(f"{motor} is drive 0x77, but was calibrated with drive 0x40")
    assert failure.count(" is drive ") == 1
    for bench in (bench_before, bench_after):
        bench.peer.close()


def test_a_log_names_its_drives_and_repeats(work_folder, capsys):
    bench = CalibratedBench(work_folder, "jamia", SECOND_SERIALS)
    calibration = bench.commission("made")
    bench.jog(
        calibration.model_copy(update={"drive": dict.fromkeys(calibration.drive, "0x1")}), "refused"
    )
    bench.peer.close()
    assert mode_texts(work_folder / "refused.mcap")[-1].startswith("READY -> DONE: ")
    assert main(["replay", "execute", "refused.mcap", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["differing"] == 0


def test_a_calibration_of_an_earlier_version_is_accepted_with_a_notice(work_folder, capsys):
    bench = CalibratedBench(work_folder, "jamia")
    calibration = bench.commission("made").model_copy(update={"drive": {}})
    path = work_folder / "old.toml"
    write_calibration(path, calibration)
    assert "drive" not in tomllib.loads(path.read_text())
    old_calibration = load_calibration(path, bench.plan.hand)
    capsys.readouterr()
    bench.args.calibration = path
    announce_motion(bench.args, bench.plan, path, old_calibration)
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert f"caution: {path} does not name its drives" in err
    assert bench.jog(old_calibration, "with_old").state.failure == ""
    bench.peer.close()


@pytest.mark.parametrize(
    ("hours", "reason"), [(-1, ""), (-25, "older than a day"), (1, "from the future")]
)
def test_a_calibration_is_used_for_a_day(work_folder, hours, reason):
    """Reproduce a defect: no command refused a calibration with a date in the future.

    If the clock of a computer is wrong, the date of a calibration can be in the future.
    """
    bench = CalibratedBench(work_folder, "jamia")
    path = work_folder / "c.toml"
    made_at = datetime.datetime.now(datetime.UTC) + datetime.timedelta(hours=hours)
    write_calibration(
        path, bench.commission("made").model_copy(update={"made": made_at.isoformat()})
    )
    bench.peer.close()
    calibration, why = find_calibration(path, bench.plan.hand, is_file_given=True)
    assert (calibration is None) == bool(reason)
    assert reason in why


def test_identified_values_of_other_drives_are_not_used(work_folder, capsys):
    bench = CalibratedBench(work_folder, "jamia")
    calibration, path = bench.commission("made"), work_folder / "c.toml"
    bench.peer.close()
    hand = bench.plan.hand
    write_calibration(path, calibration)
    assert previous_identified_parameters(path, hand, calibration.drive) == {}
    other_serials = dict.fromkeys(calibration.drive, "0x1")
    capsys.readouterr()
    assert previous_identified_parameters(path, hand, other_serials) == {}
    assert capsys.readouterr().err == "", "without identified values there is no notice"


@pytest.mark.parametrize(
    ("word", "expected_message"),
    [
        ("x", "expected a number, or MOTOR=NUMBER"),
        ("nobody=3", "no motor 'nobody'; expected one of index_motor"),
        ("-999", "expected 0 to 0xffffffff"),
        ("0x1ffffffff", "expected 0 to 0xffffffff"),
    ],
)
def test_serial_numbers_that_no_drive_has_are_refused(capfd, word, expected_message):
    assert main(["sim", "--bus", "local:a", f"--serial={word}", "--dry-run"]) == 2
    err = capfd.readouterr().err
    assert expected_message in err
    assert err.count("\n") == 1
