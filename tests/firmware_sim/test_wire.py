"""Test the simulated wire of a CAN bus: bit times, arbitration, queues, acknowledgement and error states."""

import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.bus.frame import BRS, ERROR_FLAG, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from firmware_sim.wire.can_adapter import ADAPTER_CLASSES, AdapterLatency
from firmware_sim.wire.can_controller import CanController, CanErrorState
from firmware_sim.wire.frame_bits import FD_LENGTHS, BitRates, arbitration_priority
from firmware_sim.wire.simulated_wire import NEVER_NS, SimulatedWire, WireOptions
from handctl.drives.frame_time import frame_time_s

NOMINAL_BIT_S, DATA_BIT_S = 1_000_000, 5_000_000
WORST_CASE_RATES, ACTUAL_RATES = (
    BitRates(NOMINAL_BIT_S, DATA_BIT_S),
    BitRates(NOMINAL_BIT_S, DATA_BIT_S, are_stuff_bits_counted=True),
)
FRAME_STRATEGY = st.builds(
    lambda can_id, data, fd: Frame(can_id, data, FDF | BRS) if fd else Frame(can_id, data[:8]),
    st.integers(0, 0x7FF),
    st.sampled_from(FD_LENGTHS).flatmap(lambda size: st.binary(min_size=size, max_size=size)),
    st.booleans(),
)


class BusMember:
    """A CAN controller on the simulated wire, and the frames that it has received."""

    def __init__(self, wire: SimulatedWire, queue_length: int | None = None) -> None:
        self.received: list[Frame] = []
        self.errors: list[Frame] = []
        self.controller = wire.add_controller(self._receive, queue_length)

    def _receive(self, frame: Frame, t_ns: int) -> None:
        (self.errors if frame.can_id & ERROR_FLAG else self.received).append(
            frame._replace(t_ns=t_ns)
        )

    @property
    def received_ids(self) -> list[int]:
        return [frame.can_id for frame in self.received]

    @property
    def error_class_bits(self) -> list[int]:
        """Return the error-class bits of each received error frame.

        The bits that mark an error frame or a counter are zero in the returned numbers.
        """
        return [frame.can_id & 0x1FF for frame in self.errors]


def add_controllers(wire: SimulatedWire, controller_count: int) -> list[BusMember]:
    return [BusMember(wire) for _ in range(controller_count)]


@given(FRAME_STRATEGY)
def test_both_packages_compute_the_same_maximum_frame_time(frame: Frame) -> None:
    expected = frame_time_s(len(frame.data), bool(frame.flags & FDF), NOMINAL_BIT_S, DATA_BIT_S)
    assert WORST_CASE_RATES.frame_duration_ns(frame) == pytest.approx(expected * 1e9, abs=2)
    assert (
        0.7 * expected * 1e9
        < ACTUAL_RATES.frame_duration_ns(frame)
        <= WORST_CASE_RATES.frame_duration_ns(frame)
    )


