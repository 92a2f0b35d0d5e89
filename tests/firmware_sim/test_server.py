"""Test the real-time server of the simulator with a clock whose time the test sets.

The simulator server replies at once, and its simulated time follows the clock. If the server is too
slow, the simulated time falls behind the clock by whole time steps.
"""

import socket
from collections.abc import Collection
from pathlib import Path

import pytest

from firmware_sim.bus.bus_ports import assign_buses, open_port
from firmware_sim.bus.frame import FDF, Frame, pack_record
from firmware_sim.bus.local_ports import HubClientPort, HubPort
from firmware_sim.bus_server import MAX_CATCH_UP_NS, MAX_DELAY_NS, OVERRUN_DELAY_NS, BusServer
from firmware_sim.clock.realtime_priority import ORDINARY_PRIORITY_DURATION_S, RealTimePriority
from firmware_sim.clock.shared_clock import SharedClock
from firmware_sim.clock.simulation_pace import PaceMeter, round_pace_down
from firmware_sim.description.hand_description import SimulatorError, load_hand
from firmware_sim.scene.scene import load_scene
from firmware_sim.simulated_world import SimulatedWorld
from tests.firmware_sim.manual_clock import ManualClock

NS_PER_MS = 1_000_000
START_NS = 7_000 * NS_PER_MS
ENABLE_PAYLOAD, TORQUE_PAYLOAD = (
    bytes.fromhex("fffffffffffffffc"),
    bytes.fromhex("7fff7ff0000007ff"),
)
STATE_ENABLED, STATE_LOST = 1, 0xD


class FakePort:
    """Fake port through which the simulator server receives and sends frames.

    A test adds received frames to the port, and reads the frames that the server has sent through
    the port.
    """

    due_ns = 1 << 62

    def __init__(self) -> None:
        self.lost_frame_count = 0
        self.coming: list[Frame] = []
        self.sent: list[Frame] = []

    def read_sockets(self) -> list[socket.socket]:
        return []

    write_sockets = read_sockets

    def receive(self, ready: Collection[socket.socket]) -> list[Frame]:
        frames, self.coming = self.coming, []
        return frames

    def send(self, frames: list[Frame]) -> None:
        self.sent += frames

    def close(self) -> None: ...


class SimulatorServerBench:
    def __init__(self) -> None:
        self.clock, self.wire = ManualClock(START_NS), FakePort()
        self.world = SimulatedWorld(
            load_hand("jamia"), load_scene(None), homed=True, origin_ns=START_NS
        )
        self.server = BusServer(self.world, [self.wire], self.clock)

    def turn(self, t_ms: float, *received_frames: Frame) -> list[Frame]:
        """Set the clock, let the server process received frames in one pass of its loop, and return the sent frames."""
        self.clock.t_ns = START_NS + round(t_ms * NS_PER_MS)
        self.wire.coming, self.wire.sent = list(received_frames), []
        self.server.serve_once()
        return self.wire.sent


@pytest.fixture
def bench() -> SimulatorServerBench:
    return SimulatorServerBench()


def feedback_state(frame: Frame) -> int:
    return frame.data[0] >> 4


def test_the_plant_follows_the_clock_in_whole_steps(bench: SimulatorServerBench) -> None:
    bench.turn(3.7)
    assert bench.world.t_ns == START_NS + round(3.5 * NS_PER_MS)
    bench.turn(4.0)
    assert bench.world.t_ns == START_NS + 4 * NS_PER_MS


def test_a_frame_samples_the_plant_at_its_exact_time(bench: SimulatorServerBench) -> None:
    """When a frame arrives, the server reads the simulated sensors at exactly the time of arrival.

    The simulation advances in steps of 0.5 ms. When the server reads a sensor between two steps,
    the times of the steps do not change.
    """
    bench.turn(3.7, Frame(1, ENABLE_PAYLOAD))
    assert bench.world.t_ns == START_NS + round(3.7 * NS_PER_MS)
    assert bench.world.plant.step_progress_ns == round(0.2 * NS_PER_MS)
    bench.turn(3.9, Frame(1, TORQUE_PAYLOAD))
    assert bench.world.t_ns == START_NS + round(3.9 * NS_PER_MS)
    bench.turn(4.6)
    assert bench.world.t_ns == START_NS + round(4.5 * NS_PER_MS)
    assert (bench.world.plant.steps, bench.world.plant.step_progress_ns) == (9, 0)


