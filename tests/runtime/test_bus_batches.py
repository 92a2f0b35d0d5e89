"""Test how all kinds of buses treat unusual batches of frames.

An unusual batch contains frames of mixed kinds with 0 to 64 bytes, error frames, or more frames
than a buffer can store.
"""

import random
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from handctl.compiled import compile_kernels
from handctl.drives.frame import BRS, ERROR_FLAG, EXTENDED_FLAG, FDF, Frame
from handctl.drives.frame_records import (
    FRAME_RECORD_DTYPE,
    WORDS_PER_RECORD,
    Frames,
    concatenate_frames,
    frames_as_records,
)
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.buses.contract import Bus
from handctl.runtime.buses.socketcan import MAX_FRAMES_PER_CALL, SocketCanBus
from tests.runtime.bus_hub import RUN_DIR_VARIABLE, ScriptedHub, frame_record
from tests.runtime.datagram_bus import datagram_bus

CLASSICAL_FRAME_STRUCT, FD_FRAME_STRUCT = struct.Struct("=IB3x8s"), struct.Struct("=IBB2x64s")
"""Layouts of classical and FD frames in Linux. Source: Linux ``can.h``."""
CLASSICAL_PAYLOAD_SIZES = (0, 1, 7, 8)
FD_PAYLOAD_SIZES = (0, 8, 12, 64)
BUS_INDEX = 3


def mixed_frames(frame_count: int, seed: int) -> list[Frame]:
    """Return classical and FD frames of various lengths in random order."""
    rng = random.Random(seed)
    frames = []
    for number in range(frame_count):
        can_id = rng.choice((number & 0x7FF, number | EXTENDED_FLAG))
        fd = rng.random() < 0.5
        size = rng.choice(FD_PAYLOAD_SIZES if fd else CLASSICAL_PAYLOAD_SIZES)
        frames.append(
            Frame(can_id, rng.randbytes(size), (FDF | rng.choice((0, BRS))) if fd else 0, BUS_INDEX)
        )
    return frames


def equal_frames(payload_size: int, frame_flags: int) -> list[Frame]:
    return [
        Frame(number, bytes([number + 1] * payload_size), frame_flags, BUS_INDEX)
        for number in range(11)
    ]


FRAME_BATCH_BY_NAME = {
    **{f"classical of {size}": equal_frames(size, 0) for size in CLASSICAL_PAYLOAD_SIZES},
    **{f"FD of {size}": equal_frames(size, FDF) for size in FD_PAYLOAD_SIZES},
    "one frame": equal_frames(8, 0)[:1],
    "mixed": mixed_frames(40, 1),
    "mixed, more than a buffer": mixed_frames(2 * MAX_FRAMES_PER_CALL + 44, 2),
}


def frame_contents(frames: Frames) -> list[tuple[int, bytes, int, int]]:
    return [frame[:4] for frame in frames]


def has_zeros_behind_payloads(frames: Frames) -> bool:
    """Return True if frame records contain only zeros after each payload.

    Also assert that each frame record has ``WORDS_PER_RECORD`` words.
    """
    assert frames.rows.shape == (len(frames), WORDS_PER_RECORD)
    is_behind_payload = np.arange(64) >= frames.records["length"][:, np.newaxis]
    return not frames.records["data"][is_behind_payload].any()


@pytest.fixture
def local_bus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[Bus, socket.socket]]:
    monkeypatch.setenv(RUN_DIR_VARIABLE, str(tmp_path))
    scripted_hub = ScriptedHub(tmp_path, "x")
    bus = open_bus("local:x", BUS_INDEX, 1_000_000)
    link = scripted_hub.accept_client()
    yield bus, link
    bus.close()
    link.close()
    scripted_hub.close()


@pytest.fixture
def udp_bus() -> Iterator[tuple[SocketCanBus, socket.socket]]:
    with datagram_bus(BUS_INDEX) as pair:
        yield pair


def drain_frames(bus: Bus, frame_count: int) -> Frames:
    frame_batches = [bus.drain()]
    end = time.monotonic() + 20.0
    while sum(map(len, frame_batches)) < frame_count and time.monotonic() < end:
        time.sleep(0.001)
        frame_batches.append(bus.drain())
    return concatenate_frames(frame_batches)


