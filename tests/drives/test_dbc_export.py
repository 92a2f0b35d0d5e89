"""Test the DBC file for the buses of a hand.

With the DBC file, cantools decodes the same values as the controller.
"""

import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cantools
import pytest
from cantools.database import Database

from fuzz.fuzzed_drives import FUZZED_DRIVES, FuzzedDrive
from handctl.controller.run_setup import make_drives, make_sensors
from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.dbc_export import HOST_NODE_NAME, SENSOR_NODE_NAME, export_bus_dbc
from handctl.drives.frame import Frame
from handctl.drives.signals import CyclicMessage, SignalQuantity
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from tests.drives.protocol_bench import ProtocolBench, hand_file, move_to_second_bus
from tests.drives.wired_drives import WiredDrives

FIELD_BY_QUANTITY = {
    SignalQuantity.POSITION: "position",
    SignalQuantity.VELOCITY: "velocity",
    SignalQuantity.TORQUE: "reported",
}
DRIVE_VARIANTS = FUZZED_DRIVES | {"mit-fd": FuzzedDrive("mit", "[motor.options]\nfd = true\n")}
TICK_COUNT = 40


def exported_dbc(hand: Hand, bus_index: int = 0) -> Database:
    text = export_bus_dbc(
        bus_index, make_drives(hand), make_sensors(hand), hand.tendon_names, hand.joints
    )
    database = cantools.database.load_string(text, "dbc", strict=True)
    assert isinstance(database, Database)
    return database


@pytest.fixture(params=DRIVE_VARIANTS)
def bench(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[ProtocolBench]:
    variant = DRIVE_VARIANTS[request.param]
    path = hand_file(tmp_path, [variant.protocol], variant.options)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not line.startswith(variant.skipped_option)))
    new_bench = ProtocolBench(path)
    yield new_bench
    new_bench.simulated_hand.close()


def values_read_by_controller(
    wired_drives: WiredDrives, message: CyclicMessage, drive_index: int
) -> dict[str, float]:
    """Return the values that the controller has decoded from a frame of the drive with the index ``drive_index``."""
    values = {
        signal.name: signal.quantity
        for signal in message.signals
        if signal.quantity in FIELD_BY_QUANTITY
    }
    return {
        name: float(wired_drives.field_view(FIELD_BY_QUANTITY[quantity])[drive_index])
        for name, quantity in values.items()
    }


def test_cantools_reads_what_the_controller_reads(bench: ProtocolBench) -> None:
    """The frames of this test come from a lockstep run with the simulated firmware.

    The frames are commands and feedback of drives, and readings of load cells and joint encoders.
    """
    dbc, hand = exported_dbc(bench.hand), bench.hand
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    wired_drives, message_counts = WiredDrives(bench.drives, bench.sensor_node), Counter[str]()
    for i, state in enumerate(bench.states):
        wired_drives.store_drive_state(i, state)
    sender_by_id = {
        message.can_id: (i, message)
        for i, drive in enumerate(bench.drives)
        for message in drive.cyclic_messages.feedback
    }
    for k in range(TICK_COUNT):
        torque = 0.04 * math.sin(0.3 * k)
        wired_drives.begin_tick_with_sync(bench.k)
        bench.tick(DriveTarget.ENABLE, torque)
        for frame in bench.received_frames:
            wired_drives.receive([frame])
            # A reply to a register request has the same identifier as a feedback frame, but another
            # length.
            if (
                frame.can_id in sender_by_id
                and len(frame.data) == sender_by_id[frame.can_id][1].length
            ):
                decoded_signals = dbc.decode_message(frame.can_id, frame.data)
                for name, value in values_read_by_controller(
                    wired_drives, sender_by_id[frame.can_id][1], sender_by_id[frame.can_id][0]
                ).items():
                    assert decoded_signals[name] == pytest.approx(value, abs=1e-9), (name, frame)
                    message_counts[name] += 1
            if frame.can_id in bench.sensor_node.node_ids:
                decoded_signals = dbc.decode_message(frame.can_id, frame.data)
                decoded_signals.pop("counter")
                names = {hand.tendon_names[n]: value for n, value in wired_drives.tensions.items()}
                names |= {hand.joints[j]: value for j, value in wired_drives.joint_readings.items()}
                assert decoded_signals == pytest.approx(
                    {name: names[name] for name in decoded_signals}, abs=1e-9
                )
                message_counts["sensors"] += 1
        message_counts["torques"] += sum(
            is_torque_command(dbc, frame, bench, torque) for frame in bench.sent_frames
        )
    assert min(message_counts[name] for name in ("position", "sensors")) >= TICK_COUNT // 4
    assert message_counts["torques"] == (
        0 if hand.motor[0].protocol in ("cubemars", "robstride") else 4 * TICK_COUNT
    )


