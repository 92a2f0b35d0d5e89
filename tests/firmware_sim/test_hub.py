"""Test the hub of the local bus.

The hub forwards the frames of each client to all other clients, as records of bytes. The hub
completes every record that it has begun to send to a client, but never waits for a client.
"""

import os
import select
import socket
import stat
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from firmware_sim.bus.hub import BusHub
from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.socket_paths import bus_path, run_dir, truth_path

RECORD_BYTES = 72
CLASSICAL_FLAGS, FD_FLAGS = 0, 4


def frame_record(
    can_id: int, data: bytes, flags: int = CLASSICAL_FLAGS, dropped_record_count: int = 0
) -> bytes:
    """Build the bytes of the kernel's ``struct canfd_frame``, without the code of the hub."""
    head = (
        can_id.to_bytes(4, "little")
        + bytes((len(data), flags))
        + dropped_record_count.to_bytes(2, "little")
    )
    return head + data + bytes(64 - len(data))


@pytest.fixture(autouse=True)
def run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path / "run"))


@pytest.fixture
def hub() -> Iterator[BusHub]:
    bus_hub = BusHub("test")
    yield bus_hub
    bus_hub.close()


def serve_until_idle(hub: BusHub) -> bytes:
    """Let the hub serve its clients until no socket is ready.

    Return the records of frames that the hub passes to the simulator.
    """
    received = b""
    while ready := select.select(hub.read_sockets(), [], [], 0.0)[0]:
        received += hub.serve(ready)
    return received


@pytest.fixture
def connect_client(hub: BusHub) -> Iterator[Callable[[], socket.socket]]:
    links = []

    def connect() -> socket.socket:
        link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        link.connect(str(bus_path("test")))
        link.setblocking(False)
        links.append(link)
        serve_until_idle(hub)
        return link

    yield connect
    for link in links:
        link.close()


def read_all(client_socket: socket.socket) -> bytes:
    data = b""
    try:
        while received_bytes := client_socket.recv(1 << 20):
            data += received_bytes
    except BlockingIOError:
        pass
    return data


def test_all_but_the_sender_get_every_record_in_order(
    hub: BusHub, connect_client: Callable[[], socket.socket]
) -> None:
    a, b, c = connect_client(), connect_client(), connect_client()
    batch = (
        frame_record(0x123, b"\x01\x02")
        + frame_record(1 << 31 | 0x1ABCDE, bytes(range(64)), FD_FLAGS | 1)
        + frame_record(0x7FF, b"")
    )
    a.sendall(batch)
    assert serve_until_idle(hub) == batch
    assert (read_all(a), read_all(b), read_all(c)) == (b"", batch, batch)


def test_the_owners_records_reach_every_client(
    hub: BusHub, connect_client: Callable[[], socket.socket]
) -> None:
    a, b = connect_client(), connect_client()
    hub.send(frame_record(0x11, b"answer"))
    assert read_all(a) == read_all(b) == frame_record(0x11, b"answer")


@pytest.mark.parametrize("split_position", [1, 71, 73, 100, 143])
def test_a_record_cut_in_two_arrives_whole(
    hub: BusHub, connect_client: Callable[[], socket.socket], split_position: int
) -> None:
    a, b = connect_client(), connect_client()
    batch = frame_record(1, b"one") + frame_record(2, b"two")
    a.sendall(batch[:split_position])
    serve_until_idle(hub)
    assert read_all(b) == batch[: split_position - split_position % RECORD_BYTES]
    a.sendall(batch[split_position:])
    serve_until_idle(hub)
    assert read_all(b) == batch[split_position - split_position % RECORD_BYTES :]


def test_the_senders_reserved_bytes_do_not_look_like_drops(
    hub: BusHub, connect_client: Callable[[], socket.socket]
) -> None:
    a, b = connect_client(), connect_client()
    a.sendall(frame_record(1, b"x", dropped_record_count=0x1234))
    serve_until_idle(hub)
    assert read_all(b) == frame_record(1, b"x", dropped_record_count=0)


def record_numbers(record_bytes: bytes) -> list[tuple[int, int]]:
    """Return, for each record, its sequence number and the number of records that were dropped before it."""
    assert len(record_bytes) % RECORD_BYTES == 0
    rows = struct.iter_unpack("<4xBBHI60x", record_bytes)
    return [(number, dropped) for _, _, dropped, number in rows]


