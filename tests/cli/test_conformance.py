"""Test ``handctl conformance`` on drives in another process: output, exit codes, and the final state of the drives."""

import json
import threading
import time

import pytest

from handctl.cli.console.bench_drive import parse_options
from handctl.cli.main import main
from handctl.drives.frame import Frame
from handctl.drives.mit.codec import MotorRanges, command_message
from handctl.drives.signals import SignalTable
from handctl.runtime.buses.local_bus import LocalBus
from handctl.runtime.mailbox import Mailbox
from handctl.session.exit_codes import ExitCode
from tests.drives.bench_process import run_simulated_drives
from tests.runtime.processes import run_handctl

CONFORMANCE_OPTIONS = ["conformance", "--bus", "local:c", "--torque-limit-Nm", "0.1"]
ENDPOINT_OPTIONS = [f"--option=endpoint_{key}={number}" for number, key in enumerate(
    ("enable_watchdog", "watchdog_timeout", "torque_max", "torque_min"), 201)]  # fmt: skip


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("protocol", "protocol_options"),
    [
        pytest.param("mit", [], id="mit"),
        pytest.param("odrive", ENDPOINT_OPTIONS, id="odrive", marks=pytest.mark.nightly),
        pytest.param("cia402", [], id="cia402", marks=pytest.mark.nightly),
    ],
)
def test_a_good_drive_in_another_process_passes(protocol, protocol_options):
    with run_simulated_drives("local:c", protocol, "--ids", "33"):
        done = run_handctl(
            *CONFORMANCE_OPTIONS,
            "--protocol",
            protocol,
            "--node",
            "33",
            "--yes",
            "--json",
            *protocol_options,
        )
        result = json.loads(done.stdout)
        assert [check for check in result["checks"] if check["verdict"] == "failed"] == []
        assert (done.returncode, result["confirmed_off"]) == (0, True)
        process_result = run_handctl("scan", "--bus", "local:c", "--json")
        assert process_result.returncode == 0
    (node,) = json.loads(process_result.stdout)["buses"][0]["nodes"]
    if protocol == "mit":
        assert node["settings"]["torque_max_N_m"] == 10.0, "the original torque range is restored"
        assert node["state"] == "disabled"


@pytest.mark.realtime
@pytest.mark.parametrize("protocol", ["odrive", "cia402"])
def test_conformance_leaves_no_error_in_a_drive(protocol):
    """Reproduce a defect: `conformance` left a latched error in a drive, so `commission` refused the hand."""
    protocol_options = ENDPOINT_OPTIONS if protocol == "odrive" else []
    with run_simulated_drives("local:c", protocol, "--ids", "33"):
        done = run_handctl(
            *CONFORMANCE_OPTIONS,
            "--protocol",
            protocol,
            "--node",
            "33",
            "--yes",
            "--json",
            *protocol_options,
        )
        assert done.returncode == 0
        time.sleep(0.5)
        process_result = run_handctl("scan", "--bus", "local:c", "--json")
    (node,) = json.loads(process_result.stdout)["buses"][0]["nodes"]
    assert node["error"] == ""
    assert "fault" not in node["state"]


def test_two_drives_with_one_number_are_refused(capsys):
    with run_simulated_drives("local:c", "mit", "--ids", "2", "--broken", "twin"):
        assert main([*CONFORMANCE_OPTIONS, "--protocol", "mit", "--node", "2", "--yes"]) == 1
    assert "two drives answer as mit 2" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option_words", "parsed_options"),
    [
        (["motor_type=ak80-9"], {"motor_type": "ak80-9"}),
        (
            ["motor_type='ak80-9'", "temperature_offset_C=0"],
            {"motor_type": "ak80-9", "temperature_offset_C": 0},
        ),
        (["firmware=0.5"], {"firmware": "0.5"}),
        (["sync=true", "gear_ratio=6.0"], {"sync": True, "gear_ratio": 6.0}),
    ],
)
def test_a_text_option_needs_no_quotes(option_words, parsed_options):
    assert parse_options(option_words) == parsed_options


def test_an_odrive_of_firmware_05_needs_no_option(capsys):
    """Reproduce a defect: by default, ``conformance`` set the option torque_feedback of an ODrive.

    An ODrive with firmware 0.5 refuses the option ``torque_feedback``.
    """
    words = ["--protocol", "odrive", "--node", "3", "--option", "firmware=0.5", "--dry-run"]
    assert main([*CONFORMANCE_OPTIONS, *words]) == 0


@pytest.mark.realtime
def test_a_broken_drive_fails_and_its_line_says_why():
    with run_simulated_drives("local:c", "mit", "--ids", "2", "--broken", "sign"):
        done = run_handctl(*CONFORMANCE_OPTIONS, "--protocol", "mit", "--node", "2", "--yes")
    assert done.returncode == 1
    lines = done.stdout.splitlines()
    (line,) = (line for line in lines if line.startswith("FAILED"))
    assert "the wrong way" in line
    assert lines[-1].split(", ")[1] == "1 failed"


