"""Test the behaviour that every drive protocol must have.

The simulated firmware in these tests shares no code with the drives of handctl.
"""

import math
import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.frame import EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from handctl.drives.readback import RECHECK_TRIES, RecheckCursor
from tests.drives.protocol_bench import ProtocolBench, hand_file, servo_torques


@pytest.fixture(params=VERIFIABLE_PROTOCOLS)
def protocol(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def bench(protocol: str, tmp_path: Path) -> Iterator[ProtocolBench]:
    new_bench = ProtocolBench(hand_file(tmp_path, [protocol]))
    yield new_bench
    new_bench.simulated_hand.close()


def test_a_drive_goes_from_silent_to_enabled_to_confirmed_disabled(bench: ProtocolBench) -> None:
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert servo_torques(bench) == [0.0] * 4
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for _ in range(200):
        bench.tick(DriveTarget.ENABLE, 0.05)
    world = bench.simulated_hand.world
    for drive, state in zip(bench.drives, bench.states, strict=True):
        truth = world.plant.motors[drive.name].theta + world.encoder_offset[drive.name]
        assert state.position == pytest.approx(truth, abs=0.01)
        assert state.feedback_t_ns >= (bench.k - 2) * 2_000_000
    assert servo_torques(bench) == pytest.approx([0.05] * 4, abs=0.001)
    bench.run_until_phase(DriveTarget.DISABLE, DrivePhase.READY, max_ticks=100)
    assert servo_torques(bench) == [0.0] * 4
    assert [state.misread_frame_count for state in bench.states] == [0] * 4
    assert bench.simulated_hand.world.malformed_frame_count == 0


@pytest.mark.parametrize("period_ms", [1, 25])
def test_any_control_rate_that_the_watchdogs_allow_comes_to_torque(
    protocol: str, period_ms: int, tmp_path: Path
) -> None:
    """A drive setting that was verified in the last tick counts as verified, even if a tick lasts 25 ms."""
    slow_bench = ProtocolBench(hand_file(tmp_path, [protocol]), period_ns=period_ms * 1_000_000)
    slow_bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    for _ in range(5):
        slow_bench.tick(DriveTarget.POLL)
    slow_bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED, max_ticks=200)
    slow_bench.simulated_hand.close()


def test_dead_host_loses_torque_until_an_operator_clears(bench: ProtocolBench) -> None:
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    bench.tick(DriveTarget.ENABLE, 0.05)
    for _ in range(15):
        bench.tick(DriveTarget.LISTEN)
    assert servo_torques(bench) == pytest.approx([0.05] * 4, abs=0.001), "30 ms: not yet"
    for _ in range(35):
        bench.tick(DriveTarget.LISTEN)
    assert servo_torques(bench) == [0.0] * 4, "100 ms, and the watchdogs are set to 50 ms"
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.FAULT, max_ticks=100)
    for state in bench.states:
        assert "watchdog" in state.error_text
    bench.run_until_phase(DriveTarget.DISABLE, DrivePhase.FAULT, max_ticks=100)
    bench.clear_errors()
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert [state.error for state in bench.states] == [0] * 4
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)


@pytest.mark.parametrize("protocol", ["mit", "odrive", "moteus", "robstride"])
@pytest.mark.parametrize("target", [DriveTarget.POLL, DriveTarget.DISABLE])
def test_a_waiting_drive_gets_no_new_state_when_nothing_changes(
    bench: ProtocolBench, target: DriveTarget
) -> None:
    """Reproduce a waste: in each tick, drives replaced parts of their states by equal parts.

    The controller then computed the hash of all parts again. The state of a CiA 402 drive contains
    the time of each status word, so it changes in each tick.
    """
    bench.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    for _ in range(10):
        bench.tick(target)
    new_part_count = 0
    for _ in range(100):
        parts_before = [state.protocol_state for state in bench.states]
        bench.tick(target)
        new_part_count += sum(
            state.protocol_state is not part
            for state, part in zip(bench.states, parts_before, strict=True)
        )
    assert new_part_count < 100, "of 400 parts: four drives in 100 ticks"


def test_a_cut_removes_the_torque_in_the_same_tick_and_disarms(bench: ProtocolBench) -> None:
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    bench.tick(DriveTarget.ENABLE, 0.05)
    assert 0.0 not in servo_torques(bench)
    bench.tick(
        DriveTarget.LISTEN,
        extra_frames=[frame for drive in bench.drives for frame in drive.torque_cut_frames()],
    )
    assert servo_torques(bench) == [0.0] * 4
    for _ in range(200):
        bench.tick(DriveTarget.DISABLE)
    assert {state.phase for state in bench.states} <= {DrivePhase.READY, DrivePhase.FAULT}


