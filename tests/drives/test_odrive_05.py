"""Test ODrives with firmware 0.5.x.

ODrives with firmware 0.5.x are set up, enabled and disabled in the same way as ODrives with later
firmware. The heartbeat message of firmware 0.5.x has another layout than that of later firmware. In
an ODrive with firmware 0.5.x, handctl cannot verify protections such as the watchdog.
"""

import struct
from pathlib import Path

import cantools.database
import odrive_can
import pytest

from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.frame import REMOTE_FLAG, Frame
from handctl.drives.odrive import firmware_05 as odrive_05
from handctl.drives.protocol_registry import make_drive
from handctl.errors import ConfigError
from handctl.runtime.diagnostics.bus_scan import scan_bus
from handctl.runtime.diagnostics.conformance import CheckVerdict, DeviceUnderTest, run_checks
from tests.drives.protocol_bench import motor_on_bench
from tests.drives.virtual_bench import DRIVE_NODE_ID, VirtualBench, make_drive_rig

OLD_FIRMWARE_OPTIONS = {"firmware": "0.5"}


def test_odrive_05_with_watchdog_passes_all_checks_except_the_readback():
    virtual_bench = VirtualBench("odrive", usb_watchdog_s=0.05, **OLD_FIRMWARE_OPTIONS)
    rig = make_drive_rig(virtual_bench, "odrive", 0.1, OLD_FIRMWARE_OPTIONS)
    results = list(run_checks(DeviceUnderTest(rig, 0.1, 0.05)))
    (unpassed_check,) = (check for check in results if check.verdict is not CheckVerdict.PASSED)
    assert unpassed_check.verdict is CheckVerdict.NOT_CHECKED
    assert unpassed_check.name == "identifies itself, takes its settings and reads them back"
    assert len(rig.drive.unverified_protections) == 2
    assert 0.0 < virtual_bench.largest_torque <= 0.1001


def test_odrive_05_without_watchdog_fails_the_watchdog_check():
    rig = make_drive_rig(
        VirtualBench("odrive", **OLD_FIRMWARE_OPTIONS), "odrive", 0.1, OLD_FIRMWARE_OPTIONS
    )
    failed_checks = [
        check.name
        for check in run_checks(DeviceUnderTest(rig, 0.1, 0.05))
        if check.verdict is CheckVerdict.FAILED
    ]
    assert failed_checks == ["disables itself when the host falls silent, and stays off"]


@pytest.mark.parametrize(
    ("error_code", "error_text"), [(1 << 25, "emergency stop"), (1 << 13, "motor failed")]
)
def test_errors_have_texts(error_code, error_text):
    virtual_bench = VirtualBench("odrive", **OLD_FIRMWARE_OPTIONS)
    rig = make_drive_rig(virtual_bench, "odrive", 0.1, OLD_FIRMWARE_OPTIONS)
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 3.0)
    virtual_bench.bench.nodes[0].disarm(error_code)
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.FAULT, 1.0)
    assert error_text in rig.state.error_text


def test_odrive_05_is_not_asked_for_missing_messages():
    virtual_bench = VirtualBench("odrive", **OLD_FIRMWARE_OPTIONS)
    rig = make_drive_rig(virtual_bench, "odrive", 0.1, OLD_FIRMWARE_OPTIONS)
    sent = []
    send = virtual_bench.send
    virtual_bench.send = lambda frames: (sent.extend(frames), send(frames))[1]
    rig.run_until(DriveTarget.ENABLE, lambda state: False, 1.0)
    requests = {frame.can_id & 0x1F for frame in sent if frame.can_id & REMOTE_FLAG}
    assert requests == {0x09}
    assert rig.state.phase == DrivePhase.ENABLED


def test_a_scan_names_odrive_05():
    virtual_bench = VirtualBench("odrive", **OLD_FIRMWARE_OPTIONS)

    def advance_and_receive(bus, duration_s, seen_frames):
        bus.bench.advance(bus.bench.t_ns + round(duration_s * 1e9))
        seen_frames += bus.drain()

    (found_node,) = scan_bus(virtual_bench, listen_function=advance_and_receive).found_nodes
    assert (found_node.protocol, found_node.node_id, found_node.options) == (
        "odrive",
        DRIVE_NODE_ID,
        OLD_FIRMWARE_OPTIONS,
    )
    assert "0.5" in found_node.notes[0]


@pytest.mark.parametrize(
    ("drive_options", "expected_message"),
    [
        ({"firmware": "0.4"}, "'0.6' or '0.5'"),
        ({"firmware": 0.5}, "'0.6' or '0.5'"),
        ({"torque_feedback": True, **OLD_FIRMWARE_OPTIONS}, "does not report torque"),
        ({"endpoint_torque_max": 3, **OLD_FIRMWARE_OPTIONS}, "no SDO"),
    ],
)
def test_options_missing_in_odrive_05_are_refused(drive_options, expected_message):
    with pytest.raises(ConfigError, match=expected_message):
        make_drive(motor_on_bench("odrive", DRIVE_NODE_ID, 0.1, drive_options), 0)


def test_the_heartbeat_of_odrive_05_has_the_vendors_layout():
    folder = Path(odrive_can.__file__).parent
    dbc = cantools.database.load_file(next(folder.rglob("odrive-cansimple-0.5*.dbc")))
    message = dbc.get_message_by_name("Axis1_Heartbeat")
    choices = message.get_signal_by_name("Axis_Error").choices
    for bit in odrive_05.ERROR_TEXTS:
        assert 1 << bit in choices, bit
    flags = {"Motor_Error_Flag": 64, "Encoder_Error_Flag": 256, "Controller_Error_Flag": 512}
    values = {signal.name: 0 for signal in message.signals} | {"Axis_State": 8}
    for name, error in flags.items():
        data = message.encode(values | {name: 1})
        assert odrive_05.decode_heartbeat(data) == (error, 8, 0)
    virtual_bench = VirtualBench("odrive", **OLD_FIRMWARE_OPTIONS)
    virtual_bench.bench.nodes[0].disarm(1 << 24)
    virtual_bench.bench.advance(200_000_000)
    heartbeat = next(frame for frame in virtual_bench.drain() if frame.can_id & 0x1F == 1)
    assert (
        message.decode(heartbeat.data, decode_choices=True)["Axis_Error"]
        == "WATCHDOG_TIMER_EXPIRED"
    )


def test_a_heartbeat_of_the_new_kind_is_not_taken_for_an_old_one_with_flags():
    drive = make_drive(motor_on_bench("odrive", DRIVE_NODE_ID, 0.1, {}), 0)
    heartbeat = Frame(DRIVE_NODE_ID << 5 | 1, struct.pack("<IBBBB", 0, 1, 3, 0, 0), 0, 0, 10)
    assert drive.receive(drive.initial_state(), heartbeat).phase != DrivePhase.FAULT
