"""Compiled kernel that answers the cyclic frames of a tick. Frames and answers are records.

For each CAN identifier, a table contains the index of the first node that receives frames with this
identifier. Each entry in the array of receivers contains the index of the next receiver of the same
identifier. The kernel stops at a frame that Python must process: a special command, a register
request, a frame of wrong length, or any frame while a watchdog is due. After a stop of the kernel,
the node processes the frame in Python, and the kernel continues with the next frame. The bit
layouts are in ``mit.codec``, ``odrive.node``, ``cia402.kernels`` and ``sensor_node``.
"""

import ctypes
import math
from typing import Any

import numpy as np

from firmware_sim.bus.frame import FDF, REMOTE_FLAG
from firmware_sim.bus.frame_records import FRAME_DTYPE
from firmware_sim.compiled import array_at, compiled, kernel_helper
from firmware_sim.nodes import sensor_node
from firmware_sim.nodes.cia402.kernels import (
    CONTROL_WORD,
    OPERATIONAL_STATE,
    POSITION,
    STATUS_WORD,
    TARGET_TORQUE,
    TORQUE,
    Cia402Struct,
    apply_torque,
    heartbeat_due,
    is_in_torque_mode,
    update_measured_objects,
)
from firmware_sim.nodes.cia402.kernels import THERMAL_PERIOD_NS as CIA402_THERMAL_PERIOD_NS
from firmware_sim.nodes.cia402.kernels import schedule_wake as schedule_cia402
from firmware_sim.nodes.cia402.kernels import watchdog_expired as cia402_watchdog_expired
from firmware_sim.nodes.mit.codec import (
    ENABLED_STATE,
    MitStruct,
    apply_command,
    feedback_word,
    schedule_wake,
)
from firmware_sim.nodes.mit.registers import MODE_MIT
from firmware_sim.nodes.odrive.kernels import (
    THERMAL_PERIOD_NS,
    OdriveStruct,
    next_period_ns,
    position_in_turns,
    set_torque,
    velocity_in_turns_per_s,
    watchdog_expired,
)
from firmware_sim.nodes.odrive.kernels import schedule_wake as schedule_odrive
from firmware_sim.nodes.protocol_spec import MIT_KIND, ODRIVE_KIND, SENSOR_NODE_KIND
from firmware_sim.nodes.sensor_node import (
    CHANNELS_PER_FRAME,
    JOINT_OFFSET,
    SensorStruct,
    bias_drift_deviation,
    encode,
    has_joint_reading,
    payload_size,
    read_cells,
)
from firmware_sim.plant.drivetrain import encoder_angle, tensions
from firmware_sim.plant.plant_structs import RotorStruct, TendonStruct

FRAME_DURATION_NS = 135_000
"""Maximum duration of a classical frame of 8 bytes at 1 Mbit/s [ns].

The times of neighbouring answers in a tick differ by the duration of a frame. Source: VCAN.
"""
FD_FRAME_DURATION_NS = 57_000
"""Maximum duration of an FD frame of 8 bytes at 1/5 Mbit/s [ns]. Source: VCAN."""
NEXT_FRAME, ANSWERS, IN_ORDER, SENT, WAKE_NS = range(5)
"""Indices into the array ``progress``.

The first three numbers of the array are the index of the next frame, the number of answers, and a
flag that is 1 if the times of the answers rise. The other two numbers of the array are the number
of unsolicited frames, and the earliest wake time of all drives [ns].
"""
NEVER_NS = 1 << 62
"""Wake time that means that no drive needs a wake-up [ns]."""
_STANDARD_ID_COUNT = 0x800
"""Number of standard identifiers.

For each bus, the table of receivers has two blocks with one entry per standard identifier: for data
frames and for remote frames.
"""
_TENSION_LOW, _TENSION_STEP, _TENSION_OFFSET = sensor_node.TENSION_CODE
_JOINT_LOW, _JOINT_STEP, _JOINT_OFFSET = sensor_node.JOINT_CODE
_SPECIAL_COMMAND_BITS = 0xFFFFFFFFFFFFFF
"""Seven bytes of FF as an integer. Special commands of MIT motors start with seven bytes of FF."""