def is_torque_command(dbc: Database, frame: Frame, bench: ProtocolBench, torque: float) -> bool:
    """Return True if a frame is a torque command.

    If the frame is a torque command, check that its torque equals ``torque`` within one count.
    """
    for drive in bench.drives:
        for message in drive.cyclic_messages.commands:
            signals = [
                signal for signal in message.signals if signal.quantity == SignalQuantity.TORQUE
            ]
            is_command_frame = message.can_id == frame.can_id and message.length == len(frame.data)
            # A frame that writes a setting can have the identifier and the length of a torque
            # command. Only the first bytes distinguish a torque command from a written setting.
            first_signal_byte = min((signal.start for signal in message.signals), default=0) // 8
            is_big_endian = any(signal.is_big_endian for signal in message.signals)
            is_command_frame = is_command_frame and (
                is_big_endian
                or frame.data[:first_signal_byte] == message.base_payload[:first_signal_byte]
            )
            if is_command_frame and signals and message.can_id not in drive.node_ids:
                decoded_signals = dbc.decode_message(frame.can_id, frame.data)
                step = abs(signals[0].scale) if signals[0].length < 32 else 1e-7
                assert decoded_signals["torque"] == pytest.approx(torque, abs=step)
                return True
    return False


def test_the_dbc_tells_who_sends_and_what_is_fd(tmp_path: Path) -> None:
    dbc = exported_dbc(load_hand(str(hand_file(tmp_path, ["mit"], "[motor.options]\nfd = true\n"))))
    senders = {message.name: message.senders for message in dbc.messages}
    assert senders["sync"] == [HOST_NODE_NAME]
    assert senders["tensions_0"] == [SENSOR_NODE_NAME]
    assert senders["index_motor_feedback"] == ["index_motor"]
    assert senders["index_motor_command"] == [HOST_NODE_NAME]
    assert dbc.get_message_by_name("index_motor_command").is_fd
    assert not dbc.get_message_by_name("sync").is_fd
    kd = dbc.get_message_by_name("index_motor_command").get_signal_by_name("kd")
    assert (kd.start, kd.length) == (47, 12)


def test_each_bus_has_its_own(tmp_path: Path) -> None:
    hand = load_hand(
        str(move_to_second_bus(hand_file(tmp_path, ["mit", "odrive", "cia402", "cubemars"])))
    )
    main, second = (exported_dbc(hand, bus) for bus in (0, 1))
    assert {"sync", "index_motor_feedback", "middle_motor_encoder_estimates"} <= {
        message.name for message in main.messages
    }
    assert {message.name for message in second.messages} == {
        "ring_motor_tpdo1", "ring_motor_rpdo1", "thumb_motor_feedback"
    }  # fmt: skip


def test_every_packaged_hand_has_one() -> None:
    for name in ("jamia", "jamia11"):
        hand = load_hand(name)
        ids = [message.frame_id for message in exported_dbc(hand).messages]
        assert len(ids) == len(set(ids)) >= 2 * len(hand.tendon_names) + 2
