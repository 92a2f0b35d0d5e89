"""Build the wire tables of a hand from the cyclic messages of its drives and of its sensor node."""

from collections.abc import Iterator, Sequence

import numpy as np

from handctl.core.wire.wire_tables import (
    FEEDBACK_FRAMES,
    HOST_FRAMES,
    REPLY_BYTES_WORD,
    REPLY_ENTRY_WORD,
    REPLY_KEY_MASK_WORD,
    REPLY_MASK_WORD,
    REPLY_WORD,
    SENSOR_FRAMES,
    SENSOR_NODE_OWNER,
    STATE_MACHINE_FRAMES,
    VALUE_FRAMES,
    WORDS_PER_RECHECK,
    FloatArray,
    IntArray,
    WireTables,
)
from handctl.drives.contract import Drive
from handctl.drives.frame import Frame
from handctl.drives.frame_records import (
    FIRST_PAYLOAD_WORD,
    ID_AND_FLAGS_WORD,
    LENGTH_SHIFT,
    WORDS_PER_RECORD,
    WordRows,
    frames_as_records,
)
from handctl.drives.readback import SettingRecheck
from handctl.drives.sensors.contract import SensorInterface
from handctl.drives.signals import INTEGER_COLUMN_COUNT, CyclicMessage, SignalQuantity, SignalTable


def build_wire_tables(
    drives: Sequence[Drive],
    sensors: SensorInterface,
    is_loop_closed_by_drive: Sequence[bool] = (),
    torque_gain: FloatArray | None = None,
) -> WireTables:
    """Return the wire tables of a hand.

    Args:
        drives: drives of the hand.
        sensors: sensor node of the hand.
        is_loop_closed_by_drive: for each drive, True if the drive closes the position loop. The
            sequence is empty if no drive of the hand closes a position loop.
        torque_gain: (N,) torque at the spool divided by the commanded torque, or None if all values
            are 1.
    """
    received_frames = _received_frames(drives, sensors)
    closes_loop = is_loop_closed_by_drive or [False] * len(drives)
    return WireTables(
        *received_frames,
        *_torque_commands(drives),
        *_position_commands(drives, closes_loop, torque_gain),
        *_rechecks(drives, received_frames[0]),
    )


