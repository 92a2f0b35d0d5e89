"""Test the ring buffer of observations in shared memory, and the socket for streamed targets.

In the tests of the ring buffer, writer and reader are in one process.
"""

import copy
import errno
import math
import os
import pickle
import struct
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from handctl.client import Observation
from handctl.core.tick_types import (
    TELEMETRY_AXES,
    TELEMETRY_FIELDS,
    HandMode,
    PackedTelemetry,
    TelemetrySlices,
    TickIn,
    TickOut,
)
from handctl.errors import BusError
from handctl.hand.hand_loading import load_hand
from handctl.programs.stream_plans import StreamStatus
from handctl.runtime.mailbox import Mailbox
from handctl.runtime.observations import (
    RING_RECORDS,
    ObservationReader,
    ObservationWriter,
    observation_dtype,
)
from handctl.runtime.socket_paths import observations_path, targets_path
from handctl.runtime.target_socket import (
    HEADER_STRUCT,
    MAX_DATAGRAMS_PER_TICK,
    MAX_TARGETS_PER_TICK,
    TARGET_MAGIC,
    TargetReceiver,
    TargetSender,
)
from handctl.safety.safety_action import SafetyAction

AXIS_LENGTHS = {"joint": 3, "tendon": 2, "motor": 2, "digit": 1}


