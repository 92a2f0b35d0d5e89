"""Conversion of received cyclic frames into values of the state block, and of commands into frames.

``receive_frames`` decodes the feedback of steady drives and all frames of the sensor node, by
tables of signals. A drive is steady while it is enabled and its state machine (``drives.contract``)
has nothing to do. ``receive_frames`` stops at each frame that a state machine must handle. The
caller handles this frame, and calls ``receive_frames`` again for the frames after this one.
``encode_commands`` encodes the commands of steady drives, and stops at each drive that is not
steady. ``wire_tables`` builds the tables for a hand.
"""

import math
from typing import Any

import numpy as np

from handctl.compiled import borrowed_array, kernel, kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, TablePlaces
from handctl.core.constants import ConstantTables, constant_tables
from handctl.core.control_law.servo_commands import command_torque_only
from handctl.core.estimation.varying_moment_arms import carrier_excursion
from handctl.core.state_block import StateTables, state_tables
from handctl.core.wire.wire_tables import (
    END_SIGNAL_COLUMN,
    FEEDBACK_FRAMES,
    FIRST_SIGNAL_COLUMN,
    FRAME_KIND_COLUMN,
    GROUP_COLUMN,
    HOST_FRAMES,
    NEAREST_ONLY_COLUMN,
    OWNER_COLUMN,
    PAYLOAD_BYTES_COLUMN,
    SENSOR_FRAMES,
    SENSOR_NODE_OWNER,
    STATE_MACHINE_FRAMES,
    FloatArray,
    IntArray,
)
from handctl.drives.contract import DrivePhase
from handctl.drives.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from handctl.drives.frame_records import (
    BUS_BIT,
    HEAD_WORD,
    LENGTH_BIT,
    PAYLOAD_WORD,
    TIME_WORD,
    WORDS_PER_RECORD,
    WordRows,
)
from handctl.drives.signals import (
    CHANNEL_COLUMN,
    ORDER_COLUMN,
    QUANTITY_COLUMN,
    WINDOW_COLUMN,
    SignalQuantity,
    bytes_reversed,
    decode_signal,
    encode_signal,
    window_at,
    write_window,
)
from handctl.drives.signals import LENGTH_COLUMN as LENGTH_BITS

MISSING_ENTRY = -1
"""Index that stands for a missing entry."""
ENABLED_PHASE = int(DrivePhase.ENABLED)
"""Value of ``drives.contract.DrivePhase.ENABLED``."""
POSITION, VELOCITY, TORQUE, TEMPERATURE, STATUS, CELL, ANGLE, COUNTER = map(
    int, tuple(SignalQuantity)[:8]
)
"""Values of ``drives.signals.SignalQuantity``, for compiled code."""
ID_MASK = 0xFFFFFFFF
"""Mask of a CAN identifier with its flags."""
BYTE_MASK = 0xFF
NUMBER_MASK = 0x1FFFFFFF
"""Mask of a CAN identifier without its flags."""
STANDARD_IDS = 0x800
"""Number of possible 11-bit identifiers."""


@kernel_helper
def find_key(keys: IntArray, key: Any) -> int:
    """Return the index of a key among sorted keys by binary search, MISSING_ENTRY if the key is missing."""
    low = 0
    high = len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low if low < len(keys) and keys[low] == key else MISSING_ENTRY