def test_a_cut_removes_the_torque_before_the_node_leaves_operational(bench: ProtocolBench) -> None:
    """The command that disables a CiA 402 drive arrives before the node leaves the NMT state operational.

    A node accepts PDOs only in the NMT state operational (CiA 301). CiA 402-2 does not require that
    a drive stops its motor when it leaves the NMT state operational.
    """
    for drive in bench.drives:
        command_ids = [frame.can_id for frame in drive.torque_cut_frames()]
        assert 0 not in command_ids[:1], "an NMT order comes after the control word"


def test_disabling_is_not_confirmed_by_silence(bench: ProtocolBench) -> None:
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for _ in range(400):
        bench.received_frames = []
        bench.tick(DriveTarget.DISABLE)
    bench.received_frames = []
    assert [state.phase for state in bench.states] == [DrivePhase.ENABLED] * 4


@pytest.mark.parametrize("target", [DriveTarget.POLL, DriveTarget.ENABLE])
def test_an_enabled_drive_is_cut_as_soon_as_a_repeated_read_back_fails(
    bench: ProtocolBench, target: DriveTarget
) -> None:
    """When the repeated read-back of an enabled drive fails, the drive gets frames that cut its torque.

    The feedback of the drive shows no error, so the drive could still make torque without the
    frames that cut it.
    """
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    t_ns = bench.k * bench.period_ns
    for drive, state in zip(bench.drives, bench.states, strict=True):
        unanswered_recheck = RecheckCursor(due_ns=t_ns, tries=RECHECK_TRIES)
        state = state._replace(recheck=unanswered_recheck)
        state, _ = drive.advance(state, t_ns, DriveTarget.ENABLE, 0.0)
        assert state.phase == DrivePhase.FAULT
        assert "not answered while enabled" in state.error_text
        _, frames = drive.advance(state, t_ns + bench.period_ns, target, 0.0)
        assert set(drive.torque_cut_frames()) <= set(frames)


@pytest.mark.parametrize("torque", [math.nan, math.inf, -math.inf, 0.801, -1e9])
def test_invalid_torque_cannot_be_encoded(bench: ProtocolBench, torque: float) -> None:
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for drive, state in zip(bench.drives, bench.states, strict=True):
        with pytest.raises(ValueError, match=drive.name):
            drive.advance(state, bench.k * 2_000_000, DriveTarget.ENABLE, torque)


@pytest.mark.parametrize("phase", [DrivePhase.SILENT, DrivePhase.ENABLED])
def test_any_bytes_on_any_identifier_are_survived(bench: ProtocolBench, phase: DrivePhase) -> None:
    if phase == DrivePhase.ENABLED:
        bench.run_until_phase(DriveTarget.ENABLE, phase)
    random_source, drive, known_state = random.Random(7), bench.drives[0], bench.states[0]
    for can_id in range(0x800):
        for length in range(65) if can_id in drive.node_ids else (0, 8, 64):
            frame = Frame(
                can_id,
                random_source.randbytes(length),
                FDF if length > 8 else 0,
                0,
                bench.k * 2_000_000,
            )
            state_after = drive.receive(known_state, frame)
            if can_id not in drive.node_ids:
                assert state_after is known_state
            drive.advance(state_after, bench.k * 2_000_000, DriveTarget.POLL, 0.0)
            for other_frame in (
                frame._replace(bus=1),
                frame._replace(can_id=can_id | EXTENDED_FLAG),
            ):
                assert drive.receive(known_state, other_frame) is known_state
            assert (
                drive.receive(known_state, frame._replace(can_id=can_id | REMOTE_FLAG))
                is known_state
            )


def test_simulated_nodes_survive_any_bytes(bench: ProtocolBench) -> None:
    random_source = random.Random(8)
    for can_id in range(0x800):
        for length in (0, 1, 3, 4, 8, 64):
            flags = FDF if length > 8 else 0
            bench.simulated_hand.world.receive(
                Frame(can_id, random_source.randbytes(length), flags)
            )  # type: ignore[arg-type]
        bench.simulated_hand.world.receive(Frame(can_id | REMOTE_FLAG, b""))  # type: ignore[arg-type]
    bench.simulated_hand.world.advance(bench.simulated_hand.world.t_ns + 100_000_000)


def test_frames_of_host_and_node_have_distinct_identifiers(bench: ProtocolBench) -> None:
    drive = bench.drives[0]
    assert not drive.host_ids & drive.node_ids
    bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    ours = {
        can_id for drive in bench.drives for can_id in drive.host_ids
    } | bench.sensor_node.host_ids
    assert {frame.can_id for frame in bench.sent_frames} <= ours