def test_a_frame_whose_bits_were_counted_by_hand() -> None:
    """A frame with the identifier 0 and without data begins with 34 zeros: 19 before the CRC, and 15 in the CRC.

    A stuff bit follows after every five zeros of the frame.
    """
    zero_bit_count = 1 + 11 + 3 + 4 + 15
    assert (
        ACTUAL_RATES.frame_duration_ns(Frame(0, b""))
        == (zero_bit_count + zero_bit_count // 5 + 13) * 1000
    )
    assert ACTUAL_RATES.frame_duration_ns(Frame(0x555, b"\x55" * 8)) < (34 + 64 + 13 + 6) * 1000, (
        "at most six stuff bits"
    )


def test_an_extended_identifier_takes_twenty_bits_more() -> None:
    assert (
        WORST_CASE_RATES.frame_duration_ns(Frame(1 | EXTENDED_FLAG, bytes(8)))
        == (54 + 64 + (54 + 64 - 1) // 4 + 13) * 1000
    )


def test_the_lowest_identifier_goes_first_without_interruption() -> None:
    wire = SimulatedWire(WORST_CASE_RATES)
    a, b, ears = add_controllers(wire, 3)
    a.controller.queue_frame(Frame(0x300, b""), 0)
    for can_id in (0x200, 0x100):
        b.controller.queue_frame(Frame(can_id, b""), 1000)
    a.controller.queue_frame(Frame(0x150, b""), 1000)
    wire.advance(10**9)
    assert ears.received_ids == [0x300, 0x150, 0x200, 0x100], (
        "the first frames of the queues compete"
    )
    assert [frame.t_ns for frame in ears.received] == [55_000 * n for n in (1, 2, 3, 4)]


@pytest.mark.parametrize(
    ("first_id", "second_id"),
    [
        (0x100, 0x101),
        (0x100, 0x100 | REMOTE_FLAG),
        (0x100 | REMOTE_FLAG, 0x100 << 18 | EXTENDED_FLAG),
        (5 | EXTENDED_FLAG, 6 | EXTENDED_FLAG),
    ],
)
def test_arbitration_is_bit_by_bit(first_id: int, second_id: int) -> None:
    assert arbitration_priority(first_id) < arbitration_priority(second_id)


def test_the_wire_is_never_idle_while_a_frame_waits() -> None:
    wire, rng = SimulatedWire(ACTUAL_RATES), random.Random(1)
    senders = add_controllers(wire, 4)
    frames = [Frame(rng.randrange(0x800), rng.randbytes(rng.randrange(9))) for _ in range(200)]
    frames = list({frame.can_id: frame for frame in frames}.values())
    for frame in frames:
        rng.choice(senders).controller.queue_frame(frame, 0)
    wire.advance(10**9)
    assert wire.busy_ns == sum(map(ACTUAL_RATES.frame_duration_ns, frames))
    assert wire.frames == len(frames)
    assert wire.next_event_ns() == NEVER_NS


def test_a_full_queue_refuses_and_reports() -> None:
    wire = SimulatedWire(WORST_CASE_RATES, WireOptions(queue=3))
    a, b = add_controllers(wire, 2)
    assert [a.controller.queue_frame(Frame(n, b""), 0) for n in range(5)] == [True] * 3 + [
        False
    ] * 2
    assert a.controller.refused == 2
    assert a.error_class_bits == [0x04, 0x04]
    assert [frame.data[1] for frame in a.errors] == [0x02, 0x02], "CAN_ERR_CRTL_TX_OVERFLOW"
    wire.advance(10**9)
    assert b.received_ids == [0, 1, 2]
    assert a.controller.queue_frame(Frame(5, b""), 10**9)


def test_a_sender_alone_repeats_and_turns_passive_but_stays_on_the_bus() -> None:
    wire = SimulatedWire(WORST_CASE_RATES)
    single_bus_member = BusMember(wire)
    single_bus_member.controller.queue_frame(Frame(1, bytes(8)), 0)
    wire.advance(10**9)
    assert wire.frames == 0
    assert single_bus_member.controller.tx_errors == 128
    assert single_bus_member.controller.state == CanErrorState.ERROR_PASSIVE
    assert single_bus_member.error_class_bits == [0x20, 0x24, 0x24], (
        "missing acknowledge, then with warning, then with passive"
    )
    assert [frame.data[1] for frame in single_bus_member.errors] == [0, 0x08, 0x20]
    assert wire.load(0, 10**9) > 0.9, "a single node repeats its frame"
    other_bus_member = BusMember(wire)
    wire.advance(2 * 10**9)
    assert other_bus_member.received_ids == [1]
    assert single_bus_member.controller.tx_errors == 127


def destroy_frames(wire: SimulatedWire, sender: CanController, frame_count: int, t_ns: int) -> None:
    wire.disturbed = frame_count
    sender.queue_frame(Frame(1, b"x"), t_ns)
    wire.advance(t_ns + 10**8)


def test_disturbance_leads_over_warning_and_passive_to_bus_off_and_back() -> None:
    wire = SimulatedWire(WORST_CASE_RATES, WireOptions(restart_ms=100.0))
    sender, receiver = add_controllers(wire, 2)
    destroy_frames(wire, sender.controller, 32, 0)
    assert sender.controller.tx_errors == 256
    assert sender.error_class_bits == [0x88, 0x8C, 0x8C, 0xC8]
    assert [frame.data[1] for frame in sender.errors] == [0, 0x08, 0x20, 0]
    assert [frame.data[6] for frame in sender.errors] == [8, 96, 128, 255]
    assert receiver.controller.rx_errors == 32
    assert not sender.controller.queue_frame(Frame(2, b""), 10**8)
    assert receiver.received_ids == [], "waiting frames are lost"
    wire.advance(10**9)
    assert sender.error_class_bits[-1] == 0x100
    assert sender.controller.state == CanErrorState.ERROR_ACTIVE
    assert sender.errors[-1].t_ns - sender.errors[3].t_ns == 100_000_000 + 128 * 11 * 1000
    sender.controller.queue_frame(Frame(3, b""), 10**9)
    wire.advance(2 * 10**9)
    assert receiver.received_ids == [3]


def test_bus_off_is_permanent_without_a_restart() -> None:
    wire = SimulatedWire(WORST_CASE_RATES)
    sender, receiver = add_controllers(wire, 2)
    destroy_frames(wire, sender.controller, 32, 0)
    wire.advance(10**10)
    assert sender.controller.state == CanErrorState.BUS_OFF
    assert wire.next_event_ns() == NEVER_NS
    receiver.controller.queue_frame(Frame(1, b""), 10**10)
    wire.advance(10**10 + 10**8)
    assert receiver.controller.state == CanErrorState.ERROR_PASSIVE, (
        "the receiver gets no acknowledge"
    )


def test_successful_frames_reduce_the_error_counters() -> None:
    wire = SimulatedWire(WORST_CASE_RATES)
    sender, receiver = add_controllers(wire, 2)
    destroy_frames(wire, sender.controller, 13, 0)
    assert (sender.controller.tx_errors, receiver.controller.rx_errors) == (103, 12)
    assert sender.controller.state == CanErrorState.ERROR_WARNING
    for n in range(8):
        sender.controller.queue_frame(Frame(n, b""), 10**9)
    wire.advance(2 * 10**9)
    assert sender.controller.state == CanErrorState.ERROR_ACTIVE
    assert sender.errors[-1].data[1] == 0x40, "CAN_ERR_CRTL_ACTIVE"
    assert receiver.controller.rx_errors == 4


def test_two_of_one_identifier_destroy_each_other() -> None:
    wire = SimulatedWire(WORST_CASE_RATES)
    a, b, ears = add_controllers(wire, 3)
    for party, data in ((a, b"a"), (b, b"b")):
        party.controller.queue_frame(Frame(7, data), 0)
    wire.advance(10**9)
    assert ears.received == []
    assert a.controller.state == b.controller.state == CanErrorState.BUS_OFF
    for party in add_controllers(wire, 2):
        party.controller.queue_frame(Frame(8, b"same"), 10**9)
    wire.advance(2 * 10**9)
    assert ears.received_ids == [8], "two equal frames are one frame"


def test_the_error_rate_is_met_and_repeats() -> None:
    errors = []
    for _ in range(2):
        wire = SimulatedWire(WORST_CASE_RATES, WireOptions(error_rate=0.05, queue=10_000, seed=3))
        sender, receiver = add_controllers(wire, 2)
        for n in range(4000):
            sender.controller.queue_frame(Frame(n & 0x7FF, b""), 0)
        wire.advance(10**12)
        assert len(receiver.received) == 4000
        errors.append(wire.errors)
    assert errors[0] == errors[1] == pytest.approx(4000 * 0.05 / 0.95, rel=0.2)


def test_removing_a_controller_during_its_frame_is_harmless() -> None:
    wire = SimulatedWire(WORST_CASE_RATES)
    leaves, stays, ears = add_controllers(wire, 3)
    leaves.controller.queue_frame(Frame(1, bytes(8)), 0)
    stays.controller.queue_frame(Frame(2, b""), 0)
    wire.advance(50_000)
    wire.remove_controller(leaves.controller)
    wire.advance(10**9)
    assert ears.received_ids == [2]


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("adapter_class", sorted(ADAPTER_CLASSES))
def test_an_adapter_delays_by_at_most_a_usb_frame(adapter_class: str, seed: int) -> None:
    adapter, latency = ADAPTER_CLASSES[adapter_class], AdapterLatency(adapter_class, seed)
    sent = [latency.send(t_ns) - t_ns for t_ns in range(0, 200_000_000, 3_000_000)]
    received = [latency.receive(t_ns) - t_ns for t_ns in range(0, 200_000_000, 3_000_000)]
    for delays, period in ((sent, adapter.send_period_ns), (received, adapter.receive_period_ns)):
        assert 0 <= min(delays) <= max(delays) <= period * 1.001 + adapter.frame_duration_ns
    if adapter_class == "none":
        assert set(sent + received) == {0}


def test_frames_of_one_usb_frame_arrive_together_and_in_order() -> None:
    latency = AdapterLatency("usb-fs", 3)
    times = [latency.receive(t_ns) for t_ns in range(0, 20_000_000, 130_000)]
    assert times == sorted(times)
    steps = sorted(
        {later_time - earlier_time for earlier_time, later_time in pairwise(times)} - {0}
    )
    assert steps == pytest.approx([1_000_100] * len(steps), abs=2)


def test_all_phases_of_a_usb_frame_occur() -> None:
    latency = AdapterLatency("usb-fs")
    delays = [latency.send(t_ns) - t_ns for t_ns in range(0, 12_000_000_000, 2_000_000)]
    assert min(delays) < 20_000
    assert max(delays) > 980_000
