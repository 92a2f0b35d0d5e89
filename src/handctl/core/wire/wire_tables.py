"""Tables of all cyclic frames of a hand, for the compiled functions of ``cyclic_frames``.

All tables are in one block of words. A compiled function gets the block and the positions of the
tables, and ``wire_tables`` returns the tables by name.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import borrowed_array, kernel_helper
from handctl.core.block_schema import TableOffsets
from handctl.drives.frame_records import WORDS_PER_RECORD, WordRows
from handctl.drives.signals import INTEGER_COLUMN_COUNT

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
    ENTRY_COLUMN_COUNT,
) = range(8)
"""Columns of an entry, which describes the frames with one identifier, and the number of columns.

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

WordBlock = NDArray[np.uint64]
"""Block of words that contains all wire tables of a hand."""


class WireTables(NamedTuple):
    """Identifiers, signals and records of all cyclic frames of a hand, in tables.

    Attributes:
        keys: (e,) sorted keys of all frames. The key of a frame is bus << 32 | identifier.
        entries: (e, ENTRY_COLUMN_COUNT) values of each frame, in the columns ``OWNER_COLUMN`` to
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
    """

    keys: IntArray
    entries: IntArray
    signal_integers: IntArray
    signal_scalings: FloatArray
    commands: IntArray
    command_signal_integers: IntArray
    command_signal_scalings: FloatArray
    templates: WordRows
    servos: IntArray
    servo_templates: WordRows
    servo_signal_integers: IntArray
    servo_signal_scalings: FloatArray
    recheck_ranges: IntArray
    rechecks: WordRows


@kernel_helper
def wire_tables(words: WordBlock, at: TableOffsets) -> WireTables:
    """Return the wire tables of a hand.

    Args:
        words: block of the tables, ``WireBlock.words``.
        at: positions of the tables, ``WireBlock.offsets``.
    """
    integers = words.view(np.int64)
    reals = words.view(np.float64)
    return WireTables(
        borrowed_array(integers, at[0], (at[1],)),
        borrowed_array(integers, at[2], (at[3], ENTRY_COLUMN_COUNT)),
        borrowed_array(integers, at[4], (at[5], INTEGER_COLUMN_COUNT)),
        borrowed_array(reals, at[6], (at[7], 2)),
        borrowed_array(integers, at[8], (at[9], 3)),
        borrowed_array(integers, at[10], (at[11], INTEGER_COLUMN_COUNT)),
        borrowed_array(reals, at[12], (at[13], 3)),
        borrowed_array(words, at[14], (at[15], WORDS_PER_RECORD)),
        borrowed_array(integers, at[16], (at[17], 2)),
        borrowed_array(words, at[18], (at[19], WORDS_PER_RECORD)),
        borrowed_array(integers, at[20], (at[21], INTEGER_COLUMN_COUNT)),
        borrowed_array(reals, at[22], (at[23], 4)),
        borrowed_array(integers, at[24], (at[25], 2)),
        borrowed_array(words, at[26], (at[27], WORDS_PER_RECHECK)),
    )


class WireBlock:
    """Wire tables of a hand in one block of words.

    Attributes:
        tables: tables of the hand.
        words: (w,) block with all tables, one after the other. Each number of a table is one word.
        offsets: first word and number of rows of each table, in the order of ``WireTables``.
        kernel_args: ``words`` and ``offsets``, as arguments of a compiled function.
        max_frames: largest number of frames, including SYNC, that one tick sends to steady drives.
    """

    def __init__(self, tables: WireTables) -> None:
        """Copy the tables into a block."""
        self.tables = tables
        self.words: WordBlock = np.concatenate([
            np.ascontiguousarray(table).view(np.uint64).ravel() for table in tables
        ])  # fmt: skip
        first_words = np.cumsum([0, *(table.size for table in tables[:-1])])
        row_counts = [len(table) for table in tables]
        self.offsets: TableOffsets = np.column_stack((first_words, row_counts)).ravel()
        self.kernel_args = self.words, self.offsets
        self.max_frames = 1 + len(tables.templates) + len(tables.servos)
        self._blocks_by_removed_groups: dict[tuple[int, ...], WireBlock] = {}

    def without_groups(self, removed_groups: tuple[int, ...]) -> "WireBlock":
        """Return a block in which state machines process the frames of the given sensor groups.

        Compiled code processes the sensor frames of all other groups.
        """
        block = self._blocks_by_removed_groups.get(removed_groups)
        if block is None:
            entries = self.tables.entries.copy()
            entries[
                (entries[:, FRAME_KIND_COLUMN] == SENSOR_FRAMES)
                & np.isin(entries[:, GROUP_COLUMN], removed_groups),
                FRAME_KIND_COLUMN,
            ] = STATE_MACHINE_FRAMES
            block = WireBlock(self.tables._replace(entries=entries))
            self._blocks_by_removed_groups[removed_groups] = block
        return block
