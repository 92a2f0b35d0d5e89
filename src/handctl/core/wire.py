"""Cyclic frames between the wire and the block: a tick's frames in, the commands of a tick out.

``receive`` reads feedback of drives that are enabled and steady, and all frames of the sensor node, from the tables of
signals. It stops at a frame that a drive's state machine must see (``drives.contract``), and goes on behind it. ``send``
writes the commands of drives that are steady, and stops at a drive whose state machine must act. The tables of one hand
are put together by ``Wire``.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import inner, kernel
from handctl.core import block as s
from handctl.core.block import Tables, tables
from handctl.core.schema import Block, Places
from handctl.drives.contract import Drive
from handctl.drives.frame import ERROR, EXTENDED, REMOTE
from handctl.drives.records import SIZE, Rows
from handctl.drives.sensors.node import SensorNode
from handctl.drives.signals import QUANTITY, Message, Quantity, Table, insert, packed, unpacked, word

Whole = NDArray[np.int64]
Real = NDArray[np.float64]

OWNER, KIND, FIRST, END, LENGTH, GROUP = range(6)
"""Columns of an entry: tendon of the drive (or NODE), what is done with its frames, its signals, its payload [bytes],
and its frame group."""
NODE = -1
"""Owner of the sensor node's frames."""
LOOK, FEEDBACK, VALUES, SENSORS, HOST = range(5)
"""What is done with a frame: the state machine looks at it; it is feedback that answers a command; it has values besides;
it is the sensor node's; only this host may send it."""
ENABLED = 3
"""``drives.contract.Phase.ENABLED``."""
UNKNOWN = -1
"""No entry."""
T_NS_AT, ID_AT, FLAGS_AT, BUS_AT, LENGTH_AT, DATA_AT = 0, 8, 12, 14, 15, 16
"""Bytes of a record; see ``drives.records``."""


@inner
def number(row: Rows, at: int, size: int) -> int:
    """Return a little-endian number of so many bytes."""
    value = 0
    for i in range(size):
        value |= np.int64(row[at + i]) << (8 * i)
    return value


@inner
def find(keys: Whole, key: int) -> int:
    """Return the index of a key among sorted ones, UNKNOWN if it is not there."""
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low if low < len(keys) and keys[low] == key else UNKNOWN


@kernel("block", "layout")
def begin(block: Block, at: Places) -> None:
    """Forget what came in the last tick."""
    x = tables(block, at)
    for n in range(x.tendon.shape[1]):
        x.tendon_int[s.ANSWERED, n] = x.tendon_int[s.CELL_FRESH, n] = 0
        x.tendon_int[s.PHASE_BEFORE, n] = x.tendon_int[s.PHASE, n]
    for j in range(x.joint.shape[1]):
        x.joint_int[s.JOINT_FRESH, j] = 0
    for g in range(x.group_int.shape[1]):
        x.group_int[s.GROUP_ANSWERED, g] = 0
    for node in range(x.node_int.shape[1]):
        x.node_int[s.MISREAD_NOW, node] = x.node_int[s.TWICE, node] = 0
    x.run_int[s.STALE_NOW] = x.run_int[s.STRANGE] = x.run_int[s.REFUSED_NOW] = 0


@kernel("block", "layout", "records", "counts", "matrix_int", "matrix_int", "matrix", "count")
def receive(
    block: Block, at: Places, rows: Rows, keys: Whole, entries: Whole, wholes: Whole, reals: Real, first: int
) -> int:
    """Take in frames from the first one on.

    Args:
        block, at: the state. rows: (n, SIZE) records. keys, entries, wholes, reals: see ``Wire``.
        first: index of the first frame.

    Returns:
        the index of a frame that a state machine, or the monitor of other controllers, must see; n if there is none.
    """
    x = tables(block, at)
    for r in range(first, len(rows)):
        row = rows[r]
        can_id = number(row, ID_AT, 4) & ~ERROR
        entry = find(keys, np.int64(row[BUS_AT]) << 32 | can_id)
        if entry == UNKNOWN:
            _strange(x, keys, entries, row, can_id)
            continue
        kind = entries[entry, KIND]
        if kind == SENSORS:
            _sensors(x, row, entries[entry], wholes, reals)
        elif kind in (LOOK, HOST) or not _values(x, row, entries[entry], wholes, reals):
            return r
    return len(rows)


