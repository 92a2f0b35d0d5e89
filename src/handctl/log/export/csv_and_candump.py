"""Export of a log as a CSV file or as text in the format of candump.

This module also makes the tables of ticks that all exports use.
"""

import csv
import re
from bisect import bisect_left
from collections.abc import Collection, Iterator
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import TELEMETRY_AXES, HandMode
from handctl.drives.frame import ERROR_FLAG, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from handctl.log.read.hand_in_log import prismatic_joints
from handctl.log.read.reader import RunLog
from handctl.safety.safety_action import SafetyAction

TICKS_PER_BLOCK = 4096
"""Largest number of ticks that an export has in memory at a time."""

TEXT_COLUMNS = ("mode", "phase", "action")
"""Names of the columns that contain text."""

INTEGER_COLUMNS = {"k": "1", "t_ns": "ns", "late_ns": "ns"}
"""Unit of each column of integers, by name of the column. The unit 1 stands for a plain number."""

FIELD_UNITS = {
    "q": "rad", "dq": "rad/s", "joint_torque": "N m", "joint_encoder": "rad",
    "excursion": "m", "excursion_rate": "m/s", "tension": "N", "stretch_offset": "m", "innovation": "N", "nis": "1",
    "external_tension": "N",
    "motor_position": "rad", "motor_velocity": "rad/s", "motor_torque": "N m", "motor_temperature": "degC",
    "motor_age": "s", "drive_phase": "1",
    "tip_force": "N", "contact": "1",
}  # fmt: skip
"""Unit of each telemetry quantity. The unit 1 stands for a plain number."""

PRISMATIC_UNITS = {"rad": "m", "rad/s": "m/s", "N m": "N"}
"""Unit of a quantity of a prismatic joint, by the unit of the same quantity of a hinge."""

VARIANT_SUFFIX = re.compile("_(goal|raw|sigma)$")
"""Suffixes in the names of telemetry fields.

A telemetry field has the same unit with a suffix such as `_raw` and without a suffix.
"""


class TableBlock(NamedTuple):
    """Table with consecutive ticks of a log, one row for each tick.

    Attributes:
        k, t_ns, late_ns: (rows,) number, time and lateness of each tick, as in TickIn [ns].
        mode, phase, action: names of the mode, the grasp phase and the reaction to faults in each
            tick.
        numbers: (rows, columns) telemetry of each tick.
    """

    k: NDArray[np.int64]
    t_ns: NDArray[np.int64]
    late_ns: NDArray[np.int64]
    mode: list[str]
    phase: list[str]
    action: list[str]
    numbers: NDArray[np.float64]


def column_names(log: RunLog) -> tuple[str, ...]:
    """Return the names of the telemetry columns of a log, such as `q/index_j1` and `tension/index_tendon`.

    The function `column_unit` returns the unit of each column.
    """
    return tuple(
        f"{field}/{name}"
        for field in log.fields
        for name in log.header.axis_names(TELEMETRY_AXES[field])
    )


def column_unit(column: str, prismatic: Collection[str] = ()) -> str:
    """Return the unit of a numeric column: `rad` for `q/index_j1`, `ns` for `t_ns`, 1 for a number without a unit.

    Args:
        column: name of the column.
        prismatic: names of the prismatic joints of the hand. The positions of prismatic joints are
            in m.
    """
    if column in INTEGER_COLUMNS:
        return INTEGER_COLUMNS[column]
    field, _, name = column.partition("/")
    unit = FIELD_UNITS[VARIANT_SUFFIX.sub("", field)]
    is_prismatic = TELEMETRY_AXES[field] == "joint" and name in prismatic
    return PRISMATIC_UNITS[unit] if is_prismatic else unit


def column_title(column: str, prismatic: Collection[str] = ()) -> str:
    """Return the title of a column, for example `tension/index_tendon [N]`.

    If the name of the column already contains the unit, the title is the unchanged name.

    The function has the same arguments as `column_unit`.
    """
    return column if column in INTEGER_COLUMNS else f"{column} [{column_unit(column, prismatic)}]"


def table_blocks(log: RunLog) -> Iterator[TableBlock]:
    """Yield all ticks of a log in order, as tables of at most `TICKS_PER_BLOCK` rows."""
    changes = log.phases
    start_indices = np.array([change.k for change in changes], np.int64)
    names = [change.name for change in changes]
    rows = log.packed_telemetry()
    for start in range(0, len(log), TICKS_PER_BLOCK):
        block_slice = slice(start, min(start + TICKS_PER_BLOCK, len(log)))
        data = b"".join(next(rows) for _ in range(block_slice.start, block_slice.stop))
        numbers = np.frombuffer(data, "<f8").reshape(block_slice.stop - block_slice.start, -1)
        phase = [names[i] for i in np.searchsorted(start_indices, log.k[block_slice], "right") - 1]
        mode = [HandMode(value).name for value in log.mode[block_slice].tolist()]
        action = [SafetyAction(value).name for value in log.action[block_slice].tolist()]
        yield TableBlock(
            log.k[block_slice],
            log.t_ns[block_slice],
            log.late_ns[block_slice],
            mode,
            phase,
            action,
            numbers,
        )


