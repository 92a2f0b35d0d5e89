"""Conversion of received cyclic frames into values of the state block, and of commands into frames.

``receive_frames`` decodes the feedback of steady drives and all frames of the sensor node, by
tables of signals. A drive is steady while it is enabled and its state machine (``drives.contract``)
has nothing to do. ``receive_frames`` stops at each frame that a state machine must handle. The
caller handles this frame, and calls ``receive_frames`` again for the frames after this one.
``encode_commands`` encodes the commands of steady drives, and stops at each drive that is not
steady. ``WireTables`` builds the tables for a hand.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import borrowed_array, kernel, kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, TablePlaces
from handctl.core.constants import ConstantTables, constant_tables
from handctl.core.control_law.servo_commands import command_torque_only
from handctl.core.estimation.varying_moment_arms import carrier_excursion
from handctl.core.state_block import StateTables, state_tables
from handctl.drives.contract import Drive, DrivePhase
from handctl.drives.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from handctl.drives.frame_records import (
    BUS_BIT,
    HEAD_WORD,
    LENGTH_BIT,
    PAYLOAD_WORD,
    TIME_WORD,
    WORDS_PER_RECORD,
    WordRows,
    frames_as_records,
)
from handctl.drives.sensors.contract import SensorInterface
from handctl.drives.signals import (
    CHANNEL_COLUMN,
    INTEGER_COLUMN_COUNT,
    ORDER_COLUMN,
    QUANTITY_COLUMN,
    WINDOW_COLUMN,
    CyclicMessage,
    SignalQuantity,
    SignalTable,
    bytes_reversed,
    decode_signal,
    encode_signal,
    window_at,
    write_window,
)
from handctl.drives.signals import LENGTH_COLUMN as LENGTH_BITS

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]

(
    OWNER_COLUMN,
    FRAME_KIND_COLUMN,
    FIRST_SIGNAL_COLUMN,
    END_SIGNAL_COLUMN,
    PAYLOAD_BYTES_COLUMN,
    GROUP_COLUMN,
    NEAREST_ONLY_COLUMN,
) = range(7)
"""Columns of an entry, which describes the frames with one identifier.

