"""Test that the load of a simulated bus is the load that ``bus plan`` predicts.

Further tests run a hand on a disturbed bus.
"""

from collections.abc import Sequence
from pathlib import Path

import pytest

from handctl.controller.bus_load import bus_loads
from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.frame import ERROR_FLAG
from handctl.hand.hand_loading import hand_path, load_hand
from handctl.runtime.clocks.lockstep import LockstepBus, LockstepClock
from tests.drives.protocol_bench import ProtocolBench, hand_file, move_to_second_bus

MEASURED_TICK_COUNT = 400
PERIOD_NS = 4_000_000


def planned_tick_s(hand_path: Path, period_ns: int = PERIOD_NS) -> list[float]:
    """Return the time per tick [s] that frames are planned to occupy each bus.

    This time includes the frames that a node sends at its own rate, such as heartbeats.
    """
    return [
        load.load_at_rate(1e9 / period_ns) * period_ns * 1e-9
        for load in bus_loads(load_hand(str(hand_path)))
    ]


def measured_tick_s(
    hand_path: Path, wire_words: Sequence[str], period_ns: int = PERIOD_NS
) -> list[float]:
    """Return the mean time per tick [s] that frames occupy each bus while the drives are enabled."""
    bench = ProtocolBench(hand_path, wire_words, period_ns)
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    assert bench.simulated_hand.wired
    simulated_wires = bench.simulated_hand.wired.wires
    for _ in range(20):
        bench.tick(DriveTarget.ENABLE, 0.05)
    busy_ns_before = [wire.busy_ns for wire in simulated_wires]
    for _ in range(MEASURED_TICK_COUNT):
        bench.tick(DriveTarget.ENABLE, 0.05)
    assert [state.phase for state in bench.states] == [DrivePhase.ENABLED] * len(bench.states)
    bench.simulated_hand.close()
    return [
        (wire.busy_ns - start) * 1e-9 / MEASURED_TICK_COUNT
        for wire, start in zip(simulated_wires, busy_ns_before, strict=True)
    ]


@pytest.mark.parametrize("protocol", ["cia402", "mit", "odrive"])
def test_the_wire_is_as_full_as_the_plan_says(protocol: str, tmp_path: Path) -> None:
    path = hand_file(tmp_path, [protocol])
    planned_s = planned_tick_s(path)
    assert measured_tick_s(path, []) == pytest.approx(planned_s, rel=0.02)
    assert 0.8 * planned_s[0] < measured_tick_s(path, ["stuffing=actual"])[0] < planned_s[0]


def test_each_of_two_buses_is_as_full_as_planned(tmp_path: Path) -> None:
    path = move_to_second_bus(hand_file(tmp_path, ["mit", "mit", "odrive"]), (0, 1))
    bit_rate_text = '"second"\nbitrate = 1000000'
    text = path.read_text().replace(bit_rate_text, bit_rate_text + "\ndata_bitrate = 5_000_000")
    head, *motors = text.split("[[motor]]")
    for i in (0, 1):
        motors[i] += "\noptions = { fd = true }\n"
    path.write_text("[[motor]]".join([head, *motors]))
    planned_s = planned_tick_s(path)
    assert len(planned_s) == 2
    assert measured_tick_s(path, []) == pytest.approx(planned_s, rel=0.02)


def test_eleven_motors_fit_where_the_plan_says() -> None:
    path = hand_path("jamia11")
    planned = planned_tick_s(path, 5_000_000)
    assert measured_tick_s(path, [], 5_000_000) == pytest.approx(planned, rel=0.02)


def test_an_overloaded_wire_is_full_and_replies_come_late(tmp_path: Path) -> None:
    bench = ProtocolBench(hand_file(tmp_path, ["mit"]), ["queue=16"], period_ns=1_000_000)
    for _ in range(400):
        bench.tick(DriveTarget.POLL)
    assert bench.simulated_hand.wired
    assert bench.simulated_hand.wired.wires[0].load(0, 400 * 1_000_000) > 0.9
    assert bench.simulated_hand.wired.wires[0].next_event_ns() < bench.k * 1_000_000 + 200_000, (
        "frames wait"
    )


def test_lockstep_matches_the_timed_wire(tmp_path: Path) -> None:
    bench = ProtocolBench(hand_file(tmp_path, ["mit"]), [])
    assert bench.simulated_hand.wired
    clock = LockstepClock(bench.simulated_hand, 2_000_000)
    bus = LockstepBus(clock)
    bench.simulated_hand.wired.wires[0].disturbed = 32
    bus.send([bench.sensor_node.sync(0)])
    for k in range(1, 5):
        clock.wait(k)
    assert not any(frame.can_id & ERROR_FLAG for frame in bus.drain())
    assert {"error_warning", "error_passive", "bus_off"} <= {
        kind for kind, _, _ in bus.take_events()
    }
    assert ("bus_off", "lockstep:0", 1) in bus.take_events()
    bench.simulated_hand.close()


def test_the_same_wire_gives_the_same_answers(tmp_path: Path) -> None:
    path, heard = hand_file(tmp_path, ["odrive"]), []
    for _ in range(2):
        bench = ProtocolBench(path, ["error_rate=0.02", "stuffing=actual", "seed=5"])
        frames = []
        for _ in range(200):
            bench.tick(DriveTarget.ENABLE, 0.02)
            frames += bench.received_frames
        heard.append(frames)
        bench.simulated_hand.close()
    assert heard[0] == heard[1]
    assert len(heard[0]) > 400


@pytest.mark.parametrize(
    ("adapter_class", "delay_ticks"),
    [("none", 1), ("usb-hs", 1), ("spi", 1), ("usb-fs", 2), ("ftdi", 8)],
)
def test_feedback_is_as_late_as_the_usb_frames_of_the_adapter(
    adapter_class: str, delay_ticks: int, tmp_path: Path
) -> None:
    """At a control rate of 250 Hz, the drives become ready with each class of CAN adapter.

    Because of the latency of the adapter, some ticks get no drive feedback.
    """
    bench = ProtocolBench(hand_file(tmp_path, ["mit"]), [f"adapter={adapter_class}"], PERIOD_NS)
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY, 1000)
    silent_ticks = max_silent_ticks = 0
    for _ in range(100):
        feedback_count_before = bench.states[0].feedback_count
        bench.tick(DriveTarget.POLL)
        silent_ticks = (
            silent_ticks + 1 if bench.states[0].feedback_count == feedback_count_before else 0
        )
        max_silent_ticks = max(max_silent_ticks, silent_ticks)
    assert delay_ticks // 2 - 1 <= max_silent_ticks < delay_ticks
    bench.simulated_hand.close()