def export_csv(log: RunLog, path: Path) -> int:
    """Write a log as CSV with one row for each tick, and return the number of rows.

    Each number has enough digits to restore the exact value of the number. NaN becomes an empty
    field. The first row contains the titles of the columns with their units: `tension/index_tendon
    [N]`.

    Raises:
        OSError: the file already exists or cannot be written.
    """
    count = 0
    prismatic = prismatic_joints(log.header)
    column_titles = [column_title(name, prismatic) for name in column_names(log)]
    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow((*INTEGER_COLUMNS, *TEXT_COLUMNS, *column_titles))
        for block in table_blocks(log):
            fixed_columns = zip(
                *(integer_column.tolist() for integer_column in block[:3]), *block[3:6], strict=True
            )
            for tick_columns, row in zip(fixed_columns, block.numbers.tolist(), strict=True):
                writer.writerow(
                    (*tick_columns, *("" if value != value else repr(value) for value in row))
                )
                count += 1
    return count


def export_candump(log: RunLog, path: Path) -> int:
    """Write all CAN frames of a log in the format of can-utils' log files, and return the number of frames.

    The letter R marks a frame that the host has received, and T marks a frame that the host has
    sent.

    Raises:
        OSError: the file already exists or cannot be written.
    """
    count = 0
    buses = log.header.buses
    offset = log.header.offset_ns
    with path.open("x", encoding="ascii") as file:
        for t_ns, direction, frame in _frames_by_time(log):
            file.write(_candump_line(frame, offset + t_ns, buses, direction))
            count += 1
    return count


def _frames_by_time(log: RunLog) -> Iterator[tuple[int, str, Frame]]:
    """Yield the time [ns], the direction (R or T) and the content of all CAN frames, in the order of their times.

    The time of a received frame is its arrival. The time of a sent frame is the start of its tick.
    If a tick has read frames that arrived after the start of the tick, its sent frames get the
    latest arrival time. On a local bus, every received frame arrives after the start of the tick,
    because a frame arrives when the tick reads the bus.
    """
    pending_frames: list[tuple[int, str, Frame]] = []
    complete_until_ns = 0
    for tick in log.ticks():
        start_ns = tick.tick_in.t_ns + tick.tick_in.late_ns
        received_frames = tick.tick_in.frames
        sent_ns = max((frame.t_ns for frame in received_frames), default=start_ns)
        pending_frames += [(frame.t_ns, "R", frame) for frame in received_frames]
        pending_frames += [(max(start_ns, sent_ns), "T", frame) for frame in tick.frames]
        pending_frames.sort(key=itemgetter(0))
        # Frames that the next tick reads arrive after the start of the present tick. However, the
        # kernel can deliver a frame slightly later than the frame's time stamp says. Because of
        # late deliveries by the kernel, this function yields each frame one tick later.
        ready_count = bisect_left(pending_frames, complete_until_ns, key=itemgetter(0))
        yield from pending_frames[:ready_count]
        pending_frames = pending_frames[ready_count:]
        complete_until_ns = start_ns
    yield from pending_frames


def _candump_line(frame: Frame, t_ns: int, buses: tuple[str, ...], direction: str) -> str:
    """Return a CAN frame as a line of candump text.

    Source: can-utils `lib.c`, `snprintf_canframe`.
    """
    # Extended identifiers and error frames have eight hexadecimal digits, and standard identifiers
    # have three.
    has_long_id = frame.can_id & (EXTENDED_FLAG | ERROR_FLAG)
    can_id = f"{frame.can_id & 0x3FFF_FFFF:08X}" if has_long_id else f"{frame.can_id & 0x7FF:03X}"
    data = frame.data.hex().upper()
    if frame.flags & FDF:
        body = f"##{frame.flags & 0xF & ~FDF:X}{data}"
    else:
        body = f"#R{len(frame.data) or ''}" if frame.can_id & REMOTE_FLAG else f"#{data}"
    bus = buses[frame.bus] if frame.bus < len(buses) else "unknown"
    # In the format of can-utils' log files, times are in microseconds. If the time of a frame is
    # negative, 0 is written.
    return f"({max(t_ns, 0) // 10**9}.{max(t_ns, 0) % 10**9 // 1000:06d}) {bus} {can_id}{body} {direction}\n"
