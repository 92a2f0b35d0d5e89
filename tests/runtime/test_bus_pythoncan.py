"""Test that errors of python-can become events, and that the tools of python-can can use handctl's local bus."""

import asyncio
import errno
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest

from handctl.drives.frame import Frame
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.buses.contract import Bus
from handctl.runtime.buses.pythoncan import PythonCanBus
from tests.runtime.bus_hub import RUN_DIR_VARIABLE, ScriptedHub, frame_record, hub_process


class BrokenCanBus(can.BusABC):
    """Interface of python-can that raises a given error.

    The first ``failure_count`` calls of the interface raise ``error``. Later calls succeed.
    """

    def __init__(self, error: Exception, failure_count: int = 1_000_000) -> None:
        super().__init__("broken")
        self.error = error
        self.times = failure_count

    def _raise_error(self) -> None:
        if self.times > 0:
            self.times -= 1
            raise self.error

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._raise_error()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._raise_error()
        return None, False


@pytest.fixture
def virtual_bus() -> Iterator[PythonCanBus]:
    opened_bus = PythonCanBus("virtual", "broken", 0, 1_000_000, None, int)
    yield opened_bus
    opened_bus.close()


def test_frames_that_an_adapter_echoes_are_not_received(virtual_bus: PythonCanBus) -> None:
    """A gs_usb adapter returns every sent frame to the host as if it were received.

    The bus must discard the echo of a sent frame, because the echo looks like a frame of a second
    controller.
    """
    virtual_bus._bus.shutdown()
    virtual_bus._bus = can.Bus("broken", interface="virtual", receive_own_messages=True)
    with can.Bus("broken", interface="virtual") as other_bus:
        virtual_bus.send([Frame(1, b"mine")])
        other_bus.send(can.Message(arbitration_id=0x11, data=b"yours", is_extended_id=False))
        assert [(frame.can_id, frame.data) for frame in virtual_bus.drain()] == [(0x11, b"yours")]


@pytest.mark.parametrize(
    ("error", "send_event", "read_event"),
    [
        (can.CanOperationError("full", errno.ENOBUFS), ("enobufs", 3), "enobufs"),
        (can.CanOperationError("down", errno.ENETDOWN), ("enetdown", 3), "enetdown"),
        (OSError(errno.ENODEV, "unplugged"), ("enodev", 1), "enodev"),
        (
            OSError("device reports readiness to read but returned no data"),
            ("enobufs", 3),
            "enodev",
        ),
        (can.CanOperationError("something"), ("enobufs", 3), "enodev"),
        (can.CanTimeoutError("late"), ("enobufs", 3), "enodev"),
    ],
)
def test_errors_are_events_of_the_fault_table(
    virtual_bus: PythonCanBus, error: Exception, send_event: tuple[str, int], read_event: str
) -> None:
    virtual_bus._bus.shutdown()
    virtual_bus._bus = BrokenCanBus(error)
    assert virtual_bus.send([Frame(1, b""), Frame(2, b""), Frame(3, b"")]) == 0
    kind, number = send_event
    assert virtual_bus.take_events() == [(kind, "virtual:broken", number)]
    for _ in range(2):
        assert virtual_bus.drain() == []
        assert virtual_bus.take_events() == [(read_event, "virtual:broken", 1)]


def test_an_error_without_a_number_is_classified_by_its_cause(virtual_bus: PythonCanBus) -> None:
    virtual_bus._bus.shutdown()
    error = can.CanOperationError("full")
    error.__cause__ = OSError(errno.ENOBUFS, "full")
    virtual_bus._bus = BrokenCanBus(error)
    assert virtual_bus.send([Frame(1, b"")]) == 0
    assert virtual_bus.take_events() == [("enobufs", "virtual:broken", 1)]