def test_a_client_that_never_reads_blocks_nobody_and_its_drops_are_counted(
    hub: BusHub, connect_client: Callable[[], socket.socket]
) -> None:
    reader, idle_client = connect_client(), connect_client()
    total, batch = 0, 1000
    received: list[tuple[int, int]] = []
    # The hub drops more records than the counter in a record can count.
    while hub.dropped_record_count < 70_000:
        hub.send(
            b"".join(
                frame_record(5, number.to_bytes(4, "little"))
                for number in range(total, total + batch)
            )
        )
        total += batch
        received += record_numbers(read_all(reader))
    assert received == [(number, 0) for number in range(total)]

    read = read_all(idle_client)
    hub.serve([])  # this call of ``serve`` completes a record that was partly sent
    read += read_all(idle_client)
    rows = record_numbers(read)
    assert rows == [(number, 0) for number in range(len(rows))], (
        "the first records are kept, complete and in order"
    )
    assert len(rows) + hub.dropped_record_count == total
    hub.send(frame_record(5, total.to_bytes(4, "little")))
    assert record_numbers(read_all(idle_client)) == [(total, hub.dropped_record_count % 65536)]


def test_an_incomplete_record_is_completed_before_the_next(
    hub: BusHub, connect_client: Callable[[], socket.socket]
) -> None:
    idle_client = connect_client()
    batch = b"".join(frame_record(number, number.to_bytes(4, "little")) for number in range(2000))
    while not hub.write_sockets():
        hub.send(batch)
        assert hub.dropped_record_count < 1_000_000, "the kernel accepted no part of a record"
        batch += frame_record(0, b"")  # with a larger batch, Linux splits the data at another byte
    dropped = hub.dropped_record_count
    hub.send(frame_record(1, b"while one is half sent"))
    assert hub.dropped_record_count == dropped + 1
    first_part = read_all(idle_client)
    assert len(first_part) % RECORD_BYTES
    hub.serve([])
    assert hub.write_sockets() == []
    hub.send(frame_record(0x7FF, b"next"))
    data = first_part + read_all(idle_client)
    assert len(data) % RECORD_BYTES == 0
    assert data[-RECORD_BYTES:] == frame_record(
        0x7FF, b"next", dropped_record_count=hub.dropped_record_count % 65536
    )


def test_drops_of_a_disconnected_client_still_count(
    hub: BusHub, connect_client: Callable[[], socket.socket]
) -> None:
    stays, leaves = connect_client(), connect_client()
    while not hub.dropped_record_count:
        hub.send(frame_record(1, b"") * 100)
        read_all(stays)
    dropped_count_before = hub.dropped_record_count
    leaves.close()
    serve_until_idle(hub)
    assert hub.client_count == 1
    assert hub.dropped_record_count == dropped_count_before
    hub.send(frame_record(2, b"still here"))
    assert read_all(stays) == frame_record(2, b"still here")


def test_a_second_hub_is_refused_and_the_first_goes_on(
    hub: BusHub, connect_client: Callable[[], socket.socket]
) -> None:
    a, b = connect_client(), connect_client()
    with pytest.raises(SimulatorError, match=r"local:test is already served"):
        BusHub("test")
    serve_until_idle(hub)
    a.sendall(frame_record(3, b"alive"))
    serve_until_idle(hub)
    assert read_all(b) == frame_record(3, b"alive")


def test_a_stale_socket_is_replaced() -> None:
    code = "import os\nfrom firmware_sim.bus.hub import BusHub\nhub = BusHub('stale')\nos._exit(0)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    assert stat.S_ISSOCK(bus_path("stale").stat().st_mode)
    hub = BusHub("stale")
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    link.connect(str(bus_path("stale")))
    serve_until_idle(hub)
    assert hub.client_count == 1
    link.close()
    hub.close()


def test_closing_removes_the_socket_but_not_a_successors(hub: BusHub) -> None:
    path = bus_path("test")
    path.unlink()
    second_hub = BusHub("test")
    hub.close()
    assert path.exists()
    second_hub.close()
    assert not path.exists()


def test_the_run_directory_is_closed_to_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert stat.S_IMODE(run_dir().stat().st_mode) == 0o700
    monkeypatch.delenv("HANDCTL_RUN_DIR")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "xdg"))
    assert bus_path("demo") == tmp_path / "xdg" / "handctl" / "demo.bus"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert run_dir() == tmp_path / f"handctl-{os.getuid()}" / "handctl"
    assert stat.S_IMODE(run_dir().parent.stat().st_mode) == 0o700


@pytest.mark.parametrize("bus_name", ["", "a/b", ".hidden", "x" * 120])
def test_invalid_bus_names_are_refused(bus_name: str) -> None:
    with pytest.raises(SimulatorError):
        bus_path(bus_name)


def test_the_truth_file_is_named_after_the_bus() -> None:
    assert truth_path("local:demo").name == "local_demo.truth"
    assert truth_path("join:demo").name == "local_demo.truth"
    assert truth_path("socketcan:vcan0").name == "socketcan_vcan0.truth"