def test_answers_go_out_in_the_same_turn_in_the_order_of_the_requests(
    bench: SimulatorServerBench,
) -> None:
    sent = bench.turn(
        1,
        Frame(0x80, b"\x05"),
        Frame(2, ENABLE_PAYLOAD),
        Frame(1, ENABLE_PAYLOAD),
        Frame(0x333, b"foreign"),
    )
    assert [frame.can_id for frame in sent] == [0x1A0, 0x12, 0x11]
    assert [feedback_state(frame) for frame in sent[1:]] == [STATE_ENABLED] * 2
    assert sent[0].data[0] & 0xF == 5
    assert bench.server.summary()["foreign_frames"] == 1


def test_a_late_turn_catches_up_in_strides_and_is_counted(bench: SimulatorServerBench) -> None:
    for turn in range(1, 9):
        bench.turn(30)
        assert bench.world.t_ns == START_NS + min(turn * MAX_CATCH_UP_NS, 30 * NS_PER_MS)
    assert bench.server.overruns == sum(
        30 * NS_PER_MS - turn * MAX_CATCH_UP_NS > OVERRUN_DELAY_NS for turn in range(8)
    )
    assert bench.world.slip_ns == 0


def test_progress_is_reported_to_a_controller_on_the_same_clock(
    bench: SimulatorServerBench,
) -> None:
    bench.clock.sent = 5
    bench.turn(3.7, Frame(1, ENABLE_PAYLOAD))
    assert bench.clock.reached_ns == bench.world.t_ns == START_NS + round(3.7 * NS_PER_MS)
    assert bench.clock.answered == 5


def test_a_tick_is_answered_only_when_no_frame_waits() -> None:
    """While a received frame is waiting, the server does not report that it has sent all replies of the tick.

    If a frame arrives while the server processes other frames, the server replies to the new frame
    after the other frames.
    """
    port = HubPort("t", 0)
    clock = ManualClock(START_NS)
    server = BusServer(
        SimulatedWorld(load_hand("jamia"), load_scene(None), homed=True, origin_ns=START_NS),
        [port],
        clock,
    )
    controller = HubClientPort("t", 0)
    server.serve_once()
    answer = server._send_answers

    def send_during_step(frames: list[Frame]) -> None:
        answer(frames)
        if clock.sent == 1:
            controller.send([Frame(2, ENABLE_PAYLOAD)])
            clock.sent = 2

    server._send_answers = send_during_step  # type: ignore[method-assign]
    controller.send([Frame(1, ENABLE_PAYLOAD)])
    clock.sent = 1
    server.serve_once()
    assert clock.answered == 0
    server.serve_once()
    assert clock.answered == 2
    controller.close()
    port.close()


def test_an_answer_waits_for_one_stride_at_most(bench: SimulatorServerBench) -> None:
    """Reproduce a defect: a server that was 10 ms behind its clock first simulated the whole 10 ms, and then replied.

    The simulation of 10 ms took 2 ms of real time, so the reply came after the next SYNC frame.
    """
    sent = bench.turn(30, Frame(0x80, b"\x05"))
    assert [frame.can_id for frame in sent] == [0x1A0]
    assert bench.world.t_ns == START_NS + MAX_CATCH_UP_NS


class GrantedPriority:
    """Fake real-time priority, which is always granted."""

    def __init__(self) -> None:
        self.now_s, self.requests, self.active = 0.0, 0, False

    def take_priority(self) -> bool:
        self.requests, self.active = self.requests + 1, True
        return True

    def restore_priority(self) -> None:
        self.active = False


