"""Test a local bus with the timing of a real wire, on a clock whose time the test sets.

The local bus connects a bus client of handctl with a simulated hand.
"""

import select
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_sim.bus.bus_ports import open_port
from firmware_sim.bus.timed_port import DEFAULT_BITRATES, TimedPort, timed_port_factory
from firmware_sim.bus_server import BusServer
from firmware_sim.description.hand_description import SimulatorError, load_hand
from firmware_sim.scene.scene import load_scene
from firmware_sim.simulated_world import SimulatedWorld
from handctl.drives.frame import Frame
from handctl.drives.frame_time import frame_time_s
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.buses.contract import Bus
from tests.firmware_sim.manual_clock import ManualClock

NS_PER_MS = 1_000_000
START_NS = 5_000 * NS_PER_MS
SYNC_ID, TENSIONS_ID, REGISTERS_ID = 0x80, 0x1A0, 0x7FF


class TimedBus:
    """A simulated hand and a host on a bus with the timing of a real wire.

    The method ``run_until`` sets the clock of the bus, and processes all events up to the new time.
    """

    def __init__(self, wire_words: list[str], has_hand: bool = True) -> None:
        self.clock = ManualClock(START_NS)
        make_port = timed_port_factory(
            wire_words, [DEFAULT_BITRATES], self.clock.now_ns, is_node_side=has_hand
        )
        assert make_port
        self.port = make_port("lab", 0)
        self.world = SimulatedWorld(
            load_hand("jamia"), load_scene(None), homed=True, origin_ns=START_NS
        )
        self.server = BusServer(self.world, [self.port], self.clock)
        self.host: Bus = open_bus("local:lab", 0, 1_000_000)
        self.serve_clients()

    def serve_clients(self) -> None:
        while ready := select.select(self.port.read_sockets(), [], [], 0.0)[0]:
            self.port.receive(ready)

    def run_until(self, time_ms: float) -> list[Frame]:
        self.clock.t_ns = START_NS + round(time_ms * NS_PER_MS)
        for _ in range(30):
            self.server.serve_once()
            if self.port.due_ns > self.clock.t_ns:
                break
        return self.host.drain()


@pytest.fixture(autouse=True)
def _run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path))


@pytest.fixture
def timed_bus() -> Iterator[TimedBus]:
    new_bus = TimedBus(["queue=8"])
    yield new_bus
    new_bus.host.close()
    new_bus.port.close()


def frame_time_us(payload_size: int) -> float:
    return frame_time_s(payload_size, False, 1e6) * 1e6


def test_an_answer_arrives_after_the_wire_time_of_request_and_answer(timed_bus: TimedBus) -> None:
    assert isinstance(timed_bus.port, TimedPort)
    timed_bus.host.send([Frame(SYNC_ID, b"\x05")])
    assert timed_bus.run_until(0.0) == []
    assert timed_bus.run_until((frame_time_us(1) + frame_time_us(7) - 1) * 1e-3) == []
    (frame,) = timed_bus.run_until((frame_time_us(1) + frame_time_us(7)) * 1e-3)
    assert (frame.can_id, frame.data[0] & 0xF) == (TENSIONS_ID, 5)
    assert timed_bus.port.wire.busy_ns == round((frame_time_us(1) + frame_time_us(7)) * 1e3)


@pytest.mark.parametrize(
    ("adapter_class", "longest_latency_ms"), [("usb-hs", 0.25), ("usb-fs", 2.0), ("spi", 0.2)]
)
def test_an_answer_arrives_later_behind_an_adapter(
    adapter_class: str, longest_latency_ms: float
) -> None:
    bus_with_adapter = TimedBus([f"adapter={adapter_class}"])
    wire_ms = (frame_time_us(1) + frame_time_us(7)) * 1e-3
    bus_with_adapter.host.send([Frame(SYNC_ID, b"\x05")])
    passed = 0.0
    while not (frames := bus_with_adapter.run_until(passed)):
        passed += 0.01
        assert passed < 10.0
    assert [frame.can_id for frame in frames] == [TENSIONS_ID]
    assert wire_ms < passed <= wire_ms + longest_latency_ms + 0.02
    bus_with_adapter.host.close()
    bus_with_adapter.port.close()


def test_answers_with_low_identifiers_overtake_requests_with_high_identifiers(
    timed_bus: TimedBus,
) -> None:
    timed_bus.host.send(
        [Frame(REGISTERS_ID, bytes((node, 0, 0xCC, 0, 0, 0, 0, 0))) for node in (1, 2, 3, 4)]
    )
    timed_bus.run_until(0.0)
    arrival_by_id = {}
    for tenth in range(20):
        for frame in timed_bus.run_until(tenth * frame_time_us(8) * 1e-3 + 0.001):
            arrival_by_id[frame.can_id] = tenth
    assert arrival_by_id == {0x11: 2, 0x12: 4, 0x13: 6, 0x14: 8}, (
        "each answer overtakes the next request"
    )


