"""Conversion of received cyclic frames to values of the state block, and of commands to frames.

``receive_frames`` decodes all frames of the sensor node, and the feedback of steady drives, by
tables of signals. A drive is steady while it is enabled and its state machine (``drives.contract``)
has nothing to do. ``receive_frames`` stops at each frame that a state machine must handle. The
caller passes the frame to the state machine, and calls ``receive_frames`` again for the remaining
frames. ``encode_commands`` encodes the commands of steady drives, and stops at each drive that is
not steady. The module ``wire_tables`` builds the tables of signals for a hand.
"""

import math
from typing import Any

import numpy as np

from handctl.compiled import borrowed_array, kernel, kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, TableOffsets
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
    REPLY_BYTES_WORD,
    REPLY_ENTRY_WORD,
    REPLY_KEY_MASK_WORD,
    REPLY_MASK_WORD,
    REPLY_WORD,
    SENSOR_FRAMES,
    SENSOR_NODE_OWNER,
    STATE_MACHINE_FRAMES,
    FloatArray,
    IntArray,
)
from handctl.drives.contract import DrivePhase
from handctl.drives.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from handctl.drives.frame_records import (
    BUS_SHIFT,
    BYTE_MASK,
    FIRST_PAYLOAD_WORD,
    ID_AND_FLAGS_WORD,
    ID_MASK,
    LENGTH_SHIFT,
    TIME_WORD,
    WORDS_PER_RECORD,
    WordRows,
)
from handctl.drives.readback import RECHECK_PERIOD_NS, RECHECK_TRIES
from handctl.drives.signals import (
    CHANNEL_COLUMN,
    ORDER_COLUMN,
    QUANTITY_COLUMN,
    WINDOW_COLUMN,
    SignalQuantity,
    bytes_reversed,
    decode_signal,
    encode_signal,
    read_window,
    write_window,
)
from handctl.drives.signals import LENGTH_COLUMN as LENGTH_BITS

NO_FRAME_ENTRY = -1
"""Index that stands for a missing entry of the frame table."""
ENABLED_PHASE = int(DrivePhase.ENABLED)
"""Value of ``drives.contract.DrivePhase.ENABLED``."""
POSITION, VELOCITY, TORQUE, TEMPERATURE, STATUS, CELL, ANGLE, COUNTER = map(
    int, tuple(SignalQuantity)[:8]
)
"""Values of ``drives.signals.SignalQuantity``, for compiled code."""
CAN_ID_MASK = 0x1FFFFFFF
"""Mask of the CAN identifier in a word that also contains the flags of the identifier."""
STANDARD_ID_COUNT = 0x800
"""Number of possible 11-bit identifiers."""
OTHER_FRAME, RIGHT_REPLY, WRONG_REPLY = range(3)
"""Results of the comparison of a frame with the reply to a repeated read-back."""


@kernel_helper
def find_key(keys: IntArray, key: Any) -> int:
    """Return the index of a key in sorted keys, or NO_FRAME_ENTRY if the key is missing.

    The function uses a binary search.
    """
    low = 0
    high = len(keys)
    while low < high:
        middle_index = (low + high) // 2
        if keys[middle_index] < key:
            low = middle_index + 1
        else:
            high = middle_index
    return low if low < len(keys) and keys[low] == key else NO_FRAME_ENTRY


@kernel(
    "block", "layout", "constants", "layout",
    "keys", "table_int", "table_int", "table", "table_int", "words",
    "words", "count", "count",
)  # fmt: skip
def receive_frames(
    block: BlockArray,
    at: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    keys: IntArray,
    entries: IntArray,
    signal_integers: IntArray,
    signal_scalings: FloatArray,
    recheck_ranges: IntArray,
    rechecks: WordRows,
    frame_rows: WordRows,
    first_frame: int,
    min_receive_ns: int,
) -> int:
    """Decode received frames, from ``first_frame`` to the next frame that needs a state machine.

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the state block.
        constants: constants of the hand.
        constant_offsets: ``BlockLayout.offsets`` of the constants.
        keys: see ``WireTables``.
        entries: see ``WireTables``.
        signal_integers: see ``WireTables``.
        signal_scalings: see ``WireTables``.
        recheck_ranges: see ``WireTables``.
        rechecks: see ``WireTables``.
        frame_rows: (n, WORDS_PER_RECORD) records of frames.
        first_frame: index of the first frame.
        min_receive_ns: earliest time at which an answer to the latest SYNC can arrive [ns]. The
            time is negative if the answers of the sensor node contain the counter of the SYNC.

    Returns:
        Index of the first frame that a state machine must handle or that only this host is allowed
        to send, or n if no frame is of these two kinds.
    """
    return decode_frames(
        state_tables(block, at), constant_tables(constants, constant_offsets),
        keys, entries, signal_integers, signal_scalings, recheck_ranges, rechecks,
        frame_rows, first_frame, min_receive_ns,
    )  # fmt: skip


