"""Faults of sensors, motors, tendons and digits in the simulated plant.

Each start function changes the simulation, and returns a function that undoes the change.
"""

import math
import random
from collections import deque
from collections.abc import Callable
from typing import Any, cast

from firmware_sim.bus.frame import Frame
from firmware_sim.faults.fault_text import (
    FAULT_TARGET_CELL,
    FAULT_TARGET_ENCODER,
    SENSOR_NODE_NAME,
    Fault,
)
from firmware_sim.faults.wire_faults import ActiveFault
from firmware_sim.nodes.cia402.node import Cia402Node
from firmware_sim.nodes.mit.node import FeedbackState, MitNode
from firmware_sim.nodes.moteus import node as moteus
from firmware_sim.nodes.moteus.node import MoteusNode
from firmware_sim.nodes.odrive.node import OdriveNode
from firmware_sim.nodes.robstride import node as robstride
from firmware_sim.nodes.robstride.node import RobstrideNode
from firmware_sim.nodes.sensor_node import CHANNELS_PER_FRAME, JOINT_OFFSET

UndoFunction = Callable[[], None]
OUT_OF_RANGE_TENSION_N = 1e4
"""Tension beyond the range of every load cell [N]."""
BLOCKED_JOINT_DAMPING = 1e3
"""Damping of a blocked joint [N m s/rad]."""
ERROR_CODES = {
    "error": (
        FeedbackState.WINDING_OVERHEATED,
        1 << 13,
        0x4310,
        moteus.OVER_TEMPERATURE,
        robstride.OVER_TEMPERATURE_FAULT,
    ),
    "watchdog": (FeedbackState.COMMUNICATION_LOST, 1 << 24, 0x8130, moteus.TIMEOUT, 0),
    "voltage": (0x9, 1 << 9, 0x3220, moteus.UNDER_VOLTAGE, robstride.UNDER_VOLTAGE),
}
"""Error codes that each kind of fault sets in a drive: for MIT, ODrive, CiA 402, moteus and RobStride."""