class ReceiverStruct(ctypes.Structure):
    """Entry for a node that receives frames with a certain identifier.

    Attributes:
        kind: kind of the node.
        number: row of the node in the array for this kind.
        next: index of the next receiver of the same frame, or -1.
    """

    _fields_ = [(name, ctypes.c_int64) for name in ("kind", "number", "next")]


def empty_table(buses: int) -> Any:
    """Create an empty table of receivers. The table has 2 * 2048 entries for each bus."""
    return np.full(buses * 2 * _STANDARD_ID_COUNT, -1, np.int64)


@kernel_helper
def table_index(bus: int, can_id: int) -> int:
    """Return the index of an identifier in the table of receivers.

    If an identifier has more than 11 bits, return -1.
    """
    if can_id & ~REMOTE_FLAG >= _STANDARD_ID_COUNT:
        return -1
    # Each bus has two blocks of the table: one for data frames and one for remote frames.
    return (2 * bus + (1 if can_id & REMOTE_FLAG else 0)) * _STANDARD_ID_COUNT + (
        can_id & (_STANDARD_ID_COUNT - 1)
    )


@kernel_helper
def _payload_as_integer(payload: Any) -> int:
    """Return eight bytes as an integer.

    The first byte of the payload is the most significant byte. The integer can be negative, but
    only its 64 bits have a meaning.
    """
    word = 0
    for i in range(8):
        word = word << 8 | int(payload[i])
    return word


@kernel_helper
def _fill_header(answer_record: Any, can_id: int, length: int, flags: int, bus: int) -> None:
    """Fill all fields of a frame except the time. The payload is set to zero."""
    answer_record.can_id = can_id
    answer_record.length = length
    answer_record.flags = flags
    answer_record.bus = bus
    data = answer_record.data
    for i in range(64):
        data[i] = 0


@kernel_helper
def _write_integer(payload: Any, byte_offset: int, size: int, value: int) -> None:
    """Write an integer into a payload, low byte first."""
    for i in range(size):
        payload[byte_offset + i] = value >> 8 * i & 0xFF


@kernel_helper
def _write_float(payload: Any, byte_offset: int, value: float) -> None:
    """Write a float of four bytes into a payload, low byte first."""
    _write_integer(payload, byte_offset, 4, int(np.float32(value).view(np.uint32)))


@kernel_helper
def _mit_needs_python(node: Any, rotor: Any, frame: Any, t_ns: int) -> bool:
    """Return True if a frame to an MIT drive must be processed in Python."""
    if frame.length != 8 or t_ns >= node.wake_ns or rotor.faulty != 0 or node.mode != MODE_MIT:
        return True
    # The code compares only the first seven bytes of the payload. The eighth byte is the code of
    # the special command.
    return _payload_as_integer(frame.data) >> 8 & _SPECIAL_COMMAND_BITS == _SPECIAL_COMMAND_BITS


@kernel_helper
def _answer_mit(node: Any, rotor: Any, frame: Any, t_ns: int, answer: Any) -> None:
    """Apply a command to an MIT drive, and write the feedback of the drive."""
    node.watchdog_fed_ns = t_ns
    if node.state == ENABLED_STATE:
        apply_command(node, rotor.own_servo, _payload_as_integer(frame.data))
    temperatures = node.temperatures
    word = feedback_word(
        node, rotor, encoder_angle(rotor.theta), temperatures.mosfet, temperatures.winding
    )
    schedule_wake(node)
    _fill_header(answer, node.reply_id, 8, frame.flags, frame.bus)
    data = answer.data
    for i in range(8):
        # In the payload, the most significant byte of each field comes first.
        data[i] = word >> (56 - 8 * i) & 0xFF


@kernel_helper
def _read_float(payload: Any) -> float:
    """Return the float in the first four bytes of a payload."""
    return float(
        np.uint32(payload[0] | payload[1] << 8 | payload[2] << 16 | payload[3] << 24).view(
            np.float32
        )
    )