def test_priority_is_taken_for_a_host_and_given_back_after_slips() -> None:
    granted_priority = GrantedPriority()
    priority = RealTimePriority(
        granted_priority.take_priority,
        granted_priority.restore_priority,
        lambda: granted_priority.now_s,
    )
    for _ in range(10):
        priority.count_clock_slip()
    assert granted_priority.requests == 0, "no priority before the first frame of a host"
    priority.request_priority()
    assert granted_priority.active
    priority.count_clock_slip()
    assert granted_priority.active, "one slip does not restore the priority"
    for _ in range(2):
        granted_priority.now_s += 0.2
        priority.count_clock_slip()
    assert not granted_priority.active
    priority.request_priority()
    assert not granted_priority.active, "no second request shortly after the slips"
    granted_priority.now_s += ORDINARY_PRIORITY_DURATION_S
    priority.request_priority()
    assert granted_priority.active


def test_a_slow_machine_is_reported_once_a_second_with_an_advised_pace() -> None:
    """Reproduce a defect.

    On a slow machine, the simulator printed 2,338 lines in 275 s, but did not advise a smaller time
    scale.
    """
    now = {"wall": 0.0, "cpu": 0.0}
    lines: list[str] = []
    pace = PaceMeter(0, lambda: now["wall"], lambda: now["cpu"], lines.append)
    plant_ns = 0
    for _ in range(100):  # 10 s of wall time, in which 1 s is simulated without idle time
        now["wall"] += 0.1
        now["cpu"] += 0.1
        plant_ns += 10 * NS_PER_MS
        pace.count_slip(90 * NS_PER_MS, plant_ns)
    assert 9 <= len(lines) <= 11
    assert sum(int(line.split(" times")[0].rsplit(" ", 1)[1]) for line in lines[1:]) >= 80
    assert pace.advice == pytest.approx(0.08)
    assert "--time-scale 0.08" in lines[-1]
    assert pace.report(plant_ns)["plant_s_per_cpu_s"] == pytest.approx(0.1)


def test_one_stall_gives_no_advice() -> None:
    lines: list[str] = []
    pace = PaceMeter(0, lambda: 0.0, lambda: 0.0, lines.append)
    pace.count_slip(200 * NS_PER_MS, NS_PER_MS)
    assert lines == ["firmware_sim: 200 ms behind, clock slipped"]
    assert pace.advice is None


