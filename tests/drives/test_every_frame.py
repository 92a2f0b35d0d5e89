"""Test the message decoders with frames of random data, and the message encoders with random numbers.

The frames have every 11-bit identifier and every length.
"""

import functools
import math
import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from handctl.drives.contract import DrivePhase, DriveState, DriveTarget
from handctl.drives.frame import BRS, EXTENDED_FLAG, FDF, Frame
from handctl.drives.protocol_registry import PROTOCOL_ENTRIES
from handctl.runtime.diagnostics.drive_rig import DriveRig
from tests.drives.protocol_bench import ProtocolBench, hand_file
from tests.drives.virtual_bench import VirtualBench, make_drive_rig
from tests.drives.wired_drives import WiredDrives

TORQUE_LIMIT_N_M = 0.8
STANDARD_IDS, PAYLOAD_LENGTHS = range(0x800), range(65)
RANDOM_ID_COUNT = 200
"""Number of random 29-bit identifiers with which each drive protocol is tested."""


@pytest.fixture(params=sorted(PROTOCOL_ENTRIES), scope="module")
def bench(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[ProtocolBench]:
    folder: Path = tmp_path_factory.mktemp("hand")
    new_bench = ProtocolBench(hand_file(folder, [request.param]))
    new_bench.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    yield new_bench
    new_bench.simulated_hand.close()


def extended_ids(bench: ProtocolBench, random_source: random.Random) -> set[int]:
    """Return random 29-bit identifiers, and at most four 29-bit identifiers that the drive or its host uses.

    The result also contains identifiers with one wrong bit: 29 for each returned identifier of the
    drive or its host.
    """
    drive_and_host_ids = sorted(
        identifier
        for identifier in bench.drives[0].node_ids | bench.drives[0].host_ids
        if identifier & EXTENDED_FLAG
    )
    sampled_ids = random_source.sample(drive_and_host_ids, min(len(drive_and_host_ids), 4))
    changed_ids = {identifier ^ 1 << bit for identifier in sampled_ids for bit in range(29)}
    return {
        *sampled_ids,
        *changed_ids,
        *(EXTENDED_FLAG | random_source.getrandbits(29) for _ in range(RANDOM_ID_COUNT)),
    }


def frames_of_all_kinds(bench: ProtocolBench, seed: int, t_ns: int) -> Iterator[Frame]:
    """Yield frames of each length, with all 11-bit and many 29-bit identifiers.

    Frames with more than 8 bytes are CAN FD frames.
    """
    random_source = random.Random(seed)
    for can_id in [*STANDARD_IDS, *sorted(extended_ids(bench, random_source))]:
        data = random_source.randbytes(64)
        for length in PAYLOAD_LENGTHS:
            yield Frame(can_id, data[:length], FDF | BRS if length > 8 else 0, 0, t_ns)


def silent_ready_and_enabled_states(bench: ProtocolBench) -> list[DriveState]:
    """Return a silent, a ready and an enabled state of the first drive.

    The enabled state is the present state of the drive on the bench. The ready state differs from
    the enabled state only in the drive phase.
    """
    ready_state = bench.states[0]._replace(phase=DrivePhase.READY)
    return [bench.drives[0].initial_state(), ready_state, bench.states[0]]


@pytest.mark.parametrize("state_index", range(3), ids=["silent", "ready", "enabled"])
def test_a_frame_of_another_host_changes_nothing_and_no_frame_raises(
    bench: ProtocolBench, state_index: int
) -> None:
    drive, state_before = bench.drives[0], silent_ready_and_enabled_states(bench)[state_index]
    receive, own_node_ids, t_ns = drive.receive, drive.node_ids, bench.k * 2_000_000
    for frame in frames_of_all_kinds(bench, state_index, t_ns):
        state_after = receive(state_before, frame)
        if frame.can_id not in own_node_ids:
            assert state_after is state_before, frame
        elif state_after is not state_before:
            drive.advance(state_after, t_ns, DriveTarget.DISABLE, 0.0)


@pytest.mark.parametrize("bench", ["mit"], indirect=True)
def test_the_sensor_node_s_decoder_takes_its_own_frames_only(bench: ProtocolBench) -> None:
    wired_drives, sensor_node_ids = (
        WiredDrives((), bench.sensor_node),
        bench.sensor_node.node_ids | bench.sensor_node.host_ids,
    )
    wired_drives.begin_tick_with_sync(0)
    frames = list(frames_of_all_kinds(bench, 9, bench.k * 2_000_000))
    other_frames, block_before = (
        [frame for frame in frames if frame.can_id not in sensor_node_ids],
        wired_drives.block.copy(),
    )
    assert wired_drives.receive(other_frames).field_number("strange") == len(other_frames)
    wired_drives.field_view("strange")[...] = 0
    assert wired_drives.block.tobytes() == block_before.tobytes()
    assert [frame.can_id for frame in wired_drives.receive(frames).foreign_frames] == [
        bench.sensor_node.sync_id
    ] * len(PAYLOAD_LENGTHS)


def test_simulated_drives_survive_every_frame(bench: ProtocolBench) -> None:
    node, t_ns = bench.simulated_hand.world.nodes[0][0], bench.simulated_hand.world.t_ns
    for frame in frames_of_all_kinds(bench, 10, t_ns):
        node.receive(frame, t_ns)  # type: ignore[arg-type]


@functools.cache
def enabled_drive_on_bench(protocol: str) -> tuple[VirtualBench, DriveRig]:
    virtual_bench = VirtualBench(protocol)
    rig = make_drive_rig(virtual_bench, protocol, TORQUE_LIMIT_N_M)
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 10.0)
    return virtual_bench, rig


@pytest.mark.parametrize("protocol", sorted(PROTOCOL_ENTRIES))
@given(torque=st.floats(width=64) | st.floats(-TORQUE_LIMIT_N_M, TORQUE_LIMIT_N_M))
@example(torque=TORQUE_LIMIT_N_M)
@example(torque=-TORQUE_LIMIT_N_M)
@example(torque=math.nextafter(TORQUE_LIMIT_N_M, 1.0))
@example(torque=5e-324)
@example(torque=math.nan)
@example(torque=-math.inf)
def test_a_number_is_refused_or_arrives_as_it_is(protocol: str, torque: float) -> None:
    virtual_bench, rig = enabled_drive_on_bench(protocol)
    if abs(torque) <= TORQUE_LIMIT_N_M:
        _, frames = rig.drive.advance(rig.state, rig.t_ns, DriveTarget.ENABLE, torque)
        virtual_bench.send(frames)
        # In the protocols of this list, the motor model determines the range of the torque codes.
        # In the other protocols, the torque limit determines the range of the torque codes.
        step = {"cubemars": 36.0 / 4095, "robstride_mit": 11.0 / 4095}.get(
            protocol, TORQUE_LIMIT_N_M / 1000
        )
        assert virtual_bench.bench.motors[0].servo.torque == pytest.approx(torque, abs=step)
    else:
        with pytest.raises(ValueError, match="expected at most"):
            rig.drive.advance(rig.state, rig.t_ns, DriveTarget.ENABLE, torque)
