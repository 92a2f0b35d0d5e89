"""Conversion of received cyclic frames to values of the state block, and of commands to frames.

``receive_frames`` decodes all frames of the sensor node, and the feedback of steady drives, by
tables of signals. A drive is steady while it is enabled and its state machine (``drives.contract``)
has nothing to do. ``receive_frames`` stops at each frame that a state machine must handle. The
caller passes the frame to the state machine, and calls ``receive_frames`` again for the remaining
frames. ``encode_commands`` encodes the commands of steady drives, and stops at each drive that is
not steady. The module ``wire_table_building`` builds the tables of signals for a hand.
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
    WireTables,
    WordBlock,
    wire_tables,
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
    "block", "layout", "constants", "layout", "frame_tables", "layout", "words", "count", "count"
)
def receive_frames(
    block: BlockArray,
    at: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    table_words: WordBlock,
    table_offsets: TableOffsets,
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
        table_words: ``WireBlock.words`` of the hand.
        table_offsets: ``WireBlock.offsets`` of the hand.
        frame_rows: (n, WORDS_PER_RECORD) records of frames.
        first_frame: index of the first frame.
        min_receive_ns: earliest time at which an answer to the latest SYNC can arrive [ns]. The
            time is negative if the answers of the sensor node contain the counter of the SYNC.

    Returns:
        Index of the first frame that a state machine must handle or that only this host is allowed
        to send, or n if no frame is of these two kinds.
    """
    return decode_frames(
        state_tables(block, at),
        constant_tables(constants, constant_offsets),
        wire_tables(table_words, table_offsets),
        frame_rows,
        first_frame,
        min_receive_ns,
    )


@kernel_helper
def decode_frames(
    x: StateTables,
    c: ConstantTables,
    w: WireTables,
    frame_rows: WordRows,
    first_frame: int,
    min_receive_ns: int,
) -> int:
    """Decode received frames, see ``receive_frames``."""
    frame_rows = borrowed_array(frame_rows, 0, frame_rows.shape)
    for r in range(first_frame, len(frame_rows)):
        # The word ID_AND_FLAGS_WORD contains the identifier with its flags in bits 0 to 31, then the flags of
        # the frame, the bus (from BUS_SHIFT) and the payload length (from LENGTH_SHIFT).
        header_word = np.int64(frame_rows[r, ID_AND_FLAGS_WORD])
        can_id = header_word & ID_MASK & ~ERROR_FLAG
        bus = header_word >> BUS_SHIFT & BYTE_MASK
        length = header_word >> LENGTH_SHIFT & BYTE_MASK
        entry = find_key(w.keys, bus << 32 | can_id)
        is_error_frame = header_word & ERROR_FLAG != 0
        if entry == NO_FRAME_ENTRY or (
            is_error_frame and w.entries[entry, FRAME_KIND_COLUMN] == HOST_FRAMES
        ):
            _count_unknown_frame(x, w, bus, can_id)
            continue
        if is_error_frame:
            continue  # an error frame has no values, even if its identifier belongs to a node
        kind = w.entries[entry, FRAME_KIND_COLUMN]
        t_ns = np.int64(frame_rows[r, TIME_WORD])
        payload = frame_rows[r, FIRST_PAYLOAD_WORD]
        has_expected_length = length == w.entries[entry, PAYLOAD_BYTES_COLUMN]
        owner = w.entries[entry, OWNER_COLUMN]
        if owner != SENSOR_NODE_OWNER and x.tendon_int[s.RECHECK_TRIES, owner] > 0:
            reply = _compare_recheck(x, w, owner, payload, length, entry)
            if reply == RIGHT_REPLY:
                continue
            if reply == WRONG_REPLY:
                return r
        if kind == SENSOR_FRAMES and has_expected_length and t_ns < min_receive_ns:
            _count_stale_frame(x, w.entries[entry, GROUP_COLUMN])
        elif kind == SENSOR_FRAMES:
            _decode_sensor_frame(x, w, t_ns, payload, has_expected_length, entry)
        elif (
            kind == STATE_MACHINE_FRAMES
            or kind == HOST_FRAMES
            or not has_expected_length
            or not _decode_drive_frame(x, c, w, t_ns, frame_rows[r], entry)
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
    x: StateTables, w: WireTables, n: Any, payload: Any, length: Any, entry: Any
) -> int:
    """Compare a frame with the expected reply to the unanswered read-back request of an enabled drive.

    After a reply with the required value, the host requests the next setting of the drive.

    Args:
        x: state tables.
        w: wire tables of the hand.
        n: index of the drive.
        payload: first eight bytes of the frame's payload.
        length: length of the payload [bytes].
        entry: row of the frame's identifier in ``WireTables.entries``.

    Returns:
        ``RIGHT_REPLY``, ``WRONG_REPLY`` if the value or the length differs, or ``OTHER_FRAME``.
    """
    first_row = w.recheck_ranges[n, 0]
    count = w.recheck_ranges[n, 1] - first_row
    if count == 0 or not _is_steady(x, n):
        return OTHER_FRAME
    recheck_row = w.rechecks[first_row + x.tendon_int[s.RECHECK_STEP, n]]
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
def _is_recheck_due(x: StateTables, w: WireTables, n: Any, now_ns: Any) -> bool:
    """Return True if the next read-back request to an enabled drive is due in the present tick."""
    is_due: bool = (
        w.recheck_ranges[n, 0] < w.recheck_ranges[n, 1]
        and now_ns >= x.tendon_int[s.RECHECK_DUE_NS, n]
    )
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
def _request_recheck(x: StateTables, w: WireTables, n: Any, frame_row: Any) -> None:
    """Write the next read-back request to an enabled drive into the record of a frame."""
    step = x.tendon_int[s.RECHECK_STEP, n]
    _copy_record(w.rechecks[w.recheck_ranges[n, 0] + step], frame_row)
    x.tendon_int[s.RECHECK_DUE_NS, n] += RECHECK_PERIOD_NS
    x.tendon_int[s.RECHECK_TRIES, n] += 1