@kernel_helper
def decode_frames(
    x: StateTables,
    c: ConstantTables,
    keys: IntArray,
    entries: IntArray,
    signal_integers: IntArray,
    signal_scalings: FloatArray,
    recheck_ranges: IntArray,
    rechecks: WordRows,
    frame_rows: WordRows,
    first_frame: int,
    min_receive_ns: int,
) -> int:
    """Decode received frames, see ``receive_frames``."""
    frame_rows = borrowed_array(frame_rows, 0, frame_rows.shape)
    keys = borrowed_array(keys, 0, keys.shape)
    entries = borrowed_array(entries, 0, entries.shape)
    signal_integers = borrowed_array(signal_integers, 0, signal_integers.shape)
    signal_scalings = borrowed_array(signal_scalings, 0, signal_scalings.shape)
    recheck_ranges = borrowed_array(recheck_ranges, 0, recheck_ranges.shape)
    rechecks = borrowed_array(rechecks, 0, rechecks.shape)
    for r in range(first_frame, len(frame_rows)):
        # The word ID_AND_FLAGS_WORD contains the identifier with its flags in bits 0 to 31, then the flags of
        # the frame, the bus (from BUS_SHIFT) and the payload length (from LENGTH_SHIFT).
        header_word = np.int64(frame_rows[r, ID_AND_FLAGS_WORD])
        can_id = header_word & ID_MASK & ~ERROR_FLAG
        bus = header_word >> BUS_SHIFT & BYTE_MASK
        length = header_word >> LENGTH_SHIFT & BYTE_MASK
        entry = find_key(keys, bus << 32 | can_id)
        is_error_frame = header_word & ERROR_FLAG != 0
        if entry == NO_FRAME_ENTRY or (
            is_error_frame and entries[entry, FRAME_KIND_COLUMN] == HOST_FRAMES
        ):
            _count_unknown_frame(x, keys, entries, bus, can_id)
            continue
        if is_error_frame:
            continue  # an error frame has no values, even if its identifier belongs to a node
        kind = entries[entry, FRAME_KIND_COLUMN]
        t_ns = np.int64(frame_rows[r, TIME_WORD])
        payload = frame_rows[r, FIRST_PAYLOAD_WORD]
        has_expected_length = length == entries[entry, PAYLOAD_BYTES_COLUMN]
        owner = entries[entry, OWNER_COLUMN]
        if owner != SENSOR_NODE_OWNER and x.tendon_int[s.RECHECK_TRIES, owner] > 0:
            reply = _compare_recheck(x, owner, payload, length, entry, recheck_ranges, rechecks)
            if reply == RIGHT_REPLY:
                continue
            if reply == WRONG_REPLY:
                return r
        if kind == SENSOR_FRAMES and has_expected_length and t_ns < min_receive_ns:
            _count_stale_frame(x, entries[entry, GROUP_COLUMN])
        elif kind == SENSOR_FRAMES:
            _decode_sensor_frame(
                x,
                t_ns,
                payload,
                has_expected_length,
                entries,
                entry,
                signal_integers,
                signal_scalings,
            )
        elif (
            kind == STATE_MACHINE_FRAMES
            or kind == HOST_FRAMES
            or not has_expected_length
            or not _decode_drive_frame(
                x, c, t_ns, frame_rows[r], entries, entry, signal_integers, signal_scalings
            )
        ):
            return r
    return len(frame_rows)


@kernel_helper
def _is_steady(x: StateTables, n: Any) -> bool:
    """Return True if a drive is enabled and its state machine has nothing to do."""
    is_steady: bool = (
        x.tendon_int[s.DRIVE_PHASE, n] == ENABLED_PHASE
        and x.tendon_int[s.EXPECTED_DRIVE_STATUS, n] >= 0
    )
    return is_steady


