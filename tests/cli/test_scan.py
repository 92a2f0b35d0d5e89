"""Test ``handctl scan``.

A scan of a bus finds the nodes of the bus and moves no motor. A scan sends no frame that a drive of
another drive protocol would execute as a command.
"""

import json
import tomllib
from dataclasses import replace

import pytest

from firmware_sim.bus.frame import Frame as SimFrame
from firmware_sim.nodes.moteus import registers
from firmware_sim.programs.drive import SimulatedDriveBench
from firmware_sim.programs.drive_types import drive_spec
from handctl.cli.checks.hand_file_snippet import hand_file_snippet
from handctl.cli.checks.scan import _print_scans
from handctl.cli.main import main
from handctl.drives.discovery import DUPLICATE_NODE_WARNING
from handctl.drives.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from handctl.drives.protocol_registry import make_drive
from handctl.hand.file.section_models import Bus, Motor
from handctl.runtime.diagnostics.bus_scan import BusScan, requests_without_answers, scan_bus
from tests.drives.bench_process import run_simulated_drives
from tests.drives.protocol_bench import ProtocolBench as HandBench
from tests.drives.protocol_bench import hand_file


class BenchBus:
    """A bus with simulated drives and a second host, which sends the frames ``foreign_frames``."""

    name = "bench"

    def __init__(self, drive_bench, foreign_frames=()):
        self.bench, self.foreign_frames = drive_bench, list(foreign_frames)
        self.heard, self.waiting = [], []

    def send(self, frames):
        for frame in frames:
            self.heard.append(frame)
            self.waiting += self.bench.receive(SimFrame(*frame))
        return len(frames)

    def drain(self):
        frames = [
            Frame(*frame) for frame in self.bench.take_unsolicited_frames() + self.waiting
        ] + 5 * self.foreign_frames
        self.waiting = []
        return frames

    def take_events(self):
        return []


def advance_and_listen(bus, duration_s, received_frames):
    bus.bench.advance(bus.bench.t_ns + round(duration_s * 1e9))
    received_frames += bus.drain()


def scan_bench(
    *drive_specs, foreign_frames=(), force_scan=False, fault_command=""
) -> tuple[BusScan, SimulatedDriveBench, BenchBus]:
    bench = SimulatedDriveBench([drive_spec(*spec) for spec in drive_specs], fault=fault_command)
    bus = BenchBus(bench, foreign_frames)
    return scan_bus(bus, force_scan, listen_function=advance_and_listen), bench, bus


def test_damiao_and_canopen_drives_are_found_on_one_bus():
    result, bench, _ = scan_bench(("mit", 1, "dm4310"), ("mit", 9, "dm4340", True), ("cia402", 33))
    assert [(node.protocol, node.node_id) for node in result.found_nodes] == [
        ("mit", 1),
        ("mit", 9),
        ("cia402", 33),
    ]
    first_node, second_node, _ = result.found_nodes
    assert first_node.settings == {
        "position_range_rad": 12.5,
        "velocity_range_rad_s": 30.0,
        "torque_max_N_m": 10.0,
    }
    assert (first_node.state, first_node.serial, first_node.options) == (
        "disabled",
        "0x53494d01",
        {},
    )
    assert second_node.options == {"fd": True}
    assert "watchdog is off" in first_node.notes[0]
    assert [motor.servo.torque for motor in bench.motors] == [0.0] * 3
    assert [motor.theta for motor in bench.motors] == [0.0] * 3


def test_moteus_controllers_are_found_by_classical_frames():
    result, bench, bus = scan_bench(("moteus", 1), ("moteus", 17), ("mit", 3))
    assert [(node.protocol, node.node_id) for node in result.found_nodes] == [
        ("mit", 3),
        ("moteus", 1),
        ("moteus", 17),
    ]
    first_node, second_node = result.found_nodes[1:]
    assert (first_node.firmware, first_node.state, first_node.error, first_node.twins) == (
        "1.0.1",
        "stopped",
        "",
        False,
    )
    assert first_node.serial != second_node.serial != ""
    assert all(frame.flags == 0 and len(frame.data) <= 8 for frame in bus.heard), (
        "the bus may be classical"
    )
    assert [node.mode for node in bench.nodes[:2]] == [0, 0]
    assert [motor.theta for motor in bench.motors] == [0.0] * 3


