"""Test a hand with three drive protocols on two buses.

The tests include hand files that handctl refuses because of their combination of drives.
"""

import re
from pathlib import Path

import pytest

from handctl.controller.bus_load import bus_loads
from handctl.controller.run_setup import make_sensors
from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.frame_time import bus_time_s
from handctl.drives.identifier_checks import check_identifiers
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from handctl.drives.odrive.discovery import CONFLICT_FREE_NODE_NUMBERS
from handctl.drives.protocol_registry import make_drive
from handctl.errors import ConfigError
from handctl.hand.hand_loading import load_hand
from tests.drives.protocol_bench import ProtocolBench, hand_file, motor_on_bench, move_to_second_bus


def mixed_hand(hand_folder: Path) -> Path:
    """Write the file of a hand with three drive protocols on two buses, and return its path.

    An MIT and an ODrive drive share the first bus with the load cells. Two CiA 402 drives are on
    the second bus, and one of them sends the SYNC frame.
    """
    path = move_to_second_bus(hand_file(hand_folder, ["mit", "odrive", "cia402"]))
    head, *motors = path.read_text().split("[[motor]]")
    motors[2] = motors[2].replace("counts_per_turn", "sync = true\ncounts_per_turn")
    path.write_text("[[motor]]".join([head, *motors]))
    return path


def test_two_buses_and_three_protocols_work_as_one_hand(tmp_path: Path) -> None:
    bench = ProtocolBench(mixed_hand(tmp_path))
    assert [drive.bus for drive in bench.drives] == [0, 0, 1, 1]
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for _ in range(100):
        bench.tick(DriveTarget.ENABLE, 0.05)
    motors = bench.simulated_hand.world.plant.motors.values()
    assert [motor.servo.torque for motor in motors] == pytest.approx([0.05] * 4, abs=0.001)
    assert min(state.feedback_t_ns for state in bench.states) >= (bench.k - 2) * 2_000_000
    bench.run_until_phase(DriveTarget.DISABLE, DrivePhase.READY, max_ticks=100)
    bench.simulated_hand.close()


def test_no_drive_is_silent_while_the_others_are_enabled(tmp_path: Path) -> None:
    """Reproduce a defect: handctl verified the settings of an ODrive again before it enabled the ODrive.

    During the verification, the ODrive sent no feedback for five ticks, which counted as a fault.
    """
    bench = ProtocolBench(hand_file(tmp_path, ["mit", "odrive", "cubemars", "cia402"]))
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    for _ in range(10):
        bench.tick(DriveTarget.POLL)
    for _ in range(60):
        bench.tick(DriveTarget.ENABLE)
        assert min(state.feedback_t_ns for state in bench.states) >= (bench.k - 4) * 2_000_000
    assert [state.phase for state in bench.states] == [DrivePhase.ENABLED] * 4
    bench.simulated_hand.close()


def test_a_mirrored_geared_motor_winds_too(tmp_path: Path) -> None:
    for protocol in ("odrive", "cia402"):
        path = hand_file(tmp_path, [protocol], "gear_ratio = 4.0\n")
        path.write_text(re.sub(r"\ndirection = 1", "\ndirection = -1", path.read_text()))
        bench = ProtocolBench(path)
        bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
        positions_before = [state.position for state in bench.states]
        for _ in range(100):
            bench.tick(DriveTarget.ENABLE, 0.05)
        motors = bench.simulated_hand.world.plant.motors
        for drive, state, start in zip(bench.drives, bench.states, positions_before, strict=True):
            assert motors[drive.name].servo.torque == pytest.approx(0.05, abs=0.002), (
                "in the hand's sign, at the spool"
            )
            assert state.position > start
        bench.simulated_hand.close()


@pytest.mark.parametrize("protocol", VERIFIABLE_PROTOCOLS)
def test_a_zero_of_a_motor_is_an_angle_at_its_shaft(protocol: str, tmp_path: Path) -> None:
    has_gear_ratio = protocol in ("odrive", "cia402")
    gear = 4.0 if has_gear_ratio else 1.0
    path = hand_file(tmp_path, [protocol], f"gear_ratio = {gear}\n" if has_gear_ratio else "")
    text = path.read_text()
    assert "zero_rad" in text
    path.write_text(re.sub(r"\nzero_rad = [^ \n#]+", "\nzero_rad = 0.7", text))
    bench = ProtocolBench(path)
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    for _ in range(20):
        bench.tick(DriveTarget.POLL)
    world = bench.simulated_hand.world
    for drive, state in zip(bench.drives, bench.states, strict=True):
        truth = (
            world.plant.motors[drive.name].theta + (world.encoder_offset[drive.name] - 0.7) / gear
        )
        assert state.position == pytest.approx(truth, abs=0.01), drive.name
    bench.simulated_hand.close()


def test_identifiers_of_different_protocols_may_not_meet(tmp_path: Path) -> None:
    path = hand_file(tmp_path, ["odrive"])
    path.write_text(path.read_text().replace("node_id = 16", "node_id = 4"))
    with pytest.raises(ConfigError, match=r"0x80 on bus \"main\" is taken.*sensor_node.sync_id"):
        load_hand(str(path))