@kernel_helper
def _count_unknown_frame(x: StateTables, w: WireTables, bus: Any, can_id: Any) -> None:
    """Count a frame whose identifier is unknown.

    A remote frame or 29-bit frame with the identifier of a node counts as a malformed frame of the
    node. A 29-bit identifier of 0x800 or more belongs to another protocol, even if its lower 11
    bits equal the identifier of a node.
    """
    x.run_int[s.UNKNOWN_FRAME_COUNT] += 1
    if can_id & (EXTENDED_FLAG | REMOTE_FLAG) and can_id & CAN_ID_MASK < STANDARD_ID_COUNT:
        entry = find_key(w.keys, bus << 32 | can_id & CAN_ID_MASK)
        if entry != NO_FRAME_ENTRY and w.entries[entry, FRAME_KIND_COLUMN] != HOST_FRAMES:
            owner = w.entries[entry, OWNER_COLUMN]
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
    x: StateTables, w: WireTables, t_ns: Any, payload: Any, has_valid_length: bool, entry: int
) -> None:
    """Decode a frame of load cells or joint encoders.

    If the counter in the frame is not the counter of the latest SYNC, the frame is stale.

    Args:
        x: state tables.
        w: wire tables of the hand.
        t_ns: reception time [ns].
        payload: first eight bytes of the frame's payload.
        has_valid_length: True if the payload has the expected length.
        entry: row of the frame in ``WireTables.entries``.
    """
    if not has_valid_length:
        x.node_int[s.HAS_MALFORMED_FRAME, x.node_int.shape[1] - 1] = 1
        return
    group = w.entries[entry, GROUP_COLUMN]
    tensions = 0
    for i in range(w.entries[entry, FIRST_SIGNAL_COLUMN], w.entries[entry, END_SIGNAL_COLUMN]):
        value = decode_signal(payload, w.signal_integers, w.signal_scalings, i)
        quantity = w.signal_integers[i, QUANTITY_COLUMN]
        channel = w.signal_integers[i, CHANNEL_COLUMN]
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
    x: StateTables, c: ConstantTables, w: WireTables, t_ns: Any, frame_row: Any, entry: int
) -> bool:
    """Decode a frame of a drive.

    Return False, and change nothing, if the state machine of the drive must handle the frame.

    Args:
        x: state tables.
        c: constants of the hand.
        w: wire tables of the hand.
        t_ns: reception time [ns].
        frame_row: (WORDS_PER_RECORD,) record of the frame.
        entry: row of the frame in ``WireTables.entries``.
    """
    n = w.entries[entry, OWNER_COLUMN]
    if not _is_steady(x, n):
        return False
    expected = x.tendon_int[s.EXPECTED_DRIVE_STATUS, n]
    position = velocity = torque = temperature = math.nan
    status = 0
    payload = frame_row[FIRST_PAYLOAD_WORD]
    reversed_payload = bytes_reversed(payload)
    for i in range(w.entries[entry, FIRST_SIGNAL_COLUMN], w.entries[entry, END_SIGNAL_COLUMN]):
        if w.signal_integers[i, WINDOW_COLUMN] == 0:
            window = reversed_payload if w.signal_integers[i, ORDER_COLUMN] else payload
        else:
            window = read_window(frame_row, FIRST_PAYLOAD_WORD, w.signal_integers[i, WINDOW_COLUMN])
            window = bytes_reversed(window) if w.signal_integers[i, ORDER_COLUMN] else window
        value = decode_signal(window, w.signal_integers, w.signal_scalings, i)
        if math.isnan(value):
            return False
        quantity = w.signal_integers[i, QUANTITY_COLUMN]
        if quantity == STATUS:
            # Several status fields of a frame form one number, with the first field in the highest
            # bits.
            status = status << w.signal_integers[i, LENGTH_BITS] | np.int64(value)
        elif quantity == POSITION:
            position = value
        elif quantity == VELOCITY:
            velocity = value
        elif quantity == TORQUE:
            torque = value
        elif quantity == TEMPERATURE:
            temperature = value if math.isnan(temperature) else max(temperature, value)
    feedback = w.entries[entry, FRAME_KIND_COLUMN] == FEEDBACK_FRAMES
    if feedback and status != expected:
        return False
    if (
        w.entries[entry, NEAREST_ONLY_COLUMN]
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
    x: StateTables, w: WireTables, n: int, first_signal: int, signals_end: int
) -> bool:
    """Return True if each number of a position command is within the range of its signal."""
    for i in range(first_signal, signals_end):
        if (
            not w.servo_signal_scalings[i, 2]
            <= x.servo[s.SERVO_POSITION + i - first_signal, n]
            <= w.servo_signal_scalings[i, 3]
        ):
            return False
    return True