def test_robstride_motors_are_found_by_their_identity():
    result, bench, bus = scan_bench(
        ("robstride", 1), ("robstride", 0x7F), ("mit", 3), ("moteus", 5)
    )
    identities = [(node.protocol, node.node_id) for node in result.found_nodes]
    assert identities == [("mit", 3), ("moteus", 5), ("robstride", 1), ("robstride", 0x7F)]
    assert [node.serial for node in result.found_nodes[2:]] == [
        "5253050000000001",
        "525305000000007f",
    ]
    assert [node.mode for node in bench.nodes[:2]] == [0, 0]
    assert bench.nodes[3].command == registers.REGISTER_DEFAULTS, (
        "to moteus node 5 the request writes no register"
    )
    assert all(frame.flags == 0 and len(frame.data) <= 8 for frame in bus.heard)


@pytest.mark.parametrize("protocol", ["moteus", "robstride"])
def test_two_drives_with_one_number_are_named(protocol):
    bench = SimulatedDriveBench([drive_spec(protocol, 7)], fault="twin")
    (node,) = scan_bus(BenchBus(bench), listen_function=advance_and_listen).found_nodes
    assert node.twins


@pytest.mark.parametrize("frame_kind", [1, 3, 4, 6, 0x12])
def test_scan_only_listens_if_another_robstride_host_is_active(frame_kind):
    result, _, bus = scan_bench(
        ("robstride", 1),
        foreign_frames=[Frame(EXTENDED_FLAG | frame_kind << 24 | 0xFD01, bytes(8))],
    )
    assert result.foreign_frames
    assert bus.heard == []


def test_scan_does_not_change_an_enabled_moteus_or_robstride():
    bench = SimulatedDriveBench([drive_spec("moteus", 1), drive_spec("robstride", 2)])
    bench.receive(SimFrame(EXTENDED_FLAG | 0x8001, bytes.fromhex("01000a022080000223000001ff")))
    bench.receive(SimFrame(EXTENDED_FLAG | 3 << 24 | 0xFD02, bytes(8)))
    bench.advance(20_000_000)
    modes_before = [node.mode for node in bench.nodes]
    watchdog_feed_times = [node.watchdog_fed_ns for node in bench.nodes]
    for question in requests_without_answers():
        bench.receive(SimFrame(*question))
    assert [node.mode for node in bench.nodes] == modes_before
    assert [node.watchdog_fed_ns for node in bench.nodes] == watchdog_feed_times
    assert [motor.servo.torque for motor in bench.motors] == [0.0, 0.0]


def test_scan_only_listens_if_another_moteus_host_is_active():
    result, _, bus = scan_bench(
        ("moteus", 1), foreign_frames=[Frame(EXTENDED_FLAG | 0x8101, b"\x11\x00")]
    )
    assert result.foreign_frames
    assert bus.heard == []


def test_scan_sends_no_frame_that_an_odrive_would_obey():
    result, bench, bus = scan_bench(("odrive", 3), ("odrive", 48), ("mit", 1))
    assert [(node.protocol, node.node_id) for node in result.found_nodes] == [
        ("odrive", 3),
        ("odrive", 48),
    ]
    drive = result.found_nodes[0]
    assert (drive.firmware, drive.serial, drive.state) == ("0.6.10", "0D5A11000003", "idle")
    orders = [
        frame
        for frame in bus.heard
        if not frame.can_id & REMOTE_FLAG and frame.can_id >> 5 in (3, 48, 0x3F)
    ]
    assert orders == [], "0x7ff is Enter_DFU_Mode, 0x602 the Estop of node 48"
    assert 0x7FF in {frame.can_id for frame in result.omitted_requests}
    assert [node.state for node in bench.nodes[:2]] == [1, 1]


def test_an_enabled_drive_stays_as_it_is():
    bench = SimulatedDriveBench([drive_spec("mit", 2)])
    bench.receive(SimFrame(2, b"\xff" * 7 + b"\xfc"))
    result = scan_bus(BenchBus(bench), listen_function=advance_and_listen)
    assert [node.state for node in result.found_nodes] == ["enabled"]
    assert bench.motors[0].servo.torque == 0.0


