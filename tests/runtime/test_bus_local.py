"""Test the edge cases of the local bus.

The edge cases are partial frame records, a slow or lost hub, dropped frames, and error frames.
"""

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.drives.frame import ERROR_FLAG, FDF, Frame
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.buses.contract import Bus
from tests.runtime.bus_hub import RUN_DIR_VARIABLE, ScriptedHub, frame_record

RECORD_BYTES = 72


@pytest.fixture
def scripted_bus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[Bus, socket.socket]]:
    monkeypatch.setenv(RUN_DIR_VARIABLE, str(tmp_path))
    scripted_hub = ScriptedHub(tmp_path, "x")
    bus = open_bus("local:x", 2, 1_000_000)
    link = scripted_hub.accept_client()
    yield bus, link
    bus.close()
    link.close()
    scripted_hub.close()


@pytest.fixture(scope="module")
def bus_with_partial_records(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[Bus, socket.socket]]:
    folder = tmp_path_factory.mktemp("torn")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(RUN_DIR_VARIABLE, str(folder))
        scripted_hub = ScriptedHub(folder, "x")
        bus = open_bus("local:x", 2, 1_000_000)
    link = scripted_hub.accept_client()
    yield bus, link
    bus.close()
    link.close()
    scripted_hub.close()


def test_a_record_is_laid_out_as_agreed(scripted_bus: tuple[Bus, socket.socket]) -> None:
    bus, link = scripted_bus
    assert bus.send([Frame(0x123, b"\x01\x02"), Frame(0x80000456, bytes(range(12)), FDF)]) == 2
    assert link.recv(1000) == frame_record(0x123, b"\x01\x02") + frame_record(
        0x80000456, bytes(range(12)), FDF
    )
    link.send(frame_record(0x7FF, b"reply"))
    (frame,) = bus.drain()
    assert frame[:4] == (0x7FF, b"reply", 0, 2)


@given(
    cut_positions=st.lists(st.integers(1, 200), min_size=1, max_size=40),
    frame_count=st.integers(1, 20),
)
def test_records_split_anywhere_are_reassembled(
    bus_with_partial_records: tuple[Bus, socket.socket], cut_positions: list[int], frame_count: int
) -> None:
    bus, link = bus_with_partial_records
    stream = b"".join(
        frame_record(number, bytes([number] * (number % 9))) for number in range(frame_count)
    )
    frames: list[Frame] = []
    at = 0
    for cut in cut_positions:
        link.send(stream[at : at + cut])
        frames += bus.drain()
        at += cut
        assert len(frames) == min(at, len(stream)) // RECORD_BYTES
    link.send(stream[at:])
    frames += bus.drain()
    assert [(frame.can_id, frame.data) for frame in frames] == [
        (n, bytes([n] * (n % 9))) for n in range(frame_count)
    ]


def test_a_slow_hub_costs_frames_but_no_time_and_no_alignment(
    scripted_bus: tuple[Bus, socket.socket],
) -> None:
    bus, link = scripted_bus
    start = time.monotonic()
    accepted = []
    sent = 0
    while sum(number for _, _, number in bus.take_events()) == 0:
        batch = [Frame((sent + i) & 0x7FF, (sent + i).to_bytes(4, "little")) for i in range(97)]
        accepted_count = bus.send(batch)
        accepted += [frame.data for frame in batch[:accepted_count]]
        sent += len(batch)
    refused = [Frame(1, b"late")] * 5
    assert bus.send(refused) == 0
    assert bus.take_events() == [("enobufs", "local:x", 5)]
    assert time.monotonic() - start < 10.0
    stream = b""
    while len(stream) < (len(accepted) - 1) * RECORD_BYTES:
        stream += link.recv(1 << 20)
    assert bus.send([Frame(2, b"after")]) == 1
    while len(stream) < (len(accepted) + 1) * RECORD_BYTES:
        stream += link.recv(1 << 20)
    records = [stream[at : at + RECORD_BYTES] for at in range(0, len(stream), RECORD_BYTES)]
    assert [record[8:12] for record in records[:-1]] == accepted
    assert records[-1] == frame_record(2, b"after")


@pytest.mark.parametrize(
    ("drop_counters", "expected_dropped"),
    [([0, 0, 0], 0), ([0, 3, 3], 3), ([65_530, 4], 65_540), ([7, 7, 65_535, 1], 65_537)],
)
def test_frames_dropped_by_the_hub_are_reported_once(
    scripted_bus: tuple[Bus, socket.socket], drop_counters: list[int], expected_dropped: int
) -> None:
    bus, link = scripted_bus
    numbers = []
    for counter in drop_counters:
        link.send(frame_record(1, b"", dropped_frames=counter))
        assert len(bus.drain()) == 1
        numbers += bus.take_events()
    assert all(event[:2] == ("dropped", "local:x") for event in numbers)
    assert sum(event[2] for event in numbers) == expected_dropped


def test_a_lost_hub_is_reported_at_every_call(scripted_bus: tuple[Bus, socket.socket]) -> None:
    bus, link = scripted_bus
    link.send(frame_record(5, b"last"))
    link.close()
    assert [frame.can_id for frame in bus.drain()] == [5]
    assert bus.drain() == []
    for _ in range(3):
        assert bus.take_events() == [("enodev", "local:x", 1)]
        assert bus.send([Frame(1, b"")]) == 0
        assert bus.drain() == []


def test_sending_to_a_lost_hub_does_not_raise(scripted_bus: tuple[Bus, socket.socket]) -> None:
    bus, link = scripted_bus
    link.close()
    assert bus.send([Frame(1, b"")]) == 0
    assert bus.take_events() == [("enodev", "local:x", 1)]


def test_error_frames_become_events(scripted_bus: tuple[Bus, socket.socket]) -> None:
    bus, link = scripted_bus
    link.send(frame_record(ERROR_FLAG | 0x40, bytes(8)) + frame_record(7, b"data"))
    assert [frame.can_id for frame in bus.drain()] == [7]
    kinds = [kind for kind, _, _ in bus.take_events()]
    assert kinds == ["error_frame", "bus_off"]


@given(hub_bytes=st.binary(min_size=RECORD_BYTES, max_size=5 * RECORD_BYTES))
def test_no_bytes_from_a_hub_can_raise(
    bus_with_partial_records: tuple[Bus, socket.socket], hub_bytes: bytes
) -> None:
    bus, link = bus_with_partial_records
    whole_hub_bytes = hub_bytes[: len(hub_bytes) - len(hub_bytes) % RECORD_BYTES]
    link.send(whole_hub_bytes)
    frames = bus.drain()
    bus.take_events()
    assert len(frames) <= len(whole_hub_bytes) // RECORD_BYTES
    assert all(len(frame.data) <= 64 for frame in frames)
