"""Faults of sensors, motors, ropes and digits: what is changed while one lasts, and put back when it ends."""

import math
import random
from collections import deque
from collections.abc import Callable
from typing import Any, cast

from firmware_sim.bus.frame import Frame
from firmware_sim.faults.of_wire import Active
from firmware_sim.faults.text import CELL, ENCODER, SENSORS, Fault
from firmware_sim.nodes.cia402.node import Cia402Node
from firmware_sim.nodes.mit.node import MitNode, State
from firmware_sim.nodes.odrive.node import OdriveNode
from firmware_sim.nodes.sensors import CHANNELS, JOINT_OFFSET

Undo = Callable[[], None]
RAIL_N = 1e4
"""More than any load cell can tell [N]."""
BLOCK = 1e3
"""Damping of a joint that cannot move [N m s/rad]."""
ERRORS = {
    "error": (State.WINDING_HOT, 1 << 13, 0x4310),
    "watchdog": (State.COMMUNICATION_LOST, 1 << 24, 0x8130),
    "voltage": (0x9, 1 << 9, 0x3220),
}
"""Codes by kind for MIT, ODrive, CiA 402."""


def begin(world: Any, one: Active) -> Undo:
    """Let a fault begin; what ends it."""
    kind = one.fault.kind
    if kind in ("stuck", "offset", "drift", "noise", "saturate", "scale", "old"):
        return _misread(world, one)
    return _BEGIN[kind](world, one) if kind in _BEGIN else lambda: None


def _misread(world: Any, one: Active) -> Undo:
    """Put something between a quantity and its sensor."""
    fault, change = one.fault, _reading(one, lambda: int(world.t_ns))
    if fault.component == ENCODER:
        motor = world.plant.motors[fault.instance]
        motor.misread = change
        return lambda: setattr(motor, "misread", None)
    node, spec = world.sensor_node, world.hand.sensors
    names, table = (spec.tendons, node.misread) if fault.component == CELL else (spec.joints, node.misread_joints)
    index = names.index(fault.instance)
    table[index] = change
    return lambda: table.pop(index, None) and None


def _reading(one: Active, now: Callable[[], int]) -> Callable[[float], float]:
    """The law of a wrong reading."""
    fault, begun, held = one.fault, now(), list[float]()
    chance = random.Random(f"reading {fault.seed} {fault.text}")

    def wrong(value: float) -> float:
        if not held:
            held.append(value)
        if fault.kind == "old":
            return _older(one, held, value, now())
        if fault.kind == "stuck":
            other = held[0]
        elif fault.kind == "offset":
            other = value + fault.size
        elif fault.kind == "drift":
            other = value + fault.size * (now() - begun) * 1e-9
        elif fault.kind == "scale":
            other = held[0] + fault.size * (value - held[0])
        elif fault.kind == "noise":
            other = value + chance.gauss(0.0, fault.size)
        else:
            other = math.copysign(RAIL_N, fault.size)
        if other != value:
            one.feel(now())
        return other

    return wrong


def _older(one: Active, past: list[float], value: float, now_ns: int) -> float:
    """Return the reading of ``size`` samples ago; until there are so many, the reading itself."""
    past.append(value)
    if len(past) <= int(one.fault.size) + 1:  # the first is there twice
        return value
    one.feel(now_ns)
    del past[0]
    return past[0]


def _mute(world: Any, one: Active) -> Undo:
    node, spec = world.sensor_node, world.hand.sensors
    of_cells = one.fault.component == CELL
    first, names = (spec.base_id, spec.tendons) if of_cells else (spec.base_id + JOINT_OFFSET, spec.joints)
    can_id = first + names.index(one.fault.instance) // CHANNELS
    node.mute[can_id] = lambda: one.feel(int(world.t_ns))
    return lambda: node.mute.pop(can_id, None) and None


def _snap(world: Any, one: Active) -> Undo:
    rope = _rope(world, one.fault)
    one.feel(world.t_ns)
    mend: Undo = rope.tear()
    return mend


def _slack(world: Any, one: Active) -> Undo:
    rope = _rope(world, one.fault)
    one.feel(world.t_ns)
    rope.longer = one.fault.size * 1e-3
    return lambda: setattr(rope, "longer", 0.0)


def _friction(world: Any, one: Active) -> Undo:
    tendon = next(spec for spec in world.hand.tendons if spec.name == one.fault.instance)
    motor = world.plant.motors[tendon.motor]
    before = motor.coulomb
    motor.coulomb += one.fault.size * _rope(world, one.fault).radius
    one.feel(world.t_ns)
    return lambda: setattr(motor, "coulomb", before)


def _rope(world: Any, fault: Fault) -> Any:
    names = [spec.name for spec in world.hand.tendons]
    return world.plant.ropes[names.index(fault.instance)][0]


def _block(world: Any, one: Active) -> Undo:
    digit = next(digit for digit in world.hand.digits if digit.name == one.fault.instance)
    one.feel(world.t_ns)
    let_go: Undo = world.plant.engine.brake([world.hand.joints.index(joint) for joint in digit.joints], BLOCK)
    return let_go