def test_garbage_of_a_serial_adapter_is_counted_and_skipped(virtual_bus: PythonCanBus) -> None:
    virtual_bus._bus.shutdown()
    virtual_bus._bus = BrokenCanBus(
        ValueError("invalid literal for int() with base 16: 'xx'"), failure_count=3
    )
    assert virtual_bus.drain() == []
    assert virtual_bus.take_events() == [("error_frame", "virtual:broken garbled", 3)]


@pytest.fixture(scope="module")
def socket_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("tools")
    with hub_process("tools", folder):
        yield folder


@pytest.fixture
def handctl_bus(socket_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bus]:
    monkeypatch.setenv(RUN_DIR_VARIABLE, str(socket_folder))
    opened_bus = open_bus("local:tools", 0, 1_000_000)
    yield opened_bus
    opened_bus.close()


def test_filters_are_applied(handctl_bus: Bus) -> None:
    filters: list[can.typechecking.CanFilter] = [
        {"can_id": 0x10, "can_mask": 0x7F0, "extended": False}
    ]
    with can.Bus(
        "tools", interface="local", can_filters=filters, ignore_config=True
    ) as python_can_bus:
        handctl_bus.send([Frame(number, b"") for number in range(0x40)])
        received_arbitration_ids = [
            message.arbitration_id for message in iter(lambda: python_can_bus.recv(0.2), None)
        ]
    assert received_arbitration_ids == list(range(0x10, 0x20))


def test_a_receive_timeout_is_respected(handctl_bus: Bus) -> None:
    with can.Bus("tools", interface="local", ignore_config=True) as python_can_bus:
        start = time.monotonic()
        assert python_can_bus.recv(0) is None
        assert python_can_bus.recv(0.1) is None
        assert 0.1 <= time.monotonic() - start < 5.0


def test_own_messages_are_received_on_request(handctl_bus: Bus) -> None:
    with can.Bus(
        "tools", interface="local", receive_own_messages=True, ignore_config=True
    ) as python_can_bus:
        sent_message = can.Message(arbitration_id=1, data=b"x", is_extended_id=False)
        python_can_bus.send(sent_message)
        returned_message = python_can_bus.recv(5.0)
    assert returned_message is not None
    assert returned_message.equals(
        sent_message, timestamp_delta=None, check_channel=False, check_direction=False
    )


def test_fd_can_be_disabled(handctl_bus: Bus) -> None:
    with can.Bus("tools", interface="local", fd=False, ignore_config=True) as python_can_bus:
        with pytest.raises(can.CanOperationError, match="without fd"):
            python_can_bus.send(can.Message(arbitration_id=1, is_fd=True, data=bytes(12)))
        handctl_bus.send([Frame(0x6F1, bytes(12), 4), Frame(0x6F2, b"old")])
        received_message = python_can_bus.recv(5.0)
        while (
            received_message is not None and received_message.arbitration_id < 0x6F1
        ):  # skip the frames of an earlier client
            received_message = python_can_bus.recv(5.0)
    assert received_message is not None
    assert received_message.arbitration_id == 0x6F2


def test_stamps_are_wall_clock_time(handctl_bus: Bus) -> None:
    with can.Bus("tools", interface="local", ignore_config=True) as python_can_bus:
        time_before = time.time()
        handctl_bus.send([Frame(1, b"")])
        received_message = python_can_bus.recv(5.0)
    assert received_message is not None
    assert time_before - 0.02 <= received_message.timestamp <= time.time() + 0.02


def test_a_notifier_receives_messages(handctl_bus: Bus) -> None:
    reader = can.BufferedReader()
    with can.Bus("tools", interface="local", ignore_config=True) as python_can_bus:
        notifier = can.Notifier(python_can_bus, [reader], timeout=0.05)
        handctl_bus.send([Frame(number, b"") for number in range(20)])
        received_messages = [reader.get_message(5.0) for _ in range(20)]
        notifier.stop()
    assert [message.arbitration_id for message in received_messages if message] == list(range(20))


