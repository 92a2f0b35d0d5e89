"""Tables of all cyclic frames of a hand, for the compiled functions of ``cyclic_frames``."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

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

The columns are: index of the drive or ``SENSOR_NODE_OWNER``, kind of frame, index of the first
signal, index after the last signal, payload length [bytes], group, and 1 if only the frame nearest
to the expected position is used.
"""
SENSOR_NODE_OWNER = -1
"""Value of the column ``OWNER_COLUMN`` for frames of the sensor node."""
STATE_MACHINE_FRAMES, FEEDBACK_FRAMES, VALUE_FRAMES, SENSOR_FRAMES, HOST_FRAMES = range(5)
"""Kinds of frames: for a state machine, reply to a command, other drive values, sensor values, sent by this host."""
(
    REPLY_WORD,
    REPLY_KEY_MASK_WORD,
    REPLY_MASK_WORD,
    REPLY_ENTRY_WORD,
    REPLY_BYTES_WORD,
    WORDS_PER_RECHECK,
) = range(WORDS_PER_RECORD, WORDS_PER_RECORD + 6)
"""Words of a repeated read-back after the record of its request, and the total number of words.

The words of a repeated read-back are: payload of the reply with the required value, bits that
identify the reply, bits that are compared, index of the reply's entry, and length of the reply's
payload [bytes].
"""


ReceiveTables = tuple[IntArray, IntArray, IntArray, FloatArray, IntArray, WordRows]
"""Tables that decode received frames, see ``WireTables.receive_tables``."""
CommandTables = tuple[
    IntArray, IntArray, FloatArray, WordRows,
    IntArray, WordRows, IntArray, FloatArray,
    IntArray, WordRows,
]  # fmt: skip
"""Tables that encode commands, see ``WireTables.command_tables``."""


