"""The frames that come in every tick, answered by one compiled law that reads and writes records.

A table leads from an identifier to the node that takes it, and from that one to the next that takes it, too. A frame
that asks for a decision (a special command, a register, a wrong length, a watchdog that is due) stops the law. The node
itself then answers it in Python, and the law goes on with the next frame.
"""

import ctypes
import math
from typing import Any

import numpy as np

from firmware_sim.bus.frame import FDF, REMOTE
from firmware_sim.bus.records import RECORD
from firmware_sim.compiled import compiled, inner, rows_at
from firmware_sim.nodes import sensors
from firmware_sim.nodes.cia402.laws import (
    CONTROL_WORD,
    OPERATIONAL,
    POSITION,
    STATUS_WORD,
    TARGET_TORQUE,
    TORQUE,
    WARM_NS,
    Cia402Row,
    beats,
    follow,
    follows,
    measure,
)
from firmware_sim.nodes.cia402.laws import schedule as schedule_cia402
from firmware_sim.nodes.cia402.laws import starves as starves_cia402
from firmware_sim.nodes.kind import MIT, ODRIVE, SENSORS
from firmware_sim.nodes.mit.codec import ENABLED, MitRow, feedback_word, obey, schedule
from firmware_sim.nodes.odrive.laws import WARM_PERIOD_NS, OdriveRow, make_torque, next_due, starves, turns, turns_per_s
from firmware_sim.nodes.odrive.laws import schedule as schedule_odrive
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
from firmware_sim.plant.drivetrain import encoded, tensions
from firmware_sim.plant.rows import RopeRow, RotorRow

FRAME_NS = 135_000
"""Worst case of a classical frame of 8 bytes at 1 Mbit/s [ns], by which answers follow one another. Source: VCAN."""
FD_FRAME_NS = 57_000
"""Worst case of an FD frame of 8 bytes at 1/5 Mbit/s [ns]. Source: VCAN."""
NEXT_FRAME, ANSWERS, IN_ORDER, SAID, WAKE_NS = range(5)
"""Places in ``progress``: number of the frame that comes next; how many answers there are; whether their times rise;
how many frames nodes have sent of their own accord; when time must pass for a drive next [ns]."""
NEVER_NS = 1 << 62
"""When time must pass for no drive at all [ns]."""
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
def _fill(answer: Any, can_id: int, length: int, flags: int, bus: int) -> None:
    """Fill in a frame but for its payload, which is all zeros."""
    answer.can_id, answer.length, answer.flags, answer.bus = can_id, length, flags, bus
    data = answer.data
    for i in range(64):
        data[i] = 0


@inner
def _put(data: Any, at: int, size: int, value: int) -> None:
    """Write a number into bytes, the lowest first."""
    for i in range(size):
        data[at + i] = value >> 8 * i & 0xFF


@inner
def _put_float(data: Any, at: int, value: float) -> None:
    """Write a number as a float of four bytes."""
    _put(data, at, 4, int(np.float32(value).view(np.uint32)))


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
    _fill(answer, node.reply_id, 8, frame.flags, frame.bus)
    data = answer.data
    for i in range(8):
        data[i] = word >> (56 - 8 * i) & 0xFF


@inner
def _float(data: Any) -> float:
    """Return the float in the first four bytes."""
    return float(np.uint32(data[0] | data[1] << 8 | data[2] << 16 | data[3] << 24).view(np.float32))


@inner
def _odrive_decides(rotor: Any, frame: Any) -> bool:
    """Return whether an ODrive has to look at a setpoint of torque, or at a question for its encoder, itself."""
    if frame.flags & FDF or rotor.faulty != 0:
        return True
    return bool(frame.can_id & REMOTE == 0 and (frame.length < 4 or not math.isfinite(_float(frame.data))))


@inner
def _tell_encoder(node: Any, rotor: Any, bus: int, answer: Any) -> None:
    """Let an ODrive tell its position and velocity."""
    _fill(answer, node.node_id << 5 | 0x09, 8, 0, bus)
    _put_float(answer.data, 0, turns(node, encoded(rotor.theta)))
    _put_float(answer.data, 4, turns_per_s(node, rotor.velocity))


@inner
def _odrive(node: Any, rotor: Any, frame: Any, t_ns: int, answers: Any, count: int) -> int:
    """Let an ODrive take a setpoint, or answer a question for its encoder; return how many answers there are."""
    if frame.can_id & REMOTE:
        _tell_encoder(node, rotor, frame.bus, answers[count])
        return count + 1
    make_torque(node, rotor.law, _float(frame.data), t_ns)
    schedule_odrive(node)
    return count