@kernel_helper
def _odrive_needs_python(node: Any, rotor: Any, frame: Any) -> bool:
    """Return True if a frame to an ODrive must be processed in Python.

    The argument ``frame`` is a torque setpoint or an encoder request.
    """
    if frame.flags & FDF or rotor.faulty != 0 or node.motion_due_ns > 0:
        return True
    return bool(
        frame.can_id & REMOTE_FLAG == 0
        and (frame.length < 4 or not math.isfinite(_read_float(frame.data)))
    )


@kernel_helper
def _write_encoder_frame(node: Any, rotor: Any, bus: int, answer: Any) -> None:
    """Write the frame with the encoder estimates of an ODrive."""
    _fill_header(answer, node.node_id << 5 | 0x09, 8, 0, bus)
    _write_float(answer.data, 0, position_in_turns(node, encoder_angle(rotor.theta)))
    _write_float(answer.data, 4, velocity_in_turns_per_s(node, rotor.velocity))


@kernel_helper
def _answer_odrive(
    node: Any, rotor: Any, frame: Any, t_ns: int, answer_frames: Any, count: int
) -> int:
    """Apply a torque setpoint to an ODrive, or answer an encoder request.

    Returns:
        The number of answers in ``answer_frames``.
    """
    if frame.can_id & REMOTE_FLAG:
        _write_encoder_frame(node, rotor, frame.bus, answer_frames[count])
        return count + 1
    set_torque(node, rotor.own_servo, _read_float(frame.data), t_ns)
    schedule_odrive(node)
    return count


@kernel_helper
def _cia402_needs_python(node: Any, rotor: Any, frame: Any) -> bool:
    """Return True if a frame to a CiA 402 drive must be processed in Python.

    The argument ``frame`` is a SYNC, an RPDO or the master's heartbeat.
    """
    if frame.flags & FDF or rotor.faulty != 0 or node.thermal_ns < 0:
        return True
    if frame.can_id == node.sync_id:
        return bool(node.nmt != OPERATIONAL_STATE)
    if frame.can_id == node.master_id:
        return False
    # A control word with bits 0 to 3 set and the bit *fault reset* clear keeps the operation
    # enabled.
    remains_enabled = frame.data[0] & 0x8F == 0x0F and node.power_stage.reset_bit == 0
    return (
        node.nmt != OPERATIONAL_STATE
        or frame.length < 4
        or not remains_enabled
        or not is_in_torque_mode(node, node.power_stage)
    )


@kernel_helper
def _answer_cia402(
    node: Any, rotor: Any, frame: Any, t_ns: int, answer_frames: Any, count: int
) -> int:
    """Process a frame in a CiA 402 drive: a SYNC, an RPDO or the master's heartbeat.

    Returns:
        Number of answers in ``answer_frames``.
    """
    data = frame.data
    values = node.values
    if frame.can_id == node.sync_id:
        update_measured_objects(
            node, node.power_stage, encoder_angle(rotor.theta), rotor.velocity, rotor.torque
        )
        node.syncs += 1
        if node.syncs % node.tpdo_kind == 0:
            _fill_header(answer_frames[count], node.tpdo_id, 8, 0, frame.bus)
            _write_integer(answer_frames[count].data, 0, 2, values[STATUS_WORD])
            _write_integer(answer_frames[count].data, 2, 4, values[POSITION])
            _write_integer(answer_frames[count].data, 6, 2, values[TORQUE])
            count += 1
    elif frame.can_id == node.master_id:
        node.watchdog_fed_ns = t_ns
    else:
        values[CONTROL_WORD] = data[0] | data[1] << 8
        torque = int(data[2] | data[3] << 8)
        # The statement below converts 16 bits to a signed number (two's complement).
        values[TARGET_TORQUE] = torque - (1 << 16) if torque >= 1 << 15 else torque
        apply_torque(node, rotor.own_servo)
    schedule_cia402(node, t_ns, False)
    return count