The columns are: index of the drive or ``SENSOR_NODE_OWNER``, kind of frame, first signal, signal
after the last, payload length [bytes], group, and 1 if only the frame nearest to the expected
position is used.
"""
SENSOR_NODE_OWNER = -1
"""Value of the column ``OWNER_COLUMN`` for frames of the sensor node."""
STATE_MACHINE_FRAMES, FEEDBACK_FRAMES, VALUE_FRAMES, SENSOR_FRAMES, HOST_FRAMES = range(5)
"""Kinds of frames: for a state machine, reply to a command, more drive values, sensor node, sent by this host only."""
ENABLED_PHASE = int(DrivePhase.ENABLED)
"""Value of ``drives.contract.DrivePhase.ENABLED``."""
MISSING_ENTRY = -1
"""Index that stands for a missing entry."""
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


@kernel("block", "layout", "count", "count", "count", "count", "count")
def begin_tick(
    block: BlockArray, at: TablePlaces, k: int, t_ns: int, late_ns: int, missed: int, frames: int
) -> None:
    """Reset the flags of received data, and store number and time of the tick.

    Args:
        block: state block.
        at: ``BlockLayout.places`` of the state block.
        k: number of the tick.
        t_ns: time of the tick [ns].
        late_ns: delay of the tick's start [ns].
        missed: ticks missed before the present tick.
        frames: number of received frames.
    """
    x = state_tables(block, at)
    x.run_int[s.K] = k
    x.run_int[s.T_NS] = t_ns
    x.run_int[s.LATE_NS] = late_ns
    x.run_int[s.MISSED_TICKS] = missed
    x.run_int[s.RECEIVED_FRAMES] = frames
    for n in range(x.tendon.shape[1]):
        x.tendon_int[s.FEEDBACKS_NOW, n] = x.tendon_int[s.CELL_FRESH, n] = 0
        x.tendon_int[s.PHASE_BEFORE, n] = x.tendon_int[s.PHASE, n]
    for j in range(x.joint.shape[1]):
        x.joint_int[s.JOINT_FRESH, j] = 0
    for g in range(x.group_int.shape[1]):
        x.group_int[s.GROUP_FRAMES_NOW, g] = 0
    for node in range(x.node_int.shape[1]):
        x.node_int[s.MALFORMED_NOW, node] = x.node_int[s.DUPLICATES, node] = 0
    x.run_int[s.STALE_NOW] = x.run_int[s.UNKNOWN_FRAMES] = 0
    x.run_int[s.REFUSED_REQUESTS_NOW] = x.run_int[s.CONSISTENCY_CHANGED] = 0


@kernel("block", "layout", "count", "real", "real", "real", "real", *("count",) * 8)
def store_drive(
    block: BlockArray,
    at: TablePlaces,
    n: int,
    position: float,
    velocity: float,
    torque: float,
    temperature: float,
    feedback_t_ns: int,
    feedback_count: int,
    phase: int,
    fault_code: int,
    fault_cause: int,
    steady_status: int,
    due_ns: int,
    misread: int,
) -> None:
    """Store the values of a drive after its state machine has run.

    Args:
        block: state block.
        at: ``BlockLayout.places`` of the state block.
        n: index of the drive.
        position: motor position, at the spool [rad].
        velocity: motor velocity, at the spool [rad/s].
        torque: torque that the drive reports [N m].
        temperature: hottest sensor of the drive [degC].
        feedback_t_ns: reception time of the latest feedback [ns].
        feedback_count: number of feedback frames since the start.
        phase: ``drives.contract.DrivePhase`` of the drive.
        fault_code: error code of the drive.
        fault_cause: ``drives.fault_causes.DriveFaultCause`` of the error code, -1 without a fault.
        steady_status: drive status at which the drive's state machine has nothing to do.
        due_ns: time at which the drive's state machine must run next [ns].
        misread: 1 if a frame of the drive in this tick had a wrong shape.
    """
    x = state_tables(block, at)
    x.tendon[s.POSITION, n] = position
    x.tendon[s.VELOCITY, n] = velocity
    x.tendon[s.REPORTED_TORQUE, n] = torque
    x.tendon[s.TEMPERATURE, n] = temperature
    x.tendon_int[s.FEEDBACKS_NOW, n] += feedback_count - x.tendon_int[s.FEEDBACKS, n]
    x.tendon_int[s.FEEDBACKS, n] = feedback_count
    x.tendon_int[s.FEEDBACK_NS, n] = feedback_t_ns
    x.tendon_int[s.PHASE, n] = phase
    x.tendon_int[s.FAULT_CODE, n] = fault_code
    x.tendon_int[s.FAULT_CAUSE, n] = fault_cause
    x.tendon_int[s.STATUS_EXPECTED, n] = steady_status
    x.tendon_int[s.DUE_NS, n] = due_ns
    if misread:
        x.node_int[s.MALFORMED_NOW, n] = 1


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


class WireTables:
    """Tables of all cyclic frames of a hand.

    Attributes:
        keys: (e,) bus << 32 | identifier, sorted.
        entries: (e, 7) with the columns ``OWNER_COLUMN`` to ``NEAREST_ONLY_COLUMN``.
        wholes: (s, INTEGER_COLUMN_COUNT) integers of the received signals.
        reals: (s, 2) real numbers of the received signals.
        commands: (f, 3) drive, row of the torque in ``sent_wholes`` or -1, and feedback timeout
            [ns] of each command.
        sent_wholes: (t, INTEGER_COLUMN_COUNT) integers of the sent torques.
        sent_reals: (t, 3) real numbers of the sent torques, with the limit [N m] in the third
            column.
        templates: (f, WORDS_PER_RECORD) commands without torque.
        servos: (N, 2) first row of each drive in ``servo_wholes``, and the row after its last. Both
            are equal for a drive that receives only torques.
        servo_templates: (N, WORDS_PER_RECORD) position commands with all signals 0.
        servo_wholes: (p, INTEGER_COLUMN_COUNT) integers of the signals of position commands.
        servo_reals: (p, 4) real numbers of these signals: scale, offset, smallest and largest
            value, for the true torque of the motor.
    """

    def __init__(
        self,
        drives: Sequence[Drive],
        sensors: SensorInterface,
        holds_position: Sequence[bool] = (),
        torque_gain: FloatArray | None = None,
    ) -> None:
        """Build the tables of all frames.

        Args:
            drives: drives of the hand.
            sensors: sensor node of the hand.
            holds_position: for each drive, True if it closes the position loop. Empty if no drive
                does.
            torque_gain: (N,) torque at the spool per commanded torque. If it is None, all gains are
                1.
        """
        self._signals: list[SignalTable] = []
        found: dict[int, list[int]] = {}
        for drive in drives:
            found |= {
                _frame_key(drive.bus, can_id): [0, HOST_FRAMES, 0, 0, 0, 0, 0]
                for can_id in drive.host_ids
            }
        found |= {
            _frame_key(sensors.bus, can_id): [SENSOR_NODE_OWNER, HOST_FRAMES, 0, 0, 0, 0, 0]
            for can_id in sensors.host_ids
        }
        for n, drive in enumerate(drives):
            found |= {
                _frame_key(drive.bus, can_id): [n, STATE_MACHINE_FRAMES, 0, 0, 0, 0, 0]
                for can_id in drive.node_ids
            }
            for message in drive.cyclic_messages.feedback:
                kind = FEEDBACK_FRAMES if message.answers else VALUE_FRAMES
                signals = self._add_message(message)
                found[_frame_key(drive.bus, message.can_id)] = [
                    n,
                    kind,
                    *signals,
                    message.length,
                    0,
                    message.nearest,
                ]
        found |= {
            _frame_key(sensors.bus, can_id): [
                SENSOR_NODE_OWNER,
                STATE_MACHINE_FRAMES,
                0,
                0,
                0,
                0,
                0,
            ]
            for can_id in sensors.service_ids
        }
        for group, message in enumerate(sensors.messages):
            found[_frame_key(sensors.bus, message.can_id)] = [
                SENSOR_NODE_OWNER,
                SENSOR_FRAMES,
                *self._add_message(message),
                message.length,
                group,
                0,
            ]
        keys = sorted(found)
        self.keys: IntArray = np.array(keys, dtype=np.int64)
        self.entries: IntArray = np.array([found[key] for key in keys], dtype=np.int64)
        self.wholes = np.concatenate([table.wholes for table in self._signals])
        self.reals = np.concatenate([table.reals for table in self._signals])
        self._build_torque_commands(drives)
        self._build_position_commands(drives, holds_position or [False] * len(drives), torque_gain)
        self._entries_without: dict[tuple[int, ...], IntArray] = {}

    def entries_without(self, groups: tuple[int, ...]) -> IntArray:
        """Return a copy of the entries in which the frames of some groups go to the state machines of the sensors."""
        entries = self._entries_without.get(groups)
        if entries is None:
            entries = self.entries.copy()
            entries[
                (entries[:, FRAME_KIND_COLUMN] == SENSOR_FRAMES)
                & np.isin(entries[:, GROUP_COLUMN], groups),
                FRAME_KIND_COLUMN,
            ] = STATE_MACHINE_FRAMES
            self._entries_without[groups] = entries
        return entries

    def _add_message(self, message: CyclicMessage) -> tuple[int, int]:
        """Add the signals of a message to the tables. Return the range of their rows."""
        first = sum(len(table.wholes) for table in self._signals)
        self._signals.append(SignalTable(message))
        return first, first + len(self._signals[-1].wholes)

    def _build_torque_commands(self, drives: Sequence[Drive]) -> None:
        rows = list[list[int]]()
        templates = list[WordRows]()
        wholes = list[IntArray]()
        reals = list[list[float]]()
        for n, drive in enumerate(drives):
            for message in drive.cyclic_messages.commands:
                table = SignalTable(message)
                signal = -1
                if len(table.wholes):
                    signal = len(wholes)
                    wholes.append(table.wholes[0])
                    reals.append([*table.reals[0], message.limit])
                rows.append([n, signal, drive.cyclic_messages.feedback_timeout_ns])
                templates.append(_frame_template(message, drive.bus))
        self.commands: IntArray = np.array(rows, dtype=np.int64).reshape(-1, 3)
        self.sent_wholes: IntArray = np.array(wholes, dtype=np.int64).reshape(
            -1, INTEGER_COLUMN_COUNT
        )
        self.sent_reals: FloatArray = np.array(reals, dtype=np.float64).reshape(-1, 3)
        self.templates: WordRows = np.array(templates, dtype=np.uint64).reshape(
            -1, WORDS_PER_RECORD
        )

    def _build_position_commands(
        self,
        drives: Sequence[Drive],
        holds_position: Sequence[bool],
        torque_gain: FloatArray | None,
    ) -> None:
        """Build the tables of the position commands of all drives that close the position loop."""
        wholes = [np.empty((0, INTEGER_COLUMN_COUNT), np.int64)]
        reals = [np.empty((0, 4))]
        servos = np.zeros((len(drives), 2), np.int64)
        templates = np.zeros((len(drives), WORDS_PER_RECORD), np.uint64)
        for n, drive in enumerate(drives):
            message = drive.cyclic_messages.position
            if not holds_position[n] or message is None:
                continue
            signals = SignalTable(message).wholes
            first = sum(len(one) for one in wholes)
            servos[n] = first, first + len(signals)
            templates[n] = _frame_template(message, drive.bus)
            wholes.append(signals)
            gain = 1.0 if torque_gain is None else float(torque_gain[n])
            reals.append(_ranges_of_signals(message, gain))
        self.servos: IntArray = servos
        self.servo_templates: WordRows = templates
        self.servo_wholes: IntArray = np.concatenate(wholes)
        self.servo_reals: FloatArray = np.concatenate(reals)


def _ranges_of_signals(message: CyclicMessage, torque_gain: float) -> FloatArray:
    """Return scale, offset, smallest and largest value of each signal of a position command, (p, 4)."""
    rows = []
    for signal in message.signals:
        if signal.quantity == SignalQuantity.UNUSED:
            continue
        gain = (
            1.0
            if signal.quantity in (SignalQuantity.POSITION, SignalQuantity.VELOCITY)
            else torque_gain
        )
        low, high = signal.ends
        if signal.quantity == SignalQuantity.TORQUE:
            low = max(low, -message.limit)
            high = min(high, message.limit)
        rows.append([gain * value for value in (signal.scale, signal.offset, low, high)])
    return np.array(rows)


def _frame_key(bus: int, can_id: int) -> int:
    return bus << 32 | can_id


def _frame_template(message: CyclicMessage, bus: int) -> WordRows:
    payload = message.base.ljust(message.length, b"\0")
    row: WordRows = frames_as_records([Frame(message.can_id, payload, message.flags, bus)]).rows[0]
    return row
