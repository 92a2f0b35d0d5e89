"""Run ODrive's own scripts for CAN with simulated drives.

ODrive has a script that restores a configuration, and a script that calibrates a drive. No Python
package contains ODrive's scripts. The tests use the scripts in the folder that the environment
variable ``HANDCTL_ODRIVE_SCRIPTS`` names. If ``HANDCTL_ODRIVE_SCRIPTS`` is not set, the tests
download a fixed version of the scripts. If the download of the scripts fails, the tests are
skipped. The scripts open a bus of python-can, so they run on a local bus.
"""

import json
import os
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from firmware_sim.nodes.odrive.bench import ENDPOINT_NUMBERS
from tests.drives.bench_process import run_simulated_drives

pytestmark = [pytest.mark.nightly, pytest.mark.realtime]
LOCAL_BUS_NAME = "odrivescripts"
ODRIVE_SCRIPTS_COMMIT = "2ce0576359402806222057ad7573a5e8d1834f67"
ODRIVE_SCRIPTS_URL = f"https://raw.githubusercontent.com/odriverobotics/ODriveResources/{ODRIVE_SCRIPTS_COMMIT}/examples"
SCRIPT_NAMES = ("can_simple_utils.py", "can_restore_config.py", "can_calibrate.py")
DOWNLOAD_TIMEOUT_S = 30.0
SCRIPT_TIMEOUT_S = 60.0
WAIT_TIMEOUT_S = 10.0
ODRIVE_NODE_ID = 1
IDLE_STATE, CLOSED_LOOP_STATE = 1, 8
ENDPOINT_BY_PATH = {
    "axis0.config.enable_watchdog": ("endpoint_enable_watchdog", "bool", "?", True),
    "axis0.config.watchdog_timeout": ("endpoint_watchdog_timeout", "float", "f", 0.25),
    "axis0.config.torque_soft_max": ("endpoint_torque_max", "float", "f", 0.5),
    "axis0.config.torque_soft_min": ("endpoint_torque_min", "float", "f", -0.5),
}
"""For the path of each ODrive setting: its option in the hand file, its type, its format, and the value to write."""


@pytest.fixture(scope="module")
def odrive_script_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder that contains ODrive's scripts."""
    if folder_name := os.environ.get("HANDCTL_ODRIVE_SCRIPTS"):
        return Path(folder_name)
    folder = tmp_path_factory.mktemp("scripts")
    for name in SCRIPT_NAMES:
        try:
            with urllib.request.urlopen(
                f"{ODRIVE_SCRIPTS_URL}/{name}", timeout=DOWNLOAD_TIMEOUT_S
            ) as reply:
                (folder / name).write_bytes(reply.read())
        except urllib.error.URLError as error:
            pytest.skip(f"cannot download {name}: {error.reason}")
    return folder


@pytest.fixture
def run_script(odrive_script_folder: Path, tmp_path: Path) -> Callable[..., Any]:
    """Return a function that runs a script on the local bus.

    The returned function returns the completed process of the script.
    """
    (tmp_path / "flat_endpoints.json").write_text(json.dumps(_endpoints_file("0.6.10")))

    def run(name: str, *words: str) -> Any:
        bus = (
            "--interface",
            "local",
            "--channel",
            LOCAL_BUS_NAME,
            "--node-id",
            str(ODRIVE_NODE_ID),
        )
        return subprocess.run(
            [sys.executable, str(odrive_script_folder / name), *bus, *words],
            capture_output=True,
            text=True,
            check=False,
            timeout=SCRIPT_TIMEOUT_S,
            cwd=tmp_path,
        )

    return run


def _endpoints_file(firmware_version: str) -> dict[str, Any]:
    """Return the contents of flat_endpoints.json for the simulated drives."""
    rows = {
        path: {"id": ENDPOINT_NUMBERS[option], "type": kind}
        for path, (option, kind, _, _) in ENDPOINT_BY_PATH.items()
    }
    return {"fw_version": firmware_version, "hw_version": "4.4.58", "endpoints": rows}


def _await_message(
    bus: can.BusABC, command_number: int, accepts_payload: Callable[[bytes], bool]
) -> bytes:
    """Return the next payload that has a given command number, and for which ``accepts_payload`` returns True."""
    end_s = time.monotonic() + WAIT_TIMEOUT_S
    while time.monotonic() < end_s:
        message = bus.recv(0.1)
        if (
            message
            and message.arbitration_id == ODRIVE_NODE_ID << 5 | command_number
            and accepts_payload(message.data)
        ):
            return bytes(message.data)
    raise AssertionError(f"no message 0x{command_number:02X} with the expected contents")