@kernel_helper
def _write_position_command(
    x: StateTables, w: WireTables, n: int, frame_row: Any, first_signal: int, signals_end: int
) -> None:
    """Write position, velocity, kp, kd, torque and torque limit into the record of a command."""
    _copy_record(w.servo_templates[n], frame_row)
    for i in range(first_signal, signals_end):
        number = x.servo[s.SERVO_POSITION + i - first_signal, n]
        bits = encode_signal(number, w.servo_signal_integers, w.servo_signal_scalings, i)
        bits = bytes_reversed(bits) if w.servo_signal_integers[i, ORDER_COLUMN] else bits
        write_window(frame_row, FIRST_PAYLOAD_WORD, w.servo_signal_integers[i, WINDOW_COLUMN], bits)


@kernel_helper
def _write_torque_command(w: WireTables, command: int, torque: float, frame_row: Any) -> None:
    """Write a torque command into the record of a frame. A command can also have no torque.

    Args:
        w: wire tables of the hand.
        command: row of the command in ``WireTables.commands``.
        torque: commanded torque [N m].
        frame_row: (WORDS_PER_RECORD,) result: record of the frame.
    """
    _copy_record(w.templates[command], frame_row)
    signal = w.commands[command, 1]
    if signal >= 0:
        integers = w.command_signal_integers
        bits = encode_signal(torque, integers, w.command_signal_scalings, signal)
        ordered_bits = bytes_reversed(bits) if integers[signal, ORDER_COLUMN] else bits
        write_window(frame_row, FIRST_PAYLOAD_WORD, integers[signal, WINDOW_COLUMN], ordered_bits)