@inner
def _cia402_decides(node: Any, rotor: Any, frame: Any) -> bool:
    """Return whether a CiA 402 drive has to look at SYNC, an RPDO or its master's heartbeat itself."""
    if frame.flags & FDF or rotor.faulty != 0 or node.warmed_ns < 0:
        return True
    if frame.can_id == node.sync_id:
        return bool(node.nmt != OPERATIONAL)
    if frame.can_id == node.master_id:
        return False
    goes_on = frame.data[0] & 0x8F == 0x0F and node.power_stage.reset_bit == 0
    return node.nmt != OPERATIONAL or frame.length < 4 or not goes_on or not follows(node, node.power_stage)


@inner
def _cia402(node: Any, rotor: Any, frame: Any, t_ns: int, answers: Any, count: int) -> int:
    """Let a CiA 402 drive take SYNC, an RPDO or its master's heartbeat; return how many answers there are."""
    data, values = frame.data, node.values
    if frame.can_id == node.sync_id:
        measure(node, node.power_stage, encoded(rotor.theta), rotor.velocity, rotor.torque)
        node.syncs += 1
        if node.syncs % node.tpdo_kind == 0:
            _fill(answers[count], node.tpdo_id, 8, 0, frame.bus)
            _put(answers[count].data, 0, 2, values[STATUS_WORD])
            _put(answers[count].data, 2, 4, values[POSITION])
            _put(answers[count].data, 6, 2, values[TORQUE])
            count += 1
    elif frame.can_id == node.master_id:
        node.fed_ns = t_ns
    else:
        values[CONTROL_WORD] = data[0] | data[1] << 8
        torque = int(data[2] | data[3] << 8)
        values[TARGET_TORQUE] = torque - (1 << 16) if torque >= 1 << 15 else torque
        follow(node, rotor.law)
    schedule_cia402(node, t_ns, False)
    return count


@inner
def _tell(words: Any, channels: int, can_id: int, frame: Any, answers: Any, count: int) -> int:
    """Answer SYNC with payloads, of which each is a word, its lowest byte first; return how many answers there are."""
    for g in range(len(words)):
        length = payload_size(channels - g * CHANNELS)
        _fill(answers[count], can_id + g, length, frame.flags, frame.bus)
        _put(answers[count].data, 0, length, words[g])
        count += 1
    return count


