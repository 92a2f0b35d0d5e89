"""Test the compiled code that receives and sends frames.

For any received frames, compiled code gives the same values and sends the same frames as the Python
code of each drive.
"""

import math
import random
import struct
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from fuzz.fuzzed_drives import FUZZED_DRIVES, FuzzedDrive
from handctl.drives import readback
from handctl.drives.cia402.drive import Cia402Drive
from handctl.drives.contract import NO_STEADY_STATUS, Drive, DrivePhase, DriveState, DriveTarget
from handctl.drives.frame import BRS, ERROR_FLAG, FDF, REMOTE_FLAG, Frame
from handctl.drives.odrive.drive import OdriveDrive
from handctl.drives.protocol_registry import PROTOCOL_ENTRIES
from handctl.drives.sensors.sensor_node import SensorNode
from tests.drives.protocol_bench import PERIOD_NS, ProtocolBench, hand_file
from tests.drives.wired_drives import WiredDrives

DRIVE_VARIANTS = FUZZED_DRIVES | {
    "mit-fd": FuzzedDrive("mit", "[motor.options]\nfd = true\n"),
    "odrive-torque": FuzzedDrive("odrive", "torque_feedback = true\n"),
}
UNCHECKED_VARIANTS = ("moteus", "cubemars", "odrive-0.5", "robstride_mit")
"""Drive variants whose settings cannot be read with one request frame and one reply frame."""
RANDOM_FRAME_SEEDS, TICKS_PER_SEED = range(20), 150
NO_SENSORS = SensorNode(0, 0x7F0, (0x7F1,), ((),), (1,), 0, (-1,), 1)


@cache
def enable_drive(variant_name: str) -> tuple[Drive, DriveState, int, tuple[Frame, ...]]:
    """Return an enabled drive, the drive state, the time [ns], and frames that the drive has sent."""
    variant = DRIVE_VARIANTS[variant_name]
    with TemporaryDirectory() as folder:
        path = hand_file(Path(folder), [variant.protocol], variant.options)
        lines = path.read_text().splitlines(keepends=True)
        path.write_text(
            "".join(line for line in lines if not line.startswith(variant.skipped_option))
        )
        bench = ProtocolBench(path)
        bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
        bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
        drive, state, t_ns = bench.drives[0], bench.states[0], bench.k * PERIOD_NS
        heard: list[Frame] = []
        for _ in range(60):
            bench.tick(DriveTarget.ENABLE, 0.05)
            heard += [frame for frame in bench.received_frames if frame.can_id in drive.node_ids]
        bench.simulated_hand.close()
    return drive, state, t_ns, tuple(heard)


def random_frame(
    random_source: random.Random, received_frames: tuple[Frame, ...], t_ns: int
) -> Frame:
    """Return one of the frames that a drive has sent, unchanged or with one random change."""
    frame = random_source.choice(received_frames)._replace(t_ns=t_ns)
    data, change_kind = bytearray(frame.data), random_source.randrange(12)
    if change_kind == 0:
        return frame._replace(data=random_source.randbytes(random_source.randrange(65)))
    if change_kind == 1:
        return frame._replace(data=random_source.randbytes(8))
    if change_kind == 2:
        return frame._replace(data=bytes(data[:-1]))
    if change_kind == 3:
        return frame._replace(can_id=frame.can_id | random_source.choice((ERROR_FLAG, REMOTE_FLAG)))
    if change_kind == 4:
        return frame._replace(flags=frame.flags ^ (FDF | BRS))
    if change_kind == 5 and data:
        data[0] ^= 1 << random_source.randrange(8)
    if change_kind == 6 and len(data) == 8:
        data[4 * random_source.randrange(2) :][:4] = b""
        wrong_float = struct.pack(
            "<f", random_source.choice((math.nan, math.inf, -math.inf, 3.4e38))
        )
        data = (
            bytearray(wrong_float + bytes(data[-4:]))
            if random_source.random() < 0.5
            else bytearray(bytes(data[:4]) + wrong_float)
        )
    if change_kind > 7 and len(data) == 8:
        data[1 + random_source.randrange(7)] = random_source.randrange(256)
    return frame._replace(data=bytes(data))


def are_states_equal(first_state: DriveState, second_state: DriveState, drive: Drive) -> bool:
    """Return True if two states of a drive are equal, apart from a difference that has no effect.

    For a CiA 402 drive, the later of two times has an effect: the time of the last feedback, and the
    time of the last sign of life. The earlier of the two times is not compared.
    """
    if isinstance(drive, Cia402Drive):
        first_state, second_state = (
            state._replace(
                protocol_state=state.protocol_state._replace(
                    life_sign_ns=max(state.protocol_state.life_sign_ns, state.feedback_t_ns)
                )
            )
            for state in (first_state, second_state)
        )
    numbers = [(first_state[i], second_state[i]) for i in range(1, 5)]
    are_numbers_equal = all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in numbers)
    return (
        are_numbers_equal
        and first_state[0] == second_state[0]
        and first_state[5:] == second_state[5:]
    )