@pytest.fixture(autouse=True)
def run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder for the sockets and files of one test."""
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path / "h"))
    return tmp_path


def telemetry_of_tick(tick_index: int) -> PackedTelemetry:
    """Return telemetry in which number i of tick k has the value 1000 k + i."""
    places, first_element = TelemetrySlices(), 0
    for name in TELEMETRY_FIELDS:
        places[name] = slice(first_element, first_element + AXIS_LENGTHS[TELEMETRY_AXES[name]])
        first_element = places[name].stop
    return PackedTelemetry(1000.0 * tick_index + np.arange(first_element), places)


CLOSED_STREAM_STATUS = StreamStatus()


def ticks_of_unread_records(reader: ObservationReader) -> list[int]:
    """Return the ticks of all records that the reader has not yet read."""
    ticks = list[int]()
    while (record := reader.next_record()) is not None:
        ticks.append(record["k"].item())
    return ticks


def write_observation(
    writer: ObservationWriter, tick_index: int, status: StreamStatus = CLOSED_STREAM_STATUS
) -> None:
    """Write the record of the tick ``tick_index`` into the ring of observations."""
    out = TickOut(
        (), HandMode.ACTIVE, "live", SafetyAction.WARN, telemetry_of_tick(tick_index), (), bytes(8)
    )
    writer.write_record(
        TickIn(tick_index, 2_000_000 * tick_index, 7), out, status, time.monotonic_ns()
    )


@pytest.mark.parametrize("error_number", [errno.ENOSPC, errno.ENOMEM, errno.EFBIG])
def test_a_full_disk_is_an_error_and_leaves_no_file(
    error_number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail_to_allocate(*_: int) -> None:
        raise OSError(error_number, os.strerror(error_number))

    monkeypatch.setattr(os, "posix_fallocate", fail_to_allocate)
    with pytest.raises(BusError, match="cannot write observations"):
        ObservationWriter("local:x", AXIS_LENGTHS, {})
    assert not observations_path("local:x").exists()


def test_a_record_comes_back_with_every_field() -> None:
    writer = ObservationWriter("local:x", AXIS_LENGTHS, {"rate_Hz": 500.0})
    reader = ObservationReader("local:x")
    assert reader.latest_record() is None
    assert reader.description["rate_Hz"] == 500.0
    write_observation(writer, 41, StreamStatus(5, 0.25, 6, 7, 8, 9, 10))
    record = reader.latest_record()
    assert record is not None
    assert (record["k"], record["t_ns"], record["late_ns"]) == (41, 82_000_000, 7)
    assert (record["mode"], record["action"], record["phase"]) == (
        HandMode.ACTIVE,
        SafetyAction.WARN,
        b"live",
    )
    assert [record[name].item() for name in record.dtype.names or () if name.startswith("stream_")] == [
        5, 0.25, 6, 7, 8, 9, 10,
    ]  # fmt: skip
    packed = telemetry_of_tick(41)
    np.testing.assert_array_equal(record["q_rad"], packed.q)
    np.testing.assert_array_equal(record["tip_force_sigma_N"], packed.tip_force_sigma)
    assert 0 <= time.monotonic_ns() - int(record["published_ns"]) < 5e9
    reader.close()
    writer.close()


@pytest.mark.parametrize("attribute_name", ["jamia", "n_plus_1"])
def test_an_observation_is_copied_pickled_and_listed(attribute_name: str) -> None:
    """Reproduce a defect: ``copy.copy`` and ``pickle`` of an observation raised a RecursionError.

    In addition, ``dir(observation)`` did not list the fields of the observation.

    Programs put observations into queues between processes, and notebooks complete names with
    ``dir``.
    """
    hand = load_hand(attribute_name)
    axes = {"joint": len(hand.joints), "tendon": len(hand.tendon), "motor": len(hand.motor)}
    record = np.zeros((), observation_dtype(axes | {"digit": len(hand.digit)}))
    record["q_rad"] = np.arange(len(hand.joints))
    observation = Observation(record, hand)
    for again in (
        copy.copy(observation),
        copy.deepcopy(observation),
        pickle.loads(pickle.dumps(observation)),
    ):
        assert again.record == observation.record
        assert again.named("q_rad") == observation.named("q_rad")
        assert repr(again) == repr(observation)
    assert {"q_rad", "tension_N", "motor_age_s", "t_s", "named"} <= set(dir(observation))
    with pytest.raises(AttributeError, match="no field 'q_red' in an observation"):
        observation.q_red  # noqa: B018


def test_a_reader_gets_every_tick_once_and_a_late_one_misses_the_oldest() -> None:
    writer = ObservationWriter("local:x", AXIS_LENGTHS, {})
    reader = ObservationReader("local:x")
    for k in range(10):
        write_observation(writer, k)
    assert ticks_of_unread_records(reader) == list(range(10))
    for k in range(10, 10 + 2 * RING_RECORDS):
        write_observation(writer, k)
    late_ticks = ticks_of_unread_records(reader)
    assert late_ticks == list(range(10 + 2 * RING_RECORDS - len(late_ticks), 10 + 2 * RING_RECORDS))
    assert RING_RECORDS - 4 <= len(late_ticks) < RING_RECORDS
    reader.close()
    writer.close()


def test_no_reader_sees_a_torn_record() -> None:
    writer = ObservationWriter("local:x", AXIS_LENGTHS, {})
    stop, torn, read_ticks = threading.Event(), list[int](), list[int]()

    def read() -> None:
        reader = ObservationReader("local:x")
        while not stop.is_set():
            record = reader.latest_record()
            if record is not None:
                k = record["k"].item()
                read_ticks.append(k)
                if not np.array_equal(record["q_rad"], 1000.0 * k + np.arange(3)):
                    torn.append(k)
        reader.close()

    reader_threads = [threading.Thread(target=read) for _ in range(2)]
    for reader_thread in reader_threads:
        reader_thread.start()
    for k in range(20_000):
        write_observation(writer, k)
    stop.set()
    for reader_thread in reader_threads:
        reader_thread.join()
    assert not torn
    assert len(set(read_ticks)) > 10
    writer.close()


def test_a_half_written_record_is_not_returned() -> None:
    writer = ObservationWriter("local:x", AXIS_LENGTHS, {})
    reader = ObservationReader("local:x")
    write_observation(writer, 1)
    writer._counters[0][0] = 3  # the ring's counter is 3 while record 2 is written
    assert reader.read_record(0) is None
    assert reader.latest_record() is None, "a reader does not wait for a dead writer"
    reader.close()
    writer.close()


def test_the_file_is_private_and_is_removed_after_the_run() -> None:
    writer = ObservationWriter("local:x", AXIS_LENGTHS, {})
    path = observations_path("local:x")
    assert path.stat().st_mode & 0o777 == 0o600
    reader = ObservationReader("local:x")
    assert not reader.has_run_ended
    writer.close()
    assert reader.has_run_ended
    assert not path.exists()
    reader.close()
    with pytest.raises(
        BusError, match="bus local:x: no observations; expected a running handctl run"
    ):
        ObservationReader("local:x")


def test_a_file_that_a_killed_controller_left_is_replaced() -> None:
    path = observations_path("local:x")
    path.write_bytes(b"old")
    with pytest.raises(BusError, match="of this version"):
        ObservationReader("local:x") if path.write_bytes(b"x" * 100) else None
    writer = ObservationWriter("local:x", AXIS_LENGTHS, {})
    ObservationReader("local:x").close()
    writer.close()


def test_targets_arrive_in_order_with_the_time_of_the_run() -> None:
    box = TargetReceiver("local:x", lambda ns: ns - 1000)
    sender = TargetSender("local:x", 17, 3)
    for index in range(3):
        assert sender.send(index, 5000 + index, np.array([0.1, math.nan, 1e308]))
    targets = box.read_targets()
    assert [target[:3] for target in targets] == [
        ("17-3", index, 4000 + index) for index in range(3)
    ]
    assert targets[0].values[0] == 0.1
    assert math.isnan(targets[0].values[1])
    assert targets[0].values[2] == 1e308
    assert box.read_targets() == ()
    sender.close()
    box.close()
    assert not targets_path("local:x").exists()


def test_a_flood_neither_blocks_nor_delays_a_stop() -> None:
    """If too many targets arrive at the socket for streams, the next tick gets the newest targets.

    Requests such as a stop use another socket, so the flood of targets does not delay these
    requests.
    """
    box, mail = TargetReceiver("local:x", int), Mailbox("local:x")
    sender, sent = TargetSender("local:x", 1, 1), 0
    start_time_s = time.monotonic()
    while time.monotonic() < start_time_s + 0.2:
        sent += sender.send(sent, sent, np.zeros(4))
    read = 0
    while targets := box.read_targets():
        assert len(targets) <= MAX_TARGETS_PER_TICK
        assert targets[-1].number == min(read + MAX_DATAGRAMS_PER_TICK, sent) - 1, (
            "the newest message of those read"
        )
        read += MAX_DATAGRAMS_PER_TICK
    assert mail.read_requests() == ()
    sender.close()
    box.close()
    mail.close()


@pytest.mark.parametrize(
    "datagram",
    [
        b"", b"HCT1", b"x" * 1000, HEADER_STRUCT.pack(b"HCT0", 1, 1, 0, 0, 0),
        HEADER_STRUCT.pack(TARGET_MAGIC, 1, 1, 2, 0, 0) + bytes(8),
        HEADER_STRUCT.pack(TARGET_MAGIC, 1, 1, 2**32 - 1, 0, 0),
        HEADER_STRUCT.pack(TARGET_MAGIC, 1, 1, 65, 0, 0) + bytes(8 * 65),
    ],
)  # fmt: skip
def test_a_datagram_of_another_form_is_dropped(datagram: bytes) -> None:
    box, sender = TargetReceiver("local:x", int), TargetSender("local:x", 1, 1)
    sender._socket.send(datagram)
    assert box.read_targets() == ()
    sender._socket.send(
        HEADER_STRUCT.pack(TARGET_MAGIC, 1, 1, 1, 2**63 - 1, -(2**63)) + struct.pack("<d", 5.0)
    )
    assert box.read_targets()[0].values == (5.0,)
    sender.close()
    box.close()


def test_a_sender_without_a_controller_reports_it() -> None:
    with pytest.raises(
        BusError, match="bus local:x: no controller accepts targets; expected a running handctl run"
    ):
        TargetSender("local:x", os.getpid(), 1)
