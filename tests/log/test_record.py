"""The bytes of a tick pass through the pipe to the recorder without a change.

The recorder refuses bytes that do not describe a tick.
"""

import contextlib
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handctl.core.tick_types import (
    TELEMETRY_AXES,
    HandMode,
    IoEvent,
    PackedTelemetry,
    Telemetry,
    TelemetrySlices,
    TickEvent,
    TickIn,
    TickOut,
)
from handctl.drives.frame import FDF, Frame
from handctl.drives.frame_records import frames_as_records
from handctl.log.tick_packing import pack_tick, pack_tick_record
from handctl.log.tick_record import (
    RECORD_FRAMING_STRUCT,
    message_layout,
    unpack_tick,
    unpack_tick_record,
    unpack_ticks,
)
from handctl.safety.safety_action import SafetyAction

INT64_STRATEGY = st.integers(-(2**63), 2**63 - 1)
TEXT_STRATEGY = st.text(st.characters(codec="utf-8"), max_size=30)
CLASSICAL_FRAME_STRATEGY = st.builds(
    Frame,
    st.integers(0, 2**32 - 1),
    st.binary(max_size=8),
    st.just(0),
    st.integers(0, 255),
    INT64_STRATEGY,
)
FD_FRAME_STRATEGY = st.builds(
    Frame,
    st.integers(0, 2**32 - 1),
    st.binary(max_size=64),
    st.integers(FDF, 7),
    st.integers(0, 255),
    INT64_STRATEGY,
)
FRAMES_STRATEGY = st.lists(CLASSICAL_FRAME_STRATEGY | FD_FRAME_STRATEGY, max_size=12).map(tuple)
TICK_INPUT_STRATEGY = st.builds(
    TickIn,
    INT64_STRATEGY,
    INT64_STRATEGY,
    INT64_STRATEGY,
    FRAMES_STRATEGY,
    st.lists(st.builds(IoEvent, TEXT_STRATEGY, TEXT_STRATEGY, INT64_STRATEGY), max_size=3).map(
        tuple
    ),
    st.lists(TEXT_STRATEGY, max_size=3).map(tuple),
)


@st.composite
def telemetry_strategy(draw: st.DrawFn) -> Telemetry:
    sizes = {axis: draw(st.integers(1, 12)) for axis in ("joint", "tendon", "motor", "digit")}
    bits = np.random.default_rng(draw(st.integers(0, 2**32))).integers(
        0, 2**64, 300, dtype=np.uint64
    )
    return Telemetry(
        **{name: bits[: sizes[axis]].view("<f8").copy() for name, axis in TELEMETRY_AXES.items()}
    )


TICK_OUTPUT_STRATEGY = st.builds(
    TickOut,
    FRAMES_STRATEGY,
    st.sampled_from(HandMode),
    TEXT_STRATEGY,
    st.sampled_from(SafetyAction),
    telemetry_strategy(),
    st.lists(
        st.builds(TickEvent, TEXT_STRATEGY, TEXT_STRATEGY, TEXT_STRATEGY, TEXT_STRATEGY), max_size=3
    ).map(tuple),
    st.binary(min_size=8, max_size=8),
)


@settings(deadline=None)
@given(TICK_INPUT_STRATEGY, TICK_OUTPUT_STRATEGY)
def test_a_tick_comes_back_bit_for_bit(tick_in: TickIn, out: TickOut) -> None:
    unpacked_input, unpacked_output = unpack_tick_record(pack_tick_record(tick_in, out))
    assert unpacked_input == tick_in
    assert unpacked_output.telemetry.to_bytes() == out.telemetry.to_bytes()
    for name in ("frames", "mode", "phase", "action", "events", "state_hash"):
        assert getattr(unpacked_output, name) == getattr(out, name), name


@settings(max_examples=20, deadline=None)
@given(TICK_INPUT_STRATEGY, TICK_OUTPUT_STRATEGY)
def test_a_lone_surrogate_is_escaped_since_no_other_reader_could_decode_it(
    tick_in: TickIn, out: TickOut
) -> None:
    unpacked_input, unpacked_output = unpack_tick_record(
        pack_tick_record(tick_in._replace(requests=("\ud800",)), out._replace(phase="\udcff"))
    )
    assert (unpacked_input.requests, unpacked_output.phase) == (("\\ud800",), "\\udcff")


@settings(deadline=None)
@given(TICK_INPUT_STRATEGY, TICK_OUTPUT_STRATEGY)
def test_the_layout_agrees_with_the_decoder(tick_in: TickIn, out: TickOut) -> None:
    message = pack_tick(tick_in, out)
    places = message_layout(message)
    assert (places.received.stop - places.received.start) == 24 * len(tick_in.frames)
    assert (places.sent.stop - places.sent.start) == 24 * len(out.frames)
    long_data = b"".join(frame.data[8:] for frame in tick_in.frames + out.frames)
    assert message[places.long_data] == long_data
    phase = out.phase.encode("utf-8")
    assert message[places.tail_offset + 4 : places.tail_offset + 4 + len(phase)] == phase