@kernel(
    "block",
    "layout",
    "constants",
    "layout",
    "words",
    "keys",
    "table_int",
    "table_int",
    "table",
    "count",
    "count",
)
def receive_frames(
    block: BlockArray,
    at: TablePlaces,
    constants: BlockArray,
    constants_at: TablePlaces,
    rows: WordRows,
    keys: IntArray,
    entries: IntArray,
    wholes: IntArray,
    reals: FloatArray,
    first: int,
    fresh_ns: int,
) -> int:
    """Decode received frames from index ``first`` on, until a frame that a state machine must handle.

    Args:
        block: state block.
        at: ``BlockLayout.places`` of the state block.
        constants: constants of the hand.
        constants_at: ``BlockLayout.places`` of the constants.
        rows: (n, WORDS_PER_RECORD) records of frames.
        keys: see ``WireTables``.
        entries: see ``WireTables``.
        wholes: see ``WireTables``.
        reals: see ``WireTables``.
        first: index of the first frame.
        fresh_ns: earliest arrival of an answer to the latest SYNC [ns]. It is negative if answers
            contain the counter of the SYNC.

    Returns:
        Index of the first frame that a state machine must handle or that only this host may send, n
        if there is no such frame.
    """
    x = state_tables(block, at)
    c = constant_tables(constants, constants_at)
    rows = borrowed_array(rows, 0, rows.shape)
    keys = borrowed_array(keys, 0, keys.shape)
    entries = borrowed_array(entries, 0, entries.shape)
    wholes = borrowed_array(wholes, 0, wholes.shape)
    reals = borrowed_array(reals, 0, reals.shape)
    for r in range(first, len(rows)):
        # The word HEAD_WORD contains the identifier with its flags in bits 0 to 31, then the flags of
        # the frame, the bus (from BUS_BIT) and the payload length (from LENGTH_BIT).
        head = np.int64(rows[r, HEAD_WORD])
        can_id = head & ID_MASK & ~ERROR_FLAG
        bus = head >> BUS_BIT & BYTE_MASK
        length = head >> LENGTH_BIT & BYTE_MASK
        entry = find_key(keys, bus << 32 | can_id)
        flagged = head & ERROR_FLAG != 0
        if entry == MISSING_ENTRY or (flagged and entries[entry, FRAME_KIND_COLUMN] == HOST_FRAMES):
            _count_unknown_frame(x, keys, entries, bus, can_id)
            continue
        if flagged:
            continue  # an error frame has no values, even if its identifier is that of a node
        kind = entries[entry, FRAME_KIND_COLUMN]
        t_ns = np.int64(rows[r, TIME_WORD])
        payload = rows[r, PAYLOAD_WORD]
        fits = length == entries[entry, PAYLOAD_BYTES_COLUMN]
        if kind == SENSOR_FRAMES and fits and t_ns < fresh_ns:
            _count_stale_frame(x, entries[entry, GROUP_COLUMN])
        elif kind == SENSOR_FRAMES:
            _decode_sensor_frame(x, t_ns, payload, fits, entries, entry, wholes, reals)
        elif (
            kind == STATE_MACHINE_FRAMES
            or kind == HOST_FRAMES
            or not fits
            or not _decode_drive_frame(x, c, t_ns, rows[r], entries, entry, wholes, reals)
        ):
            return r
    return len(rows)


@kernel_helper
def _count_unknown_frame(
    x: StateTables, keys: IntArray, entries: IntArray, bus: Any, can_id: Any
) -> None:
    """Count a frame with an unknown identifier.

    A remote or 29-bit frame with the identifier of a node counts as a malformed frame of this node.
    A 29-bit identifier of 0x800 or more belongs to another protocol, even if its lower 11 bits are
    those of a node.
    """
    x.run_int[s.UNKNOWN_FRAMES] += 1
    if can_id & (EXTENDED_FLAG | REMOTE_FLAG) and can_id & NUMBER_MASK < STANDARD_IDS:
        entry = find_key(keys, bus << 32 | can_id & NUMBER_MASK)
        if entry != MISSING_ENTRY and entries[entry, FRAME_KIND_COLUMN] != HOST_FRAMES:
            owner = entries[entry, OWNER_COLUMN]
            x.node_int[
                s.MALFORMED_NOW, owner if owner != SENSOR_NODE_OWNER else x.node_int.shape[1] - 1
            ] = 1


@kernel_helper
def _count_stale_frame(x: StateTables, group: int) -> None:
    """Count a sensor frame that answers an older SYNC."""
    x.run_int[s.STALE_FRAMES] += 1
    x.run_int[s.STALE_NOW] = max(
        x.run_int[s.STALE_NOW], 2 if x.group_int[s.GROUP_FRAMES_NOW, group] else 1
    )


@kernel_helper
def _decode_sensor_frame(
    x: StateTables,
    t_ns: Any,
    payload: Any,
    is_length_right: bool,
    entries: IntArray,
    entry: int,
    wholes: IntArray,
    reals: FloatArray,
) -> None:
    """Decode a frame of load cells or joint encoders. If its counter is not that of the SYNC, the frame is stale.

    Args:
        x: state tables.
        t_ns: reception time [ns].
        payload: first eight bytes of the frame's payload.
        is_length_right: True if the payload has the expected length.
        entries: see ``WireTables``.
        entry: row of ``entries``.
        wholes: see ``WireTables``.
        reals: see ``WireTables``.
    """
    if not is_length_right:
        x.node_int[s.MALFORMED_NOW, x.node_int.shape[1] - 1] = 1
        return
    group = entries[entry, GROUP_COLUMN]
    tensions = 0
    for i in range(entries[entry, FIRST_SIGNAL_COLUMN], entries[entry, END_SIGNAL_COLUMN]):
        value = decode_signal(payload, wholes, reals, i)
        quantity = wholes[i, QUANTITY_COLUMN]
        channel = wholes[i, CHANNEL_COLUMN]
        if quantity == COUNTER and value != x.run_int[s.SYNC_COUNTER]:
            _count_stale_frame(x, group)
            return
        if quantity == CELL:
            tensions = 1
            x.tendon[s.CELL_READING, channel] = value
            x.tendon_int[s.CELL_FRESH, channel] = 1
        if quantity == ANGLE:
            x.joint[s.JOINT_ANGLE, channel] = value
            x.joint_int[s.JOINT_FRESH, channel] = 1
    x.group_int[s.GROUP_NS, group] = t_ns
    x.group_int[s.GROUP_FRAMES, group] += 1
    x.run_int[s.TENSION_FRAMES] += tensions
    x.group_int[s.GROUP_FRAMES_NOW, group] += 1