@inner
def _strange(x: Tables, keys: Whole, entries: Whole, row: Rows, can_id: int) -> None:
    """Count a frame of nobody's; one with a node's number as a remote or 29-bit frame is misshapen."""
    x.run_int[s.STRANGE] += 1
    if can_id & (EXTENDED | REMOTE):
        entry = find(keys, np.int64(row[BUS_AT]) << 32 | can_id & 0x7FF)
        if entry != UNKNOWN and entries[entry, KIND] != HOST:
            owner = entries[entry, OWNER]
            x.node_int[s.MISREAD_NOW, owner if owner != NODE else x.node_int.shape[1] - 1] = 1


@inner
def _sensors(x: Tables, row: Rows, entry: Whole, wholes: Whole, reals: Real) -> None:
    """Take in a frame of load cells or joint encoders; one with another counter than that of SYNC is stale."""
    if row[LENGTH_AT] != entry[LENGTH]:
        x.node_int[s.MISREAD_NOW, x.node_int.shape[1] - 1] = 1
        return
    group, value = entry[GROUP], word(row[DATA_AT:], 0)
    for i in range(entry[FIRST], entry[END]):
        number_, signal = unpacked(value, wholes[i], reals[i]), wholes[i]
        if signal[QUANTITY] == 7 and number_ != x.run_int[s.SYNC_ASKED]:
            x.run_int[s.STALE] += 1
            x.run_int[s.STALE_NOW] = max(x.run_int[s.STALE_NOW], 2 if x.group_int[s.GROUP_ANSWERED, group] else 1)
            return
        if signal[QUANTITY] == 5:
            x.tendon[s.CELL, signal[5]] = number_
            x.tendon_int[s.CELL_FRESH, signal[5]] = 1
        if signal[QUANTITY] == 6:
            x.joint[s.JOINT_ANGLE, signal[5]] = number_
            x.joint_int[s.JOINT_FRESH, signal[5]] = 1
    x.group_int[s.GROUP_NS, group] = number(row, T_NS_AT, 8)
    x.group_int[s.GROUP_FRAMES, group] += 1
    x.group_int[s.GROUP_ANSWERED, group] += 1


@inner
def _values(x: Tables, row: Rows, entry: Whole, wholes: Whole, reals: Real) -> bool:
    """Take in a frame of a drive; return False, and take nothing, if its state machine must see it."""
    n = entry[OWNER]
    expected = x.tendon_int[s.STATUS_EXPECTED, n]
    if x.tendon_int[s.PHASE, n] != ENABLED or expected < 0 or row[LENGTH_AT] != entry[LENGTH]:
        return False
    found, status = np.full(4, math.nan), 0
    little, big = word(row[DATA_AT:], 0), word(row[DATA_AT:], 1)
    for i in range(entry[FIRST], entry[END]):
        signal = wholes[i]
        value = unpacked(big if signal[2] else little, signal, reals[i])
        if math.isnan(value):
            return False
        quantity = signal[QUANTITY]
        if quantity == 4:
            status = status << signal[1] | np.int64(value)
        elif quantity == 3:
            found[3] = value if math.isnan(found[3]) else max(found[3], value)
        elif quantity < 3:
            found[quantity] = value
    feedback = entry[KIND] == FEEDBACK
    if feedback and status != expected:
        return False
    for quantity in range(4):
        if not math.isnan(found[quantity]):
            x.tendon[s.POSITION + quantity, n] = found[quantity]
    if feedback:
        x.tendon_int[s.FEEDBACK_NS, n] = number(row, T_NS_AT, 8)
        x.tendon_int[s.FEEDBACKS, n] += 1
        x.tendon_int[s.ANSWERED, n] += 1
    return True


@kernel("block", "layout", "records", "matrix_int", "matrix_int", "matrix", "records", "vector", "count", "count")
def send(
    block: Block,
    at: Places,
    out: Rows,
    commands: Whole,
    wholes: Whole,
    reals: Real,
    templates: Rows,
    torque: Real,
    first: int,
    count: int,
) -> tuple[int, int]:
    """Write the commands of drives that are steady.

    Args:
        block, at: the state. out: (frames, SIZE) records.
        commands: (frames, 3) drive, signal (-1 for none) and patience [ns]; see ``Wire``.
        wholes, reals: of the signals; a third column of ``reals`` is the limit [N m].
        templates: (frames, SIZE) records without their torque.
        torque: (N,) what each drive is told [N m].
        first: drive to begin with. count: records in ``out`` so far.

    Returns:
        the first drive whose state machine must act (N if none must), and the number of records. A torque that cannot
        be sent stops at its drive, too, and its state machine says so.
    """
    x = tables(block, at)
    now_ns = x.run_int[s.T_NS]
    for i in range(len(commands)):
        n = commands[i, 0]
        if n < first:
            continue
        steady = x.tendon_int[s.PHASE, n] == ENABLED and x.tendon_int[s.STATUS_EXPECTED, n] >= 0
        heard_ns, patience_ns = x.tendon_int[s.FEEDBACK_NS, n], commands[i, 2]
        overdue = patience_ns > 0 and heard_ns < now_ns - patience_ns
        if not steady or now_ns >= x.tendon_int[s.DUE_NS, n] or overdue:
            return n, count
        signal = commands[i, 1]
        if signal >= 0 and not abs(torque[n]) <= reals[signal, 2]:
            return n, count
        for b in range(SIZE):
            out[count, b] = templates[i, b]
        if signal >= 0:
            bits = packed(torque[n], wholes[signal], reals[signal])
            insert(out[count, DATA_AT : DATA_AT + 8], bits, wholes[signal, 2])
        count += 1
    return len(torque), count


