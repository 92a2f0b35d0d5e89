"""Test ``handctl gains`` with command lines that a user would type."""

import datetime
import json
import subprocess
import sys
import time

import pytest

from handctl.cli.main import main
from handctl.core.calibration import Calibration, TendonCalibration
from handctl.core.gains.gains import Gains, GainsProvenance, gains_text
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.session.calibration import write_calibration
from tests.runtime.processes import make_time_scale_options

PACKAGED_FORCE_N = Gains().motion.force_N
UNCHANGED_GAIN = f"tension.force_N={Gains().tension.force_N}"
"""Argument that sets a gain to its present value. ``handctl gains`` must report that no gain changes."""


@pytest.fixture
def hand_with_two_gain_changes(work_folder):
    """Apply two gain files to the hand, one after the other."""
    for newtons in (25, 30):
        (work_folder / "new.toml").write_text(f"schema = 1\n[motion]\nforce_N = {newtons}.0\n")
        assert main(["gains", "apply", "new.toml", "--note", f"{newtons} N"]) == 0


def write_gains(gain_file, hand_name, hand_identity):
    gain_file.write_text(
        gains_text(Gains(), GainsProvenance(hand=hand_name, identity=hand_identity))
    )


def run_json_command(capsys, *command_words):
    capsys.readouterr()
    assert main([*command_words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_gains_show_tells_the_origin_of_each_value(hand_with_two_gain_changes, capsys):
    shown_output = run_json_command(capsys, "gains", "show", "--gain", "tension.force_N=12")
    rows = shown_output["gains"]
    assert (rows["motion.force_N"]["value"], rows["motion.force_N"]["origin"]) == (
        30.0,
        "jamia.gains.toml",
    )
    assert (rows["tension.force_N"]["value"], rows["tension.force_N"]["origin"]) == (
        12.0,
        "command line",
    )
    assert shown_output["provenance"]["note"] == "30 N"
    hand = run_json_command(capsys, "config", "show")
    assert hand["gains"]["motion"]["force_N"] == 30.0
    assert hand["gains_origins"]["motion.force_N"] == "jamia.gains.toml"


@pytest.mark.parametrize(
    "cli_verb",
    [
        ("run", "--bus", "local:nowhere", "--dry-run", "--gains"),
        ("gains", "show", "--gains"),
        ("gains", "apply"),
        ("tune", "design", "--gains"),
        ("tune", "verify", "--lockstep"),
    ],
)
def test_gains_of_another_hand_are_refused(work_folder, capsys, cli_verb):
    write_gains(work_folder / "new.toml", hand_name="jamia11", hand_identity="1" * 64)
    assert main([*cli_verb, "new.toml"]) == 2
    assert (
        capsys.readouterr().err
        == "handctl: new.toml: is for hand 'jamia11'; expected gains for 'jamia'\n"
    )


def test_gains_of_an_earlier_hand_file_are_used_and_reported(work_folder, capsys):
    write_gains(work_folder / "new.toml", hand_name="jamia", hand_identity="1" * 64)
    assert main(["gains", "show", "--gains", "new.toml", "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["provenance"]["identity"] == "1" * 64
    now = load_hand("jamia").identity[:12]
    assert f"new.toml was made for jamia as 111111111111, which is now {now}" in captured.err


@pytest.mark.parametrize(
    "cli_verb", [("gains", "apply"), ("tune", "verify", "--lockstep", "--dry-run")]
)
def test_gains_of_a_changed_hand_are_reported_by_apply_and_verify(work_folder, capsys, cli_verb):
    write_gains(work_folder / "new.toml", hand_name="jamia", hand_identity="1" * 64)
    assert main([*cli_verb, "new.toml"]) == 0
    assert "new.toml was made for jamia as 111111111111" in capsys.readouterr().err


def test_gains_show_names_the_packaged_gains(capsys):
    assert (
        run_json_command(capsys, "gains", "show")["gains"]["motion.force_N"]["origin"] == "packaged"
    )


def test_rollback_changes_diff_and_log(hand_with_two_gain_changes, capsys):
    assert run_json_command(capsys, "gains", "diff")["changed"] == {
        "motion.force_N": [PACKAGED_FORCE_N, 30.0]
    }
    assert run_json_command(capsys, "gains", "diff", "1", "2")["changed"] == {
        "motion.force_N": [25.0, 30.0]
    }
    assert run_json_command(capsys, "gains", "rollback")["provenance"]["restores"] == 1
    assert run_json_command(capsys, "gains", "diff")["changed"] == {
        "motion.force_N": [PACKAGED_FORCE_N, 25.0]
    }
    history = run_json_command(capsys, "gains", "log")
    assert history["present"] == 3
    assert [entry["note"] for entry in history["entries"]] == ["25 N", "30 N", "rollback to 1"]


@pytest.mark.parametrize(
    ("command_words", "expected_message"),
    [
        (["set", "motion.farce_N=3", "--bus", "local:x"], "motion.force_N?"),
        (["set", "motion.force_N=3000", "--bus", "local:x"], "at most 500"),
        (["set", "filter.offset_m=1e-4", "--bus", "local:x"], "designed before arming"),
        (["set", "motion.force_N", "--bus", "local:x"], "KEY=NUMBER"),
        (["set", "motion.force_N=nan", "--bus", "local:x"], "KEY=NUMBER"),
        (["show", "--gain", "motion.force_N=-1"], "more than 0"),
        (["apply", "nothing.toml"], "cannot be read"),
        (["diff", "7", "8"], "no gains number 7"),
        (["rollback"], "nothing was applied"),
    ],
)
def test_mistakes_give_one_line_and_exit_code_2(command_words, expected_message, capsys):
    assert main(["gains", *command_words]) == 2
    error = capsys.readouterr().err
    assert expected_message in error
    assert error.count("\n") == 1


def test_a_damaged_gains_file_does_not_prevent_a_rollback(
    hand_with_two_gain_changes, work_folder, capsys
):
    (work_folder / "jamia.gains.toml").write_text("schema = [")
    capsys.readouterr()
    assert main(["gains", "log"]) == 0
    assert "rollback brings back number 2" in capsys.readouterr().err
    assert main(["gains", "rollback"]) == 0
    assert "was renamed to jamia.gains.damaged.toml" in capsys.readouterr().err
    assert run_json_command(capsys, "gains", "diff", "2", "present")["changed"] == {}


def test_gains_that_give_no_controller_are_not_applied(work_folder, capsys):
    (work_folder / "tiny.toml").write_text("schema = 1\n[motion]\nforce_N = 1e-9\n")
    for words in (
        ("gains", "apply", "tiny.toml"),
        ("config", "check", "--gains", "tiny.toml"),
        ("tune", "verify", "tiny.toml", "--lockstep", "--dry-run"),
        ("run", "--gains", "tiny.toml", "--bus", "local:nobody", "--dry-run"),
    ):
        assert main(list(words)) == 2
        out, error = capsys.readouterr()
        assert (out, error.count("\n")) == ("", 1)
        assert "no controller follows from these values" in error
    assert not (work_folder / "jamia.gains.toml").exists()


@pytest.mark.realtime
def test_set_on_a_running_hand_is_in_its_log(work_folder, time_scale_of_attempt):
    scale = make_time_scale_options(time_scale_of_attempt)
    handctl = [sys.executable, "-m", "handctl.cli"]
    sim = [
        sys.executable,
        "-m",
        "firmware_sim",
        "--hand",
        "jamia",
        "--bus",
        "local:set",
        "--homed",
        *scale,
    ]
    log, hand_file = work_folder / "run.mcap", load_hand("jamia")
    tendon_calibration = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=3.0, crosstalk_N=0.0)
    date_text = datetime.datetime.now(datetime.UTC).isoformat()
    tendons = dict.fromkeys(hand_file.tendon_names, tendon_calibration)
    known_calibration = Calibration(
        hand="jamia", identity=hand_file.identity, made=date_text, tendon=tendons
    )
    write_calibration(work_folder / "jamia.calibration.toml", known_calibration)
    with subprocess.Popen(sim, stdout=subprocess.PIPE, text=True) as hand:
        try:
            assert "ready" in hand.stdout.readline()
            run = subprocess.Popen(
                [*handctl, "run", "--bus", "local:set", "--log", str(log), "--json", *scale]
            )
            change = [
                *handctl,
                "gains",
                "set",
                "motion.force_N=26",
                UNCHANGED_GAIN,
                "--bus",
                "local:set",
            ]
            end = time.monotonic() + 60.0
            while (
                captured := subprocess.run([*change, "--json"], capture_output=True, text=True)
            ).returncode:
                assert time.monotonic() < end, captured.stderr
            subprocess.run([*handctl, "stop", "--bus", "local:set"], check=True)
            assert run.wait(30.0) == 0
        finally:
            hand.terminate()
    # While a controller starts, it possibly executes a request late, and does not reply to the
    # command that sent the request.
    assert json.loads(captured.stdout)["set"] in ({"motion.force_N": "26.0"}, {})
    with RunLog(log) as record:
        events = [event.event for event in record.events if event.event.name == "gain"]
    assert [(event.where, event.text) for event in events] == [("motion.force_N", "26.0")]
