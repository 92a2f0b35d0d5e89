"""Test faults of ODrive and CiA 402 drives, and the error messages about the faults.

The simulated firmware injects the faults.
"""

import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_sim.bus.frame import Frame as WireFrame
from firmware_sim.nodes.cia402.node import Cia402Node
from firmware_sim.nodes.odrive.node import OdriveNode
from handctl.drives.cia402.drive import Cia402Drive
from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.odrive import codec
from handctl.drives.odrive.drive import OdriveDrive
from handctl.drives.odrive.progress import get_progress
from tests.drives.protocol_bench import (
    FIRST_NODE_ID,
    OPTIONS_TEXT_BY_PROTOCOL,
    ProtocolBench,
    hand_file,
)


@pytest.fixture
def odrive_bench(tmp_path: Path) -> Iterator[ProtocolBench]:
    bench = ProtocolBench(hand_file(tmp_path, ["odrive"]))
    yield bench
    bench.simulated_hand.close()


@pytest.fixture
def cia402_bench(tmp_path: Path) -> Iterator[ProtocolBench]:
    bench = ProtocolBench(hand_file(tmp_path, ["cia402"]))
    yield bench
    bench.simulated_hand.close()


def first_odrive_node(bench: ProtocolBench) -> OdriveNode:
    node = bench.simulated_hand.world.nodes[0][0]
    assert isinstance(node, OdriveNode)
    return node


def first_cia402_node(bench: ProtocolBench) -> Cia402Node:
    node = bench.simulated_hand.world.nodes[0][0]
    assert isinstance(node, Cia402Node)
    return node


def error_of_first_drive(
    bench: ProtocolBench, phase: DrivePhase, target: DriveTarget, max_ticks: int
) -> str:
    """Run ticks until the first drive is in a given drive phase, and return the error text of the first drive."""
    for _ in range(max_ticks):
        bench.tick(target)
        if bench.states[0].phase == phase:
            return bench.states[0].error_text
    raise AssertionError(bench.states[0])


def lose_first_frames(
    node: OdriveNode, command_number: int, payload_start: bytes = b"", frame_count: int = 1
) -> list[WireFrame]:
    """Drop the first frames that contain a given command to the first ODrive.

    Return a list that collects the dropped frames.

    If ``payload_start`` is given, drop only frames whose payload begins with ``payload_start``.
    """
    original_receive, lost_frames = node.receive, list[WireFrame]()

    def receive(frame: WireFrame, t_ns: int) -> list[WireFrame] | None:
        is_lost_frame = (
            frame.can_id == FIRST_NODE_ID << 5 | command_number
            and frame.data.startswith(payload_start)
        )
        if is_lost_frame and len(lost_frames) < frame_count:
            lost_frames.append(frame)
            return []
        return original_receive(frame, t_ns)

    node.receive = receive  # type: ignore[method-assign]  # this one node alone is to lose them
    return lost_frames


@pytest.mark.parametrize("restart_moment", ["ready", "ordered"])
def test_an_odrive_that_restarts_while_it_is_armed_is_set_up_anew(
    odrive_bench: ProtocolBench, restart_moment: str
) -> None:
    """After a restart, an ODrive is in position control and has no watchdog.

    The host can detect the restart only because the axis state of the drive becomes idle.
    """
    node = first_odrive_node(odrive_bench)
    odrive_bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    if restart_moment != "ready":
        while get_progress(odrive_bench.states[0]).enable_command_ns < 0:
            odrive_bench.tick(DriveTarget.ENABLE)
    settings = dict(node.endpoints)
    for _ in range(10 * (restart_moment == "ready")):
        odrive_bench.tick(DriveTarget.POLL)
    node.receive(Frame(0x10 << 5 | 0x16, b"\0"), odrive_bench.simulated_hand.world.t_ns)  # type: ignore[arg-type]
    assert node.endpoints != settings
    for _ in range(400):
        odrive_bench.tick(DriveTarget.ENABLE)
        assert node.state == 1 or (node.mode == (1, 1) and node.endpoints == settings)
        if odrive_bench.states[0].phase == DrivePhase.ENABLED:
            return
    raise AssertionError(odrive_bench.states[0])


@pytest.mark.parametrize("command_number", [codec.SET_MODE, codec.SET_LIMITS])
def test_a_mode_or_limit_that_is_lost_on_the_wire_is_not_lost_for_good(
    odrive_bench: ProtocolBench, command_number: int
) -> None:
    """An ODrive does not confirm the commands that set its control mode and its limits.

    An ODrive that has stayed in position control would jump at the first torque command.
    """
    node = first_odrive_node(odrive_bench)
    lost_frames = lose_first_frames(node, command_number)
    velocity_limit_before = node.velocity_limit
    odrive_bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    assert lost_frames
    assert node.mode == (1, 1)
    assert node.velocity_limit != velocity_limit_before