class Wire:
    """Tables of all cyclic frames of a hand.

    Attributes:
        keys: (e,) bus << 32 | identifier, sorted. entries: (e, 6) see the columns above.
        wholes, reals: (s, 6) and (s, 2) signals that are read.
        commands: (f, 3) drive, index of its torque among ``sent_wholes`` or -1, and patience [ns] of each command.
        sent_wholes, sent_reals: (t, 6) and (t, 3) torques that are sent; the third column is the limit [N m].
        templates: (f, SIZE) commands without their torque.
    """

    def __init__(self, drives: Sequence[Drive], sensors: SensorNode) -> None:
        self._signals: list[Table] = []
        found: dict[int, list[int]] = {}
        for drive in drives:
            found |= {_key(drive.bus, can_id): [0, HOST, 0, 0, 0, 0] for can_id in drive.host_ids}
        found |= {_key(sensors.bus, can_id): [NODE, HOST, 0, 0, 0, 0] for can_id in sensors.host_ids}
        for n, drive in enumerate(drives):
            found |= {_key(drive.bus, can_id): [n, LOOK, 0, 0, 0, 0] for can_id in drive.node_ids}
            for message in drive.cyclic.feedback:
                kind = FEEDBACK if message.answers else VALUES
                found[_key(drive.bus, message.can_id)] = [n, kind, *self._added(message), message.length, 0]
        for group, message in enumerate(sensors.messages):
            found[_key(sensors.bus, message.can_id)] = [NODE, SENSORS, *self._added(message), message.length, group]
        keys = sorted(found)
        self.keys: Whole = np.array(keys, dtype=np.int64)
        self.entries: Whole = np.array([found[key] for key in keys], dtype=np.int64)
        self.wholes = np.concatenate([table.wholes for table in self._signals])
        self.reals = np.concatenate([table.reals for table in self._signals])
        self._commands(drives)

    def _added(self, message: Message) -> tuple[int, int]:
        """Add the signals of a message; return the rows that are its own."""
        first = sum(len(table.wholes) for table in self._signals)
        self._signals.append(Table(message))
        return first, first + len(self._signals[-1].wholes)

    def _commands(self, drives: Sequence[Drive]) -> None:
        rows, wholes, reals, templates = [], [], [], []
        for n, drive in enumerate(drives):
            for message in drive.cyclic.commands:
                table, signal = Table(message), -1
                if len(table.wholes):
                    signal = len(wholes)
                    wholes.append(table.wholes[0])
                    reals.append([*table.reals[0], message.limit])
                rows.append([n, signal, drive.cyclic.patience_ns])
                templates.append(_template(message, drive.bus))
        self.commands: Whole = np.array(rows, dtype=np.int64).reshape(-1, 3)
        self.sent_wholes: Whole = np.array(wholes, dtype=np.int64).reshape(-1, 6)
        self.sent_reals: Real = np.array(reals, dtype=np.float64).reshape(-1, 3)
        self.templates: Rows = np.array(templates, dtype=np.uint8).reshape(-1, SIZE)


def _key(bus: int, can_id: int) -> int:
    return bus << 32 | can_id


def _template(message: Message, bus: int) -> Rows:
    from handctl.drives.frame import Frame
    from handctl.drives.records import frames_of

    payload = message.base.ljust(message.length, b"\0")
    return frames_of([Frame(message.can_id, payload, message.flags, bus)]).rows[0]


assert (Quantity.POSITION, Quantity.VELOCITY, Quantity.TORQUE, Quantity.TEMPERATURE) == (0, 1, 2, 3)