def start_plant_fault(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Start the effect of a fault.

    Args:
        world: simulated world in which the fault acts.
        active_fault: fault whose effect starts.

    Returns:
        Function that ends the effect of the fault.
    """
    kind = active_fault.fault.kind
    if kind in ("stuck", "offset", "drift", "noise", "saturate", "scale", "old"):
        return _start_reading_fault(world, active_fault)
    return _START_FUNCTIONS[kind](world, active_fault) if kind in _START_FUNCTIONS else lambda: None


def _start_reading_fault(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Change the readings of the faulty sensor from now on."""
    fault = active_fault.fault
    change = _make_reading_fault(active_fault, lambda: int(world.t_ns))
    if fault.component == FAULT_TARGET_ENCODER:
        motor = world.plant.motors[fault.instance]
        motor.encoder_fault = change
        return lambda: setattr(motor, "encoder_fault", None)
    node = world.sensor_node
    spec = world.hand.sensors
    names, table = (
        (spec.tendons, node.cell_faults)
        if fault.component == FAULT_TARGET_CELL
        else (spec.joints, node.joint_faults)
    )
    index = names.index(fault.instance)
    table[index] = change
    return lambda: table.pop(index, None) and None


def _make_reading_fault(
    active_fault: ActiveFault, read_clock_ns: Callable[[], int]
) -> Callable[[float], float]:
    """Return a function that changes each reading of a sensor, as the kind of the fault requires.

    Args:
        active_fault: active fault, which counts its effects.
        read_clock_ns: function that returns the present time [ns].

    Returns:
        Function that takes the true reading and returns the changed reading.
    """
    fault = active_fault.fault
    start_ns = read_clock_ns()
    readings = list[float]()
    rng = random.Random(f"reading {fault.seed} {fault.text}")

    def apply_reading_fault(value: float) -> float:
        if not readings:
            readings.append(value)
        if fault.kind == "old":
            return _delayed_reading(active_fault, readings, value, read_clock_ns())
        if fault.kind == "stuck":
            faulty_reading = readings[0]
        elif fault.kind == "offset":
            faulty_reading = value + fault.size
        elif fault.kind == "drift":
            faulty_reading = value + fault.size * (read_clock_ns() - start_ns) * 1e-9
        elif fault.kind == "scale":
            faulty_reading = readings[0] + fault.size * (value - readings[0])
        elif fault.kind == "noise":
            faulty_reading = value + rng.gauss(0.0, fault.size)
        else:
            faulty_reading = math.copysign(OUT_OF_RANGE_TENSION_N, fault.size)
        if faulty_reading != value:
            active_fault.count_effect(read_clock_ns())
        return faulty_reading

    return apply_reading_fault


def _delayed_reading(
    active_fault: ActiveFault, past_readings: list[float], value: float, now_ns: int
) -> float:
    """Return a reading that is ``fault.size`` samples old.

    While the sensor has fewer earlier samples than ``fault.size``, return the present reading.
    """
    past_readings.append(value)
    # The list contains the first reading twice, because ``_make_reading_fault`` has already stored this
    # reading.
    if len(past_readings) <= int(active_fault.fault.size) + 1:
        return value
    active_fault.count_effect(now_ns)
    del past_readings[0]
    return past_readings[0]


def _start_muted_sensor(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Suppress the frame in which the sensor node sends the reading of the faulty sensor."""
    node = world.sensor_node
    spec = world.hand.sensors
    if active_fault.fault.component == FAULT_TARGET_CELL:
        can_id = node.frame_id_of_cell(spec.tendons.index(active_fault.fault.instance))
    else:
        can_id = (
            spec.base_id
            + JOINT_OFFSET
            + spec.joints.index(active_fault.fault.instance) // CHANNELS_PER_FRAME
        )
    node.suppressed[can_id] = lambda: active_fault.count_effect(int(world.t_ns))
    return lambda: node.suppressed.pop(can_id, None) and None


def _start_snapped_tendon(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Break a tendon."""
    tendon = _tendon_of_fault(world, active_fault.fault)
    active_fault.count_effect(world.t_ns)
    mend_tendon: UndoFunction = tendon.break_tendon()
    return mend_tendon


def _start_slack_tendon(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Lengthen a tendon by the size of the fault [mm]."""
    tendon = _tendon_of_fault(world, active_fault.fault)
    active_fault.count_effect(world.t_ns)
    tendon.extra_length = active_fault.fault.size * 1e-3
    return lambda: setattr(tendon, "extra_length", 0.0)


def _start_extra_friction(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Add Coulomb friction to a motor.

    The size of the fault is the friction force, converted to the tendon [N].
    """
    tendon = next(
        spec for spec in world.hand.all_tendons if spec.name == active_fault.fault.instance
    )
    motor = world.plant.motors[tendon.motor]
    original_coulomb_friction = motor.coulomb
    motor.coulomb += active_fault.fault.size * _tendon_of_fault(world, active_fault.fault).radius
    active_fault.count_effect(world.t_ns)
    return lambda: setattr(motor, "coulomb", original_coulomb_friction)


def _tendon_of_fault(world: Any, fault: Fault) -> Any:
    """Return the simulated tendon on which the fault acts."""
    names = [spec.name for spec in world.hand.all_tendons]
    return world.plant.tendons[names.index(fault.instance)][0]


def _start_blocked_digit(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Block all joints of a digit."""
    digit = next(digit for digit in world.hand.digits if digit.name == active_fault.fault.instance)
    active_fault.count_effect(world.t_ns)
    release: UndoFunction = world.plant.engine.brake(
        [world.hand.joints.index(joint) for joint in digit.joints], BLOCKED_JOINT_DAMPING
    )
    return release


def _start_tripped_drive(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Make a drive report an error.

    The size of the fault is the error code. Without a size, the kind of the fault determines the
    error code.
    """
    node = world.node_of(active_fault.fault.instance)
    codes = ERROR_CODES[active_fault.fault.kind]
    size = int(active_fault.fault.size)
    active_fault.count_effect(world.t_ns)
    match node:
        case MitNode():
            node.trip(cast(FeedbackState, size or codes[0]))
        case OdriveNode():
            node.disarm(size or codes[1])
        case Cia402Node():
            node.trip(size or codes[2])
            node.wake_ns = 0
        case MoteusNode():
            node.trip(size or codes[3])
        case RobstrideNode():
            node.trip(size or codes[4])
    return lambda: None


def _start_drive_reset(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Reset a drive, either by a power cycle or by the reset command of the drive's protocol."""
    node = world.node_of(active_fault.fault.instance)
    active_fault.count_effect(world.t_ns)
    match node:
        case MitNode() | MoteusNode() | RobstrideNode():
            node.power_cycle()
        case OdriveNode():
            node.receive(
                Frame(world.motor_spec(active_fault.fault.instance).node_id << 5 | 0x16, b""),
                world.t_ns,
            )
        case Cia402Node():
            node.receive(
                Frame(0x000, bytes((0x81, world.motor_spec(active_fault.fault.instance).node_id))),
                world.t_ns,
            )
            node.wake_ns = 0
    return lambda: None


def _start_forgotten_settings(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Make a drive lose all unsaved settings, while its power stage stays on.

    The fault simulates a voltage dip that resets only the processor of the drive.
    """
    active_fault.count_effect(world.t_ns)
    match node := world.node_of(active_fault.fault.instance):
        case MitNode():
            node.lose_settings(active_fault.fault.size)
        case OdriveNode() | Cia402Node() | MoteusNode() | RobstrideNode():
            node.lose_settings()
    return lambda: None


def _start_torque_ripple(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Add a sinusoidal torque ripple to a motor."""
    motor = world.plant.motors[active_fault.fault.instance]
    fault = active_fault.fault

    def add_ripple(torque_command: float) -> float:
        active_fault.count_effect(int(world.t_ns))
        return torque_command + fault.size * math.sin(
            2.0 * math.pi * fault.hz * world.plant.t_ns * 1e-9
        )

    motor.power_stage_fault = add_ripple
    return lambda: setattr(motor, "power_stage_fault", None)


def _start_motor_overheating(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Keep the winding of a motor at a constant temperature.

    The size of the fault is the temperature of the winding [degC].
    """
    thermal_model = world.node_of(active_fault.fault.instance).thermal
    active_fault.count_effect(world.t_ns)
    thermal_model.forced = active_fault.fault.size
    thermal_model.winding = active_fault.fault.size
    return lambda: setattr(thermal_model, "forced", None)


class _CrossConnectedMotor:
    """A motor whose drive is connected to two rotors.

    The sensors of the drive measure one rotor, and the power stage of the drive turns the other
    rotor.

    Attributes:
        servo: setpoints of the rotor driven by the power stage. All other attributes of the motor
            belong to the rotor measured by the sensors.
    """

    def __init__(self, sensed_motor: Any, driven_motor: Any) -> None:
        self.__dict__.update(sensed=sensed_motor, servo=driven_motor.servo)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["sensed"], name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self.__dict__["sensed"], name, value)


def _start_exchanged_motors(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Exchange the sensors of two drives (``swap``), or the power stages of two drives (``cross``)."""
    names = active_fault.fault.instance, active_fault.fault.other
    nodes = [world.node_of(name) for name in names]
    motors = [world.plant.motors[name] for name in names]
    is_swap = active_fault.fault.kind == "swap"
    for i, node in enumerate(nodes):
        motor_of_node = motors[i]
        other_motor = motors[1 - i]
        node.motor = (
            _CrossConnectedMotor(other_motor, motor_of_node)
            if is_swap
            else _CrossConnectedMotor(motor_of_node, other_motor)
        )
    active_fault.count_effect(world.t_ns)

    def undo() -> None:
        for node, motor in zip(nodes, motors, strict=True):
            node.motor = motor

    return undo


def _start_late_commands(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Delay each torque command of a drive by the size of the fault [ms]."""
    motor = world.plant.motors[active_fault.fault.instance]
    delay_ns = round(active_fault.fault.size * 1e6)
    queued_commands: deque[tuple[int, float]] = deque()

    def delay_torque_command(torque_command: float) -> float:
        now_ns = int(world.plant.t_ns)
        queued_commands.append((now_ns, torque_command))
        while len(queued_commands) > 1 and queued_commands[1][0] <= now_ns - delay_ns:
            queued_commands.popleft()
        delayed_torque_command = queued_commands[0][1]
        if abs(delayed_torque_command - torque_command) > 1e-9:
            active_fault.count_effect(int(world.t_ns))
        return delayed_torque_command

    motor.power_stage_fault = delay_torque_command
    return lambda: setattr(motor, "power_stage_fault", None)


def _start_servo_fault(world: Any, active_fault: ActiveFault) -> UndoFunction:
    """Replace the torque that the power stage of a drive applies.

    The fault cannot act on the sensor node of the hand, because the sensor node has no power stage.
    """
    if active_fault.fault.instance == SENSOR_NODE_NAME:
        return lambda: None
    motor = world.plant.motors[active_fault.fault.instance]
    fault = active_fault.fault
    last_torque = motor.servo.torque
    max_torque_N_m = world.motor_spec(fault.instance).torque_max

    def replace_torque_command(torque_command: float) -> float:
        changed_torque_command: float = {
            "disobey": fault.size * torque_command,
            "runaway": fault.size * max_torque_N_m,
            "off": 0.0,
        }.get(fault.kind, last_torque)
        if abs(changed_torque_command - torque_command) > 1e-9:
            active_fault.count_effect(int(world.t_ns))
        return changed_torque_command

    motor.power_stage_fault = replace_torque_command
    return lambda: setattr(motor, "power_stage_fault", None)


_START_FUNCTIONS: dict[str, Callable[[Any, ActiveFault], UndoFunction]] = {
    "snap": _start_snapped_tendon,
    "slack": _start_slack_tendon,
    "friction": _start_extra_friction,
    "block": _start_blocked_digit,
    "error": _start_tripped_drive,
    "watchdog": _start_tripped_drive,
    "voltage": _start_tripped_drive,
    "reset": _start_drive_reset,
    "forget": _start_forgotten_settings,
    "hot": _start_motor_overheating,
    "mute": _start_muted_sensor,
    "ripple": _start_torque_ripple,
    "late": _start_late_commands,
    "disobey": _start_servo_fault,
    "runaway": _start_servo_fault,
    "hold_on": _start_servo_fault,
    "off": _start_servo_fault,
    "swap": _start_exchanged_motors,
    "cross": _start_exchanged_motors,
}
"""Function that starts a fault, by the kind of the fault."""