def random_targets(random_source: random.Random) -> Iterator[DriveTarget]:
    while True:
        yield (
            DriveTarget.ENABLE
            if random_source.random() < 0.97
            else random_source.choice(list(DriveTarget))
        )


@pytest.mark.parametrize("seed", RANDOM_FRAME_SEEDS)
@pytest.mark.parametrize("variant_name", DRIVE_VARIANTS)
def test_compiled_code_and_state_machine_give_equal_results(variant_name: str, seed: int) -> None:
    drive, begin, t_ns, heard = enable_drive(variant_name)
    random_source = random.Random(f"{variant_name} {seed}")
    state, wired_drives, steady = begin, WiredDrives([drive], NO_SENSORS), 0
    wired_drives.store_drive_state(0, begin)
    for _, target in zip(range(TICKS_PER_SEED), random_targets(random_source), strict=False):
        wired_drives.begin_tick()
        for _ in range(random_source.randrange(4)):
            valid_frames = [*heard, *reply_to_open_request(drive, state)]
            is_valid_frame = random_source.random() < 0.7
            frame = (
                random_source.choice(valid_frames)._replace(t_ns=t_ns)
                if is_valid_frame
                else random_frame(random_source, valid_frames, t_ns)
            )
            state = drive.receive(state, frame)
            wired_drives.receive([frame])
            steady += not wired_drives.frames_for_drives
            assert are_states_equal(wired_drives.drive_state(0), state, drive), frame
        torque = random_source.uniform(-drive.command_limit, drive.command_limit)
        state, frames = drive.advance(state, t_ns, target, torque)
        assert wired_drives.send(target, [torque], t_ns) == list(frames)
        assert are_states_equal(wired_drives.drive_state(0), state, drive)
        if drive.steady_status(state) == NO_STEADY_STATUS and random_source.random() < 0.3:
            state = state_enabled_at(begin, drive.node_id, t_ns)
            wired_drives.store_drive_state(0, state)
        t_ns += PERIOD_NS
    assert steady > TICKS_PER_SEED // 4, "compiled code has hardly read a frame"


def state_enabled_at(state: DriveState, node_id: int, t_ns: int) -> DriveState:
    """Return the state of a drive as if the drive had been enabled at the time ``t_ns``.

    In the returned state, the next read-back of a drive setting is already due.
    """
    protocol_state = state.protocol_state
    time_fields = ("heartbeat_ns", "life_sign_ns", "heartbeat_sent_ns", "temperature_request_ns")
    times = {name: t_ns for name in time_fields if name in protocol_state._fields}
    recheck = readback.first_recheck(node_id, t_ns - readback.RECHECK_PERIOD_NS)
    return state._replace(
        feedback_t_ns=t_ns, recheck=recheck, protocol_state=protocol_state._replace(**times)
    )


def reply_to_open_request(drive: Drive, state: DriveState) -> list[Frame]:
    """Return several copies of the correct reply to a request for a drive setting.

    A test picks a frame at random from many frames. With 20 copies, the test often picks the
    correct reply.
    """
    if not (state.recheck.is_waiting and drive.rechecks):
        return []
    return [drive.rechecks[state.recheck.step].reply] * 20


RECHECKED_VARIANTS = [name for name in DRIVE_VARIANTS if name not in UNCHECKED_VARIANTS]


@pytest.mark.parametrize("name", RECHECKED_VARIANTS)
def test_compiled_code_reads_every_setting_again(name: str) -> None:
    """Compiled code sends each request for a drive setting, and accepts each right reply.

    Only wrong replies to a settings request reach the Python state machine of the drive.
    """
    drive, state, t_ns, _ = enable_drive(name)
    wired_drives = WiredDrives([drive], NO_SENSORS)
    count = len(drive.rechecks)
    for i in range(2 * count):
        recheck = readback.RecheckCursor(step=i % count, due_ns=t_ns)
        state = state_enabled_at(state, drive.node_id, t_ns)._replace(recheck=recheck)
        wired_drives.store_drive_state(0, state)
        checked_setting = drive.rechecks[i % count]
        sent = wired_drives.send(DriveTarget.ENABLE, [0.0], t_ns)
        assert checked_setting.request in sent
        waiting = wired_drives.drive_state(0)
        assert waiting.recheck == (i % count, t_ns + readback.RECHECK_PERIOD_NS, 1)
        wired_drives.begin_tick()
        wired_drives.receive([checked_setting.reply._replace(t_ns=t_ns)])
        assert not wired_drives.frames_for_drives
        expected_recheck = waiting.recheck._replace(step=(i + 1) % count, tries=0)
        assert wired_drives.drive_state(0).recheck == expected_recheck
        wired_drives.store_drive_state(0, waiting)
        bits = bytearray(checked_setting.reply.data)
        bits[checked_setting.compared_byte_range[1] - 1] ^= 1
        wrong_reply = checked_setting.reply._replace(data=bytes(bits), t_ns=t_ns)
        wired_drives.receive([wrong_reply])
        assert wired_drives.frames_for_drives == [wrong_reply]
        assert wired_drives.drive_state(0).phase == DrivePhase.FAULT
        assert "settings are lost" in wired_drives.drive_state(0).error_text