@kernel_helper
def _is_nearer(x: StateTables, c: ConstantTables, n: Any, position: float) -> bool:
    """Return True if a position is nearer to the predicted position than the position received before in this tick.

    The tension filter predicts the position at the time of the request. Before the filter has
    started, the later position is used.
    """
    travel = x.tendon[s.TRAVEL, n]
    if c.run_int[h.HAS_CARRIER_ARMS]:
        travel += carrier_excursion(c, n, x.joint[s.Q])
    expected = travel / c.tendon[h.SPOOL_RADIUS, n] + c.tendon[h.MOTOR_ZERO, n]
    return not abs(position - expected) > abs(x.tendon[s.POSITION, n] - expected)


@kernel_helper
def _decode_drive_frame(
    x: StateTables,
    c: ConstantTables,
    t_ns: Any,
    row: Any,
    entries: IntArray,
    entry: int,
    wholes: IntArray,
    reals: FloatArray,
) -> bool:
    """Decode a frame of a drive. Return False, and change nothing, if the state machine must handle the frame.

    Args:
        x: state tables.
        c: constants of the hand.
        t_ns: reception time [ns].
        row: (WORDS_PER_RECORD,) record of the frame.
        entries: see ``WireTables``.
        entry: row of ``entries``.
        wholes: see ``WireTables``.
        reals: see ``WireTables``.
    """
    n = entries[entry, OWNER_COLUMN]
    expected = x.tendon_int[s.STATUS_EXPECTED, n]
    if x.tendon_int[s.PHASE, n] != ENABLED_PHASE or expected < 0:
        return False
    position = velocity = torque = temperature = math.nan
    status = 0
    payload = row[PAYLOAD_WORD]
    opposite = bytes_reversed(payload)
    for i in range(entries[entry, FIRST_SIGNAL_COLUMN], entries[entry, END_SIGNAL_COLUMN]):
        if wholes[i, WINDOW_COLUMN] == 0:
            window = opposite if wholes[i, ORDER_COLUMN] else payload
        else:
            window = window_at(row, PAYLOAD_WORD, wholes[i, WINDOW_COLUMN])
            window = bytes_reversed(window) if wholes[i, ORDER_COLUMN] else window
        value = decode_signal(window, wholes, reals, i)
        if math.isnan(value):
            return False
        quantity = wholes[i, QUANTITY_COLUMN]
        if quantity == STATUS:
            # Several status fields of a frame form one number, with the first field in the highest
            # bits.
            status = status << wholes[i, LENGTH_BITS] | np.int64(value)
        elif quantity == POSITION:
            position = value
        elif quantity == VELOCITY:
            velocity = value
        elif quantity == TORQUE:
            torque = value
        elif quantity == TEMPERATURE:
            temperature = value if math.isnan(temperature) else max(temperature, value)
    feedback = entries[entry, FRAME_KIND_COLUMN] == FEEDBACK_FRAMES
    if feedback and status != expected:
        return False
    if (
        entries[entry, NEAREST_ONLY_COLUMN]
        and x.tendon_int[s.FEEDBACKS_NOW, n] > 0
        and not _is_nearer(x, c, n, position)
    ):
        x.tendon_int[s.FEEDBACKS, n] += 1
        x.tendon_int[s.FEEDBACKS_NOW, n] += 1
        return True
    _store_value(x, s.POSITION, n, position)
    _store_value(x, s.VELOCITY, n, velocity)
    _store_value(x, s.REPORTED_TORQUE, n, torque)
    _store_value(x, s.TEMPERATURE, n, temperature)
    if feedback:
        x.tendon_int[s.FEEDBACK_NS, n] = t_ns
        x.tendon_int[s.FEEDBACKS, n] += 1
        x.tendon_int[s.FEEDBACKS_NOW, n] += 1
    return True