@pytest.mark.parametrize(
    "foreign_frames",
    [
        Frame(0x001, bytes(8)),
        Frame(0x080, b"\1"),
        Frame(0x7FF, bytes(8)),
        Frame(0x77F, b"\5"),
        Frame(0, b"\1\0"),
    ],
)
def test_scan_only_listens_if_another_host_is_active(foreign_frames):
    result, _, bus = scan_bench(("mit", 1), foreign_frames=[foreign_frames])
    assert result.foreign_frames
    assert bus.heard == []
    assert scan_bench(("mit", 1), foreign_frames=[foreign_frames], force_scan=True)[0].found_nodes


def test_scan_reports_no_firmware_if_another_host_is_active():
    """While another host is active on the bus, a scan sends no request frames.

    Earlier defect: if an ODrive with firmware 0.6 did not reply to a request, the scan reported
    firmware 0.5.
    """
    request = Frame(3 << 5 | 0x09 | REMOTE_FLAG, b"")
    result, _, bus = scan_bench(("odrive", 3), foreign_frames=[request])
    assert bus.heard == []
    (drive,) = result.found_nodes
    assert (drive.firmware, drive.options, drive.origins) == ("", {}, {})
    assert "firmware unknown, because nothing was asked" in drive.notes
    assert "firmware =" not in hand_file_snippet({"a": result.found_nodes}, 1_000_000, None)


def test_the_hand_file_part_marks_firmware_05_as_concluded():
    result, _, _ = scan_bench(("odrive", 3, "", False, None, "0.5"))
    (drive,) = result.found_nodes
    assert drive.options == {"firmware": "0.5"}
    assert 'firmware = "0.5"    # concluded: no answer to Get_Version' in hand_file_snippet(
        {"a": result.found_nodes}, 1_000_000, None
    )


@pytest.mark.parametrize(
    "drive_spec",
    [("mit", 5), ("cia402", 33), ("odrive", 3), ("odrive", 3, "", False, None, "0.5")],
    ids=str,
)
def test_two_drives_with_one_number_are_found(drive_spec):
    (only_node,) = scan_bench(drive_spec)[0].found_nodes
    assert (only_node.twins, DUPLICATE_NODE_WARNING in only_node.notes) == (False, False)
    (drive,) = scan_bench(drive_spec, fault_command="twin")[0].found_nodes
    assert (drive.twins, drive.notes[0]) == (True, DUPLICATE_NODE_WARNING)


def test_two_motors_that_answer_on_one_identifier_are_found():
    specs = [drive_spec("mit", 1), replace(drive_spec("mit", 2), options={"reply_id": 0x11})]
    result = scan_bus(BenchBus(SimulatedDriveBench(specs)), listen_function=advance_and_listen)
    assert ["answers on 0x11 as motor" in node.notes[0] for node in result.found_nodes] == [
        True,
        True,
    ]


def test_a_torque_too_large_for_a_hand_file_is_not_taken_from_the_drive():
    """A DM-J8009 motor reports a torque of 54 N m as its full scale.

    A hand file permits a torque of at most 50 N m. For a DM-J8009 motor, ``scan`` prints the torque
    limit 50 N m, and adds a comment with the 54 N m that the drive reports.
    """
    result, _, _ = scan_bench(("mit", 1, "dm8009"))
    text = hand_file_snippet({"a": result.found_nodes}, 1_000_000, None)
    assert (
        "torque_max_N_m = 50.0    # the drive reports the full scale 54, a hand file takes at most 50; yours: "
        in text
    )


def test_drives_that_a_scan_cannot_find_are_named(capsys):
    with run_simulated_drives("local:s", "mit", "--ids", "17"):
        assert main(["scan", "--bus", "local:s"]) == 0
        assert "not searched for: cubemars" in capsys.readouterr().out
        assert main(["bus", "doctor", "--bus", "local:s"]) == 0
    assert "not searched for: cubemars" in capsys.readouterr().out


def test_a_sensor_node_is_found_unless_drives_on_the_bus_use_sync(tmp_path):
    sensor_found_by_protocol = {"mit": True, "cia402": False}
    for protocol, is_sensor_node_found in sensor_found_by_protocol.items():
        bench = HandBench(hand_file(tmp_path, [protocol]))
        result = scan_bus(BenchBus(bench.simulated_hand.world), listen_function=advance_and_listen)
        bench.simulated_hand.close()
        assert len([node for node in result.found_nodes if node.protocol == protocol]) == 4
        sensors = [node for node in result.found_nodes if node.protocol == "sensor"]
        assert [node.node_id for node in sensors] == ([0x1A0] if is_sensor_node_found else [])
        assert (
            0x080 in {frame.can_id for frame in result.omitted_requests}
        ) is not is_sensor_node_found
        assert not is_sensor_node_found or "4 channels" in sensors[0].notes[0]