class WireTables:
    """Identifiers, signals and records of all cyclic frames of a hand, in tables.

    Attributes:
        keys: (e,) sorted keys of all frames. The key of a frame is bus << 32 | identifier.
        entries: (e, 7) values of each frame, in the columns ``OWNER_COLUMN`` to
            ``NEAREST_ONLY_COLUMN``.
        signal_integers: (s, INTEGER_COLUMN_COUNT) integers of the received signals.
        signal_scalings: (s, 2) real numbers of the received signals.
        commands: (f, 3) drive, row of the torque in ``command_signal_integers`` or -1, and feedback timeout
            [ns] of each command.
        command_signal_integers: (t, INTEGER_COLUMN_COUNT) integers of the sent torques.
        command_signal_scalings: (t, 3) real numbers of the sent torques, with the limit [N m] in the third
            column.
        templates: (f, WORDS_PER_RECORD) records of the commands with zero torque.
        servos: (N, 2) first row of each drive in ``servo_signal_integers``, and the row after the
            drive's last row. The first row and the row after the last row are equal for a drive
            that receives only torques.
        servo_templates: (N, WORDS_PER_RECORD) records of the position commands with all signals 0.
        servo_signal_integers: (p, INTEGER_COLUMN_COUNT) integers of the signals of position commands.
        servo_signal_scalings: (p, 4) scale, offset, smallest and largest value of the signals of position
            commands, for the real torque of the motor.
        recheck_ranges: (N, 2) first row of each drive in ``rechecks``, and the row after the
            drive's last row.
        rechecks: (r, WORDS_PER_RECHECK) settings that are read again while a drive is enabled: the
            record of the request, followed by the words of the reply from ``REPLY_WORD`` on.
        max_frames: largest number of frames, including SYNC, that one tick sends to steady drives.
        receive_tables: tables that decode received frames, in the order of the arguments of
            ``cyclic_frames.receive_frames``: keys, entries, signals, repeated read-backs.
        command_tables: tables that encode commands, in the order of the arguments of
            ``cyclic_frames.encode_commands``: torque commands, position commands, repeated
            read-backs.
    """

    def __init__(
        self,
        drives: Sequence[Drive],
        sensors: SensorInterface,
        is_loop_closed_by_drive: Sequence[bool] = (),
        torque_gain: FloatArray | None = None,
    ) -> None:
        """Build the tables of all cyclic frames of a hand.

        Args:
            drives: drives of the hand.
            sensors: sensor node of the hand.
            is_loop_closed_by_drive: for each drive, True if the drive closes the position loop. The
                sequence is empty if no drive of the hand closes a position loop.
            torque_gain: (N,) torque at the spool divided by the commanded torque, or None if all
                values are 1.
        """
        self._signals: list[SignalTable] = []
        entry_by_key: dict[int, list[int]] = {}
        for drive in drives:
            entry_by_key |= {
                _frame_key(drive.bus, can_id): [0, HOST_FRAMES, 0, 0, 0, 0, 0]
                for can_id in drive.host_ids
            }
        entry_by_key |= {
            _frame_key(sensors.bus, can_id): [SENSOR_NODE_OWNER, HOST_FRAMES, 0, 0, 0, 0, 0]
            for can_id in sensors.host_ids
        }
        for n, drive in enumerate(drives):
            entry_by_key |= {
                _frame_key(drive.bus, can_id): [n, STATE_MACHINE_FRAMES, 0, 0, 0, 0, 0]
                for can_id in drive.node_ids
            }
            for message in drive.cyclic_messages.feedback:
                kind = FEEDBACK_FRAMES if message.is_reply else VALUE_FRAMES
                signals = self._add_message(message)
                entry_by_key[_frame_key(drive.bus, message.can_id)] = [
                    n,
                    kind,
                    *signals,
                    message.length,
                    0,
                    message.keeps_nearest_frame,
                ]
        entry_by_key |= {
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
            entry_by_key[_frame_key(sensors.bus, message.can_id)] = [
                SENSOR_NODE_OWNER,
                SENSOR_FRAMES,
                *self._add_message(message),
                message.length,
                group,
                0,
            ]
        keys = sorted(entry_by_key)
        self.keys: IntArray = np.array(keys, dtype=np.int64)
        self.entries: IntArray = np.array([entry_by_key[key] for key in keys], dtype=np.int64)
        self.signal_integers = np.concatenate([table.signal_integers for table in self._signals])
        self.signal_scalings = np.concatenate([table.signal_scalings for table in self._signals])
        self._build_torque_commands(drives)
        self._build_position_commands(
            drives, is_loop_closed_by_drive or [False] * len(drives), torque_gain
        )
        self._build_rechecks(drives)
        self.max_frames = 1 + len(self.templates) + len(drives)
        self.receive_tables: ReceiveTables = self._receive_tables(self.entries)
        self.command_tables: CommandTables = (
            self.commands, self.command_signal_integers, self.command_signal_scalings, self.templates,
            self.servos, self.servo_templates, self.servo_signal_integers, self.servo_signal_scalings,
            self.recheck_ranges, self.rechecks,
        )  # fmt: skip
        self._tables_by_removed_groups: dict[tuple[int, ...], ReceiveTables] = {}

    def receive_tables_without_groups(self, removed_groups: tuple[int, ...]) -> ReceiveTables:
        """Return ``receive_tables`` in which state machines process the frames of the given sensor groups.

        Compiled code processes the sensor frames of all other groups.
        """
        tables = self._tables_by_removed_groups.get(removed_groups)
        if tables is None:
            entries = self.entries.copy()
            entries[
                (entries[:, FRAME_KIND_COLUMN] == SENSOR_FRAMES)
                & np.isin(entries[:, GROUP_COLUMN], removed_groups),
                FRAME_KIND_COLUMN,
            ] = STATE_MACHINE_FRAMES
            tables = self._tables_by_removed_groups[removed_groups] = self._receive_tables(entries)
        return tables

    def _receive_tables(self, entries: IntArray) -> ReceiveTables:
        return (
            self.keys, entries, self.signal_integers, self.signal_scalings,
            self.recheck_ranges, self.rechecks,
        )  # fmt: skip

    def _add_message(self, message: CyclicMessage) -> tuple[int, int]:
        """Add the signals of a message to the tables, and return the range of the new rows."""
        first_signal = sum(len(table.signal_integers) for table in self._signals)
        self._signals.append(SignalTable(message))
        return first_signal, first_signal + len(self._signals[-1].signal_integers)

    def _build_torque_commands(self, drives: Sequence[Drive]) -> None:
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
        self.commands: IntArray = np.array(rows, dtype=np.int64).reshape(-1, 3)
        self.command_signal_integers: IntArray = np.array(signal_integers, dtype=np.int64).reshape(
            -1, INTEGER_COLUMN_COUNT
        )
        self.command_signal_scalings: FloatArray = np.array(
            signal_scalings, dtype=np.float64
        ).reshape(-1, 3)
        self.templates: WordRows = np.array(templates, dtype=np.uint64).reshape(
            -1, WORDS_PER_RECORD
        )

    def _build_position_commands(
        self,
        drives: Sequence[Drive],
        is_loop_closed_by_drive: Sequence[bool],
        torque_gain: FloatArray | None,
    ) -> None:
        """Build the tables of the position commands of all drives that close the position loop."""
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
        self.servos: IntArray = servos
        self.servo_templates: WordRows = templates
        self.servo_signal_integers: IntArray = np.concatenate(signal_integers)
        self.servo_signal_scalings: FloatArray = np.concatenate(signal_scalings)

    def _build_rechecks(self, drives: Sequence[Drive]) -> None:
        """Build the table of the settings that are read again while a drive is enabled."""
        ranges = list[tuple[int, int]]()
        rows = list[WordRows]()
        for drive in drives:
            rechecks = drive.rechecks
            ranges.append((len(rows), len(rows) + len(rechecks)))
            for recheck in rechecks:
                key = _frame_key(recheck.reply.bus, recheck.reply.can_id)
                rows.append(_recheck_row(recheck, int(np.searchsorted(self.keys, key))))
        self.recheck_ranges: IntArray = np.array(ranges, dtype=np.int64).reshape(-1, 2)
        self.rechecks: WordRows = np.array(rows, dtype=np.uint64).reshape(-1, WORDS_PER_RECHECK)


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