@kernel_helper
def _store_value(x: StateTables, row: int, n: int, value: float) -> None:
    """Write a value into the tendon table, unless it is NaN.

    NaN means that the frame has no such signal.
    """
    if not math.isnan(value):
        x.tendon[row, n] = value


@kernel_helper
def _can_be_encoded(x: StateTables, n: int, reals: FloatArray, first: int, end: int) -> bool:
    """Return True if each number of a drive's position command is within the range of its signal."""
    for i in range(first, end):
        if not reals[i, 2] <= x.servo[s.SERVO_POSITION + i - first, n] <= reals[i, 3]:
            return False
    return True


@kernel_helper
def _write_position_command(
    x: StateTables,
    n: int,
    row: Any,
    template: Any,
    wholes: IntArray,
    reals: FloatArray,
    first: int,
    end: int,
) -> None:
    """Write position, velocity, kp, kd, torque and limit into the record of a command."""
    for word in range(WORDS_PER_RECORD):
        row[word] = template[word]
    for i in range(first, end):
        bits = encode_signal(x.servo[s.SERVO_POSITION + i - first, n], wholes, reals, i)
        bits = bytes_reversed(bits) if wholes[i, ORDER_COLUMN] else bits
        write_window(row, PAYLOAD_WORD, wholes[i, WINDOW_COLUMN], bits)


@kernel(
    "block", "layout", "words", "matrix_int", "matrix_int", "matrix", "words", "vector", "matrix_int", "words",
    "matrix_int", "matrix", "count", "count",
)  # fmt: skip
def encode_commands(
    block: BlockArray,
    at: TablePlaces,
    frame_words: WordRows,
    commands: IntArray,
    wholes: IntArray,
    reals: FloatArray,
    templates: WordRows,
    torque: FloatArray,
    servos: IntArray,
    servo_templates: WordRows,
    servo_wholes: IntArray,
    servo_reals: FloatArray,
    first: int,
    count: int,
) -> tuple[int, int]:
    """Encode the commands of steady drives.

    Args:
        block: state block.
        at: ``BlockLayout.places`` of the state block.
        frame_words: (frames, WORDS_PER_RECORD) result: records of the commands.
        commands: (frames, 3) see ``WireTables``.
        wholes: ``WireTables.sent_wholes``.
        reals: ``WireTables.sent_reals``.
        templates: (frames, WORDS_PER_RECORD) records without torque.
        torque: (N,) commanded torque of each drive [N m].
        servos: (N, 2) see ``WireTables``.
        servo_templates: (N, WORDS) see ``WireTables``.
        servo_wholes: see ``WireTables``.
        servo_reals: see ``WireTables``.
        first: index of the first drive.
        count: number of records that ``frame_words`` contains already.

    Returns:
        Index of the first drive that is not steady, N if all are steady, and the number of records.
        The function also stops at a drive whose commanded torque is beyond its limit. The state
        machine of this drive reports the excess.
    """
    x = state_tables(block, at)
    now_ns = x.run_int[s.T_NS]
    for i in range(len(commands)):
        n = commands[i, 0]
        if n < first:
            continue
        steady = (
            x.tendon_int[s.PHASE, n] == ENABLED_PHASE and x.tendon_int[s.STATUS_EXPECTED, n] >= 0
        )
        heard_ns = x.tendon_int[s.FEEDBACK_NS, n]
        timeout_ns = commands[i, 2]
        overdue = timeout_ns > 0 and heard_ns < now_ns - timeout_ns
        if not steady or now_ns >= x.tendon_int[s.DUE_NS, n] or overdue:
            return n, count
        signal = commands[i, 1]
        if signal >= 0 and not abs(torque[n]) <= reals[signal, 2]:
            return n, count
        for word in range(WORDS_PER_RECORD):
            frame_words[count, word] = templates[i, word]
        begin = servos[n, 0]
        end = servos[n, 1]
        if begin < end and x.servo[s.SERVO_KP, n] > 0.0:
            if _can_be_encoded(x, n, servo_reals, begin, end):
                _write_position_command(
                    x,
                    n,
                    frame_words[count],
                    servo_templates[n],
                    servo_wholes,
                    servo_reals,
                    begin,
                    end,
                )
                count += 1
                continue
            command_torque_only(x, n)
        if signal >= 0:
            bits = encode_signal(torque[n], wholes, reals, signal)
            ordered = bytes_reversed(bits) if wholes[signal, ORDER_COLUMN] else bits
            write_window(frame_words[count], PAYLOAD_WORD, wholes[signal, WINDOW_COLUMN], ordered)
        count += 1
    return len(torque), count