@pytest.mark.parametrize("lost_frames", [1, 2, 3])
def test_a_setting_that_is_lost_on_the_wire_is_written_again(
    odrive_bench: ProtocolBench, lost_frames: int
) -> None:
    """An ODrive does not confirm that it has written a setting."""
    node = first_odrive_node(odrive_bench)
    dropped_frames = lose_first_frames(node, codec.RX_SDO, bytes((codec.SDO_WRITE,)), lost_frames)
    if lost_frames < 3:
        odrive_bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
        assert node.endpoints[201] == b"\1"
    else:
        assert "enable_watchdog reads 0 after writing, expected 1" in error_of_first_drive(
            odrive_bench, DrivePhase.FAULT, DriveTarget.POLL, 200
        )
    assert len(dropped_frames) == lost_frames


def test_an_odrive_that_ignores_commands_is_a_fault(odrive_bench: ProtocolBench) -> None:
    odrive_bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    first_odrive_node(odrive_bench)._set_state = lambda state, t_ns: None  # type: ignore[method-assign]
    assert "after 5 enable commands" in error_of_first_drive(
        odrive_bench, DrivePhase.FAULT, DriveTarget.ENABLE, 600
    )


@pytest.mark.parametrize(
    ("error_bit", "error_text"),
    [(25, "emergency stop"), (13, "motor over-temperature"), (6, "missing input")],
)
def test_an_odrive_says_what_disarmed_it(
    odrive_bench: ProtocolBench, error_bit: int, error_text: str
) -> None:
    odrive_bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    first_odrive_node(odrive_bench).disarm(1 << error_bit)
    assert error_text in error_of_first_drive(
        odrive_bench, DrivePhase.FAULT, DriveTarget.ENABLE, 60
    )


def test_an_odrive_that_is_left_enabled_is_made_idle_first(odrive_bench: ProtocolBench) -> None:
    first_odrive_node(odrive_bench).state = 8
    odrive_bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert first_odrive_node(odrive_bench).state == 1


@pytest.mark.parametrize("target", [DriveTarget.ENABLE, DriveTarget.POLL])
def test_odrive_in_another_axis_state_is_a_fault_and_is_stopped(
    odrive_bench: ProtocolBench, target: DriveTarget
) -> None:
    """An ODrive that is calibrated over USB makes torque without a command from the host, and reports no error."""
    odrive_bench.run_until_phase(
        target, DrivePhase.ENABLED if target == DriveTarget.ENABLE else DrivePhase.READY
    )
    first_odrive_node(odrive_bench).state = 3
    assert "in axis state 3" in error_of_first_drive(
        odrive_bench, DrivePhase.FAULT, target, 60
    ).replace("went to", "in")
    odrive_bench.tick(target)
    assert first_odrive_node(odrive_bench).state == 1


def test_an_odrive_without_a_heartbeat_is_lost(odrive_bench: ProtocolBench) -> None:
    odrive_bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for _ in range(200):
        odrive_bench.received_frames = [
            frame for frame in odrive_bench.received_frames if frame.can_id & 0x1F != 1
        ]
        odrive_bench.tick(DriveTarget.ENABLE)
    assert odrive_bench.states[0].error_text == "no heartbeat"
    assert first_odrive_node(odrive_bench).state == 1, (
        "and what may be enabled gets a command to stop"
    )


def test_endpoints_hold_what_the_hand_file_says(odrive_bench: ProtocolBench) -> None:
    node = first_odrive_node(odrive_bench)
    assert node.endpoints[201] == b"\0"
    odrive_bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert node.endpoints[201] == b"\1"
    assert struct.unpack("<f", node.endpoints[202])[0] == pytest.approx(0.05)
    assert struct.unpack("<f", node.endpoints[203])[0] == pytest.approx(0.8)


def test_a_watchdog_that_cannot_be_verified_is_reported(tmp_path: Path) -> None:
    path = hand_file(tmp_path, ["odrive"])
    bench = ProtocolBench(path)
    assert isinstance(bench.drives[0], OdriveDrive)
    assert bench.drives[0].unverified_protections == ()
    path.write_text(path.read_text().replace(OPTIONS_TEXT_BY_PROTOCOL["odrive"], ""))
    unverified_drive = ProtocolBench(path).drives[0]
    assert isinstance(unverified_drive, OdriveDrive)
    assert "watchdog not verified" in unverified_drive.unverified_protections[0]