def test_a_full_queue_refuses_at_once(timed_bus: TimedBus) -> None:
    timed_bus.run_until(0.0)
    frames = [Frame(0x700 + n, b"") for n in range(20)]
    assert timed_bus.host.send(frames) == 8
    assert timed_bus.host.take_events() == [("enobufs", "local:lab", 12)]
    timed_bus.server.serve_once()
    assert timed_bus.host.send(frames) == 0, "no frame has left the queue"
    timed_bus.host.take_events()
    timed_bus.clock.t_ns += round(3 * frame_time_us(0) * 1000)
    timed_bus.server.serve_once()
    assert timed_bus.host.send(frames) == 3, (
        "three frames have left the queue, which the host sees without reading"
    )
    for ms in (20.0, 40.0):
        timed_bus.run_until(ms)
    assert timed_bus.port.wire.frames == 11
    assert timed_bus.host.take_events() == [("enobufs", "local:lab", 17)]
    assert timed_bus.host.send(frames) == 8


def test_a_host_that_has_not_read_yet_learns_of_refusals_later(timed_bus: TimedBus) -> None:
    assert timed_bus.host.send([Frame(0x700 + n, b"") for n in range(20)]) == 20, (
        "the hub has accepted all frames"
    )
    timed_bus.run_until(0.0)
    assert ("enobufs", "local:lab", 20 - 8) in timed_bus.host.take_events()
    timed_bus.run_until(20.0)
    assert timed_bus.port.wire.frames == 8


def test_frames_received_while_sending_are_not_lost(timed_bus: TimedBus) -> None:
    timed_bus.run_until(0.0)
    timed_bus.host.send([Frame(REGISTERS_ID, bytes((1, 0, 0xCC, 0, 0, 0, 0, 0)))] * 8)
    timed_bus.server.serve_once()
    timed_bus.clock.t_ns += round(2.5 * frame_time_us(8) * 1000)
    for _ in range(30):
        timed_bus.server.serve_once()
    assert timed_bus.host.send([Frame(0x700, b"")] * 8) < 8
    assert [frame.can_id for frame in timed_bus.host.drain()] == [0x11]


def test_a_disturbed_wire_puts_the_host_into_bus_off_and_is_reported(timed_bus: TimedBus) -> None:
    assert isinstance(timed_bus.port, TimedPort)
    timed_bus.port.wire.disturbed = 32
    timed_bus.host.send([Frame(0x700, b"")])
    timed_bus.run_until(0.0)
    timed_bus.run_until(50.0)
    kinds = {kind for kind, _, _ in timed_bus.host.take_events()}
    assert {"error_warning", "error_passive", "bus_off"} <= kinds
    assert "bus_off" in {kind for kind, _, _ in timed_bus.host.take_events()}, (
        "the event repeats during bus-off"
    )


def test_a_client_alone_gets_no_acknowledge() -> None:
    bus_without_hand = TimedBus([], has_hand=False)
    bus_without_hand.host.send([Frame(1, b"")])
    bus_without_hand.serve_clients()
    bus_without_hand.clock.t_ns += 10 * NS_PER_MS
    bus_without_hand.port.receive([])
    kinds = (
        {kind for kind, _, _ in bus_without_hand.host.take_events()}
        if bus_without_hand.host.drain() == []
        else set()
    )
    assert "error_passive" in kinds
    second_bus = open_bus("local:lab", 0, 1_000_000)
    bus_without_hand.serve_clients()
    bus_without_hand.clock.t_ns += 10 * NS_PER_MS
    bus_without_hand.port.receive([])
    assert [frame.can_id for frame in second_bus.drain()] == [1]
    bus_without_hand.host.close()
    second_bus.close()
    bus_without_hand.port.close()


def test_a_disconnected_client_loses_its_queue(timed_bus: TimedBus) -> None:
    assert isinstance(timed_bus.port, TimedPort)
    other_bus = open_bus("local:lab", 0, 1_000_000)
    timed_bus.serve_clients()
    timed_bus.host.send([Frame(0x700, b"")] * 5)
    timed_bus.run_until(0.0)
    timed_bus.host.close()
    timed_bus.serve_clients()
    timed_bus.clock.t_ns += 10 * NS_PER_MS
    timed_bus.port.receive([])
    assert len(other_bus.drain()) <= 1
    assert timed_bus.port.wire.next_event_ns() > timed_bus.clock.t_ns
    other_bus.close()


@pytest.mark.parametrize(
    "option_text",
    [
        "speed=1",
        "queue=0",
        "queue=x",
        "stuffing=none",
        "error_rate=1.5",
        "bitrate=nan",
        "restart_ms=-1",
    ],
)
def test_invalid_wire_words_are_refused(option_text: str) -> None:
    with pytest.raises(SimulatorError, match=f"--wire {option_text}"):
        timed_port_factory([option_text], [DEFAULT_BITRATES], lambda: 0)


def test_only_a_served_bus_can_have_a_wire() -> None:
    with pytest.raises(SimulatorError, match="local:NAME"):
        open_port("socketcan:vcan0", 0, timed_port_factory([], [DEFAULT_BITRATES], lambda: 0))