@kernel("block", "layout", "frame_tables", "layout", "words", "vector", "count", "count")
def encode_commands(
    block: BlockArray,
    at: TableOffsets,
    table_words: WordBlock,
    table_offsets: TableOffsets,
    frame_rows: WordRows,
    torque: FloatArray,
    first_drive: int,
    count: int,
) -> tuple[int, int]:
    """Encode the commands of steady drives, and the requests of their repeated read-back.

    Args:
        block: state block.
        at: ``BlockLayout.offsets`` of the state block.
        table_words: ``WireBlock.words`` of the hand.
        table_offsets: ``WireBlock.offsets`` of the hand.
        frame_rows: (frames, WORDS_PER_RECORD) result: records of the commands.
        torque: (N,) commanded torque of each drive [N m].
        first_drive: index of the first drive whose command is encoded.
        count: number of records that ``frame_rows`` already contains.

    Returns:
        Index of the first drive that is not steady (N if all drives are steady), and the number of
        records. ``encode_commands`` also stops at a drive whose commanded torque exceeds the torque
        limit. The state machine of a drive with a too large commanded torque reports that the
        torque limit is exceeded.
    """
    x = state_tables(block, at)
    w = wire_tables(table_words, table_offsets)
    return write_commands(x, w, frame_rows, torque, first_drive, count)


@kernel_helper
def write_commands(
    x: StateTables,
    w: WireTables,
    frame_rows: WordRows,
    torque: FloatArray,
    first_drive: int,
    count: int,
) -> tuple[int, int]:
    """Encode the commands of steady drives, see ``encode_commands``."""
    frame_rows = borrowed_array(frame_rows, 0, frame_rows.shape)
    now_ns = x.run_int[s.TICK_TIME_NS]
    for i in range(len(w.commands)):
        n = w.commands[i, 0]
        if n < first_drive:
            continue
        feedback_ns = x.tendon_int[s.FEEDBACK_RECEIVED_NS, n]
        timeout_ns = w.commands[i, 2]
        is_feedback_overdue = timeout_ns > 0 and feedback_ns < now_ns - timeout_ns
        if not _is_steady(x, n) or now_ns >= x.tendon_int[s.DRIVE_DUE_NS, n] or is_feedback_overdue:
            return n, count
        is_recheck_due = _is_recheck_due(x, w, n, now_ns)
        if is_recheck_due and not _is_recheck_regular(x, n, now_ns):
            return n, count
        signal = w.commands[i, 1]
        if signal >= 0 and not abs(torque[n]) <= w.command_signal_scalings[signal, 2]:
            return n, count
        first_servo_row = w.servos[n, 0]
        end = w.servos[n, 1]
        use_position_command = first_servo_row < end and x.servo[s.SERVO_KP, n] > 0.0
        if use_position_command and not _can_be_encoded(x, w, n, first_servo_row, end):
            command_torque_only(x, n)
            use_position_command = False
        if use_position_command:
            _write_position_command(x, w, n, frame_rows[count], first_servo_row, end)
        else:
            _write_torque_command(w, i, torque[n], frame_rows[count])
        count += 1
        if is_recheck_due and signal >= 0:
            _request_recheck(x, w, n, frame_rows[count])
            count += 1
    return len(torque), count