@kernel_helper
def _compare_recheck(
    x: StateTables,
    n: Any,
    payload: Any,
    length: Any,
    entry: Any,
    ranges: IntArray,
    rechecks: WordRows,
) -> int:
    """Compare a frame with the expected reply to the unanswered read-back request of an enabled drive.

    After a reply with the required value, the host requests the next setting of the drive.

    Args:
        x: state tables.
        n: index of the drive.
        payload: first eight bytes of the frame's payload.
        length: length of the payload [bytes].
        entry: row of the frame's identifier in ``WireTables.entries``.
        ranges: ``WireTables.recheck_ranges``.
        rechecks: see ``WireTables``.

    Returns:
        ``RIGHT_REPLY``, ``WRONG_REPLY`` if the value or the length differs, or ``OTHER_FRAME``.
    """
    first_row = ranges[n, 0]
    count = ranges[n, 1] - first_row
    if count == 0 or not _is_steady(x, n):
        return OTHER_FRAME
    recheck_row = rechecks[first_row + x.tendon_int[s.RECHECK_STEP, n]]
    difference = payload ^ recheck_row[REPLY_WORD]
    if (
        np.int64(recheck_row[REPLY_ENTRY_WORD]) != entry
        or difference & recheck_row[REPLY_KEY_MASK_WORD]
    ):
        return OTHER_FRAME
    if (
        np.int64(recheck_row[REPLY_BYTES_WORD]) != length
        or difference & recheck_row[REPLY_MASK_WORD]
    ):
        return WRONG_REPLY
    x.tendon_int[s.RECHECK_STEP, n] = (x.tendon_int[s.RECHECK_STEP, n] + 1) % count
    x.tendon_int[s.RECHECK_TRIES, n] = 0
    return RIGHT_REPLY


@kernel_helper
def _is_recheck_due(x: StateTables, n: Any, now_ns: Any, ranges: IntArray) -> bool:
    """Return True if the next read-back request to an enabled drive is due in the present tick."""
    is_due: bool = ranges[n, 0] < ranges[n, 1] and now_ns >= x.tendon_int[s.RECHECK_DUE_NS, n]
    return is_due


@kernel_helper
def _is_recheck_regular(x: StateTables, n: Any, now_ns: Any) -> bool:
    """Return True if compiled code, instead of the state machine, can send the next read-back request.

    If the result is False, the state machine of the drive must send the request. If the request is
    late by a whole period, the state machine calculates the time of the next request. If the drive
    sends no reply for a setting, the state machine reports the missing reply.
    """
    regular: bool = (
        now_ns < x.tendon_int[s.RECHECK_DUE_NS, n] + RECHECK_PERIOD_NS
        and x.tendon_int[s.RECHECK_TRIES, n] + 1 < RECHECK_TRIES
    )
    return regular


@kernel_helper
def _copy_record(record: Any, frame_row: Any) -> None:
    """Copy the record of a frame into a row.

    If ``record`` has more than WORDS_PER_RECORD words, the additional words are not copied.
    """
    for word in range(WORDS_PER_RECORD):
        frame_row[word] = record[word]


@kernel_helper
def _request_recheck(
    x: StateTables, n: Any, frame_row: Any, ranges: IntArray, rechecks: WordRows
) -> None:
    """Write the next read-back request to an enabled drive into the record of a frame."""
    _copy_record(rechecks[ranges[n, 0] + x.tendon_int[s.RECHECK_STEP, n]], frame_row)
    x.tendon_int[s.RECHECK_DUE_NS, n] += RECHECK_PERIOD_NS
    x.tendon_int[s.RECHECK_TRIES, n] += 1


