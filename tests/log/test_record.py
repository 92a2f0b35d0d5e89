"""A tick survives the pipe exactly, and bytes that are no tick are refused."""

import contextlib
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handctl.core.types import TELEMETRY_AXES, Event, IoEvent, Mode, Telemetry, TickIn, TickOut
from handctl.drives.frame import FDF, Frame
from handctl.log.record import FRAMING, layout, pack, pack_tick, unpack, unpack_tick
from handctl.safety.action import Action

I64 = st.integers(-(2**63), 2**63 - 1)
TEXT = st.text(st.characters(codec="utf-8"), max_size=30)
CLASSICAL = st.builds(Frame, st.integers(0, 2**32 - 1), st.binary(max_size=8), st.just(0), st.integers(0, 255), I64)
LONG = st.builds(
    Frame, st.integers(0, 2**32 - 1), st.binary(max_size=64), st.integers(FDF, 7), st.integers(0, 255), I64
)
FRAMES = st.lists(CLASSICAL | LONG, max_size=12).map(tuple)
TICK_IN = st.builds(
    TickIn,
    I64,
    I64,
    I64,
    FRAMES,
    st.lists(st.builds(IoEvent, TEXT, TEXT, I64), max_size=3).map(tuple),
    st.lists(TEXT, max_size=3).map(tuple),
)


@st.composite
def telemetries(draw: st.DrawFn) -> Telemetry:
    sizes = {axis: draw(st.integers(1, 12)) for axis in ("joint", "tendon", "motor", "digit")}
    bits = np.random.default_rng(draw(st.integers(0, 2**32))).integers(0, 2**64, 300, dtype=np.uint64)
    return Telemetry(**{name: bits[: sizes[axis]].view("<f8").copy() for name, axis in TELEMETRY_AXES.items()})


TICK_OUT = st.builds(
    TickOut,
    FRAMES,
    st.sampled_from(Mode),
    TEXT,
    st.sampled_from(Action),
    telemetries(),
    st.lists(st.builds(Event, TEXT, TEXT, TEXT, TEXT), max_size=3).map(tuple),
    st.binary(min_size=8, max_size=8),
)


@settings(max_examples=300, deadline=None)
@given(TICK_IN, TICK_OUT)
def test_a_tick_comes_back_bit_for_bit(tick_in: TickIn, out: TickOut) -> None:
    again_in, again = unpack(pack(tick_in, out))
    assert again_in == tick_in
    assert again.telemetry.packed() == out.telemetry.packed()
    for name in ("frames", "mode", "phase", "action", "events", "state_hash"):
        assert getattr(again, name) == getattr(out, name), name


@settings(max_examples=20, deadline=None)
@given(TICK_IN, TICK_OUT)
def test_a_lone_surrogate_is_escaped_since_no_other_reader_could_decode_it(tick_in: TickIn, out: TickOut) -> None:
    again_in, again = unpack(pack(tick_in._replace(requests=("\ud800",)), out._replace(phase="\udcff")))
    assert (again_in.requests, again.phase) == (("\\ud800",), "\\udcff")


@settings(max_examples=200, deadline=None)
@given(TICK_IN, TICK_OUT)
def test_the_layout_agrees_with_the_decoder(tick_in: TickIn, out: TickOut) -> None:
    message = pack_tick(tick_in, out)
    places = layout(message)
    assert (places.received.stop - places.received.start) == 24 * len(tick_in.frames)
    assert (places.sent.stop - places.sent.start) == 24 * len(out.frames)
    long_data = b"".join(frame.data[8:] for frame in tick_in.frames + out.frames)
    assert message[places.long_data] == long_data
    phase = out.phase.encode("utf-8")
    assert message[places.tail + 4 : places.tail + 4 + len(phase)] == phase


@settings(max_examples=300, deadline=None)
@given(TICK_IN, TICK_OUT, st.data())
def test_a_cut_or_changed_message_never_does_worse_than_value_error(
    tick_in: TickIn, out: TickOut, data: st.DataObject
) -> None:
    message = bytearray(pack_tick(tick_in, out))
    if data.draw(st.booleans()):
        del message[data.draw(st.integers(0, len(message) - 1)) :]
        with pytest.raises(ValueError):
            unpack_tick(bytes(message))
        return
    message[data.draw(st.integers(0, len(message) - 1))] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(ValueError):
        unpack_tick(bytes(message))


def test_a_record_says_its_length() -> None:
    telemetry = Telemetry(**{name: np.full(2, math.nan) for name in TELEMETRY_AXES})
    record = pack(TickIn(1, 2), TickOut((), Mode.READY, "", Action.PASS, telemetry, (), bytes(8)))
    assert FRAMING.unpack_from(record)[0] == len(record) - FRAMING.size
    with pytest.raises(ValueError, match="not the record"):
        unpack(record[:-1])


def test_a_hash_of_another_length_is_refused() -> None:
    telemetry = Telemetry(**{name: np.zeros(1) for name in TELEMETRY_AXES})
    with pytest.raises(ValueError, match="8"):
        pack(TickIn(1, 2), TickOut((), Mode.READY, "", Action.PASS, telemetry, (), b"short"))