def kernel_datagram(frame: Frame, trailing_bytes: bytes = b"") -> bytes:
    """Return a frame as Linux can deliver it, with arbitrary bytes after the payload.

    The driver of a CAN adapter is free to leave arbitrary bytes after the payload.
    """
    can_id, data, flags, *_ = frame
    if flags & FDF:
        return FD_FRAME_STRUCT.pack(
            can_id, len(data), flags, data + trailing_bytes[: 64 - len(data)]
        )
    return CLASSICAL_FRAME_STRUCT.pack(can_id, len(data), data + trailing_bytes[: 8 - len(data)])


@pytest.mark.parametrize("batch_name", FRAME_BATCH_BY_NAME)
def test_local_bus_carries_every_batch_both_ways(
    local_bus: tuple[Bus, socket.socket], batch_name: str
) -> None:
    bus, link = local_bus
    batch = FRAME_BATCH_BY_NAME[batch_name]
    all_records = b"".join(frame_record(frame.can_id, frame.data, frame.flags) for frame in batch)
    assert bus.send(frames_as_records(batch)) == len(batch)
    sent_records = b""
    while len(sent_records) < len(all_records):
        sent_records += link.recv(1 << 20)
    assert sent_records == all_records
    link.sendall(all_records)
    frames = drain_frames(bus, len(batch))
    assert frame_contents(frames) == [frame[:4] for frame in batch]
    assert has_zeros_behind_payloads(frames)
    assert bus.take_events() == []


@pytest.mark.parametrize("batch_name", FRAME_BATCH_BY_NAME)
def test_can_socket_carries_every_batch_both_ways(
    udp_bus: tuple[SocketCanBus, socket.socket], batch_name: str
) -> None:
    bus, peer_socket = udp_bus
    batch = FRAME_BATCH_BY_NAME[batch_name]
    assert bus.send(frames_as_records(batch)) == len(batch)
    assert [peer_socket.recv(100) for _ in batch] == [kernel_datagram(frame) for frame in batch]
    for frame in batch:
        peer_socket.send(kernel_datagram(frame))
    frames = drain_frames(bus, len(batch))
    assert frame_contents(frames) == [frame[:4] for frame in batch]
    assert has_zeros_behind_payloads(frames)


def test_batches_of_all_kinds_in_turn_leave_no_bytes_of_one_another(
    local_bus: tuple[Bus, socket.socket], udp_bus: tuple[SocketCanBus, socket.socket]
) -> None:
    for batch in [*FRAME_BATCH_BY_NAME.values(), *reversed(FRAME_BATCH_BY_NAME.values())]:
        test_batch = batch[:MAX_FRAMES_PER_CALL]
        for bus, link in (local_bus, udp_bus):
            assert bus.send(frames_as_records(test_batch)) == len(test_batch)
            if bus is local_bus[0]:
                all_records = b"".join(
                    frame_record(frame.can_id, frame.data, frame.flags) for frame in test_batch
                )
                sent_records = b""
                while len(sent_records) < len(all_records):
                    sent_records += link.recv(1 << 20)
                assert sent_records == all_records
                link.sendall(all_records)
            else:
                assert [link.recv(100) for _ in test_batch] == [
                    kernel_datagram(frame) for frame in test_batch
                ]
                for frame in test_batch:
                    link.send(kernel_datagram(frame))
            frames = drain_frames(bus, len(test_batch))
            assert frame_contents(frames) == [frame[:4] for frame in test_batch]
            assert has_zeros_behind_payloads(frames)


def test_bytes_behind_a_payload_are_ignored(
    local_bus: tuple[Bus, socket.socket], udp_bus: tuple[SocketCanBus, socket.socket]
) -> None:
    trailing_bytes = b"\xff" * 64
    batch = [*equal_frames(3, 0), *equal_frames(12, FDF), *equal_frames(0, 0)]
    bus, link = local_bus
    for frame in batch:
        whole_record = frame_record(frame.can_id, frame.data, frame.flags)
        link.sendall(whole_record[: 8 + len(frame.data)] + trailing_bytes[: 64 - len(frame.data)])
    frames = drain_frames(bus, len(batch))
    assert frame_contents(frames) == [frame[:4] for frame in batch]
    assert has_zeros_behind_payloads(frames)
    can, peer_socket = udp_bus
    for sent_frames in (batch[:11], batch[11:22], batch):
        for frame in sent_frames:
            peer_socket.send(kernel_datagram(frame, trailing_bytes))
        frames = drain_frames(can, len(sent_frames))
        assert frame_contents(frames) == [frame[:4] for frame in sent_frames]
        assert has_zeros_behind_payloads(frames)


