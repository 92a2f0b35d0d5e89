"""Fuzzing targets for received CAN frames.

The fuzzing targets test the decoders of each drive protocol and of the sensor node. An input of a
fuzzing target has the following fields, with their widths in bits:

    state 8 | up to five frames: identifier 8 | shape 8 | control 8 | payload

The state byte selects the initial state of the drive. The identifier byte selects one of the
identifiers of the node, because a random CAN identifier hardly ever belongs to a node. The shape
byte selects the CAN flags of the frame. It also decides whether the payload has 8 bytes, or as many
bytes as the control byte says. The control byte also selects the pause before the frame, and the
state that the host requests from the drive.

The corpus begins with inputs that contain recorded frames. A simulated drive sent the recorded
frames between the first tick and the tick in which the drive made torque.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from fuzz.fuzzed_drives import FUZZED_DRIVES
from handctl.core.block_schema import BlockArray
from handctl.drives.contract import Drive, DrivePhase, DriveState, DriveTarget
from handctl.drives.frame import BRS, ERROR_FLAG, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from tests.drives.protocol_bench import ProtocolBench, hand_file
from tests.drives.wired_drives import WiredDrives

FuzzTarget = Callable[[bytes], bool]
STEP_NS, LONG_SILENCE_NS = 2_000_000, 1_000_000_000
"""Time from one frame to the next, and silence after which every drive counts as lost [ns]."""
MIN_CONTROL_BYTE_OF_SILENCE = 240
"""If the control byte of a frame in the input is at least this value, a long silence precedes the frame."""
IDENTIFIER_FLAGS = (0, 0, 0, 0, 0, EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG)
MAX_FRAMES = 5
DRIVE_TARGETS = tuple(DriveTarget)
CLEAR_REQUEST_BIT = 0x40
"""Bit of the control byte of a frame in the input.