@settings(deadline=None)
@given(st.lists(st.tuples(TICK_INPUT_STRATEGY, TICK_OUTPUT_STRATEGY), max_size=5))
def test_ticks_decoded_together_are_those_decoded_one_by_one(
    ticks: list[tuple[TickIn, TickOut]],
) -> None:
    messages = [pack_tick(*tick) for tick in ticks]
    unpacked_ticks = unpack_ticks(messages)
    assert unpacked_ticks == [unpack_tick(message) for message in messages]
    for (tick_in, out), unpacked_tick in zip(ticks, unpacked_ticks, strict=True):
        assert (
            unpacked_tick.tick_in.frames.records.tobytes()
            == frames_as_records(tick_in.frames).records.tobytes()
        )
        assert (
            unpacked_tick.frames.records.tobytes()
            == frames_as_records(out.frames).records.tobytes()
        )


@settings(deadline=None)
@given(TICK_INPUT_STRATEGY, TICK_OUTPUT_STRATEGY)
def test_records_are_packed_as_frames_are(tick_in: TickIn, out: TickOut) -> None:
    tick_records = (
        tick_in._replace(frames=frames_as_records(tick_in.frames)),
        out._replace(frames=frames_as_records(out.frames)),
    )
    places, at = TelemetrySlices(), 0
    for name, values in zip(TELEMETRY_AXES, out.telemetry, strict=True):
        places[name], at = slice(at, at + len(values)), at + len(values)
    packed = PackedTelemetry(np.concatenate(tuple(out.telemetry)), places)
    assert pack_tick_record(
        tick_records[0], tick_records[1]._replace(telemetry=packed)
    ) == pack_tick_record(tick_in, out)


def test_bytes_behind_a_payload_are_no_part_of_the_frame() -> None:
    telemetry = Telemetry(**{name: np.zeros(1) for name in TELEMETRY_AXES})
    frame = Frame(5, b"abc")
    message = bytearray(
        pack_tick(
            TickIn(1, 2, 0, (frame,)),
            TickOut((), HandMode.READY, "", SafetyAction.PASS, telemetry, (), bytes(8)),
        )
    )
    at = message_layout(bytes(message)).received.start
    message[at + 16 + 3 : at + 24] = b"\xff" * 5
    for tick in (unpack_tick(bytes(message)), *unpack_ticks([bytes(message)])):
        assert tick.tick_in.frames.records.tobytes() == frames_as_records([frame]).records.tobytes()


def test_a_payload_longer_than_any_frames_is_refused() -> None:
    telemetry = Telemetry(**{name: np.zeros(1) for name in TELEMETRY_AXES})
    quiet = TickOut((), HandMode.READY, "", SafetyAction.PASS, telemetry, (), bytes(8))
    message = bytearray(pack_tick(TickIn(1, 2, 0, (Frame(5, bytes(64), FDF),)), quiet))
    message[message_layout(bytes(message)).received.start + 15] = 65
    for decode in (unpack_tick, lambda tick_message: unpack_ticks([tick_message])):
        with pytest.raises(ValueError, match="payload of 65 bytes"):
            decode(bytes(message))


@settings(deadline=None)
@given(TICK_INPUT_STRATEGY, TICK_OUTPUT_STRATEGY, st.data())
def test_a_cut_or_changed_message_never_does_worse_than_value_error(
    tick_in: TickIn, out: TickOut, data: st.DataObject
) -> None:
    message = bytearray(pack_tick(tick_in, out))
    if data.draw(st.booleans()):
        del message[data.draw(st.integers(0, len(message) - 1)) :]
        for decode in (unpack_tick, lambda tick_message: unpack_ticks([tick_message])):
            with pytest.raises(ValueError):
                decode(bytes(message))
        return
    message[data.draw(st.integers(0, len(message) - 1))] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(ValueError):
        unpacked_tick = unpack_tick(bytes(message))
        assert unpack_ticks([bytes(message)]) == [unpacked_tick]


def test_a_record_contains_its_length() -> None:
    telemetry = Telemetry(**{name: np.full(2, math.nan) for name in TELEMETRY_AXES})
    record = pack_tick_record(
        TickIn(1, 2), TickOut((), HandMode.READY, "", SafetyAction.PASS, telemetry, (), bytes(8))
    )
    assert RECORD_FRAMING_STRUCT.unpack_from(record)[0] == len(record) - RECORD_FRAMING_STRUCT.size
    with pytest.raises(ValueError, match="not the record"):
        unpack_tick_record(record[:-1])


def test_a_hash_of_another_length_is_refused() -> None:
    telemetry = Telemetry(**{name: np.zeros(1) for name in TELEMETRY_AXES})
    with pytest.raises(ValueError, match="8"):
        pack_tick_record(
            TickIn(1, 2),
            TickOut((), HandMode.READY, "", SafetyAction.PASS, telemetry, (), b"short"),
        )
