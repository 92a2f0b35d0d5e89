"""The frames that come in every tick, answered by one compiled law that reads and writes records.

A table leads from an identifier to the node that takes it, and from that one to the next that takes it, too. A frame
that asks for a decision (a special command, a register, a wrong length, a watchdog that is due) stops the law. The node
itself then answers it in Python, and the law goes on with the next frame.
"""

import ctypes
from typing import Any

import numpy as np

from firmware_sim.bus.frame import FDF, REMOTE
from firmware_sim.bus.records import RECORD
from firmware_sim.compiled import compiled, inner
from firmware_sim.nodes import sensors
from firmware_sim.nodes.kind import MIT
from firmware_sim.nodes.mit.codec import ENABLED, MitRow, feedback_word, obey, schedule
from firmware_sim.nodes.sensors import (
    CHANNELS,
    JOINT_OFFSET,
    SensorRow,
    drift_since,
    encode,
    has_joints,
    payload_size,
    read_cells,
)
from firmware_sim.plant.drivetrain import DRIVETRAIN, encoded, tensions

FRAME_NS = 135_000
"""Worst case of a classical frame of 8 bytes at 1 Mbit/s [ns], by which answers follow one another. Source: VCAN."""
FD_FRAME_NS = 57_000
"""Worst case of an FD frame of 8 bytes at 1/5 Mbit/s [ns]. Source: VCAN."""
NEXT_FRAME, ANSWERS, IN_ORDER = range(3)
"""Places in ``progress``: number of the frame that comes next; how many answers there are; whether their times rise."""
_IDS = 0x800
"""Standard identifiers, in the table once for data frames and once for remote frames, for each bus."""
_TENSION_LOW, _TENSION_STEP, _TENSION_OFFSET = sensors.TENSION
_JOINT_LOW, _JOINT_STEP, _JOINT_OFFSET = sensors.JOINT
_SPECIAL = 0xFFFFFFFFFFFFFF
"""Seven bytes of FF, by which a special command of an MIT motor begins."""


class Taker(ctypes.Structure):
    """Who takes an identifier: kind, number among the rows of its kind, and the number of the next taker or -1."""

    _fields_ = [(name, ctypes.c_int64) for name in ("kind", "number", "next")]


def empty_table(buses: int) -> Any:
    """Return a table in which nobody takes anything, shape (identifiers of all buses,)."""
    return np.full(buses * 2 * _IDS, -1, np.int64)


@inner
def place(bus: int, can_id: int) -> int:
    """Return the place of an identifier in the table; -1 if it has none."""
    if can_id & ~REMOTE >= _IDS:
        return -1
    return (2 * bus + (1 if can_id & REMOTE else 0)) * _IDS + (can_id & (_IDS - 1))


@inner
def _word(data: Any) -> int:
    """Return eight bytes as a number, the first highest; its sign means nothing."""
    word = 0
    for i in range(8):
        word = word << 8 | int(data[i])
    return word


@inner
def _fill(answer: Any, can_id: int, length: int, frame: Any) -> None:
    """Fill in an answer to a frame but for its payload, which is all zeros."""
    answer.can_id, answer.length, answer.flags, answer.bus = can_id, length, frame.flags, frame.bus
    data = answer.data
    for i in range(64):
        data[i] = 0


@inner
def _mit_decides(node: Any, rotor: Any, frame: Any, t_ns: int) -> bool:
    """Return whether the node of an MIT drive has to look at a frame itself."""
    if frame.length != 8 or t_ns >= node.wake_ns or rotor.faulty != 0:
        return True
    return _word(frame.data) >> 8 & _SPECIAL == _SPECIAL


@inner
def _mit(node: Any, rotor: Any, frame: Any, t_ns: int, answer: Any) -> None:
    """Let an MIT drive follow a command, and answer it."""
    node.fed_ns = t_ns
    if node.state == ENABLED:
        obey(node, rotor.law, _word(frame.data))
    temperatures = node.temperatures
    word = feedback_word(node, rotor, encoded(rotor.theta), temperatures.mosfet, temperatures.winding)
    schedule(node)
    _fill(answer, node.reply_id, 8, frame)
    data = answer.data
    for i in range(8):
        data[i] = word >> (56 - 8 * i) & 0xFF


@inner
def _tell(words: Any, channels: int, can_id: int, frame: Any, answers: Any, count: int) -> int:
    """Answer SYNC with payloads, of which each is a word, its lowest byte first; return how many answers there are."""
    for g in range(len(words)):
        length = payload_size(channels - g * CHANNELS)
        _fill(answers[count], can_id + g, length, frame)
        data = answers[count].data
        for i in range(length):
            data[i] = words[g] >> 8 * i & 0xFF
        count += 1
    return count


