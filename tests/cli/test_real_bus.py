"""Test commands on a bus to which real motors can be connected.

Commands for real motors have no default hand, ask for a confirmation before a motion, and list the
files that they use.
"""

import datetime
import io
import json
import os
import pty
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

import handctl as library
from handctl.cli.console.motion_confirmation import age_text
from handctl.cli.main import main
from handctl.hand.hand_loading import load_hand
from handctl.runtime.buses.bus_opening import real_buses
from handctl.session.calibration import load_calibration, write_calibration
from tests.cli.command_refusals import refusal_line
from tests.runtime.processes import write_homed_calibration

REAL_BUSES = ("socketcan:can0", "pcan:PCAN_USBBUS1", "slcan:/dev/ttyACM0")
MOTION_COMMANDS = {
    "run": ("run",),
    "jog": ("jog", "index", "--angle", "3"),
    "identify": ("identify",),
    "commission": ("commission",),
    "replay": ("replay", "drive", "before.mcap"),
    "tune": ("tune", "verify", "new.toml"),
}
HAND_OPTION = ("--hand", "jamia")
GOLDEN_LOG = Path(__file__).parents[2] / "logs" / "golden" / "jamia-grasp.mcap"


@pytest.fixture(autouse=True)
def input_files(work_folder, monkeypatch):
    """Create the input files that commands read before they open a bus.

    Replace standard input by a stream that is no terminal.
    """
    (work_folder / "new.toml").write_text("schema = 1\n[motion]\nforce_N = 25.0\n")
    monkeypatch.setattr("sys.stdin", io.StringIO())


@pytest.fixture(params=MOTION_COMMANDS)
def command_words(request, work_folder):
    """Return the command-line words of each handctl command that moves a hand, one command per test.

    If the command is ``replay``, create the log that the command replays.
    """
    if request.param == "replay":
        (work_folder / "before.mcap").symlink_to(GOLDEN_LOG)
    return MOTION_COMMANDS[request.param]


def test_only_real_interfaces_count_as_real_buses():
    simulated = [
        "local:a",
        "socketcan:vcan0",
        "socketcan:vxcan1",
        "virtual:x",
        "udp_multicast:ff15::1",
    ]
    assert real_buses([*simulated, *REAL_BUSES]) == list(REAL_BUSES)


def test_no_hand_is_the_default_on_a_real_bus(command_words, capsys):
    for bus in REAL_BUSES:
        for more_options in ((), ("--yes",), ("--dry-run",)):
            err = refusal_line(capsys, *command_words, "--bus", bus, *more_options)
            assert f"--hand: no hand is given, and {bus} may have" in err
    assert main([*command_words, "--bus", "local:nobody", "--dry-run"]) == 0, (
        "a simulated bus has a default hand"
    )


def test_without_a_terminal_a_hand_moves_only_with_yes(command_words, capsys):
    expected_text = (
        "jamia on socketcan:can0 is armed and moves index, middle, ring, thumb; expected --yes"
    )
    assert expected_text in refusal_line(
        capsys, *command_words, *HAND_OPTION, "--bus", "socketcan:can0"
    )
    assert main([*command_words, *HAND_OPTION, "--bus", "socketcan:can0", "--dry-run"]) == 0, (
        "no motion in a dry run"
    )
    capsys.readouterr()
    assert main([*command_words, *HAND_OPTION, "--bus", "socketcan:can0", "--yes"]) == 1, (
        "the only error is the missing bus"
    )
    assert "can0" in capsys.readouterr().err.splitlines()[-1]


def test_the_calibration_of_a_simulated_hand_arms_no_real_hand(work_folder, capsys):
    """Reproduce a defect.

    handctl armed a real hand with the calibration of a simulated hand, if neither hand had serial
    numbers, or if both hands had the same serial numbers.
    """
    hand = load_hand("jamia")
    path = work_folder / "jamia.calibration.toml"
    write_homed_calibration(path, hand)
    real = load_calibration(path, hand)
    assert not real.simulated, "files of earlier versions count as real"
    write_calibration(path, real.model_copy(update={"simulated": True}))
    dry_run = ["run", *HAND_OPTION, "--dry-run", "--json"]
    for bus, is_used in (("local:a", True), *((bus, False) for bus in REAL_BUSES)):
        assert main([*dry_run, "--bus", bus]) == 0
        reason = json.loads(capsys.readouterr().out)["commissioning"]
        assert (reason == "") == is_used, bus
        assert ("of a simulated hand" in reason) != is_used
    run_command = [*dry_run, "--calibration", str(path), "--bus"]
    assert "is of a simulated hand" in refusal_line(capsys, *run_command, "socketcan:can0")
    assert main([*run_command, "local:a"]) == 0