@kernel_helper
def _count_unknown_frame(
    x: StateTables, keys: IntArray, entries: IntArray, bus: Any, can_id: Any
) -> None:
    """Count a frame whose identifier is unknown.

    A remote frame or 29-bit frame with the identifier of a node counts as a malformed frame of the
    node. A 29-bit identifier of 0x800 or more belongs to another protocol, even if its lower 11
    bits equal the identifier of a node.
    """
    x.run_int[s.UNKNOWN_FRAME_COUNT] += 1
    if can_id & (EXTENDED_FLAG | REMOTE_FLAG) and can_id & CAN_ID_MASK < STANDARD_ID_COUNT:
        entry = find_key(keys, bus << 32 | can_id & CAN_ID_MASK)
        if entry != NO_FRAME_ENTRY and entries[entry, FRAME_KIND_COLUMN] != HOST_FRAMES:
            owner = entries[entry, OWNER_COLUMN]
            x.node_int[
                s.HAS_MALFORMED_FRAME,
                owner if owner != SENSOR_NODE_OWNER else x.node_int.shape[1] - 1,
            ] = 1


@kernel_helper
def _count_stale_frame(x: StateTables, sensor_group: int) -> None:
    """Count a stale sensor frame, which answers an older SYNC."""
    x.run_int[s.STALE_FRAME_COUNT] += 1
    x.run_int[s.STALE_FRAME_STATE] = max(
        x.run_int[s.STALE_FRAME_STATE],
        2 if x.group_int[s.GROUP_FRAME_COUNT_IN_TICK, sensor_group] else 1,
    )


@kernel_helper
def _decode_sensor_frame(
    x: StateTables,
    t_ns: Any,
    payload: Any,
    has_valid_length: bool,
    entries: IntArray,
    entry: int,
    signal_integers: IntArray,
    signal_scalings: FloatArray,
) -> None:
    """Decode a frame of load cells or joint encoders.

    If the counter in the frame is not the counter of the latest SYNC, the frame is stale.

    Args:
        x: state tables.
        t_ns: reception time [ns].
        payload: first eight bytes of the frame's payload.
        has_valid_length: True if the payload has the expected length.
        entries: see ``WireTables``.
        entry: row of the frame in ``entries``.
        signal_integers: see ``WireTables``.
        signal_scalings: see ``WireTables``.
    """
    if not has_valid_length:
        x.node_int[s.HAS_MALFORMED_FRAME, x.node_int.shape[1] - 1] = 1
        return
    group = entries[entry, GROUP_COLUMN]
    tensions = 0
    for i in range(entries[entry, FIRST_SIGNAL_COLUMN], entries[entry, END_SIGNAL_COLUMN]):
        value = decode_signal(payload, signal_integers, signal_scalings, i)
        quantity = signal_integers[i, QUANTITY_COLUMN]
        channel = signal_integers[i, CHANNEL_COLUMN]
        if quantity == COUNTER and value != x.run_int[s.SYNC_COUNTER]:
            _count_stale_frame(x, group)
            return
        if quantity == CELL:
            tensions = 1
            x.tendon[s.CELL_READING, channel] = value
            x.tendon_int[s.HAS_NEW_CELL_READING, channel] = 1
        if quantity == ANGLE:
            x.joint[s.JOINT_ANGLE, channel] = value
            x.joint_int[s.HAS_NEW_JOINT_READING, channel] = 1
    x.group_int[s.GROUP_RECEIVED_NS, group] = t_ns
    x.group_int[s.GROUP_FRAME_COUNT, group] += 1
    x.run_int[s.TENSION_FRAME_COUNT] += tensions
    x.group_int[s.GROUP_FRAME_COUNT_IN_TICK, group] += 1


@kernel_helper
def _is_nearer_to_prediction(x: StateTables, c: ConstantTables, n: Any, position: float) -> bool:
    """Return True if a new position is at least as near to the predicted position as the stored position.

    The stored position was received earlier in the present tick. The predicted position comes from
    the tension filter, and is the position at the time of the host's request. Before the tension
    filter has started, the later of the two positions is used.
    """
    travel = x.tendon[s.SPOOL_TRAVEL, n]
    if c.run_int[h.HAS_CARRIER_ARMS]:
        travel += carrier_excursion(c, n, x.joint[s.Q])
    expected = travel / c.tendon[h.SPOOL_RADIUS, n] + c.tendon[h.MOTOR_ZERO, n]
    return not abs(position - expected) > abs(x.tendon[s.POSITION, n] - expected)