def test_another_protocol_version_is_refused(odrive_bench: ProtocolBench) -> None:
    drive, state = odrive_bench.drives[0], odrive_bench.states[0]
    assert isinstance(drive, OdriveDrive)
    state = drive.receive(state, Frame(drive.node_id << 5, bytes((1, 0, 0, 0, 0, 5, 6, 0))))
    assert (state.phase, state.error_text) == (
        DrivePhase.FAULT,
        "has CANSimple version 1, expected 2",
    )


@pytest.mark.parametrize(
    ("error_code", "error_text"),
    [(0x8130, "watchdog"), (0x4310, "motor over-temperature"), (0xFF01, "0xff01")],
)
def test_a_cia402_drive_says_what_its_fault_is(
    cia402_bench: ProtocolBench, error_code: int, error_text: str
) -> None:
    cia402_bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    first_cia402_node(cia402_bench).trip(error_code)
    cia402_bench.received_frames += first_cia402_node(cia402_bench).wake(
        cia402_bench.simulated_hand.world.t_ns
    )  # type: ignore[arg-type]
    assert error_text in error_of_first_drive(
        cia402_bench, DrivePhase.FAULT, DriveTarget.ENABLE, 10
    )


def test_another_rated_torque_is_refused(cia402_bench: ProtocolBench) -> None:
    first_cia402_node(cia402_bench).objects[0x6076, 0] = 300
    assert (
        error_of_first_drive(cia402_bench, DrivePhase.FAULT, DriveTarget.POLL, 100)
        == "object 0x6076:0 reads 0x12c, expected 0x190"
    )


def test_a_drive_that_restarts_in_motion_is_a_fault(cia402_bench: ProtocolBench) -> None:
    cia402_bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    cia402_bench.tick(DriveTarget.ENABLE, extra_frames=[Frame(0x000, bytes((0x81, 0x10)))])
    assert (
        error_of_first_drive(cia402_bench, DrivePhase.FAULT, DriveTarget.ENABLE, 30) == "restarted"
    )
    assert cia402_bench.simulated_hand.world.plant.motors["index_motor"].servo.torque == 0.0


def test_a_bus_without_sync_is_reported(cia402_bench: ProtocolBench) -> None:
    drive = cia402_bench.drives[0]
    assert isinstance(drive, Cia402Drive)
    for _ in range(200):
        cia402_bench.tick(DriveTarget.POLL)
        cia402_bench.received_frames = [
            frame for frame in cia402_bench.received_frames if frame.can_id & ~0x7F != 0x180
        ]
    assert "SYNC" in cia402_bench.states[0].error_text


def refuse_sync_counter(bench: ProtocolBench) -> ProtocolBench:
    """Make the CiA 402 drives of a bench ignore every SYNC frame that contains data, and return the bench.

    The CANopen stack CANopenNode ignores a SYNC frame that contains data while object 0x1019 is 0.
    """
    for node in bench.simulated_hand.world.nodes[0]:
        if isinstance(node, Cia402Node):
            receive_frame = node.receive
            node.receive = lambda frame, t_ns, receive_frame=receive_frame: (  # type: ignore[method-assign, misc]
                None if frame.can_id == 0x080 and frame.data else receive_frame(frame, t_ns)
            )
    return bench


def test_drives_that_refuse_a_sync_counter_are_reported_and_get_an_empty_sync(
    tmp_path: Path,
) -> None:
    path = hand_file(tmp_path, ["cia402"])
    bench = refuse_sync_counter(ProtocolBench(path))
    for _ in range(200):
        bench.tick(DriveTarget.POLL)
    assert "accept SYNC with a counter" in bench.states[0].error_text
    text = path.read_text().replace("sync_id = 0x080", "sync_id = 0x0FF")
    path.write_text(
        text.replace("counts_per_turn = 65536", "counts_per_turn = 65536\nsync = true", 1)
    )
    bench = refuse_sync_counter(ProtocolBench(path))
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    bench.tick(DriveTarget.ENABLE)
    assert {frame.can_id for frame in bench.received_frames} == {0x1A0, 0x190, 0x191, 0x192, 0x193}


def test_a_simulated_drive_refuses_an_object_that_it_does_not_have(
    cia402_bench: ProtocolBench,
) -> None:
    node = first_cia402_node(cia402_bench)
    for index, sub, code in ((0x6091, 1, 0x06020000), (0x6041, 3, 0x06090011)):
        request = bytes((0x40,)) + index.to_bytes(2, "little") + bytes((sub, 0, 0, 0, 0))
        replies = node.receive(Frame(0x610, request), 0)  # type: ignore[arg-type]
        assert replies is not None
        assert int.from_bytes(replies[-1].data[4:], "little") == code