def run_at_terminal(typed_answer: str) -> tuple[int, str]:
    """Run ``handctl run`` in a terminal, and type an answer to the question that the command asks.

    Return the exit code and the text on the terminal.
    """
    controlling_side, terminal_side = pty.openpty()
    command = [
        sys.executable,
        "-m",
        "handctl.cli",
        "run",
        *HAND_OPTION,
        "--bus",
        "socketcan:nosuch",
    ]
    process = subprocess.Popen(
        command,
        stdin=terminal_side,
        stdout=terminal_side,
        stderr=terminal_side,
        start_new_session=True,
    )
    os.close(terminal_side)
    terminal_output, answered, end = "", False, time.monotonic() + 60.0
    while time.monotonic() < end and select.select([controlling_side], [], [], 60.0)[0]:
        try:
            read_text = os.read(controlling_side, 4096).decode()
        except OSError:  # the command has closed the terminal
            break
        terminal_output += read_text
        if "[y/N]" in terminal_output and not answered:
            os.write(controlling_side, f"{typed_answer}\n".encode())
            answered = True
    os.close(controlling_side)
    return process.wait(20.0), terminal_output


@pytest.mark.parametrize(("typed_answer", "code"), [("y", 1), ("", 2)])
def test_a_run_at_a_terminal_asks_once_for_consent(typed_answer, code):
    exit_code, terminal_output = run_at_terminal(typed_answer)
    assert exit_code == code, terminal_output
    assert terminal_output.count("[y/N]") == 1
    assert ("not confirmed" in terminal_output) == (code == 2)


def test_a_program_names_hand_and_consent(work_folder, capfd):
    with pytest.raises(
        library.ConfigError, match="no hand is given, and socketcan:can0 may have real motors"
    ):
        library.connect(bus="socketcan:can0")
    with pytest.raises(library.DriveError, match=r"is armed and moves .*; expected --yes"), library.connect(
        "jamia", "socketcan:can0"
    ):  # fmt: skip
        pass
    with (
        pytest.raises(library.DriveError, match="nosuch"),
        library.connect("jamia", "socketcan:nosuch", "--yes"),
    ):
        pass


def test_files_in_use_are_named_in_the_first_line(work_folder, capsys):
    hand = load_hand("jamia")
    write_homed_calibration(work_folder / "jamia.calibration.toml", hand)
    date_text = (datetime.datetime.now(datetime.UTC) - datetime.timedelta(hours=3)).isoformat()
    head = f'made = "{date_text}"\nhand = "jamia"\nidentity = "{hand.identity}"\n'
    (work_folder / "jamia.gains.toml").write_text(
        f"schema = 1\n[motion]\nforce_N = 25.0\n[provenance]\n{head}"
    )
    for words in (("run",), ("jog", "index", "--angle", "3"), ("run", "--json")):
        assert main([*words, "--bus", "local:nobody"]) == 1
        first_line = capsys.readouterr().err.splitlines()[0]
        assert first_line.startswith(
            f"handctl: found in this folder: gains {work_folder / 'jamia.gains.toml'}, 3 h old; "
        )
        assert f"calibration {work_folder / 'jamia.calibration.toml'}, " in first_line
        assert first_line.endswith(" s old")
    file_options = ("--gains", "jamia.gains.toml", "--calibration", "jamia.calibration.toml")
    assert main(["run", "--bus", "local:nobody", *file_options]) == 1
    assert "found in this folder" not in capsys.readouterr().err, (
        "files given as options are not announced"
    )


@pytest.mark.parametrize(
    ("age_s", "expected_text"),
    [
        (-5.0, "0 s"),
        (59.0, "59 s"),
        (119.0, "119 s"),
        (120.0, "2 min"),
        (7200.0, "2 h"),
        (200_000.0, "2 days"),
    ],
)
def test_an_age_has_one_unit(age_s, expected_text):
    assert age_text(age_s) == expected_text


def test_folder_without_files_prints_nothing(work_folder: Path, capsys):
    assert main(["run", "--bus", "local:nobody"]) == 1
    assert "found in this folder" not in capsys.readouterr().err