@kernel_helper
def _decode_drive_frame(
    x: StateTables,
    c: ConstantTables,
    t_ns: Any,
    frame_row: Any,
    entries: IntArray,
    entry: int,
    signal_integers: IntArray,
    signal_scalings: FloatArray,
) -> bool:
    """Decode a frame of a drive.

    Return False, and change nothing, if the state machine of the drive must handle the frame.

    Args:
        x: state tables.
        c: constants of the hand.
        t_ns: reception time [ns].
        frame_row: (WORDS_PER_RECORD,) record of the frame.
        entries: see ``WireTables``.
        entry: row of the frame in ``entries``.
        signal_integers: see ``WireTables``.
        signal_scalings: see ``WireTables``.
    """
    n = entries[entry, OWNER_COLUMN]
    if not _is_steady(x, n):
        return False
    expected = x.tendon_int[s.EXPECTED_DRIVE_STATUS, n]
    position = velocity = torque = temperature = math.nan
    status = 0
    payload = frame_row[FIRST_PAYLOAD_WORD]
    reversed_payload = bytes_reversed(payload)
    for i in range(entries[entry, FIRST_SIGNAL_COLUMN], entries[entry, END_SIGNAL_COLUMN]):
        if signal_integers[i, WINDOW_COLUMN] == 0:
            window = reversed_payload if signal_integers[i, ORDER_COLUMN] else payload
        else:
            window = read_window(frame_row, FIRST_PAYLOAD_WORD, signal_integers[i, WINDOW_COLUMN])
            window = bytes_reversed(window) if signal_integers[i, ORDER_COLUMN] else window
        value = decode_signal(window, signal_integers, signal_scalings, i)
        if math.isnan(value):
            return False
        quantity = signal_integers[i, QUANTITY_COLUMN]
        if quantity == STATUS:
            # Several status fields of a frame form one number, with the first field in the highest
            # bits.
            status = status << signal_integers[i, LENGTH_BITS] | np.int64(value)
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
        and x.tendon_int[s.FEEDBACK_COUNT_IN_TICK, n] > 0
        and not _is_nearer_to_prediction(x, c, n, position)
    ):
        x.tendon_int[s.FEEDBACK_COUNT, n] += 1
        x.tendon_int[s.FEEDBACK_COUNT_IN_TICK, n] += 1
        return True
    _store_tendon_value(x, s.POSITION, n, position)
    _store_tendon_value(x, s.VELOCITY, n, velocity)
    _store_tendon_value(x, s.REPORTED_TORQUE, n, torque)
    _store_tendon_value(x, s.TEMPERATURE, n, temperature)
    if feedback:
        x.tendon_int[s.FEEDBACK_RECEIVED_NS, n] = t_ns
        x.tendon_int[s.FEEDBACK_COUNT, n] += 1
        x.tendon_int[s.FEEDBACK_COUNT_IN_TICK, n] += 1
    return True


@kernel_helper
def _store_tendon_value(x: StateTables, table_row: int, n: int, value: float) -> None:
    """Write a value into the table of tendons, unless the value is NaN.

    A value of NaN means that the frame has no signal for the value.
    """
    if not math.isnan(value):
        x.tendon[table_row, n] = value


@kernel_helper
def _can_be_encoded(
    x: StateTables, n: int, signal_scalings: FloatArray, first_signal: int, signals_end: int
) -> bool:
    """Return True if each number of a position command is within the range of its signal."""
    for i in range(first_signal, signals_end):
        if (
            not signal_scalings[i, 2]
            <= x.servo[s.SERVO_POSITION + i - first_signal, n]
            <= signal_scalings[i, 3]
        ):
            return False
    return True


@kernel_helper
def _write_position_command(
    x: StateTables,
    n: int,
    frame_row: Any,
    template: Any,
    signal_integers: IntArray,
    signal_scalings: FloatArray,
    first_signal: int,
    signals_end: int,
) -> None:
    """Write position, velocity, kp, kd, torque and torque limit into the record of a command."""
    _copy_record(template, frame_row)
    for i in range(first_signal, signals_end):
        bits = encode_signal(
            x.servo[s.SERVO_POSITION + i - first_signal, n], signal_integers, signal_scalings, i
        )
        bits = bytes_reversed(bits) if signal_integers[i, ORDER_COLUMN] else bits
        write_window(frame_row, FIRST_PAYLOAD_WORD, signal_integers[i, WINDOW_COLUMN], bits)