@inner
def _sense(  # noqa: PLR0913 - compiled functions take flat arrays
    node: Any, frame: Any, t_ns: int, cells: Any, q: Any, cell_order: Any, joint_order: Any, bias: Any,
    noise: Any, first: Any, answers: Any, count: int,
) -> int:  # fmt: skip
    """Sample load cells and joint encoders and answer SYNC; return how many answers there are.

    Args:
        node: the sensor node. frame: SYNC. cells: tensions [N]. q: joint angles [rad]. cell_order, joint_order: tendon
            and joint of each channel. bias: of each load cell [N]. noise, first: see ``Noise``.
        answers, count: room for answers, and how many are there.
    """
    channels, joints, counter = len(cell_order), len(joint_order), int(frame.data[0])
    read, codes, words = np.empty(channels), np.empty(channels, np.int64), np.empty(-(-channels // CHANNELS), np.int64)
    true = np.empty(channels)
    for i in range(channels):
        true[i] = cells[cell_order[i]]
    at, drift = first[0], drift_since(node, t_ns)
    read_cells(true, bias, noise[at : at + 2 * channels], drift, node.tension_noise, read)
    at += 2 * channels
    encode(read, _TENSION_LOW, _TENSION_STEP, _TENSION_OFFSET, counter, codes, words)
    count = _tell(words, channels, node.base_id, frame, answers, count)
    if has_joints(node, joints, counter):
        angles = np.empty(joints)
        for i in range(joints):
            angles[i] = q[joint_order[i]] + noise[at + i] * node.joint_noise
        at += joints
        codes, words = np.empty(joints, np.int64), np.empty(-(-joints // CHANNELS), np.int64)
        encode(angles, _JOINT_LOW, _JOINT_STEP, _JOINT_OFFSET, counter, codes, words)
        count = _tell(words, joints, node.base_id + JOINT_OFFSET, frame, answers, count)
    first[0] = at
    return count


@inner
def _follow_one_another(frames: Any, answers: Any, count: int, t_ns: int, last_ns: int, buses: int) -> bool:
    """Stamp answers as if they followed the frames and one another on each bus; return whether their times rise."""
    busy_ns = np.zeros(buses, np.int64)
    for i in range(len(frames)):
        busy_ns[frames[i].bus] += FD_FRAME_NS if frames[i].flags & FDF else FRAME_NS
    rise, before_ns = True, t_ns
    for i in range(count):
        answer = answers[i]
        busy_ns[answer.bus] += FD_FRAME_NS if answer.flags & FDF else FRAME_NS
        at_ns = t_ns + min(busy_ns[answer.bus], last_ns)
        rise = rise and at_ns >= before_ns
        answer.t_ns = before_ns = at_ns
    return rise


@compiled(
    RECORD, RECORD, "counts", "count", "count", "counts", Taker, "count", MitRow, SensorRow, "counts", "counts",
    "vector", "vector", "counts", *DRIVETRAIN, "vector", "vector", "vector",
)  # fmt: skip
def answer(  # noqa: PLR0913 - compiled functions take flat arrays
    frames: Any, answers: Any, progress: Any, t_ns: int, last_ns: int, table: Any, takers: Any, most: int,
    mit: Any, sensor: Any, cell_order: Any, joint_order: Any, bias: Any, noise: Any, first: Any,
    ropes: Any, joints: Any, arms: Any, rotors: Any, q: Any, dq: Any, cells: Any,
) -> None:  # fmt: skip
    """Answer frames until one asks for a decision; after the last one, stamp all answers.

    Args:
        frames: of the host. answers: room for answers; ``most`` of them can come of one frame.
        progress: how far it is; see ``NEXT_FRAME``. t_ns: the present [ns]. last_ns: stamps go so far beyond it [ns].
        table, takers: who takes an identifier. mit: drives. sensor: the sensor node, if there is one.
        cell_order, joint_order, bias, noise, first: see ``_sense``.
        ropes, joints, arms, rotors, q, dq: see ``drivetrain.steps``. cells: room for a tension of each tendon [N].
    """
    count, buses = progress[ANSWERS], len(table) // (2 * _IDS)
    for i in range(progress[NEXT_FRAME], len(frames)):
        frame, taker = frames[i], -1
        at = place(int(frame.bus), int(frame.can_id))
        if frame.bus < buses and at >= 0:
            taker = table[at]
        if taker < 0 or count + most > len(answers):
            break
        decides, one = False, taker
        while one >= 0:
            who = takers[one]
            if who.kind == MIT:
                node = mit[who.number]
                decides = decides or _mit_decides(node, rotors[node.motor_number], frame, t_ns)
            else:
                decides = decides or frame.length != 1 or len(noise) < first[0] + 2 * len(cell_order) + len(joint_order)
            one = who.next
        if decides:
            break
        while taker >= 0:
            who = takers[taker]
            if who.kind == MIT:
                node = mit[who.number]
                _mit(node, rotors[node.motor_number], frame, t_ns, answers[count])
                count += 1
            else:
                tensions(ropes, joints, arms, rotors, q, dq, cells)
                count = _sense(
                    sensor[0], frame, t_ns, cells, q, cell_order, joint_order, bias, noise, first, answers, count
                )
            taker = who.next
        progress[NEXT_FRAME] = i + 1
    progress[ANSWERS] = count
    if progress[NEXT_FRAME] == len(frames):
        progress[IN_ORDER] = _follow_one_another(frames, answers, count, t_ns, last_ns, buses)
