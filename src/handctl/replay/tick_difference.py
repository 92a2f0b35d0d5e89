"""Differences between a logged and a computed tick: fields, values, and distances in ULPs (units in the last place)."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.controller.controller_state import ControllerDecisions, ControllerState
from handctl.core.plain_data import serialized_bytes
from handctl.core.tick_types import TELEMETRY_AXES, TELEMETRY_FIELDS, TickEvent, TickOut
from handctl.drives.frame import Frame
from handctl.drives.frame_records import ID_AND_FLAGS_WORD, frames_as_records
from handctl.log.header import RunHeader
from handctl.log.tick_record import TickRecord


class TickDifference(NamedTuple):
    """Difference between the logged and the computed value of one field in one tick.

    Attributes:
        k: number of the tick.
        t_s: time of the tick [s].
        field: name of the field of TickOut or of the telemetry, e.g. `frames[3]`, `mode`,
            `tension_goal`.
        name: joint, tendon, motor or digit to which the value belongs, or an empty text.
        logged, computed: both values of the field, as numbers in SI units or as texts.
        ulps: distance between the logged and the computed number in units in the last place, or
            None for texts.
    """

    k: int
    t_s: float
    field: str
    name: str
    logged: float | str
    computed: float | str
    ulps: int | None = None


class TelemetryColumns(NamedTuple):
    """Names for the columns of `Telemetry.to_bytes`, the array with all telemetry of a tick.

    Each column has two names: the name of a telemetry field, and the name of a joint, tendon, motor
    or digit.
    """

    field_names: tuple[str, ...]
    element_names: tuple[str, ...]

    @staticmethod
    def from_header(header: RunHeader) -> "TelemetryColumns":
        """Return the column names for a log that has the given header."""
        pairs = [
            (field, name)
            for field in TELEMETRY_FIELDS
            for name in header.axis_names(TELEMETRY_AXES[field])
        ]
        return TelemetryColumns(
            tuple(field for field, _ in pairs), tuple(name for _, name in pairs)
        )


def distance_in_ulps(first_float: float, second_float: float) -> int:
    """Return the distance between two numbers in units in the last place.

    Two neighbouring float64 numbers have the distance 1.
    """
    return abs(_float_ordinal(first_float) - _float_ordinal(second_float))


def _float_ordinal(value: float) -> int:
    """Return the position of a number in the ordered sequence of all float64 numbers.

    The positions are counted from zero, so 0.0 and -0.0 both have the position 0.
    """
    bits = int(np.float64(value).view(np.int64))
    # If the bits of positive floats are read as integers, these integers have the same order as the
    # floats. For negative floats, the order of the integers is reversed, and the sign bit is set.
    return bits if bits >= 0 else -(bits & 0x7FFF_FFFF_FFFF_FFFF)


def differing_fields(
    columns: TelemetryColumns,
    logged_tick: TickRecord,
    logged_telemetry: bytes,
    computed_tick: TickOut,
    compares_states: bool = True,
) -> Iterator[TickDifference]:
    """Yield every field in which a logged tick and a computed tick differ.

    The decisions of the tick are compared first, and the hash of the controller's state is compared
    last.

    Args:
        columns: names of the telemetry columns.
        logged_tick: the logged tick.
        logged_telemetry: packed telemetry of the logged tick.
        computed_tick: output of the computed tick.
        compares_states: False if the hash of the state is not compared.
    """
    k = logged_tick.tick_in.k
    t_s = logged_tick.tick_in.t_ns / 1e9

    def text_difference(
        field: str, logged_value: object, computed_value: object
    ) -> Iterator[TickDifference]:
        if logged_value != computed_value:
            yield TickDifference(k, t_s, field, "", str(logged_value), str(computed_value))

    yield from text_difference("mode", logged_tick.mode.name, computed_tick.mode.name)
    yield from text_difference("action", logged_tick.action.name, computed_tick.action.name)
    yield from text_difference("phase", logged_tick.phase, computed_tick.phase)
    yield from text_difference(
        "events", _events_text(logged_tick.events), _events_text(computed_tick.events)
    )
    # logs of earlier versions of handctl do not have the last telemetry fields
    packed = computed_tick.telemetry.to_bytes()[: len(logged_telemetry)]
    if packed != logged_telemetry:
        for column, logged_value, computed_value in _changed_telemetry_numbers(
            logged_telemetry, packed
        ):
            yield TickDifference(
                k,
                t_s,
                columns.field_names[column],
                columns.element_names[column],
                logged_value,
                computed_value,
                distance_in_ulps(logged_value, computed_value),
            )
    yield from text_difference(
        "number of frames", len(logged_tick.frames), len(computed_tick.frames)
    )
    for i, (logged_frame, computed_frame) in enumerate(
        zip(logged_tick.frames, computed_tick.frames, strict=False)
    ):
        yield from text_difference(
            f"frames[{i}]", _frame_text(logged_frame), _frame_text(computed_frame)
        )
    if compares_states:
        yield from text_difference(
            "state_hash", logged_tick.state_hash.hex(), computed_tick.state_hash.hex()
        )


def state_difference(
    header: RunHeader,
    logged_tick: TickRecord,
    logged_state: ControllerState,
    computed_state: ControllerState,
) -> TickDifference | None:
    """Compare two states of the controller field by field, and return the first difference, or None.

    Args:
        header: header of the log.
        logged_tick: logged tick to which both states belong.
        logged_state: state from the snapshot in the log.
        computed_state: computed state.
    """
    k = logged_tick.tick_in.k
    t_s = logged_tick.tick_in.t_ns / 1e9
    first_difference = logged_state.layout.first_difference(
        logged_state.block, computed_state.block
    )
    if first_difference:
        field, element, logged_number, computed_number = first_difference
        axis = logged_state.layout.axis_name_of_field(field)
        names = header.axis_names(axis) if axis in ("joint", "tendon", "digit") else ()
        name = names[element % len(names)] if names else f"[{element}]"
        return TickDifference(
            k,
            t_s,
            f"state {field}",
            name,
            logged_number,
            computed_number,
            distance_in_ulps(logged_number, computed_number),
        )
    for field, old_part, new_part in zip(
        ControllerDecisions._fields, logged_state.decisions, computed_state.decisions, strict=True
    ):
        if serialized_bytes(old_part) != serialized_bytes(new_part):
            return TickDifference(k, t_s, f"state {field}", "", str(old_part), str(new_part))
    return None


def are_outputs_equal(
    logged_tick: TickRecord,
    logged_telemetry: bytes,
    computed_tick: TickOut,
    compares_states: bool = True,
) -> bool:
    """Return True if every byte of a tick's output is the same in the log and in the re-execution.

    The hash of the state is compared only if `compares_states` is True.
    """
    return (
        (not compares_states or logged_tick.state_hash == computed_tick.state_hash)
        and logged_tick.mode is computed_tick.mode
        and logged_tick.action is computed_tick.action
        and logged_tick.phase == computed_tick.phase
        and logged_tick.events == computed_tick.events
        and logged_tick.frames.rows.tobytes()
        == frames_as_records(computed_tick.frames).rows.tobytes()
        and logged_telemetry == computed_tick.telemetry.to_bytes()[: len(logged_telemetry)]
    )


def are_decisions_equal(logged_tick: TickRecord, computed_tick: TickOut) -> bool:
    """Return True if the decisions of a tick are the same in the log and in the re-execution.

    The decisions of a tick are the mode, the reaction to faults, the grasp phase, the events, and
    the identifiers, flags, buses and lengths of the frames. The texts of the events and the
    payloads of the frames are not compared, because they contain numbers.
    """
    return _decisions_of_tick(logged_tick) == _decisions_of_tick(computed_tick)


def _decisions_of_tick(tick: TickRecord | TickOut) -> tuple[object, ...]:
    """Return the decisions of a tick, see `are_decisions_equal`."""
    return (
        tick.mode,
        tick.action,
        tick.phase,
        [event[:3] for event in tick.events],
        frames_as_records(tick.frames).rows[:, ID_AND_FLAGS_WORD].tolist(),
    )


def _events_text(events: tuple[TickEvent, ...]) -> str:
    """Return the events of a tick as one text, for a comparison."""
    return "; ".join(" ".join(filter(None, event)) for event in events)


def _frame_text(frame: Frame) -> str:
    """Return a CAN frame as text in the format of candump.

    The text contains the time of the frame if this time is known.
    """
    flags = f"#{frame.flags:X}" if frame.flags else ""
    at = f" at {frame.t_ns} ns" if frame.t_ns else ""
    return f"bus {frame.bus} {frame.can_id:03X}#{flags}{frame.data.hex().upper()}{at}"


def _changed_telemetry_numbers(
    logged_bytes: bytes, computed_bytes: bytes
) -> list[tuple[int, float, float]]:
    """Return (column, old, new) for each float64 number of the telemetry that has different bits.

    A number that has become NaN also counts as changed.
    """
    logged_numbers: NDArray[np.float64] = np.frombuffer(logged_bytes, "<f8")
    computed_numbers: NDArray[np.float64] = np.frombuffer(computed_bytes, "<f8")
    at = np.flatnonzero(logged_numbers.view(np.uint64) != computed_numbers.view(np.uint64))
    return [(int(i), float(logged_numbers[i]), float(computed_numbers[i])) for i in at]
