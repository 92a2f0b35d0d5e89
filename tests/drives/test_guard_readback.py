"""A drive is not armed if the read-back of a protection is wrong.

The protections of a drive are its watchdog, its heartbeat supervision and its torque limit.
"""

import pytest

from firmware_sim.nodes.cia402.node import Cia402Node
from firmware_sim.nodes.mit.node import MitNode
from firmware_sim.nodes.moteus.node import MoteusNode
from firmware_sim.nodes.odrive.node import OdriveNode
from firmware_sim.nodes.robstride.node import RobstrideNode
from handctl.cli.main import main
from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from tests.drives.protocol_bench import OPTIONS_TEXT_BY_PROTOCOL, hand_file
from tests.drives.virtual_bench import VirtualBench, make_drive_rig

GUARDS_BY_PROTOCOL = {
    "mit": {9: "TIMEOUT", 23: "TMAX", 10: "CTRL_MODE"},
    "odrive": {201: "enable_watchdog", 202: "watchdog_timeout", 203: "torque_max", 204: "torque_min"},
    "cia402": {(0x1016, 1): "0x1016:1", (0x1017, 0): "0x1017:0", (0x6007, 0): "0x6007:0", (0x6072, 0): "0x6072:0"},
    "moteus": {
        0x025: "torque limit", 0x027: "watchdog", "servo.timeout_mode": "servo.timeout_mode",
        "servo.fixed_voltage_mode": "servo.fixed_voltage_mode", "servopos.position_min": "servopos.position_min",
        "servopos.position_max": "servopos.position_max",
    },
    "robstride": {0x7005: "run_mode", 0x700B: "limit_torque", 0x7028: "canTimeout"},
}  # fmt: skip
"""For each drive protocol, the settings that protect the hand, and their names in the message that refuses to arm."""
PROTOCOLS_AND_GUARDS = [
    (protocol, guard, name)
    for protocol, guards in GUARDS_BY_PROTOCOL.items()
    for guard, name in guards.items()
]


def freeze_setting(virtual_bench: VirtualBench, guarded_setting) -> None:
    """Make a simulated drive confirm each write of a setting, but keep the old value."""
    node = virtual_bench.bench.nodes[0]
    if isinstance(node, MitNode):
        write = node.registers.write
        node.registers.write = lambda register, raw: (
            None if register == guarded_setting else write(register, raw)
        )
    elif isinstance(node, OdriveNode):
        node.endpoints = _EndpointsWithFixedValue(node.endpoints, guarded_setting)
    elif isinstance(node, MoteusNode):
        node.channel.items = _EndpointsWithFixedValue(node.channel.items, guarded_setting)
        write_register = node._write_register
        node._write_register = lambda number, kind, raw: (
            0 if number == guarded_setting else write_register(number, kind, raw)
        )
    elif isinstance(node, RobstrideNode):
        write_parameter = node._write_parameter
        node._write_parameter = lambda data, t_ns: (
            None
            if int.from_bytes(data[:2], "little") == guarded_setting
            else write_parameter(data, t_ns)
        )
    else:
        assert isinstance(node, Cia402Node)
        write_object = node.objects.write
        node.objects.write = lambda key, raw: (
            None if key == guarded_setting else write_object(key, raw)
        )


class _EndpointsWithFixedValue(dict):
    def __init__(self, endpoint_values, fixed_endpoint):
        super().__init__(endpoint_values)
        self.key = fixed_endpoint

    def __setitem__(self, key, value):
        if key != self.key:
            super().__setitem__(key, value)


@pytest.mark.parametrize(
    ("protocol", "guarded_setting", "setting_name"),
    PROTOCOLS_AND_GUARDS,
    ids=[f"{case[0]}-{case[2]}" for case in PROTOCOLS_AND_GUARDS],
)
def test_a_guard_that_does_not_read_back_keeps_the_drive_off(
    protocol, guarded_setting, setting_name
):
    virtual_bench = VirtualBench(protocol)
    if guarded_setting == 10:
        virtual_bench.bench.nodes[0].registers.set_measured(10, 2.0)
    if guarded_setting == (0x6007, 0):
        virtual_bench.bench.nodes[0].objects[guarded_setting] = 0
    if guarded_setting == "servo.fixed_voltage_mode":
        virtual_bench.bench.nodes[0].channel.items[guarded_setting] = 1.0
    if guarded_setting == 0x7005:
        virtual_bench.bench.nodes[0].parameters[guarded_setting] = b"\x03\0\0\0"
    rig = make_drive_rig(virtual_bench, protocol, 0.5)
    freeze_setting(virtual_bench, guarded_setting)
    reached_phases = set()

    def record_state(state):
        reached_phases.add(state.phase)
        return False

    rig.run_until(DriveTarget.ENABLE, record_state, 3.0)
    assert DrivePhase.FAULT in reached_phases
    assert DrivePhase.ENABLED not in reached_phases
    assert setting_name in rig.state.error_text
    assert virtual_bench.largest_torque == 0.0


def test_every_guarded_protocol_is_tried():
    assert sorted(GUARDS_BY_PROTOCOL) == sorted(VERIFIABLE_PROTOCOLS)


@pytest.mark.parametrize("protocol", sorted(GUARDS_BY_PROTOCOL))
def test_the_same_drive_is_armed_when_all_read_back(protocol):
    rig = make_drive_rig(VirtualBench(protocol), protocol, 0.5)
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 3.0)


def test_an_unverifiable_guard_is_shown(tmp_path, capsys):
    path = hand_file(tmp_path, ["odrive"])
    assert main(["config", "check", "--hand", str(path)]) == 0
    assert "caution" not in capsys.readouterr().out
    path.write_text(path.read_text().replace(OPTIONS_TEXT_BY_PROTOCOL["odrive"], ""))
    assert main(["config", "check", "--hand", str(path)]) == 0
    out = capsys.readouterr().out
    assert "# caution: index_motor, middle_motor and 2 more: watchdog not verified" in out


def test_drives_with_the_same_caution_share_a_line_and_the_watchdog_is_first(tmp_path, capsys):
    """Reproduce a defect.

    For four CubeMars drives, handctl printed 20 lines: five cautions for each drive. The expected
    output has one line for all drives with the same caution. The expected output omits the hint
    about the temperature offset, which was one of the five cautions.
    """
    path = hand_file(tmp_path, ["odrive", "cubemars"])
    path.write_text(path.read_text().replace(OPTIONS_TEXT_BY_PROTOCOL["odrive"], ""))
    assert main(["config", "check", "--hand", str(path)]) == 0
    out = capsys.readouterr().out
    cautions = [line for line in out.splitlines() if line.startswith("# caution: ")]
    assert len(cautions) == 6
    assert cautions[1] == (
        "# caution: middle_motor, ring_motor, thumb_motor: watchdog: CubeMars' MIT mode has none; "
        "a dead host leaves torque on"
    )
    assert [": watchdog" in line for line in cautions] == [True] * 2 + [False] * 4
    assert "temperature_offset_C" not in out
    assert main(["config", "check", "--hand", str(path), "--verbose"]) == 0
    assert "# hint: middle_motor, ring_motor, thumb_motor: temperature counts from -40" in (
        capsys.readouterr().out
    )