@pytest.mark.parametrize("name", RECHECKED_VARIANTS)
def test_compiled_code_leaves_a_setting_without_answers_to_the_state_machine(name: str) -> None:
    drive, state, t_ns, _ = enable_drive(name)
    wired_drives = WiredDrives([drive], NO_SENSORS)
    for tries in range(readback.RECHECK_TRIES):
        state = state_enabled_at(state, drive.node_id, t_ns)
        recheck = readback.RecheckCursor(due_ns=t_ns, tries=tries)
        wired_drives.store_drive_state(0, state._replace(recheck=recheck))
        sent = wired_drives.send(DriveTarget.ENABLE, [0.0], t_ns)
        assert drive.rechecks[0].request in sent
        is_last = tries + 1 == readback.RECHECK_TRIES
        assert (wired_drives.drive_state(0).phase == DrivePhase.FAULT) == is_last


@pytest.mark.parametrize("name", DRIVE_VARIANTS)
def test_invalid_torque_is_never_sent(name: str) -> None:
    drive, state, t_ns, _ = enable_drive(name)
    torque_beyond_limit = math.nextafter(drive.command_limit, math.inf)
    for torque in (math.nan, math.inf, -math.inf, torque_beyond_limit, -torque_beyond_limit):
        wired_drives = WiredDrives([drive], NO_SENSORS)
        wired_drives.store_drive_state(0, state)
        with pytest.raises(ValueError, match="expected at most"):
            wired_drives.send(DriveTarget.ENABLE, [torque], t_ns)
    for torque in (drive.command_limit, -drive.command_limit, 5e-324, -0.0):
        wired_drives = WiredDrives([drive], NO_SENSORS)
        wired_drives.store_drive_state(0, state)
        assert wired_drives.send(DriveTarget.ENABLE, [torque], t_ns) == list(
            drive.advance(state, t_ns, DriveTarget.ENABLE, torque)[1]
        )


@pytest.mark.parametrize("variant_name", DRIVE_VARIANTS)
def test_an_enabled_drive_is_steady_until_it_is_due(variant_name: str) -> None:
    drive, state, t_ns, _ = enable_drive(variant_name)
    assert bool(drive.rechecks) == (variant_name in RECHECKED_VARIANTS)
    assert drive.steady_status(state) != NO_STEADY_STATUS
    due_ns = drive.due_ns(state)
    assert due_ns > t_ns - PERIOD_NS
    for silent in (
        drive.initial_state(),
        state._replace(phase=DrivePhase.READY),
        state._replace(phase=DrivePhase.FAULT),
    ):
        assert drive.steady_status(silent) == NO_STEADY_STATUS


@pytest.mark.parametrize("variant_name", DRIVE_VARIANTS)
def test_cyclic_frames_are_what_the_bus_is_planned_for(variant_name: str) -> None:
    """`bus plan` computes the bus load from the cyclic commands and replies of a drive.

    The bus load does not include unsolicited or rare messages, although handctl decodes them.
    """
    drive, _, _, _ = enable_drive(variant_name)
    command_layouts = sorted(
        (message.length, bool(message.flags)) for message in drive.cyclic_messages.commands
    )
    requests = len(drive.cyclic_messages.commands) - 1 if isinstance(drive, OdriveDrive) else 1
    other_frames = list(drive.frames_per_tick)
    for command_layout in command_layouts:
        other_frames.remove(command_layout)
    assert len(other_frames) == requests
    assert {message.can_id for message in drive.cyclic_messages.feedback} <= drive.node_ids
    assert {message.can_id for message in drive.cyclic_messages.commands} - {
        0x080
    } <= drive.host_ids | drive.node_ids


def test_every_protocol_has_a_case() -> None:
    assert {variant.protocol for variant in DRIVE_VARIANTS.values()} == set(PROTOCOL_ENTRIES)