@pytest.mark.parametrize(
    ("protocol", "option_line", "expected_message"),
    [
        ("odrive", "gear_ratio = 0.0", "gear_ratio"),
        ("odrive", "colour = 1", "colour"),
        ("odrive", "endpoint_torque_max = 1.5", "endpoint_torque_max"),
        ("cia402", 'rated_torque_unit = "Nm"', "rated_torque_unit"),
        ("cia402", 'sync = "yes"', "sync"),
        ("cia402", "colour = 1", "colour"),
    ],
)
def test_wrong_options_are_refused_by_their_path(
    tmp_path: Path, protocol: str, option_line: str, expected_message: str
) -> None:
    path = hand_file(tmp_path, [protocol])
    text = path.read_text()
    if f"\n{expected_message} = " in text:
        text = re.sub(rf"\n{expected_message} = .*", "\n" + option_line, text)
    else:
        text = text.replace("[motor.options]\n", f"[motor.options]\n{option_line}\n")
    path.write_text(text)
    with pytest.raises(ConfigError, match=rf"motor\[index_motor\].options.{expected_message}"):
        bus_loads(load_hand(str(path)))


def test_can_fd_needs_its_data_bit_rate(tmp_path: Path) -> None:
    path = hand_file(tmp_path, ["mit"])
    text = path.read_text().replace("watchdog_ms = 50", "watchdog_ms = 50\noptions = { fd = true }")
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"bus\[main\].data_bitrate"):
        bus_loads(load_hand(str(path)))
    path.write_text(
        text.replace("bitrate = 1000000", "bitrate = 1000000\ndata_bitrate = 5_000_000")
    )
    busy_tick_s = bus_loads(load_hand(str(path)))[0].frame_time_per_tick_s
    sensors = bus_time_s([(1, False, 1), (7, False, 1)], 1e6)
    assert busy_tick_s - sensors == pytest.approx(8 * 56.6e-6, rel=0.001)


@pytest.mark.parametrize(
    ("protocol", "added_text", "expected_us"),
    [("mit", "", 1215), ("cia402", "", 1110), ("odrive", "encoder_period_ms = 2\n", 1055)],
)
def test_the_load_is_that_of_the_table(
    tmp_path: Path, protocol: str, added_text: str, expected_us: float
) -> None:
    """The bus load includes the frames of the motors and one load-cell frame with 8 bytes.

    With CiA 402 drives, the bus load includes an empty SYNC frame, too.
    """
    bench = ProtocolBench(hand_file(tmp_path, [protocol], added_text))
    frames = [(size, fd, 1.0) for drive in bench.drives for size, fd in drive.frames_per_tick] + [
        (8, False, 1.0)
    ]
    frames += (
        [(0, False, 1.0)]
        if protocol == "cia402"
        else [(8, False, 4.0)]
        if protocol == "odrive"
        else []
    )
    assert bus_time_s(frames, 1e6) * 1e6 == pytest.approx(expected_us, rel=0.02)


def test_the_numbers_that_the_page_recommends_for_odrives_are_free_beside_canopen() -> None:
    """Reproduce a defect: the documentation page recommended the node number 0x10 for an ODrive.

    An ODrive with the node number 0x10 uses the same identifiers as RPDO1 of the CANopen nodes 1 to
    31.
    """
    page_text = (Path(__file__).parents[2] / "docs" / "how-to" / "adding-a-drive.md").read_text(
        encoding="utf-8"
    )
    text = re.search(r"With the node\s+numbers (.*?), these\s+identifiers", page_text, re.DOTALL)
    assert text
    pairs = re.findall(r"0x(\w\w) to\s+0x(\w\w)", text[1])
    assert [(int(first_id, 16), int(last_id, 16)) for first_id, last_id in pairs] == [
        (a[0], a[-1]) for a in CONFLICT_FREE_NODE_NUMBERS
    ]
    options = {"rated_torque_N_m": 0.4, "counts_per_turn": 65536}
    other_nodes = [("sensor", make_sensors(load_hand("jamia11")))]
    canopen = [
        make_drive(motor_on_bench("cia402", node, 0.8, options), 0) for node in range(1, 0x7F)
    ]
    for node in (number for numbers in CONFLICT_FREE_NODE_NUMBERS for number in numbers):
        drive = make_drive(motor_on_bench("odrive", node, 0.8, {}), 0)
        check_identifiers([*other_nodes, ("odrive", drive)])
        for canopen_drive in canopen:
            check_identifiers([("odrive", drive), ("cia402", canopen_drive)])
    with pytest.raises(ConfigError, match="has two meanings"):
        check_identifiers(
            [
                ("odrive", make_drive(motor_on_bench("odrive", 0x10, 0.8, {}), 0)),
                ("cia402", canopen[0]),
            ]
        )


@pytest.mark.parametrize(
    ("cubemars_node", "mit_node", "reply_id"), [(5, 5, 0x15), (5, 0x21, 5), (5, 1, 0x80)]
)
def test_an_identifier_with_two_meanings_is_refused_whatever_the_protocols(
    cubemars_node: int, mit_node: int, reply_id: int
) -> None:
    """A CubeMars motor replies with its node number as the identifier.

    In each case of this test, the identifier of the reply is also an identifier of another motor or
    of the SYNC frame.
    """
    sensors = make_sensors(load_hand("jamia"))
    first_drive = make_drive(
        motor_on_bench("cubemars", cubemars_node, 0.8, {"motor_type": "ak80-9"}), 0
    )
    second_drive = make_drive(motor_on_bench("mit", mit_node, 0.8, {"reply_id": reply_id}), 0)
    with pytest.raises(ConfigError, match=r"^second: identifier .* has two meanings"):
        check_identifiers([("sensor", sensors), ("first", first_drive), ("second", second_drive)])
    drive_on_other_bus = make_drive(motor_on_bench("mit", mit_node, 0.8, {"reply_id": reply_id}), 1)
    check_identifiers([("first", first_drive), ("second", drive_on_other_bus)])