def test_a_notifier_in_an_event_loop_receives_a_complete_batch(handctl_bus: Bus) -> None:
    """The notifier of python-can reads one message for each event of the file descriptor.

    The file descriptor of the bus must stay readable as long as messages wait.
    """
    received: list[int] = []

    async def receive_messages(python_can_bus: can.BusABC) -> None:
        notifier = can.Notifier(python_can_bus, [lambda message: received.append(message.arbitration_id)],
                                loop=asyncio.get_running_loop())  # fmt: skip
        handctl_bus.send([Frame(number, b"") for number in range(20)])
        end = time.monotonic() + 20.0
        while len(received) < 20 and time.monotonic() < end:
            await asyncio.sleep(0.005)
        notifier.stop()

    with can.Bus("tools", interface="local", ignore_config=True) as python_can_bus:
        asyncio.run(receive_messages(python_can_bus))
    assert received == list(range(20))


def test_python_cans_logger_writes_what_was_sent(
    handctl_bus: Bus, socket_folder: Path, tmp_path: Path
) -> None:
    file = tmp_path / "seen.log"
    words = [sys.executable, "-m", "can.logger", "-i", "local", "-c", "tools", "-f", str(file)]
    logger = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        end = time.monotonic() + 30.0
        while not file.exists():  # the other process creates this file after it has opened the bus
            assert time.monotonic() < end
            time.sleep(0.02)
        for _ in range(20):
            handctl_bus.send([Frame(0x123, b"\xc0\xff\xee")])
            time.sleep(0.05)
        logger.send_signal(signal.SIGINT)
        logger.wait(20)
    finally:
        logger.kill()
        logger.wait()
    assert file.read_text().count("123#C0FFEE") >= 10


def test_a_bus_without_a_hub_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(RUN_DIR_VARIABLE, str(tmp_path))
    with pytest.raises(can.CanInitializationError, match="handctl sim --bus local:nobody"):
        can.Bus("nobody", interface="local", ignore_config=True)


@pytest.fixture
def scripted_bus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[can.BusABC, socket.socket]]:
    monkeypatch.setenv(RUN_DIR_VARIABLE, str(tmp_path))
    scripted_hub = ScriptedHub(tmp_path, "x")
    with can.Bus("x", interface="local", ignore_config=True) as python_can_bus:
        link = scripted_hub.accept_client()
        yield python_can_bus, link
        link.close()
    scripted_hub.close()


def fill_send_buffer(virtual_bus: can.BusABC, message: can.Message) -> None:
    for _ in range(1_000_000):
        virtual_bus.send(message, timeout=0)


def test_sending_waits_for_room_until_the_timeout(
    scripted_bus: tuple[can.BusABC, socket.socket],
) -> None:
    python_can_bus, link = scripted_bus
    message = can.Message(arbitration_id=1, data=bytes(8), is_extended_id=False)
    with pytest.raises(can.CanOperationError, match="no more frames"):
        fill_send_buffer(python_can_bus, message)
    start = time.monotonic()
    with pytest.raises(can.CanOperationError, match="no more frames"):
        python_can_bus.send(message, timeout=0.1)
    assert 0.1 <= time.monotonic() - start < 5.0
    link.recv(1 << 20)
    python_can_bus.send(message, timeout=5.0)


def test_a_lost_hub_ends_reading_and_sending(
    scripted_bus: tuple[can.BusABC, socket.socket],
) -> None:
    python_can_bus, link = scripted_bus
    link.send(frame_record(9, b"last"))
    link.close()
    last_message = python_can_bus.recv(5.0)
    assert last_message is not None
    assert last_message.arbitration_id == 9
    with pytest.raises(can.CanOperationError, match="gone"):
        python_can_bus.recv(5.0)
    with pytest.raises(can.CanOperationError, match="gone"):
        python_can_bus.send(can.Message(arbitration_id=1), timeout=5.0)