def _received_frames(
    drives: Sequence[Drive], sensors: SensorInterface
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Return the tables ``keys``, ``entries``, ``signal_integers`` and ``signal_scalings``."""
    entry_by_key = dict(_frames_without_signals(drives, sensors))
    signal_tables = list[SignalTable]()
    signal_count = 0
    for key, message, (owner, kind, group) in _frames_with_signals(drives, sensors):
        signal_tables.append(SignalTable(message))
        first_signal = signal_count
        signal_count += len(signal_tables[-1].signal_integers)
        entry_by_key[key] = [
            owner, kind, first_signal, signal_count, message.length, group, message.keeps_nearest_frame,
        ]  # fmt: skip
    keys = sorted(entry_by_key)
    return (
        np.array(keys, dtype=np.int64),
        np.array([entry_by_key[key] for key in keys], dtype=np.int64),
        np.concatenate([table.signal_integers for table in signal_tables]),
        np.concatenate([table.signal_scalings for table in signal_tables]),
    )


def _frames_without_signals(
    drives: Sequence[Drive], sensors: SensorInterface
) -> Iterator[tuple[int, list[int]]]:
    """Yield key and entry of each frame that the host sends, or that a state machine must handle.

    If several entries have the same key, the last entry is valid.
    """
    for drive in drives:
        for can_id in drive.host_ids:
            yield _frame_key(drive.bus, can_id), [0, HOST_FRAMES, 0, 0, 0, 0, 0]
    for can_id in sensors.host_ids:
        yield _frame_key(sensors.bus, can_id), [SENSOR_NODE_OWNER, HOST_FRAMES, 0, 0, 0, 0, 0]
    for n, drive in enumerate(drives):
        for can_id in drive.node_ids:
            yield _frame_key(drive.bus, can_id), [n, STATE_MACHINE_FRAMES, 0, 0, 0, 0, 0]
    for can_id in sensors.service_ids:
        yield (
            _frame_key(sensors.bus, can_id),
            [SENSOR_NODE_OWNER, STATE_MACHINE_FRAMES, 0, 0, 0, 0, 0],
        )


def _frames_with_signals(
    drives: Sequence[Drive], sensors: SensorInterface
) -> Iterator[tuple[int, CyclicMessage, tuple[int, int, int]]]:
    """Yield key, message, owner, kind and group of each cyclic frame that compiled code decodes."""
    for n, drive in enumerate(drives):
        for message in drive.cyclic_messages.feedback:
            kind = FEEDBACK_FRAMES if message.is_reply else VALUE_FRAMES
            yield _frame_key(drive.bus, message.can_id), message, (n, kind, 0)
    for group, message in enumerate(sensors.messages):
        key = _frame_key(sensors.bus, message.can_id)
        yield key, message, (SENSOR_NODE_OWNER, SENSOR_FRAMES, group)


def _torque_commands(
    drives: Sequence[Drive],
) -> tuple[IntArray, IntArray, FloatArray, WordRows]:
    """Return the commands, the integers and scalings of their torques, and their templates."""
    rows = list[list[int]]()
    templates = list[WordRows]()
    signal_integers = list[IntArray]()
    signal_scalings = list[list[float]]()
    for n, drive in enumerate(drives):
        for message in drive.cyclic_messages.commands:
            table = SignalTable(message)
            signal = -1
            if len(table.signal_integers):
                signal = len(signal_integers)
                signal_integers.append(table.signal_integers[0])
                signal_scalings.append([*table.signal_scalings[0], message.limit])
            rows.append([n, signal, drive.cyclic_messages.feedback_timeout_ns])
            templates.append(_frame_template(message, drive.bus))
    return (
        np.array(rows, dtype=np.int64).reshape(-1, 3),
        np.array(signal_integers, dtype=np.int64).reshape(-1, INTEGER_COLUMN_COUNT),
        np.array(signal_scalings, dtype=np.float64).reshape(-1, 3),
        np.array(templates, dtype=np.uint64).reshape(-1, WORDS_PER_RECORD),
    )


def _position_commands(
    drives: Sequence[Drive],
    is_loop_closed_by_drive: Sequence[bool],
    torque_gain: FloatArray | None,
) -> tuple[IntArray, WordRows, IntArray, FloatArray]:
    """Return the tables of the position commands of all drives that close the position loop.

    The tables are ``servos``, ``servo_templates``, ``servo_signal_integers`` and
    ``servo_signal_scalings``.
    """
    signal_integers = [np.empty((0, INTEGER_COLUMN_COUNT), np.int64)]
    signal_scalings = [np.empty((0, 4))]
    servos = np.zeros((len(drives), 2), np.int64)
    templates = np.zeros((len(drives), WORDS_PER_RECORD), np.uint64)
    for n, drive in enumerate(drives):
        message = drive.cyclic_messages.position
        if not is_loop_closed_by_drive[n] or message is None:
            continue
        signals = SignalTable(message).signal_integers
        first_row = sum(len(signal_rows) for signal_rows in signal_integers)
        servos[n] = first_row, first_row + len(signals)
        templates[n] = _frame_template(message, drive.bus)
        signal_integers.append(signals)
        gain = 1.0 if torque_gain is None else float(torque_gain[n])
        signal_scalings.append(_ranges_of_signals(message, gain))
    return servos, templates, np.concatenate(signal_integers), np.concatenate(signal_scalings)


def _rechecks(drives: Sequence[Drive], keys: IntArray) -> tuple[IntArray, WordRows]:
    """Return the settings that are read again while a drive is enabled: ``recheck_ranges`` and ``rechecks``."""
    ranges = list[tuple[int, int]]()
    rows = list[WordRows]()
    for drive in drives:
        rechecks = drive.rechecks
        ranges.append((len(rows), len(rows) + len(rechecks)))
        for recheck in rechecks:
            key = _frame_key(recheck.reply.bus, recheck.reply.can_id)
            rows.append(_recheck_row(recheck, int(np.searchsorted(keys, key))))
    return (
        np.array(ranges, dtype=np.int64).reshape(-1, 2),
        np.array(rows, dtype=np.uint64).reshape(-1, WORDS_PER_RECHECK),
    )


def _recheck_row(recheck: SettingRecheck, frame_entry: int) -> WordRows:
    """Return the row of ``WireTables.rechecks`` for a setting that is read again, (WORDS_PER_RECHECK,).

    Args:
        recheck: request and reply.
        frame_entry: index of the entry of the reply.
    """
    request, reply = frames_as_records((recheck.request, recheck.reply)).rows
    key_mask, mask = (
        sum(0xFF << 8 * i for i in range(first_byte, end))
        for first_byte, end in (recheck.key_byte_range, recheck.compared_byte_range)
    )
    row = np.empty(WORDS_PER_RECHECK, dtype=np.uint64)
    row[:WORDS_PER_RECORD] = request
    row[REPLY_WORD] = reply[FIRST_PAYLOAD_WORD]
    row[REPLY_KEY_MASK_WORD] = key_mask
    row[REPLY_MASK_WORD] = mask
    row[REPLY_ENTRY_WORD] = frame_entry
    row[REPLY_BYTES_WORD] = int(reply[ID_AND_FLAGS_WORD]) >> LENGTH_SHIFT
    return row


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
        low, high = signal.value_limits
        if signal.quantity == SignalQuantity.TORQUE:
            low = max(low, -message.limit)
            high = min(high, message.limit)
        rows.append([gain * value for value in (signal.scale, signal.offset, low, high)])
    return np.array(rows)


def _frame_key(bus: int, can_id: int) -> int:
    return bus << 32 | can_id


def _frame_template(message: CyclicMessage, bus: int) -> WordRows:
    payload = message.base_payload.ljust(message.length, b"\0")
    row: WordRows = frames_as_records([Frame(message.can_id, payload, message.flags, bus)]).rows[0]
    return row