def _send(bus: can.BusABC, command_number: int, payload: bytes) -> None:
    bus.send(
        can.Message(
            arbitration_id=ODRIVE_NODE_ID << 5 | command_number, data=payload, is_extended_id=False
        )
    )


def _flush(bus: can.BusABC) -> None:
    """Drop all received messages, such as replies to the requests of a script."""
    while bus.recv(0.0):
        pass


def _read_endpoint(bus: can.BusABC, endpoint_number: int, format_code: str) -> Any:
    _flush(bus)
    _send(bus, 0x04, struct.pack("<BHB", 0, endpoint_number, 0))
    reply = _await_message(bus, 0x05, lambda data: data[1:3] == struct.pack("<H", endpoint_number))
    return struct.unpack_from(f"<{format_code}", reply, 4)[0]


def _request_state(bus: can.BusABC, axis_state: int) -> int:
    """Request an axis state of the drive, and return the axis state in a later heartbeat."""
    _send(bus, 0x07, struct.pack("<I", axis_state))
    time.sleep(0.5)
    _flush(bus)
    return _await_message(bus, 0x01, lambda data: True)[4]


@pytest.mark.parametrize("is_saved", [False, True], ids=["in RAM", "saved"])
def test_a_configuration_is_restored_and_survives_a_reboot_if_it_was_saved(
    run_script: Callable[..., Any], tmp_path: Path, is_saved: bool
) -> None:
    values = {path: value for path, (_, _, _, value) in ENDPOINT_BY_PATH.items()}
    (tmp_path / "config.json").write_text(json.dumps(values))
    arguments = ["--endpoints-json", "flat_endpoints.json", "--config", "config.json"]
    with (
        run_simulated_drives(f"local:{LOCAL_BUS_NAME}", "odrive", "--ids", f"0,{ODRIVE_NODE_ID}"),
        can.Bus(interface="local", channel=LOCAL_BUS_NAME) as bus,
    ):
        script_result = run_script(
            "can_restore_config.py", *arguments, *(["--save-config"] if is_saved else [])
        )
        assert script_result.returncode == 0, script_result.stderr
        assert f"writing {len(values)} variables" in script_result.stdout
        _send(bus, 0x16, b"\0")  # a reboot of the drive that saves no settings
        time.sleep(0.2)
        stored_values = {
            path: _read_endpoint(bus, ENDPOINT_NUMBERS[option], code)
            for path, (option, _, code, _) in ENDPOINT_BY_PATH.items()
        }
    assert (stored_values == values) is is_saved, stored_values


def test_the_endpoints_of_another_firmware_are_refused(
    run_script: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "other.json").write_text(json.dumps(_endpoints_file("0.6.9")))
    (tmp_path / "config.json").write_text("{}")
    arguments = ["--endpoints-json", "other.json", "--config", "config.json"]
    with run_simulated_drives(f"local:{LOCAL_BUS_NAME}", "odrive", "--ids", f"0,{ODRIVE_NODE_ID}"):
        script_result = run_script("can_restore_config.py", *arguments)
    assert script_result.returncode == 1
    assert "0.6.9 != 0.6.10" in script_result.stderr


@pytest.mark.parametrize("is_saved", [False, True], ids=["in RAM", "saved"])
def test_a_drive_enters_closed_loop_after_the_calibration(
    run_script: Callable[..., Any], is_saved: bool
) -> None:
    drives = ("odrive", "--ids", f"0,{ODRIVE_NODE_ID}", "--uncalibrated")
    with (
        run_simulated_drives(f"local:{LOCAL_BUS_NAME}", *drives),
        can.Bus(interface="local", channel=LOCAL_BUS_NAME) as bus,
    ):
        assert _request_state(bus, CLOSED_LOOP_STATE) == IDLE_STATE
        script_result = run_script("can_calibrate.py", *(["--save-config"] if is_saved else []))
        assert script_result.returncode == 0, script_result.stderr
        assert "Calibration successful!" in script_result.stdout
        assert _request_state(bus, CLOSED_LOOP_STATE) == CLOSED_LOOP_STATE
        assert _request_state(bus, IDLE_STATE) == IDLE_STATE
        _send(bus, 0x16, b"\0")
        time.sleep(0.2)
        expected = CLOSED_LOOP_STATE if is_saved else IDLE_STATE
        assert _request_state(bus, CLOSED_LOOP_STATE) == expected