def test_slips_without_a_host_are_counted_but_not_reported(
    bench: SimulatorServerBench, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.turn(1 + MAX_DELAY_NS // NS_PER_MS + 200)
    assert bench.server.slips == 1
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("measured_pace", "rounded_pace"),
    [(0.37, 0.3), (1.0, 1.0), (0.0299, 0.02), (1e-6, 0.001), (0.3, 0.3)],
)
def test_a_pace_is_rounded_down_to_one_digit(measured_pace: float, rounded_pace: float) -> None:
    assert round_pace_down(measured_pace) == rounded_pace


def test_a_late_simulation_skips_time_and_reports_it(
    bench: SimulatorServerBench, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.turn(1, Frame(1, ENABLE_PAYLOAD))
    skipped_ms = MAX_DELAY_NS // NS_PER_MS + 200
    bench.turn(1 + skipped_ms)
    assert bench.world.t_ns == START_NS + NS_PER_MS
    assert bench.world.slip_ns == skipped_ms * NS_PER_MS
    assert capsys.readouterr().err == f"firmware_sim: {skipped_ms} ms behind, clock slipped\n"
    bench.turn(1 + skipped_ms + 2)
    assert bench.world.t_ns == START_NS + 3 * NS_PER_MS
    assert (bench.server.slips, bench.server.overruns) == (1, 0)


def write_timeout(timeout_ms: int) -> Frame:
    """Return the frame that writes a watchdog time into register 9 of motor 1.

    The unit of register 9 is 50 us.
    """
    return Frame(0x7FF, bytes((1, 0, 0x55, 9)) + (timeout_ms * 20).to_bytes(4, "little"))


def test_a_slip_does_not_trip_a_watchdog_but_real_silence_does(bench: SimulatorServerBench) -> None:
    bench.turn(1, write_timeout(40), Frame(1, ENABLE_PAYLOAD))
    bench.turn(1 + 500)
    assert [feedback_state(frame) for frame in bench.turn(502, Frame(1, TORQUE_PAYLOAD))] == [
        STATE_ENABLED
    ]
    for t_ms in range(503, 560, 2):
        bench.turn(t_ms)
    assert [feedback_state(frame) for frame in bench.turn(560, Frame(1, TORQUE_PAYLOAD))] == [
        STATE_LOST
    ]


def test_the_scaled_clock_is_monotonic_time_times_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.monotonic_ns", lambda: 123_456_789_019)
    assert SharedClock(0.1).now_ns() == 12_345_678_901
    assert SharedClock().now_ns() == 123_456_789_019


@pytest.mark.parametrize(
    ("bus_texts", "bus_names", "expected_result"),
    [
        (["local:x"], ["main"], ["local:x"]),
        (["main=local:x"], ["main"], ["local:x"]),
        (["b=socketcan:can1", "a=local:x"], ["a", "b"], ["local:x", "socketcan:can1"]),
    ],
)
def test_each_bus_gets_its_spec(
    bus_texts: list[str], bus_names: list[str], expected_result: list[str]
) -> None:
    assert assign_buses(bus_texts, bus_names) == expected_result


@pytest.mark.parametrize(
    ("bus_texts", "bus_names", "expected_result"),
    [
        (["local:x"], ["a", "b"], "this hand has 2"),
        (["a=local:x"], ["a", "b"], "no --bus for b"),
        (["c=local:x"], ["a"], "unknown"),
        (["a=local:x", "a=local:y"], ["a"], "given twice"),
    ],
)
def test_buses_that_do_not_fit_the_hand_are_refused(
    bus_texts: list[str], bus_names: list[str], expected_result: str
) -> None:
    with pytest.raises(SimulatorError, match=expected_result):
        assign_buses(bus_texts, bus_names)


@pytest.mark.parametrize(
    "bus_text",
    ["", "vcan0", "serial:x", "socketcan:", "local:", "socketcan:no-such-if", "join:nobody"],
)
def test_buses_that_cannot_be_opened_are_refused(
    bus_text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path))
    with pytest.raises(SimulatorError):
        open_port(bus_text, 0)


def test_a_port_joins_a_served_bus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path))
    hub_port = HubPort("shared", 3)
    hub_client_port = HubClientPort("shared", 5)
    hub_port.receive(hub_port.read_sockets())
    request, answer = Frame(1, ENABLE_PAYLOAD), Frame(0x11, bytes(range(48)), FDF)
    hub_port.send([request])
    assert hub_client_port.receive(hub_client_port.read_sockets()) == [request._replace(bus=5)]
    hub_client_port.send([answer])
    assert hub_port.receive(hub_port.read_sockets()) == [answer._replace(bus=3)]
    hub_port.close()
    with pytest.raises(SimulatorError, match="hub has closed the connection"):
        hub_client_port.receive(hub_client_port.read_sockets())
    hub_client_port.close()


def test_an_invalid_record_is_counted_and_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HANDCTL_RUN_DIR", str(tmp_path))
    port = HubPort("odd", 0)
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    link.connect(str(tmp_path / "odd.bus"))
    good_record = pack_record(Frame(1, b"12345678"))
    too_long_record = bytearray(good_record)
    too_long_record[4] = 9  # a classical frame with nine bytes is invalid
    link.sendall(good_record + too_long_record + good_record)
    port.receive(port.read_sockets())
    assert [frame.data for frame in port.receive(port.read_sockets())] == [b"12345678"] * 2
    assert port.lost_frame_count == 1
    link.close()
    port.close()