@inner
def _sense(  # noqa: PLR0913 - compiled functions take flat arrays
    node: Any, frame: Any, t_ns: int, cells: Any, q: Any, cell_order: Any, joint_order: Any, bias: Any,
    noise: Any, places: Any, answers: Any, count: int,
) -> int:  # fmt: skip
    """Sample load cells and joint encoders and answer SYNC; return how many answers there are.

    Args:
        node: the sensor node. frame: SYNC. cells: tensions [N]. q: joint angles [rad]. cell_order, joint_order: tendon
            and joint of each channel. bias: of each load cell [N]. noise, places: see ``Noise``.
        answers, count: room for answers, and how many are there.
    """
    channels, joints, counter = len(cell_order), len(joint_order), int(frame.data[0])
    read, codes, words = np.empty(channels), np.empty(channels, np.int64), np.empty(-(-channels // CHANNELS), np.int64)
    true = np.empty(channels)
    for i in range(channels):
        true[i] = cells[cell_order[i]]
    at, drift = places[0], drift_since(node, t_ns)
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
    places[0] = at
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


NODES = (Taker, MitRow, OdriveRow, Cia402Row)
"""Takers, and the rows of drives."""


@inner
def _drive_decides(who: Any, mit: Any, odrive: Any, cia402: Any, rotors: Any, frame: Any, t_ns: int) -> bool:
    """Return whether a drive has to look at a frame itself."""
    if who.kind == MIT:
        return _mit_decides(mit[who.number], rotors[mit[who.number].motor_number], frame, t_ns)
    if who.kind == ODRIVE:
        return _odrive_decides(rotors[odrive[who.number].motor_number], frame)
    return _cia402_decides(cia402[who.number], rotors[cia402[who.number].motor_number], frame)


@inner
def _drive(  # noqa: PLR0913 - compiled functions take flat arrays
    who: Any, mit: Any, odrive: Any, cia402: Any, rotors: Any, frame: Any, t_ns: int, answers: Any, count: int
) -> int:  # fmt: skip
    """Let a drive take a frame; return how many answers there are."""
    if who.kind == MIT:
        _mit(mit[who.number], rotors[mit[who.number].motor_number], frame, t_ns, answers[count])
        return count + 1
    if who.kind == ODRIVE:
        return _odrive(odrive[who.number], rotors[odrive[who.number].motor_number], frame, t_ns, answers, count)
    return _cia402(cia402[who.number], rotors[cia402[who.number].motor_number], frame, t_ns, answers, count)


@inner
def _wake_ns(who: Any, mit: Any, odrive: Any, cia402: Any) -> int:
    """Return when time must pass for a drive next [ns]."""
    if who.kind == MIT:
        return int(mit[who.number].wake_ns)
    return int(odrive[who.number].wake_ns if who.kind == ODRIVE else cia402[who.number].wake_ns)


@inner
def _next_wake(drives: Any, mit: Any, odrive: Any, cia402: Any) -> int:
    """Return when time must pass for any drive next [ns]."""
    wake_ns = NEVER_NS
    for i in range(len(drives)):
        wake_ns = min(wake_ns, _wake_ns(drives[i], mit, odrive, cia402))
    return wake_ns


@compiled(*NODES)
def next_wake(drives: Any, mit: Any, odrive: Any, cia402: Any) -> int:
    """Return when time must pass for any drive next [ns]."""
    return _next_wake(drives, mit, odrive, cia402)


@inner
def _answer(  # noqa: PLR0913 - compiled functions take flat arrays
    frames: Any, answers: Any, progress: Any, t_ns: int, last_ns: int, table: Any, most: int,
    takers: Any, mit: Any, odrive: Any, cia402: Any, drives: Any, sensor: Any, cell_order: Any, joint_order: Any,
    bias: Any, noise: Any, places: Any, ropes: Any, joints: Any, arms: Any, rotors: Any, q: Any, dq: Any, cells: Any,
) -> None:  # fmt: skip
    """Answer frames until one asks for a decision; after the last one, stamp all answers.

    Args:
        frames: of the host. answers: room for answers; ``most`` of them can come of one frame.
        progress: how far it is; see ``NEXT_FRAME``. t_ns: the present [ns]. last_ns: stamps go so far beyond it [ns].
        table, takers: who takes an identifier. mit, odrive, cia402: rows of drives. drives: all of them.
        sensor: the sensor node, if there is one.
        cell_order, joint_order, bias, noise, places: see ``_sense``.
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
            if who.kind == SENSORS:
                enough = places[1] >= places[0] + 2 * len(cell_order) + len(joint_order)
                decides = decides or frame.length != 1 or not enough
            else:
                decides = decides or _drive_decides(who, mit, odrive, cia402, rotors, frame, t_ns)
            one = who.next
        if decides:
            break
        while taker >= 0:
            who = takers[taker]
            if who.kind == SENSORS:
                tensions(ropes, joints, arms, rotors, q, dq, cells)
                count = _sense(
                    sensor[0], frame, t_ns, cells, q, cell_order, joint_order, bias, noise, places, answers, count
                )
            else:
                count = _drive(who, mit, odrive, cia402, rotors, frame, t_ns, answers, count)
            taker = who.next
        progress[NEXT_FRAME] = i + 1
    progress[ANSWERS] = count
    if progress[NEXT_FRAME] == len(frames):
        progress[IN_ORDER] = _follow_one_another(frames, answers, count, t_ns, last_ns, buses)
        progress[WAKE_NS] = _next_wake(drives, mit, odrive, cia402)


REAL, COUNT = np.dtype(np.float64), np.dtype(np.int64)
TAKERS, MITS, ODRIVES, CIA402S = np.dtype(Taker), np.dtype(MitRow), np.dtype(OdriveRow), np.dtype(Cia402Row)
SENSOR, ROPES, ROTORS = np.dtype(SensorRow), np.dtype(RopeRow), np.dtype(RotorRow)


@compiled(RECORD, RECORD, "counts", "count", "count", "count")
def answer(frames: Any, answers: Any, at: Any, t_ns: int, last_ns: int, most: int) -> None:
    """Answer frames; see ``_answer``.

    Args: at: address and length of each of its other arrays in their order, see ``Exchange``.
    """
    _answer(
        frames, answers, rows_at(at[0], at[1], COUNT), t_ns, last_ns, rows_at(at[2], at[3], COUNT), most,
        rows_at(at[4], at[5], TAKERS), rows_at(at[6], at[7], MITS), rows_at(at[8], at[9], ODRIVES),
        rows_at(at[10], at[11], CIA402S), rows_at(at[12], at[13], TAKERS), rows_at(at[14], at[15], SENSOR),
        rows_at(at[16], at[17], COUNT), rows_at(at[18], at[19], COUNT), rows_at(at[20], at[21], REAL),
        rows_at(at[22], at[23], REAL), rows_at(at[24], at[25], COUNT), rows_at(at[26], at[27], ROPES),
        rows_at(at[28], at[29], COUNT), rows_at(at[30], at[31], REAL), rows_at(at[32], at[33], ROTORS),
        rows_at(at[34], at[35], REAL), rows_at(at[36], at[37], REAL), rows_at(at[38], at[39], REAL),
    )  # fmt: skip


@inner
def _odrive_wakes(node: Any, rotor: Any, now_ns: int) -> bool:
    """Return whether an ODrive has more to do than to send messages: temperature, watchdog, old firmware."""
    warms = node.warmed_ns < 0 or now_ns - node.warmed_ns >= WARM_PERIOD_NS
    return warms or node.old != 0 or starves(node, now_ns) or rotor.faulty != 0


@inner
def _cia402_wakes(node: Any, now_ns: int) -> bool:
    """Return whether a CiA 402 drive has more to do than to send its heartbeat."""
    warms = node.warmed_ns < 0 or now_ns - node.warmed_ns >= WARM_NS
    return warms or starves_cia402(node, now_ns) or node.at_once != 0


@inner
def _cia402_speaks(node: Any, now_ns: int, said: Any, count: int) -> int:
    """Send the heartbeat of a CiA 402 drive if it is due; return how many frames there are."""
    if beats(node, now_ns):
        _fill(said[count], 0x700 + node.node_id, 1, 0, node.bus)
        _put(said[count].data, 0, 1, node.nmt)
        said[count].t_ns = now_ns
        node.beat_ns = now_ns
        count += 1
    schedule_cia402(node, now_ns, False)
    return count


@inner
def _odrive_speaks(node: Any, rotor: Any, now_ns: int, said: Any, count: int) -> int:
    """Send the messages of an ODrive that are due; return how many frames there are."""
    if now_ns >= node.heartbeat_due_ns:
        _fill(said[count], node.node_id << 5 | 0x01, 8, 0, node.bus)
        _put(said[count].data, 0, 4, node.active | node.reason)
        _put(said[count].data, 4, 1, node.state)
        _put(said[count].data, 5, 1, node.result)
        said[count].t_ns = now_ns
        node.heartbeat_due_ns = next_due(node.heartbeat_due_ns, now_ns, node.heartbeat_period_ns)
        count += 1
    if now_ns >= node.encoder_due_ns:
        _tell_encoder(node, rotor, node.bus, said[count])
        said[count].t_ns = now_ns
        node.encoder_due_ns = next_due(node.encoder_due_ns, now_ns, node.encoder_period_ns)
        count += 1
    schedule_odrive(node)
    return count


@compiled(*NODES, RotorRow, "count", RECORD, "counts")
def speak(drives: Any, mit: Any, odrive: Any, cia402: Any, rotors: Any, now_ns: int, said: Any, progress: Any) -> bool:
    """Let drives send what is due; return False, with nothing done, if one of them has to decide something.

    Args:
        drives: in the order in which they speak. mit, odrive, cia402, rotors: rows.
        now_ns: the present [ns]. said, progress: room for two frames of each drive, and how many are there.
    """
    for i in range(len(drives)):
        who = drives[i]
        if now_ns < _wake_ns(who, mit, odrive, cia402):
            continue
        if who.kind == ODRIVE:
            decides = _odrive_wakes(odrive[who.number], rotors[odrive[who.number].motor_number], now_ns)
        else:
            decides = who.kind == MIT or _cia402_wakes(cia402[who.number], now_ns)
        if decides:
            return False
    for i in range(len(drives)):
        who = drives[i]
        if now_ns < _wake_ns(who, mit, odrive, cia402):
            continue
        if who.kind == ODRIVE:
            rotor = rotors[odrive[who.number].motor_number]
            progress[SAID] = _odrive_speaks(odrive[who.number], rotor, now_ns, said, progress[SAID])
        else:
            progress[SAID] = _cia402_speaks(cia402[who.number], now_ns, said, progress[SAID])
    progress[WAKE_NS] = _next_wake(drives, mit, odrive, cia402)
    return True


@compiled(RECORD, RECORD, RECORD)
def merge(first: Any, second: Any, out: Any) -> None:
    """Sort two arrays of frames by their times into ``out``; frames of one time keep their order."""
    count = len(first)
    for i in range(len(out)):
        frame = first[i] if i < count else second[i - count]
        place = i
        while place > 0 and out[place - 1].t_ns > frame.t_ns:
            out[place] = out[place - 1]
            place -= 1
        out[place] = frame