def test_unrequested_frames_of_an_odrive_are_no_other_host():
    result, _, _ = scan_bench(("odrive", 0), ("odrive", 4))
    assert result.foreign_frames == ()
    assert [node.node_id for node in result.found_nodes] == [0, 4]


def test_no_scan_request_enables_torque():
    """Send every request frame of a scan to drives, two of which are enabled with zero torque.

    No enabled drive makes torque after it has received all request frames of a scan.
    """
    bench = SimulatedDriveBench(
        [drive_spec("mit", node) for node in (1, 2)]
        + [drive_spec("cia402", node) for node in (1, 32)]
    )
    for node in (1, 2):
        bench.receive(SimFrame(node, b"\xff" * 7 + b"\xfc"))
    for question in requests_without_answers():
        bench.receive(SimFrame(*question))
        bench.advance(bench.t_ns + 1_000_000)
    assert [motor.servo for motor in bench.motors] == [
        type(motor.servo)(limit=motor.servo.limit) for motor in bench.motors
    ]


def test_scan_reads_two_buses_and_prints_a_part_of_a_hand_file(capsys):
    ids = ["--ids", "17,18"]
    with (
        run_simulated_drives("local:s", "mit", *ids),
        run_simulated_drives("join:s", "cia402", *ids),
        run_simulated_drives("local:t", "odrive", *ids),
    ):
        assert main(["scan", "--bus", "lab=local:s", "--bus", "far=local:t", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    nodes = [
        (bus["name"], node["protocol"], node["node_id"])
        for bus in result["buses"]
        for node in bus["nodes"]
    ]
    lab_nodes = [("lab", protocol, node) for protocol in ("mit", "cia402") for node in (17, 18)]
    assert nodes == [*lab_nodes, ("far", "odrive", 17), ("far", "odrive", 18)]
    for node in (node for bus in result["buses"] for node in bus["nodes"]):
        assert node["serial"]
        assert node["firmware"]
        assert node["state"]
    parsed = tomllib.loads(result["fragment"])
    assert [Bus.model_validate(bus).name for bus in parsed["bus"]] == ["lab", "far"]
    for motor, (bus, protocol, node) in zip(parsed["motor"], nodes, strict=True):
        assert make_drive(Motor.model_validate(motor), 0).name == f"{bus}_{protocol}_{node}"


def test_a_repeated_frame_of_another_host_is_printed_once(capsys):
    """Reproduce a defect: ``scan`` printed one frame of another host eight times, and its other frames not at all."""
    foreign_frames = [Frame(0x6E, bytes(8)), Frame(0x67, bytes(8))]
    result, _, _ = scan_bench(("odrive", 3), foreign_frames=foreign_frames)
    _print_scans({"main": "local:s"}, {"main": result}, "")
    line = capsys.readouterr().out.splitlines()[1]
    assert line.count("06E#") == line.count("067#") == 1


def test_the_hand_file_part_of_an_empty_bus_parses():
    assert (
        tomllib.loads(hand_file_snippet({"a": ()}, 1_000_000, 5_000_000))["bus"][0]["data_bitrate"]
        == 5_000_000
    )


def test_empty_bus_is_reported(capsys):
    assert main(["scan", "--bus", "virtual:nothing-here"]) == 1
    assert "0 nodes" in capsys.readouterr().out


def test_a_bus_named_twice_is_refused(capsys):
    assert main(["scan", "--bus", "a=local:x", "--bus", "a=local:y"]) == 2
    assert "every name once" in capsys.readouterr().err


def test_the_last_frame_of_a_host_that_has_ended_is_no_host():
    bench = SimulatedDriveBench([drive_spec("mit", 1)])
    bus = BenchBus(bench)
    bus.waiting = [SimFrame(0x7FF, bytes(8))]
    assert scan_bus(bus, listen_function=advance_and_listen).foreign_frames == ()
