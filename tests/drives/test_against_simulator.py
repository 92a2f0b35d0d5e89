"""Test handctl's code for the drives and the sensor node of the packaged hand against the simulated firmware.

The simulated firmware shares no code with handctl.
"""

from collections.abc import Iterator

import pytest

from firmware_sim.lockstep_hand import LockstepHand
from handctl.drives.contract import Drive, DrivePhase, DriveState, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.protocol_registry import make_drive
from handctl.drives.sensors.sensor_node import SensorNode
from handctl.hand.hand_loading import load_hand
from tests.drives.wired_drives import WiredDrives

PERIOD_NS = 2_000_000
PACKAGED_HAND = load_hand("jamia")


class PackagedHandBench:
    """Bench that connects handctl's code for drives and sensor node of the packaged hand to the simulated firmware."""

    def __init__(self) -> None:
        """Start the simulator and the drives of the packaged hand."""
        self.simulated_hand = LockstepHand("jamia", seed=3, period_ns=PERIOD_NS)
        self.drives: list[Drive] = [
            make_drive(PACKAGED_HAND.motor_of_tendon(name), 0)
            for name in PACKAGED_HAND.tendon_names
        ]
        self.states: list[DriveState] = [drive.initial_state() for drive in self.drives]
        self.sensor_node = SensorNode.from_description(
            PACKAGED_HAND.sensor_node, 0, PACKAGED_HAND.tendon_names, PACKAGED_HAND.joints
        )
        self.sensors = WiredDrives((), self.sensor_node)
        self.tensions: dict[int, float] = {}
        self.received_frames: list[Frame] = []
        self.k = 0

    def tick(self, target: DriveTarget, torque: float = 0.0) -> None:
        """Receive the frames of the last tick, advance all drives by a tick, and let the simulator reply."""
        self.sensors.receive(
            frame for frame in self.received_frames if frame.can_id in self.sensor_node.node_ids
        )
        self.tensions = self.sensors.tensions
        for frame in self.received_frames:
            self.states = [
                d.receive(s, frame) for d, s in zip(self.drives, self.states, strict=True)
            ]
        host_frames = [self.sensors.begin_tick_with_sync(self.k)]
        for i, drive in enumerate(self.drives):
            self.states[i], frames = drive.advance(
                self.states[i], self.k * PERIOD_NS, target, torque
            )
            host_frames += frames
        self.received_frames = [
            Frame(*reply)
            for reply in self.simulated_hand.step(self.k * PERIOD_NS, list(host_frames))
        ]
        self.k += 1

    def run_until_phase(self, target: DriveTarget, phase: DrivePhase, max_ticks: int = 200) -> None:
        """Run ticks until all drives are in a given drive phase.

        If the drives do not all reach the given drive phase, the test fails.
        """
        for _ in range(max_ticks):
            self.tick(target)
            if all(state.phase == phase for state in self.states):
                return
        pytest.fail(
            f"{[(state.phase.name, state.error_text) for state in self.states]}, expected {phase.name}"
        )


@pytest.fixture
def bench() -> Iterator[PackagedHandBench]:
    hand_bench = PackagedHandBench()
    yield hand_bench
    hand_bench.simulated_hand.close()


def test_a_drive_goes_from_silent_to_enabled_and_back(bench: PackagedHandBench) -> None:
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for _ in range(200):
        bench.tick(DriveTarget.ENABLE, 0.05)
    assert sorted(bench.tensions) == [0, 1, 2, 3]
    for i, state in enumerate(bench.states):
        assert state.torque == pytest.approx(0.05, abs=0.002)
        assert state.feedback_t_ns >= (bench.k - 2) * PERIOD_NS
        assert 5.0 < bench.tensions[i] < 15.0, "0.05 N m on a spool of 5 mm is 10 N, friction aside"
    bench.tick(DriveTarget.DISABLE)
    bench.tick(DriveTarget.DISABLE)
    assert [state.phase for state in bench.states] == [DrivePhase.READY] * 4
    assert (bench.sensors.field_number("stale"), bench.sensors.has_malformed_frame) == (0, False)
    assert [state.misread_frame_count for state in bench.states] == [0] * 4


def test_the_watchdog_fires_on_silence_and_clear_makes_the_drive_ready(
    bench: PackagedHandBench,
) -> None:
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for _ in range(40):  # 40 ticks take 80 ms, which is longer than the watchdog time of 50 ms
        bench.tick(DriveTarget.LISTEN)
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.FAULT, max_ticks=3)
    assert {state.error_text for state in bench.states} == {
        "communication lost: the drive's watchdog fired"
    }
    for i, drive in enumerate(bench.drives):
        bench.states[i], frames = drive.clear(bench.states[i])
        assert len(frames) == 1
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert [state.error for state in bench.states] == [0] * 4