def test_error_frames_between_others_become_events_and_keep_the_order(
    local_bus: tuple[Bus, socket.socket], udp_bus: tuple[SocketCanBus, socket.socket]
) -> None:
    batch = mixed_frames(20, 3)
    bus_off_frame = Frame(ERROR_FLAG | 0x40, bytes(8))
    bus, link = local_bus
    link.sendall(
        b"".join(
            frame_record(f.can_id, f.data, f.flags)
            + frame_record(bus_off_frame.can_id, bus_off_frame.data)
            for f in batch
        )
    )
    assert frame_contents(drain_frames(bus, len(batch))) == [frame[:4] for frame in batch]
    assert bus.take_events() == [("error_frame", "local:x bus off", 20), ("bus_off", "local:x", 1)]
    can, peer_socket = udp_bus
    for frame in batch:
        peer_socket.send(kernel_datagram(frame))
        peer_socket.send(kernel_datagram(bus_off_frame))
    assert frame_contents(drain_frames(can, len(batch))) == [frame[:4] for frame in batch]
    events = [("error_frame", "socketcan:test bus off", 20), ("bus_off", "socketcan:test", 1)]
    assert can.take_events() == events
    link.sendall(frame_record(bus_off_frame.can_id, bus_off_frame.data))
    peer_socket.send(kernel_datagram(bus_off_frame))
    time.sleep(0.05)
    assert len(bus.drain()) == len(can.drain()) == 0
    assert bus.take_events()
    assert can.take_events()


def test_a_record_split_within_an_odd_batch_is_reassembled(
    local_bus: tuple[Bus, socket.socket],
) -> None:
    bus, link = local_bus
    batch = mixed_frames(30, 4)
    all_records = b"".join(frame_record(frame.can_id, frame.data, frame.flags) for frame in batch)
    frame_batches = []
    at = 0
    for cut in (1, 71, 72, 73, 100, 500, 700, len(all_records)):
        link.sendall(all_records[at : at + cut])
        frame_batches.append(bus.drain())
        at += cut
        assert sum(map(len, frame_batches)) == min(at, len(all_records)) // 72
    assert frame_contents(concatenate_frames(frame_batches)) == [frame[:4] for frame in batch]


@pytest.mark.parametrize("payload_size", [9, 12, 64])
def test_a_classical_frame_that_is_too_long_is_refused_as_record_too(
    local_bus: tuple[Bus, socket.socket],
    udp_bus: tuple[SocketCanBus, socket.socket],
    payload_size: int,
) -> None:
    good_frames = [Frame(1, b"good")]
    for bus, link in (local_bus, udp_bus):
        for _ in range(2):
            with pytest.raises(ValueError, match=f"payload of {payload_size} bytes in frame 0x7"):
                bus.send(
                    frames_as_records([*good_frames, Frame(7, bytes(payload_size)), *good_frames])
                )
        assert bus.send(good_frames) == 1
        assert link.recv(1000).startswith(struct.pack("<IB", 1, 4))


@pytest.mark.parametrize("time_scale", [1.0, 0.1, 3.0])
def test_the_kernels_stamps_become_the_runs_time(
    udp_bus: tuple[SocketCanBus, socket.socket], time_scale: float
) -> None:
    bus, peer_socket = udp_bus
    bus._convert_time = lambda t_ns: int((t_ns - 1000) * time_scale)
    time.sleep(0.3)  # the Linux kernel begins to add time stamps after a delay
    for _ in range(3):
        time_ns_before = time.monotonic_ns()
        for number in range(11):
            peer_socket.send(CLASSICAL_FRAME_STRUCT.pack(number, 8, bytes(8)))
        time_ns_after = time.monotonic_ns()
        stamps = [frame.t_ns for frame in drain_frames(bus, 11)]
        slack = 5_000_000
        assert (
            (time_ns_before - slack) * time_scale
            <= stamps[0]
            <= stamps[-1]
            <= (time_ns_after + slack) * time_scale
        )
        assert stamps == sorted(stamps)
        assert len(set(stamps)) > 1


def test_frames_in_read_only_memory_are_sent(
    local_bus: tuple[Bus, socket.socket], udp_bus: tuple[SocketCanBus, socket.socket]
) -> None:
    compile_kernels()  # from here on, a compiled kernel accepts only arguments of its declared types
    batch = equal_frames(8, 0)
    frames = Frames.from_records(
        np.frombuffer(frames_as_records(batch).records.tobytes(), FRAME_RECORD_DTYPE)
    )
    for bus, link in (local_bus, udp_bus):
        assert bus.send(frames) == len(batch)
        assert link.recv(16).startswith(struct.pack("<IB", batch[0].can_id, 8))