@pytest.mark.realtime
def test_a_new_robstride_motor_in_mit_mode_needs_no_host_number():
    """Reproduce a defect: ``conformance`` expected that the replies of a RobStride motor have the CAN identifier 0x11.

    In a new RobStride motor, the setting for the identifier of the host is 0, and the motor replies
    with this identifier. The simulated motor had no fault, but failed the first check, so
    ``conformance`` did not check the motion of the motor.
    """
    words = ["--protocol", "robstride_mit", "--node", "1", "--option", "motor_type=rs05", "--yes"]
    with run_simulated_drives("local:c", "robstride_mit", "--ids", "1"):
        done = run_handctl(*CONFORMANCE_OPTIONS, *words, "--json")
    verdicts = {check["name"]: check["verdict"] for check in json.loads(done.stdout)["checks"]}
    assert {name: text for name, text in verdicts.items() if text != "passed"} == dict.fromkeys(
        (
            "identifies itself, takes its settings and reads them back",
            "disables itself when the host falls silent, and stays off",
            "is cut at once, and cleared on command only",
        ),
        "not checked",
    )
    assert done.returncode == ExitCode.NOT_CHECKED


@pytest.mark.realtime
def test_an_odrive_without_endpoint_options_is_not_checked_and_names_them():
    """Reproduce a defect: the check of an ODrive's watchdog failed, although the ODrive has no fault."""
    with run_simulated_drives("local:c", "odrive", "--ids", "3"):
        done = run_handctl(*CONFORMANCE_OPTIONS, "--protocol", "odrive", "--node", "3", "--yes")
    assert done.returncode == ExitCode.NOT_CHECKED
    lines = done.stdout.splitlines()
    unchecked_lines = [line for line in lines if line.startswith("not checked")]
    assert len(unchecked_lines) == 2
    assert all(
        "endpoint_enable_watchdog, endpoint_watchdog_timeout" in line for line in unchecked_lines
    )
    assert lines[-1] == "10 passed, 0 failed, 2 not checked"


@pytest.mark.nightly
@pytest.mark.realtime
def test_a_drive_that_never_answers_is_not_called_off():
    """Reproduce a defect: `conformance` reported that a silent CubeMars motor is off, although the motor may be on."""
    words = ["--protocol", "cubemars", "--node", "1", "--option", "motor_type=ak80-6", "--yes"]
    with run_simulated_drives("local:c", "cubemars", "--ids", "1", "--broken", "mute"):
        done = run_handctl(*CONFORMANCE_OPTIONS, *words, "--json")
    assert done.returncode == ExitCode.REMOVE_POWER
    assert json.loads(done.stdout)["confirmed_off"] is False


@pytest.mark.parametrize(
    ("option_words", "expected_message"),
    [
        (
            ["--protocol", "mit", "--node", "2"],
            "mit 2 on local:c turns, with at most 0.1 N m; expected --yes",
        ),
        (["--protocol", "odrive", "--node", "63", "--yes"], "1 to 62"),
        (
            ["--protocol", "cubemars", "--node", "1", "--yes"],
            "--option motor_type=TYPE: missing; expected one of ak60-6, ak70-10",
        ),
        (["--protocol", "mit", "--node", "200", "--yes"], "1 to 127"),
        (
            ["--protocol", "mit", "--node", "1" * 50, "--yes"],
            f"--node: {'1' * 50}; expected a whole number from 1 to",
        ),
        (["--protocol", "mit", "--node", "2", "--yes", "--torque-limit-Nm", "nan"], "0.001 to 50"),
        (["--protocol", "mit", "--node", "2", "--yes", "--option", "gear=2"], "unknown key"),
        (["--protocol", "mit", "--node", "2", "--yes", "--option", "gear"], "KEY=VALUE"),
    ],
)
def test_unsuitable_drive_options_are_refused_before_a_bus_is_opened(
    capsys, option_words, expected_message
):
    assert main([*CONFORMANCE_OPTIONS, *option_words]) == 2
    error = capsys.readouterr().err
    assert expected_message in error
    assert error.count("\n") == 1


def test_missing_drive_is_reported(capsys):
    with run_simulated_drives("local:c", "odrive", "--ids", "3"):
        assert main([*CONFORMANCE_OPTIONS, "--protocol", "odrive", "--node", "4", "--yes"]) == 1
    assert "no odrive 4; found: odrive 3" in capsys.readouterr().err


def test_drive_of_another_host_is_not_commanded(capsys):
    """The command ``conformance`` detects another host that controls the drive.

    A CubeMars motor replies only to command frames. ``conformance`` must listen to the bus before
    it sends its own first command frame.
    """
    with run_simulated_drives("local:c", "cubemars", "--ids", "33"):
        other_local_bus, over = LocalBus("c", 0, int), threading.Event()
        heard, limp = [], SignalTable(command_message(33, MotorRanges(12.5, 50.0, 18.0))).pack(0.0)

        def command():
            while not over.wait(0.01):
                other_local_bus.send([Frame(33, limp)])
                heard.extend(other_local_bus.drain())

        host = threading.Thread(target=command)
        host.start()
        try:
            code = main(
                [
                    *CONFORMANCE_OPTIONS,
                    "--protocol",
                    "cubemars",
                    "--node",
                    "33",
                    "--yes",
                    "--option",
                    "motor_type='ak80-9'",
                ]
            )
        finally:
            over.set()
            host.join()
            other_local_bus.close()
    assert (code, heard != []) == (1, True)
    assert "another host controls this bus" in capsys.readouterr().err


def test_conformance_refuses_a_bus_with_a_running_controller(capsys):
    box = Mailbox("local:c")
    assert main([*CONFORMANCE_OPTIONS, "--protocol", "mit", "--node", "2", "--yes"]) == 1
    box.close()
    assert "another controller runs here" in capsys.readouterr().err