def _trip(world: Any, one: Active) -> Undo:
    node, codes = world.node_of(one.fault.instance), ERRORS[one.fault.kind]
    size = int(one.fault.size)
    one.feel(world.t_ns)
    match node:
        case MitNode():
            node.trip(cast(State, size or codes[0]))
        case OdriveNode():
            node.disarm(size or codes[1])
        case Cia402Node():
            node.trip(size or codes[2])
            node.wake_ns = 0
    return lambda: None


def _reset(world: Any, one: Active) -> Undo:
    node = world.node_of(one.fault.instance)
    one.feel(world.t_ns)
    match node:
        case MitNode():
            node.power_cycle()
        case OdriveNode():
            node.receive(Frame(world.motor_spec(one.fault.instance).node_id << 5 | 0x16, b""), world.t_ns)
        case Cia402Node():
            node.receive(Frame(0x000, bytes((0x81, world.motor_spec(one.fault.instance).node_id))), world.t_ns)
            node.wake_ns = 0
    return lambda: None


def _forget(world: Any, one: Active) -> Undo:
    """Lose all settings that were not saved, with the power stage on: a brown-out of the drive's processor only."""
    one.feel(world.t_ns)
    match node := world.node_of(one.fault.instance):
        case MitNode():
            node.forget(one.fault.size)
        case OdriveNode() | Cia402Node():
            node.forget()
    return lambda: None


def _ripple(world: Any, one: Active) -> Undo:
    """Cogging: what the motor makes besides the torque of its current."""
    motor, fault = world.plant.motors[one.fault.instance], one.fault

    def law(command: float) -> float:
        one.feel(int(world.t_ns))
        return command + fault.size * math.sin(2.0 * math.pi * fault.hz * world.plant.t_ns * 1e-9)

    motor.disobeys = law
    return lambda: setattr(motor, "disobeys", None)


def _hot(world: Any, one: Active) -> Undo:
    thermal = world.node_of(one.fault.instance).thermal
    one.feel(world.t_ns)
    thermal.held = one.fault.size
    thermal.winding = one.fault.size
    return lambda: setattr(thermal, "held", None)


class _Crossed:
    """A drive's motor whose sensors belong to one rotor and whose power stage to another.

    Attributes: servo: what the drive regulates. The rest is read from, and written to, the rotor with the sensors.
    """

    def __init__(self, sensed: Any, driven: Any) -> None:
        self.__dict__.update(sensed=sensed, servo=driven.servo)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__dict__["sensed"], name)

    def __setattr__(self, name: str, value: object) -> None:
        setattr(self.__dict__["sensed"], name, value)


def _exchange(world: Any, one: Active) -> Undo:
    """Two drives read each other's sensors (swap), or drive each other's power stage (cross)."""
    names = one.fault.instance, one.fault.other
    nodes, motors = [world.node_of(name) for name in names], [world.plant.motors[name] for name in names]
    swapped = one.fault.kind == "swap"
    for i, node in enumerate(nodes):
        own, other = motors[i], motors[1 - i]
        node.motor = _Crossed(other, own) if swapped else _Crossed(own, other)
    one.feel(world.t_ns)

    def undo() -> None:
        for node, motor in zip(nodes, motors, strict=True):
            node.motor = motor

    return undo


def _late(world: Any, one: Active) -> Undo:
    """The power stage gets each command so much later."""
    motor, delay_ns = world.plant.motors[one.fault.instance], round(one.fault.size * 1e6)
    waiting: deque[tuple[int, float]] = deque()

    def law(command: float) -> float:
        now_ns = int(world.plant.t_ns)
        waiting.append((now_ns, command))
        while len(waiting) > 1 and waiting[1][0] <= now_ns - delay_ns:
            waiting.popleft()
        other = waiting[0][1]
        if abs(other - command) > 1e-9:
            one.feel(int(world.t_ns))
        return other

    motor.disobeys = law
    return lambda: setattr(motor, "disobeys", None)


def _servo(world: Any, one: Active) -> Undo:
    """The drive's power stage does something else than it is told; a sensor node has none."""
    if one.fault.instance == SENSORS:
        return lambda: None
    motor, fault = world.plant.motors[one.fault.instance], one.fault
    kept = motor.servo.torque
    most = world.motor_spec(fault.instance).torque_max

    def law(command: float) -> float:
        other: float = {"disobey": fault.size * command, "runaway": fault.size * most, "off": 0.0}.get(fault.kind, kept)
        if abs(other - command) > 1e-9:
            one.feel(int(world.t_ns))
        return other

    motor.disobeys = law
    return lambda: setattr(motor, "disobeys", None)


_BEGIN: dict[str, Callable[[Any, Active], Undo]] = {
    "snap": _snap, "slack": _slack, "friction": _friction, "block": _block, "error": _trip, "watchdog": _trip,
    "voltage": _trip, "reset": _reset, "hot": _hot, "disobey": _servo, "runaway": _servo, "hold_on": _servo,
    "off": _servo, "mute": _mute, "forget": _forget, "ripple": _ripple,
    "swap": _exchange, "cross": _exchange, "late": _late,
}  # fmt: skip