If the bit is set, the fuzzing target clears the error of the drive.
"""
MAX_PAYLOAD_BYTES = 64


def frames_of_input(
    data: bytes, selectable_ids: Sequence[int], t_ns: int
) -> Iterator[tuple[Frame, int]]:
    """Yield each frame of an input, together with the control byte of the frame.

    Most of the frames have an identifier from ``selectable_ids``.
    """
    offset = 1
    end = len(data)
    for _ in range(MAX_FRAMES):
        if offset + 3 > end:
            return
        id_byte, shape_byte, control_byte = data[offset : offset + 3]
        can_id = (
            selectable_ids[id_byte % len(selectable_ids)]
            if id_byte < 240
            else (id_byte << 3 ^ control_byte) & 0x7FF
        )
        size = 8 if shape_byte & 3 else control_byte % (MAX_PAYLOAD_BYTES + 1)
        payload = data[offset + 3 : offset + 3 + size]
        t_ns += LONG_SILENCE_NS if control_byte >= MIN_CONTROL_BYTE_OF_SILENCE else STEP_NS
        yield (
            Frame(
                can_id | IDENTIFIER_FLAGS[shape_byte >> 5],
                payload,
                FDF | BRS if size > 8 else 0,
                0,
                t_ns,
            ),
            control_byte,
        )
        offset += 3 + size


class RecordedState(NamedTuple):
    """Record of one tick: the state of a drive before the tick, the time [ns], and the frames from this drive."""

    state: DriveState
    t_ns: int
    received_frames: tuple[Frame, ...]


def record_states_until_torque(drive_name: str, folder: Path) -> tuple[Drive, list[RecordedState]]:
    """Return a drive of ``FUZZED_DRIVES``, and the recorded states of this drive.

    The states of the drive are recorded from the first tick until the drive makes torque.
    """
    fuzzed_drive = FUZZED_DRIVES[drive_name]
    path = hand_file(folder, [fuzzed_drive.protocol], fuzzed_drive.options)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(
        "".join(line for line in lines if not line.startswith(fuzzed_drive.skipped_option))
    )
    bench = ProtocolBench(path)
    motor = bench.drives[0]
    recorded_states = list[RecordedState]()
    while bench.states[0].phase != DrivePhase.ENABLED:
        received_frames = tuple(
            frame for frame in bench.received_frames if frame.can_id in motor.node_ids
        )
        if received_frames or not recorded_states:
            recorded_states.append(
                RecordedState(bench.states[0], bench.k * bench.period_ns, received_frames)
            )
        are_drives_ready = all(state.phase >= DrivePhase.READY for state in bench.states)
        bench.tick(DriveTarget.ENABLE if are_drives_ready else DriveTarget.POLL)
    recorded_states.append(RecordedState(bench.states[0], bench.k * bench.period_ns, ()))
    bench.simulated_hand.close()
    return motor, recorded_states


def recorded_inputs(drive_name: str, folder: Path) -> list[bytes]:
    """Return the recorded frames of a drive, encoded as inputs of the fuzzing target.

    The frames were recorded from the first tick until the drive made torque.
    """
    motor, recorded_states = record_states_until_torque(drive_name, folder)
    selectable_ids = selectable_identifiers(motor, recorded_states)
    inputs = []
    for i, (_, _, received_frames) in enumerate(recorded_states):
        operations = [
            bytes((selectable_ids.index(frame.can_id), *_payload_header(frame.data))) + frame.data
            for frame in received_frames[:MAX_FRAMES]
        ]
        inputs.append(bytes((i,)) + b"".join(operations))
    return [data for data in inputs if len(data) > 1]


def selectable_identifiers(motor: Drive, recorded_states: Sequence[RecordedState]) -> list[int]:
    """Return at most 256 CAN identifiers, so that one byte of an input can select an identifier.

    The identifiers of the recorded frames come first.
    """
    received_can_ids = {
        frame.can_id
        for recorded_state in recorded_states
        for frame in recorded_state.received_frames
    }
    return [*sorted(received_can_ids), *sorted(motor.node_ids - received_can_ids)][:256]


def _payload_header(payload: bytes) -> tuple[int, int]:
    """Return the shape byte and the control byte, which precede a payload in an input of the fuzzer.

    If the shape byte is 1, the payload has 8 bytes. If the shape byte is 0, the control byte
    contains the number of payload bytes.
    """
    return (1, int(DriveTarget.POLL)) if len(payload) == 8 else (0, len(payload))


def drive_fuzz_target_factory(drive_name: str) -> Callable[[Path], FuzzTarget]:
    """Return the function that makes the fuzzing target for a drive of ``FUZZED_DRIVES``."""

    def make_fuzz_target(folder: Path) -> FuzzTarget:
        motor, recorded_states = record_states_until_torque(drive_name, folder)
        selectable_ids = selectable_identifiers(motor, recorded_states)
        return lambda data: _feed_drive(
            motor,
            recorded_states[data[0] % len(recorded_states)] if data else recorded_states[0],
            selectable_ids,
            data,
        )

    return make_fuzz_target


def _feed_drive(
    motor: Drive, start_state: RecordedState, selectable_ids: Sequence[int], data: bytes
) -> bool:
    """Feed the frames of an input to the decoder of a drive.

    After each frame, the host requests the drive state that the control byte of the frame selects,
    such as enabled. Return True if any frame changed the state of the drive.
    """
    state = start_state.state
    is_accepted = False
    for frame, control_byte in frames_of_input(data, selectable_ids, start_state.t_ns):
        state_after = motor.receive(state, frame)
        is_accepted = is_accepted or state_after is not state
        state, sent_frames = _advance_drive(motor, state_after, frame.t_ns + STEP_NS, control_byte)
        assert (
            max((len(sent_frame.data) for sent_frame in sent_frames), default=0)
            <= MAX_PAYLOAD_BYTES
        )
        assert state.phase in DrivePhase
    motor.clear(state)
    return is_accepted


def _advance_drive(
    motor: Drive, state: DriveState, t_ns: int, control_byte: int
) -> tuple[DriveState, tuple[Frame, ...]]:
    if state.phase == DrivePhase.FAULT:
        motor.fault_cause(state.error)
        if control_byte & CLEAR_REQUEST_BIT:
            return motor.clear(state)
    target = DRIVE_TARGETS[control_byte % len(DRIVE_TARGETS)]
    return motor.advance(state, t_ns, target, 0.1 if target == DriveTarget.ENABLE else 0.0)


def sensor_fuzz_target(folder: Path) -> FuzzTarget:
    """Return the fuzzing target for the decoder of the sensor node."""
    bench = ProtocolBench(hand_file(folder, ["mit"]))
    bench.simulated_hand.close()
    wired_drives = WiredDrives((), bench.sensor_node)
    node_ids = sorted(bench.sensor_node.node_ids)
    return lambda data: _feed_sensor_node(wired_drives, wired_drives.block.copy(), node_ids, data)


def _feed_sensor_node(
    wired_drives: WiredDrives,
    initial_block: BlockArray,
    node_ids: Sequence[int],
    data: bytes,
) -> bool:
    """Feed the frames of an input to the decoder of the sensor node.

    ``initial_block`` is the initial state of the decoder.

    Return True if the decoder used any frame, or found any frame malformed or stale.
    """
    wired_drives.block[:] = initial_block
    accepted_count = 0
    for frame, control_byte in frames_of_input(data, node_ids, STEP_NS):
        wired_drives.begin_tick_with_sync(control_byte)
        wired_drives.receive([frame]).observe_readings()
        accepted_count += (
            int(wired_drives.field_view("group_answered").sum())
            + wired_drives.field_number("stale_now")
            + wired_drives.has_malformed_frame
        )
    return accepted_count > 0