@kernel_helper
def _write_torque_command(
    frame_row: Any,
    template: Any,
    torque: float,
    signal: Any,
    signal_integers: IntArray,
    signal_scalings: FloatArray,
) -> None:
    """Write a torque command into the record of a frame.

    For a command without a torque, ``signal`` is -1.
    """
    _copy_record(template, frame_row)
    if signal >= 0:
        bits = encode_signal(torque, signal_integers, signal_scalings, signal)
        ordered_bits = bytes_reversed(bits) if signal_integers[signal, ORDER_COLUMN] else bits
        write_window(
            frame_row, FIRST_PAYLOAD_WORD, signal_integers[signal, WINDOW_COLUMN], ordered_bits
        )


@kernel(
    "block", "layout", "matrix_int", "matrix_int", "matrix", "words",
    "matrix_int", "words", "matrix_int", "matrix", "matrix_int", "words",
    "words", "vector", "count", "count",
)  # fmt: skip
def encode_commands(
    block: BlockArray,
    at: TableOffsets,
    commands: IntArray,
    signal_integers: IntArray,
    signal_scalings: FloatArray,
    templates: WordRows,
    servos: IntArray,
    servo_templates: WordRows,
    servo_signal_integers: IntArray,
    servo_signal_scalings: FloatArray,
    recheck_ranges: IntArray,
    rechecks: WordRows,
    frame_words: WordRows,
    torque: FloatArray,
    first_drive: int,
    count: int,
) -> tuple[int, int]:
    """Encode the commands of steady drives, and the requests of their repeated read-back.

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the state block.
        commands: (frames, 3) see ``WireTables``.
        signal_integers: ``WireTables.command_signal_integers``.
        signal_scalings: ``WireTables.command_signal_scalings``.
        templates: (frames, WORDS_PER_RECORD) records of the commands with zero torque.
        servos: (N, 2) see ``WireTables``.
        servo_templates: (N, WORDS) see ``WireTables``.
        servo_signal_integers: see ``WireTables``.
        servo_signal_scalings: see ``WireTables``.
        recheck_ranges: see ``WireTables``.
        rechecks: see ``WireTables``.
        frame_words: (frames, WORDS_PER_RECORD) result: records of the commands.
        torque: (N,) commanded torque of each drive [N m].
        first_drive: index of the first drive whose command is encoded.
        count: number of records that ``frame_words`` already contains.

    Returns:
        Index of the first drive that is not steady (N if all drives are steady), and the number of
        records. ``encode_commands`` also stops at a drive whose commanded torque exceeds the torque
        limit. The state machine of a drive with a too large commanded torque reports that the
        torque limit is exceeded.
    """
    x = state_tables(block, at)
    now_ns = x.run_int[s.TICK_TIME_NS]
    for i in range(len(commands)):
        n = commands[i, 0]
        if n < first_drive:
            continue
        feedback_ns = x.tendon_int[s.FEEDBACK_RECEIVED_NS, n]
        timeout_ns = commands[i, 2]
        is_feedback_overdue = timeout_ns > 0 and feedback_ns < now_ns - timeout_ns
        if not _is_steady(x, n) or now_ns >= x.tendon_int[s.DRIVE_DUE_NS, n] or is_feedback_overdue:
            return n, count
        is_recheck_due = _is_recheck_due(x, n, now_ns, recheck_ranges)
        if is_recheck_due and not _is_recheck_regular(x, n, now_ns):
            return n, count
        signal = commands[i, 1]
        if signal >= 0 and not abs(torque[n]) <= signal_scalings[signal, 2]:
            return n, count
        first_servo_row = servos[n, 0]
        end = servos[n, 1]
        use_position_command = first_servo_row < end and x.servo[s.SERVO_KP, n] > 0.0
        if use_position_command and not _can_be_encoded(
            x, n, servo_signal_scalings, first_servo_row, end
        ):
            command_torque_only(x, n)
            use_position_command = False
        row = frame_words[count]
        if use_position_command:
            _write_position_command(
                x,
                n,
                row,
                servo_templates[n],
                servo_signal_integers,
                servo_signal_scalings,
                first_servo_row,
                end,
            )
        else:
            _write_torque_command(
                row, templates[i], torque[n], signal, signal_integers, signal_scalings
            )
        count += 1
        if is_recheck_due and signal >= 0:
            _request_recheck(x, n, frame_words[count], recheck_ranges, rechecks)
            count += 1
    return len(torque), count
