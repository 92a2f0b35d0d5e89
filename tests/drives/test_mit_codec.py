"""Compare frames of the MIT protocol with bytes from the manual, and test all values that a frame can contain."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.drives.contract import DrivePhase, DriveState, DriveTarget
from handctl.drives.frame import FDF, Frame
from handctl.drives.mit import codec
from handctl.drives.mit.drive import MitDrive
from handctl.drives.mit.progress import MitProgress
from handctl.drives.protocol_registry import make_drive
from handctl.drives.readback import ReadbackCursor, RecheckCursor
from handctl.drives.signals import SignalTable
from handctl.errors import ConfigError
from tests.drives.conftest import MotorSection, make_mit_drive

TORQUE_MAX_N_M = 0.8
MOTOR_RANGES = codec.MotorRanges(12.5, 50.0, TORQUE_MAX_N_M)
valid_torques = st.floats(-TORQUE_MAX_N_M, TORQUE_MAX_N_M)
COMMAND_TABLE, FEEDBACK_TABLE = (
    SignalTable(codec.command_message(1, MOTOR_RANGES)),
    SignalTable(codec.feedback_message(0x11, MOTOR_RANGES)),
)
ENABLED_STATE = DriveState(
    phase=DrivePhase.ENABLED, protocol_state=MitProgress(is_configured=True, is_enable_sent=True)
)


@pytest.mark.parametrize(
    ("torque", "payload_hex"),
    [  # p = 0x7FFF, v = 0x7FF, kp = kd = 0. The last twelve bits of the payload are the torque
        (-0.8, "7fff7ff000000000"),
        (0.8, "7fff7ff000000fff"),
        (0.0, "7fff7ff000000800"),
        (0.4, "7fff7ff000000bff"),
        (-0.4, "7fff7ff000000400"),
    ],
)
def test_commands_have_the_bytes_of_the_manual(torque: float, payload_hex: str) -> None:
    assert COMMAND_TABLE.pack(torque) == bytes.fromhex(payload_hex)


@pytest.mark.parametrize(
    ("payload_hex", "expected_values"),
    [  # state and identifier of the motor, position (16 bits), velocity (12 bits), torque (12 bits), two temperatures
        ("01000000000000ff", (0, -12.5, -50.0, -0.8, 255.0)),
        ("11ffffffffff2a19", (1, 12.5, 50.0, 0.8, 42.0)),
        ("d17fff7ff7ff1e1f", (13, -12.5 / 65535, -50 / 4095, -0.8 / 4095, 31.0)),
        ("018000800bff2020", (0, 12.5 / 65535, 50 / 4095, 0.8 * (2 * 3071 / 4095 - 1), 32.0)),
    ],
)
def test_feedback_is_decoded_to_known_values(
    payload_hex: str, expected_values: tuple[float, ...]
) -> None:
    assert codec.decode_feedback(bytes.fromhex(payload_hex), FEEDBACK_TABLE) == pytest.approx(
        expected_values, abs=1e-12
    )


@pytest.mark.parametrize(
    ("request_payload", "payload_hex"),
    [
        (codec.register_request(1, codec.REFRESH), "0100cc0000000000"),
        (codec.register_request(11, codec.READ, 23), "0b00331700000000"),
        (codec.register_request(2, codec.WRITE, 9, 1000), "02005509e8030000"),
        (codec.register_request(2, codec.WRITE, 9, 1000.0), "02005509e8030000"),
        (codec.register_request(0x123, codec.WRITE, 23, 0.5), "230155170000003f"),
        (codec.special_command(codec.ENABLE), "fffffffffffffffc"),
        (codec.special_command(codec.DISABLE), "fffffffffffffffd"),
        (codec.special_command(codec.CLEAR_ERROR), "fffffffffffffffb"),
    ],
)
def test_requests_have_the_known_bytes(request_payload: bytes, payload_hex: str) -> None:
    assert request_payload == bytes.fromhex(payload_hex)


def test_register_replies_are_decoded_to_known_values() -> None:
    decoded_frame = codec.decode_register_reply(bytes.fromhex("0100330900040000"), 1)
    assert decoded_frame is not None
    assert (decoded_frame.operation, decoded_frame.register, decoded_frame.value) == (0x33, 9, 1024)
    decoded_frame = codec.decode_register_reply(bytes.fromhex("0100551700008040"), 1)
    assert decoded_frame is not None
    assert (decoded_frame.operation, decoded_frame.register, decoded_frame.value) == (0x55, 23, 4.0)
    assert codec.decode_register_reply(bytes.fromhex("0100aa0100000000"), 1) == (0xAA, 1, bytes(4))
    assert codec.decode_register_reply(bytes.fromhex("0200330900040000"), 1) is None
    assert codec.decode_register_reply(bytes.fromhex("018000800bff2020"), 1) is None


@given(valid_torques)
def test_a_torque_arrives_within_half_a_step(torque: float) -> None:
    code = int.from_bytes(COMMAND_TABLE.pack(torque), "big") & 0xFFF
    assert code * 2 * TORQUE_MAX_N_M / 4095 - TORQUE_MAX_N_M == pytest.approx(
        torque, abs=TORQUE_MAX_N_M / 4095 + 1e-12
    )


@given(valid_torques)
def test_a_command_never_looks_like_a_special_one_and_has_no_gains(torque: float) -> None:
    data = COMMAND_TABLE.pack(torque)
    assert data[:3] == b"\x7f\xff\x7f"
    assert int.from_bytes(data, "big") >> 12 & 0xFFFFFF == 0


@given(valid_torques, valid_torques)
def test_more_torque_is_never_a_smaller_code(first_torque: float, second_torque: float) -> None:
    smaller_torque, larger_torque = sorted((first_torque, second_torque))
    assert COMMAND_TABLE.pack(smaller_torque) <= COMMAND_TABLE.pack(larger_torque)


@given(
    st.one_of(
        st.floats(max_value=-TORQUE_MAX_N_M, exclude_max=True),
        st.floats(min_value=TORQUE_MAX_N_M, exclude_min=True),
    )
)
def test_torque_out_of_range_cannot_be_encoded(torque: float) -> None:
    with pytest.raises(ValueError, match="index_motor: torque"):
        make_mit_drive().advance(ENABLED_STATE, 1, DriveTarget.ENABLE, torque)


@pytest.mark.parametrize("torque", [math.nan, math.inf, -math.inf])
def test_nan_cannot_be_encoded(torque: float) -> None:
    with pytest.raises(ValueError, match=r"expected at most 0\.8$"):
        make_mit_drive().advance(ENABLED_STATE, 1, DriveTarget.ENABLE, torque)


@given(valid_torques, st.sampled_from([-1, 1]))
def test_direction_turns_every_sign(torque: float, direction: int) -> None:
    drive = make_mit_drive(direction=direction, zero_rad=0.25)
    assert drive.command.pack(torque) == COMMAND_TABLE.pack(direction * torque)
    state = DriveState(phase=DrivePhase.READY, protocol_state=MitProgress(is_configured=True))
    frames = drive.receive(state, Frame(0x11, bytes.fromhex("01c000c00c002020")))
    assert frames.position == pytest.approx(direction * (12.5 * (2 * 0xC000 / 65535 - 1) - 0.25))
    assert frames.velocity == pytest.approx(direction * 50 * (2 * 0xC00 / 4095 - 1))
    assert frames.torque == pytest.approx(direction * 0.8 * (2 * 0xC00 / 4095 - 1))


@given(st.integers(0, 15), st.integers(0, 0xFFFF), st.integers(0, 0xFFF), st.integers(0, 0xFFF))
def test_feedback_of_the_simulated_firmware_reads_back(
    state_nibble: int, position_code: int, velocity_code: int, torque: int
) -> None:
    from firmware_sim.nodes.mit import codec as firmware

    ranges = firmware.MitRanges(*MOTOR_RANGES)
    motion = (
        firmware.code_to_value(position_code, 12.5, 16),
        firmware.code_to_value(velocity_code, 50.0, 12),
        firmware.code_to_value(torque, TORQUE_MAX_N_M, 12),
    )
    data = firmware.encode_feedback(state_nibble, 3, motion, ranges, (30.0, 40.0))
    decoded_feedback = codec.decode_feedback(data, FEEDBACK_TABLE)
    assert decoded_feedback[0] == state_nibble
    steps = (25.0 / 65535, 100.0 / 4095, 1.6 / 4095)
    for value, true, step in zip(decoded_feedback[1:4], motion, steps, strict=True):
        assert abs(value - true) <= step * 1.001


@given(valid_torques)
def test_the_simulated_firmware_reads_commands(torque: float) -> None:
    from firmware_sim.nodes.mit import codec as firmware

    decoded_frame = firmware.decode_command(
        COMMAND_TABLE.pack(torque), firmware.MitRanges(*MOTOR_RANGES)
    )
    assert (decoded_frame.kp, decoded_frame.kd) == (0.0, 0.0)
    assert decoded_frame.torque == pytest.approx(torque, abs=TORQUE_MAX_N_M / 4095 + 1e-12)


drive_states = st.builds(
    DriveState,
    phase=st.sampled_from(DrivePhase),
    error=st.sampled_from([0, 0xA, 0x102]),
    protocol_state=st.builds(
        MitProgress,
        cursor=st.builds(
            ReadbackCursor,
            st.integers(0, 4),
            st.booleans(),
            st.booleans(),
            st.integers(-1, 9),
            st.integers(0, 10),
        ),
        is_configured=st.booleans(),
        enabled_by_other_host=st.booleans(),
        is_enable_sent=st.booleans(),
        is_disabling=st.booleans(),
        disable_command_ns=st.integers(0, 10),
        errors_to_ignore=st.integers(0, 6),
    ),
    # Draw only indices of existing settings. Without a limit of the index, hypothesis would
    # generate an index that no setting has.
    recheck=st.builds(
        RecheckCursor,
        st.integers(0, len(make_mit_drive().rechecked_settings) - 1),
        st.integers(0, 10),
        st.integers(0, 9),
    ),
)
frame_identifiers = st.one_of(st.just(0x11), st.integers(0, 2047))
frame_payloads = st.one_of(
    st.binary(max_size=64),
    st.builds(bytes.__add__, st.just(b"\x01\x00\x33"), st.binary(min_size=5, max_size=5)),
)


@given(
    drive_states, frame_identifiers, frame_payloads, st.sampled_from(DriveTarget), st.integers(0, 2)
)
def test_any_frame_is_survived_in_any_state(
    state: DriveState, can_id: int, data: bytes, target: DriveTarget, bus: int
) -> None:
    drive = make_mit_drive()
    state_after = drive.receive(state, Frame(can_id, data, FDF, bus, 5))
    if can_id != 0x11 or bus != 0:
        assert state_after is state
    _, frames = drive.advance(state_after, 10, target, 0.0)
    torque_frames = [
        frame for frame in frames if frame.can_id == 1 and frame.data[:7] != b"\xff" * 7
    ]
    assert not torque_frames or (
        target == DriveTarget.ENABLE and state_after.phase == DrivePhase.ENABLED
    )


def test_frames_of_every_identifier_and_length_are_survived() -> None:
    drive, state = make_mit_drive(), make_mit_drive().initial_state()
    for can_id in range(2048):
        for length in range(65):
            state_after = drive.receive(state, Frame(can_id, b"\x01" * length))
            assert (state_after is state) == (can_id != 0x11), (can_id, length)


def test_options_set_reply_identifier_and_can_fd() -> None:
    drive = make_mit_drive(options={"reply_id": 0x55, "fd": True})
    assert drive.node_ids == {0x55}
    assert drive.torque_cut_frames()[0].flags & FDF
    assert drive.frames_per_tick == ((8, True), (8, True))
    assert make_mit_drive().frames_per_tick == ((8, False), (8, False))
    assert make_mit_drive().host_ids == {0x001, 0x101, 0x201, 0x301, 0x7FF}


@pytest.mark.parametrize(
    ("drive_options", "expected_message"),
    [
        ({"speed": 1}, "motor[index_motor].options.speed: unknown key; expected reply_id or fd"),
        (
            {"reply_id": 0},
            "motor[index_motor].options.reply_id: 0; expected an identifier from 1 to 0x7fe",
        ),
        ({"reply_id": 0x7FF}, "motor[index_motor].options.reply_id: 2047; expected"),
        ({"reply_id": True}, "motor[index_motor].options.reply_id: True; expected"),
        ({"fd": 1}, "motor[index_motor].options.fd: 1; expected true or false"),
    ],
)
def test_wrong_options_are_refused(drive_options: dict[str, object], expected_message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make_mit_drive(options=drive_options)
    assert str(caught.value).startswith(expected_message)


def test_the_registry_knows_mit_and_says_what_it_knows() -> None:
    assert isinstance(make_drive(MotorSection(), 0), MitDrive)
    with pytest.raises(
        ConfigError, match=r"motor\[index_motor\].protocol: 'mlt'; expected one of .*mit"
    ):
        make_drive(MotorSection(protocol="mlt"), 0)


def test_watchdog_and_torque_limit_become_registers() -> None:
    expected = dict(make_mit_drive(watchdog_ms=50, torque_max_N_m=1.5).required_settings)
    assert expected == {10: 1, 21: 12.5, 22: 50.0, 23: 1.5, 9: 1000}
    assert codec.register_bytes(23, 1.5) == struct.pack("<f", 1.5)