@kernel_helper
def _write_sensor_frames(
    words: Any, channels: int, can_id: int, frame: Any, answer_frames: Any, count: int
) -> int:
    """Write the payloads of the sensor node into the frames that answer a SYNC frame.

    Args:
        words: payloads as integers. The kernel writes the payloads with the low byte first.
        channels: number of channels in all payloads together.
        can_id: identifier of the first frame.
        frame: the SYNC frame.
        answer_frames: array for the answers, filled by the kernel.
        count: number of answers so far.

    Returns:
        Number of answers in ``answer_frames``.
    """
    for g in range(len(words)):
        length = payload_size(channels - g * CHANNELS_PER_FRAME)
        _fill_header(answer_frames[count], can_id + g, length, frame.flags, frame.bus)
        _write_integer(answer_frames[count].data, 0, length, words[g])
        count += 1
    return count


@kernel_helper
def _answer_sync(  # noqa: PLR0913 - compiled functions take flat arrays
    node: Any, frame: Any, t_ns: int, cells: Any, q: Any, cell_order: Any, joint_order: Any, bias: Any,
    noise: Any, noise_bounds: Any, answer_frames: Any, count: int,
) -> int:  # fmt: skip
    """Read load cells and joint encoders, and write the frames that answer a SYNC frame.

    Args:
        node: row of the sensor node.
        frame: the SYNC frame.
        t_ns: present time [ns].
        cells: true tension of each tendon [N].
        q: joint angles [rad].
        cell_order: for each channel of the load cells, the index of its tendon.
        joint_order: for each channel of the joint encoders, the index of its joint.
        bias: bias of each load cell [N].
        noise: random numbers with a normal distribution, see ``NormalNoise``.
        noise_bounds: indices into ``noise``, see ``NormalNoise``.
        answer_frames: array for the answers, filled by the kernel.
        count: number of answers so far.

    Returns:
        Number of answers in ``answer_frames``.
    """
    channels = len(cell_order)
    joints = len(joint_order)
    counter = int(frame.data[0])
    read = np.empty(channels)
    codes = np.empty(channels, np.int64)
    words = np.empty(-(-channels // CHANNELS_PER_FRAME), np.int64)
    true_tensions = np.empty(channels)
    for i in range(channels):
        true_tensions[i] = cells[cell_order[i]]
    at = noise_bounds[0]
    drift = bias_drift_deviation(node, t_ns)
    read_cells(true_tensions, bias, noise[at : at + 2 * channels], drift, node.tension_noise, read)
    at += 2 * channels
    encode(read, _TENSION_LOW, _TENSION_STEP, _TENSION_OFFSET, counter, codes, words)
    count = _write_sensor_frames(words, channels, node.base_id, frame, answer_frames, count)
    if has_joint_reading(node, joints, counter):
        angles = np.empty(joints)
        for i in range(joints):
            angle = q[joint_order[i]] * node.joint_scale[i]
            angles[i] = angle + noise[at + i] * node.joint_noise[i]
        at += joints
        codes = np.empty(joints, np.int64)
        words = np.empty(-(-joints // CHANNELS_PER_FRAME), np.int64)
        encode(angles, _JOINT_LOW, _JOINT_STEP, _JOINT_OFFSET, counter, codes, words)
        count = _write_sensor_frames(
            words, joints, node.base_id + JOINT_OFFSET, frame, answer_frames, count
        )
    noise_bounds[0] = at
    return count


@kernel_helper
def _assign_bus_times(
    frames: Any, answer_frames: Any, count: int, t_ns: int, max_delay_ns: int, buses: int
) -> bool:
    """Set the times at which the answers end on their buses.

    Each bus transmits one frame after the other: first all frames of the host, then the answers.

    Args:
        frames: frames of the host.
        answer_frames: answers whose times are set.
        count: number of answers.
        t_ns: start of the tick [ns].
        max_delay_ns: largest time from the start of the tick to an answer [ns].
        buses: number of buses.

    Returns:
        True if the times of the answers are in rising order.
    """
    bus_busy_until_ns = np.zeros(buses, np.int64)
    for i in range(len(frames)):
        bus_busy_until_ns[frames[i].bus] += (
            FD_FRAME_DURATION_NS if frames[i].flags & FDF else FRAME_DURATION_NS
        )
    is_in_order = True
    previous_time_ns = t_ns
    for i in range(count):
        answer = answer_frames[i]
        bus_busy_until_ns[answer.bus] += (
            FD_FRAME_DURATION_NS if answer.flags & FDF else FRAME_DURATION_NS
        )
        send_time_ns = t_ns + min(bus_busy_until_ns[answer.bus], max_delay_ns)
        is_in_order = is_in_order and send_time_ns >= previous_time_ns
        answer.t_ns = previous_time_ns = send_time_ns
    return is_in_order


DRIVE_ARGUMENTS = (ReceiverStruct, MitStruct, OdriveStruct, Cia402Struct)
"""Types of the kernel arguments with receivers and with the rows of the drives."""


@kernel_helper
def _drive_needs_python(
    receiver_row: Any, mit: Any, odrive: Any, cia402: Any, rotors: Any, frame: Any, t_ns: int
) -> bool:
    """Return True if a frame to a drive must be processed in Python."""
    if receiver_row.kind == MIT_KIND:
        return _mit_needs_python(
            mit[receiver_row.number], rotors[mit[receiver_row.number].motor_number], frame, t_ns
        )
    if receiver_row.kind == ODRIVE_KIND:
        return _odrive_needs_python(
            odrive[receiver_row.number], rotors[odrive[receiver_row.number].motor_number], frame
        )
    return _cia402_needs_python(
        cia402[receiver_row.number], rotors[cia402[receiver_row.number].motor_number], frame
    )


@kernel_helper
def _answer_drive(  # noqa: PLR0913 - compiled functions take flat arrays
    receiver_row: Any, mit: Any, odrive: Any, cia402: Any, rotors: Any, frame: Any, t_ns: int, answer_frames: Any,
    count: int
) -> int:  # fmt: skip
    """Process a frame in a drive, and write the answers of the drive.

    Returns:
        Number of answers in ``answer_frames``.
    """
    if receiver_row.kind == MIT_KIND:
        _answer_mit(
            mit[receiver_row.number],
            rotors[mit[receiver_row.number].motor_number],
            frame,
            t_ns,
            answer_frames[count],
        )
        return count + 1
    if receiver_row.kind == ODRIVE_KIND:
        return _answer_odrive(
            odrive[receiver_row.number],
            rotors[odrive[receiver_row.number].motor_number],
            frame,
            t_ns,
            answer_frames,
            count,
        )
    return _answer_cia402(
        cia402[receiver_row.number],
        rotors[cia402[receiver_row.number].motor_number],
        frame,
        t_ns,
        answer_frames,
        count,
    )


@kernel_helper
def _wake_ns(receiver_row: Any, mit: Any, odrive: Any, cia402: Any) -> int:
    """Return the time at which a drive must wake next [ns]."""
    if receiver_row.kind == MIT_KIND:
        return int(mit[receiver_row.number].wake_ns)
    return int(
        odrive[receiver_row.number].wake_ns
        if receiver_row.kind == ODRIVE_KIND
        else cia402[receiver_row.number].wake_ns
    )


@kernel_helper
def _next_wake(drives: Any, mit: Any, odrive: Any, cia402: Any) -> int:
    """Return the earliest wake time of all drives [ns]."""
    wake_ns = NEVER_NS
    for i in range(len(drives)):
        wake_ns = min(wake_ns, _wake_ns(drives[i], mit, odrive, cia402))
    return wake_ns


@compiled(*DRIVE_ARGUMENTS)
def next_wake(drives: Any, mit: Any, odrive: Any, cia402: Any) -> int:
    """Return the earliest wake time of all drives [ns]."""
    return _next_wake(drives, mit, odrive, cia402)


@kernel_helper
def _answer(  # noqa: PLR0913 - compiled functions take flat arrays
    frames: Any, answer_frames: Any, progress: Any, t_ns: int, max_delay_ns: int, table: Any, max_answers: int,
    receivers: Any, mit: Any, odrive: Any, cia402: Any, drives: Any, sensor: Any, cell_order: Any, joint_order: Any,
    bias: Any, noise: Any, noise_bounds: Any, tendons: Any, joints: Any, arms: Any, rotors: Any, q: Any,
    dq: Any, cells: Any,
) -> None:  # fmt: skip
    """Answer the frames of the host until Python must process a frame.

    After the last frame, set the times of all answers.

    Args:
        frames: frames of the host.
        answer_frames: array for the answers, filled by the kernel.
        progress: numbers that describe the progress, see ``NEXT_FRAME``.
        t_ns: present time [ns].
        max_delay_ns: largest delay of an answer after the start of the tick [ns].
        table: index of the first receiver of each identifier, or -1.
        max_answers: largest possible number of answers to one frame.
        receivers: array of all receivers. The indices in ``table`` and in the receivers are indices
            into ``receivers``.
        mit: rows of MIT drives.
        odrive: rows of ODrives.
        cia402: rows of CiA 402 drives.
        drives: all drives as receivers.
        sensor: (1,) row of the sensor node, or (0,) if the hand has no sensor node.
        cell_order: see ``_answer_sync``.
        joint_order: see ``_answer_sync``.
        bias: see ``_answer_sync``.
        noise: see ``_answer_sync``.
        noise_bounds: see ``_answer_sync``.
        tendons: see ``drivetrain.tensions``.
        joints: see ``drivetrain.tensions``.
        arms: see ``drivetrain.tensions``.
        rotors: see ``drivetrain.tensions``.
        q: joint angles [rad].
        dq: joint velocities [rad/s].
        cells: array for the tension of each tendon, filled by the kernel [N].
    """
    count = progress[ANSWERS]
    buses = len(table) // (2 * _STANDARD_ID_COUNT)
    for i in range(progress[NEXT_FRAME], len(frames)):
        frame = frames[i]
        receiver = -1
        at = table_index(int(frame.bus), int(frame.can_id))
        if frame.bus < buses and at >= 0:
            receiver = table[at]
        if receiver < 0 or count + max_answers > len(answer_frames):
            break
        needs_python = False
        index = receiver
        while index >= 0:
            receiver_row = receivers[index]
            if receiver_row.kind == SENSOR_NODE_KIND:
                # The kernel cannot draw random numbers. So the caller must draw all random numbers
                # for one SYNC frame before it calls the kernel.
                has_enough_noise = noise_bounds[1] >= noise_bounds[0] + 2 * len(cell_order) + len(
                    joint_order
                )
                needs_python = needs_python or frame.length != 1 or not has_enough_noise
            else:
                needs_python = needs_python or _drive_needs_python(
                    receiver_row, mit, odrive, cia402, rotors, frame, t_ns
                )
            index = receiver_row.next
        if needs_python:
            break
        while receiver >= 0:
            receiver_row = receivers[receiver]
            if receiver_row.kind == SENSOR_NODE_KIND:
                tensions(tendons, joints, arms, rotors, q, dq, cells)
                count = _answer_sync(
                    sensor[0],
                    frame,
                    t_ns,
                    cells,
                    q,
                    cell_order,
                    joint_order,
                    bias,
                    noise,
                    noise_bounds,
                    answer_frames,
                    count,
                )
            else:
                count = _answer_drive(
                    receiver_row, mit, odrive, cia402, rotors, frame, t_ns, answer_frames, count
                )
            receiver = receiver_row.next
        progress[NEXT_FRAME] = i + 1
    progress[ANSWERS] = count
    if progress[NEXT_FRAME] == len(frames):
        progress[IN_ORDER] = _assign_bus_times(
            frames, answer_frames, count, t_ns, max_delay_ns, buses
        )
        progress[WAKE_NS] = _next_wake(drives, mit, odrive, cia402)


REAL_DTYPE = np.dtype(np.float64)
COUNT_DTYPE = np.dtype(np.int64)
RECEIVER_DTYPE = np.dtype(ReceiverStruct)
MIT_DTYPE = np.dtype(MitStruct)
ODRIVE_DTYPE = np.dtype(OdriveStruct)
CIA402_DTYPE = np.dtype(Cia402Struct)
SENSOR_DTYPE = np.dtype(SensorStruct)
TENDON_DTYPE = np.dtype(TendonStruct)
ROTOR_DTYPE = np.dtype(RotorStruct)


@compiled(FRAME_DTYPE, FRAME_DTYPE, "counts", "count", "count", "count")
def answer(
    frames: Any, answer_frames: Any, at: Any, t_ns: int, max_delay_ns: int, max_answers: int
) -> None:
    """Answer the frames of the host. The caller gives most of the arrays by their memory addresses.

    The docstring of the kernel ``_answer`` describes how frames are answered.

    Args:
        frames: frames of the host.
        answer_frames: array for the answers, filled by the kernel.
        at: address and length of each remaining array argument of ``_answer``, in the order of
            ``compiled_nodes.CompiledNodes``.
        t_ns: present time [ns].
        max_delay_ns: largest delay of an answer after the start of the tick [ns].
        max_answers: largest possible number of answers to one frame.
    """
    _answer(
        frames, answer_frames, array_at(at[0], at[1], COUNT_DTYPE), t_ns, max_delay_ns,
        array_at(at[2], at[3], COUNT_DTYPE), max_answers,
        array_at(at[4], at[5], RECEIVER_DTYPE), array_at(at[6], at[7], MIT_DTYPE), array_at(at[8], at[9], ODRIVE_DTYPE),
        array_at(at[10], at[11], CIA402_DTYPE), array_at(at[12], at[13], RECEIVER_DTYPE),
        array_at(at[14], at[15], SENSOR_DTYPE),
        array_at(at[16], at[17], COUNT_DTYPE), array_at(at[18], at[19], COUNT_DTYPE),
        array_at(at[20], at[21], REAL_DTYPE),
        array_at(at[22], at[23], REAL_DTYPE), array_at(at[24], at[25], COUNT_DTYPE),
        array_at(at[26], at[27], TENDON_DTYPE), array_at(at[28], at[29], COUNT_DTYPE),
        array_at(at[30], at[31], REAL_DTYPE), array_at(at[32], at[33], ROTOR_DTYPE),
        array_at(at[34], at[35], REAL_DTYPE), array_at(at[36], at[37], REAL_DTYPE),
        array_at(at[38], at[39], REAL_DTYPE),
    )  # fmt: skip


@kernel_helper
def _must_wake_odrive(node: Any, rotor: Any, now_ns: int) -> bool:
    """Return True if an ODrive must do work other than sending its two cyclic messages.

    Python must wake the drive for this work: the update of temperatures, the watchdog, the end of a
    calibration, the modes of ``odrive.motion_modes``, and the messages of firmware 0.5.
    """
    is_busy = node.busy_until_ns > 0 or node.motion_due_ns > 0
    thermal_due = node.thermal_ns < 0 or now_ns - node.thermal_ns >= THERMAL_PERIOD_NS
    watchdog_due = watchdog_expired(node, now_ns)
    return thermal_due or is_busy or watchdog_due or node.legacy != 0 or rotor.faulty != 0


@kernel_helper
def _must_wake_cia402(node: Any, now_ns: int) -> bool:
    """Return True if a CiA 402 drive must do work other than sending its heartbeat.

    For such work, Python must wake the drive.
    """
    thermal_due = node.thermal_ns < 0 or now_ns - node.thermal_ns >= CIA402_THERMAL_PERIOD_NS
    if node.motion_due_ns > 0:
        return True
    return thermal_due or cia402_watchdog_expired(node, now_ns) or node.frame_pending != 0


@kernel_helper
def _send_cia402(node: Any, now_ns: int, sent_frames: Any, count: int) -> int:
    """Write the heartbeat of a CiA 402 drive if it is due.

    Returns:
        Number of frames in ``sent_frames``.
    """
    if heartbeat_due(node, now_ns):
        _fill_header(sent_frames[count], 0x700 + node.node_id, 1, 0, node.bus)
        _write_integer(sent_frames[count].data, 0, 1, node.nmt)
        sent_frames[count].t_ns = now_ns
        node.heartbeat_ns = now_ns
        count += 1
    schedule_cia402(node, now_ns, False)
    return count


@kernel_helper
def _send_odrive(node: Any, rotor: Any, now_ns: int, sent_frames: Any, count: int) -> int:
    """Write the cyclic messages of an ODrive that are due.

    Returns:
        Number of frames in ``sent_frames``.
    """
    if now_ns >= node.heartbeat_due_ns:
        _fill_header(sent_frames[count], node.node_id << 5 | 0x01, 8, 0, node.bus)
        _write_integer(sent_frames[count].data, 0, 4, node.active_errors | node.disarm_reason)
        _write_integer(sent_frames[count].data, 4, 1, node.state)
        _write_integer(sent_frames[count].data, 5, 1, node.result)
        sent_frames[count].t_ns = now_ns
        node.heartbeat_due_ns = next_period_ns(
            node.heartbeat_due_ns, now_ns, node.heartbeat_period_ns
        )
        count += 1
    if now_ns >= node.encoder_due_ns:
        _write_encoder_frame(node, rotor, node.bus, sent_frames[count])
        sent_frames[count].t_ns = now_ns
        node.encoder_due_ns = next_period_ns(node.encoder_due_ns, now_ns, node.encoder_period_ns)
        count += 1
    schedule_odrive(node)
    return count


@compiled(*DRIVE_ARGUMENTS, RotorStruct, "count", FRAME_DTYPE, "counts")
def send_due_frames(
    drives: Any,
    mit: Any,
    odrive: Any,
    cia402: Any,
    rotors: Any,
    now_ns: int,
    sent_frames: Any,
    progress: Any,
) -> bool:
    """Write all unsolicited frames that are due.

    Args:
        drives: drives in the order of sending.
        mit: rows of MIT drives.
        odrive: rows of ODrives.
        cia402: rows of CiA 402 drives.
        rotors: rows of the rotors.
        now_ns: present time [ns].
        sent_frames: array with room for two frames of each drive.
        progress: array with the number of frames in ``sent_frames``, see ``SENT``.

    Returns:
        False if Python must wake a drive. If a drive must be woken, no frame is written.
    """
    for i in range(len(drives)):
        receiver_row = drives[i]
        if now_ns < _wake_ns(receiver_row, mit, odrive, cia402):
            continue
        if receiver_row.kind == ODRIVE_KIND:
            needs_python = _must_wake_odrive(
                odrive[receiver_row.number],
                rotors[odrive[receiver_row.number].motor_number],
                now_ns,
            )
        else:
            needs_python = receiver_row.kind == MIT_KIND or _must_wake_cia402(
                cia402[receiver_row.number], now_ns
            )
        if needs_python:
            return False
    for i in range(len(drives)):
        receiver_row = drives[i]
        if now_ns < _wake_ns(receiver_row, mit, odrive, cia402):
            continue
        if receiver_row.kind == ODRIVE_KIND:
            rotor = rotors[odrive[receiver_row.number].motor_number]
            progress[SENT] = _send_odrive(
                odrive[receiver_row.number], rotor, now_ns, sent_frames, progress[SENT]
            )
        else:
            progress[SENT] = _send_cia402(
                cia402[receiver_row.number], now_ns, sent_frames, progress[SENT]
            )
    progress[WAKE_NS] = _next_wake(drives, mit, odrive, cia402)
    return True


@compiled(FRAME_DTYPE, FRAME_DTYPE, FRAME_DTYPE)
def merge_sorted_frames(host_frames: Any, other_frames: Any, merged_frames: Any) -> None:
    """Write the frames of two arrays into ``merged_frames``, sorted by time.

    The function keeps the order of frames with equal times.
    """
    count = len(host_frames)
    for i in range(len(merged_frames)):
        frame = host_frames[i] if i < count else other_frames[i - count]
        # The loop is an insertion sort. The sort is fast because both arrays are almost sorted, and
        # keeps the order of frames with equal times.
        insertion_index = i
        while insertion_index > 0 and merged_frames[insertion_index - 1].t_ns > frame.t_ns:
            merged_frames[insertion_index] = merged_frames[insertion_index - 1]
            insertion_index -= 1
        merged_frames[insertion_index] = frame
