"""Faults as data and as a line of text, for example ``drop node=3 p=0.05 at=3s for=2s``."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from firmware_sim.description.hand_description import Hand, SimulatorError

FAULT_TARGET_NODE = "node"
"""Type of a fault's target: a drive or the sensor node."""
FAULT_TARGET_BUS = "bus"
"""Type of a fault's target: all nodes of a bus."""
FAULT_TARGET_ENCODER = "encoder"
"""Type of a fault's target: the encoder of a motor."""
FAULT_TARGET_JOINT = "joint"
"""Type of a fault's target: a joint encoder."""
FAULT_TARGET_CELL = "cell"
"""Type of a fault's target: a load cell."""
FAULT_TARGET_TENDON = "tendon"
"""Type of a fault's target: a tendon."""
FAULT_TARGET_DIGIT = "digit"
"""Type of a fault's target: a digit."""
SENSOR_NODE_NAME = "sensors"
"""Name of the sensor node in the text of a fault."""
FOREVER_NS = 1 << 62
"""Duration of a fault without end [ns]."""
_TIME_UNITS_NS = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}


class FaultKind(NamedTuple):
    """A kind of fault.

    Attributes:
        components: types of component that a fault of this kind can have as target.
        size: default size of a fault of this kind.
        text: effect of a fault of this kind, in words.
    """

    components: tuple[str, ...]
    size: float
    text: str


FAULT_KINDS = {
    "drop": FaultKind((FAULT_TARGET_NODE, FAULT_TARGET_BUS), 0, "frames from a node are lost"),
    "deaf": FaultKind((FAULT_TARGET_NODE, FAULT_TARGET_BUS), 0, "frames to a node are lost"),
    "delay": FaultKind((FAULT_TARGET_NODE, FAULT_TARGET_BUS), 4, "frames from a node are late by size [ms]"),
    "duplicate": FaultKind((FAULT_TARGET_NODE, FAULT_TARGET_BUS), 0, "frames from a node are duplicated"),
    "twin": FaultKind((FAULT_TARGET_NODE,), 0, "a second node with the same identifier answers with other values"),
    "reorder": FaultKind((FAULT_TARGET_NODE, FAULT_TARGET_BUS), 0, "a frame from a node comes after the next frame"),
    "corrupt": FaultKind((FAULT_TARGET_NODE, FAULT_TARGET_BUS), 1, "size bits of the payload are flipped"),
    "shorten": FaultKind((FAULT_TARGET_NODE, FAULT_TARGET_BUS), 1, "the payload is shortened by size bytes"),
    "extend": FaultKind((FAULT_TARGET_NODE, FAULT_TARGET_BUS), 0, "the identifier is marked as extended (29 bits)"),
    "slow": FaultKind((FAULT_TARGET_NODE,), 2, "a node answers only every size-th frame"),
    "off": FaultKind((FAULT_TARGET_NODE,), 0, "a node loses power: no torque, no answers"),
    "reset": FaultKind((FAULT_TARGET_NODE,), 0, "a node restarts, once"),
    "error": FaultKind((FAULT_TARGET_NODE,), 0, "a node enters fault with code size, once (0: over-temperature)"),
    "watchdog": FaultKind((FAULT_TARGET_NODE,), 0, "a node's watchdog fires, once"),
    "voltage": FaultKind((FAULT_TARGET_NODE,), 0, "a node reports under-voltage, once"),
    "hot": FaultKind((FAULT_TARGET_NODE,), 90, "a node's winding is at size [degC]"),
    "disobey": FaultKind((FAULT_TARGET_NODE,), 0, "a node makes size times the commanded torque"),
    "runaway": FaultKind((FAULT_TARGET_NODE,), 1, "a node makes size times its maximum torque, whatever the command"),
    "hold_on": FaultKind((FAULT_TARGET_NODE,), 0, "a node reports that it is disabled but keeps its torque"),
    "forget": FaultKind((FAULT_TARGET_NODE,), 0,
        "a node loses its settings once and stays enabled (size > 0: TMAX is size [N m])"),
    "ripple": FaultKind((FAULT_TARGET_NODE,), 0.1, "a motor's torque has a ripple of amplitude size [N m] at hz"),
    "late": FaultKind((FAULT_TARGET_NODE,), 50, "a node executes each command late by size [ms]"),
    "swap": FaultKind((FAULT_TARGET_NODE,), 0, "two drives report each other's encoder and current"),
    "cross": FaultKind((FAULT_TARGET_NODE,), 0, "two drives make each other's torque and report their own commands"),
    "flood": FaultKind((FAULT_TARGET_BUS,), 100, "size frames of identifier 0x000 every millisecond"),
    "unknown": FaultKind((FAULT_TARGET_BUS,), 1, "size frames of an unknown identifier every millisecond"),
    "foreign": FaultKind((FAULT_TARGET_NODE,), 0, "a second host sends commands to a node every 10 ms"),
    "mute": FaultKind((FAULT_TARGET_JOINT, FAULT_TARGET_CELL), 0, "the frame with a reading is not sent"),
    "stuck": FaultKind((FAULT_TARGET_ENCODER, FAULT_TARGET_JOINT, FAULT_TARGET_CELL), 0, "a reading is stuck"),
    "offset": FaultKind((FAULT_TARGET_ENCODER, FAULT_TARGET_JOINT, FAULT_TARGET_CELL), 1,
        "a reading jumps by size [rad, N]"),
    "drift": FaultKind((FAULT_TARGET_ENCODER, FAULT_TARGET_JOINT, FAULT_TARGET_CELL), 1,
        "a reading drifts by size per second [rad/s, N/s]"),
    "scale": FaultKind((FAULT_TARGET_ENCODER,), 1.5, "a reading changes by size times the true change"),
    "old": FaultKind((FAULT_TARGET_CELL,), 16, "a reading is stale by size samples with a fresh counter"),
    "replay": FaultKind((FAULT_TARGET_NODE,), 16, "a node sends the frames of size answers ago"),
    "noise": FaultKind((FAULT_TARGET_ENCODER, FAULT_TARGET_JOINT, FAULT_TARGET_CELL), 1,
        "a reading has noise of standard deviation size [rad, N]"),
    "saturate": FaultKind((FAULT_TARGET_CELL,), 1, "a load cell is saturated at its upper (size > 0) or lower limit"),
    "snap": FaultKind((FAULT_TARGET_TENDON,), 0, "a tendon breaks"),
    "slack": FaultKind((FAULT_TARGET_TENDON,), 2, "a tendon is longer by size [mm]"),
    "friction": FaultKind((FAULT_TARGET_TENDON,), 3,
        "a motor has additional Coulomb friction of size [N] at its tendon"),
    "block": FaultKind((FAULT_TARGET_DIGIT,), 0, "a digit is blocked"),
}  # fmt: skip
"""All kinds of fault by name."""
FAULT_SIZE_RANGES = {
    "delay": (0.0, 1e5), "corrupt": (1.0, 512.0), "shorten": (1.0, 64.0), "slow": (2.0, 1e6),
    "error": (0.0, 2.0**32 - 1), "hot": (-40.0, 1000.0), "disobey": (-10.0, 10.0), "runaway": (-4.0, 4.0),
    "forget": (0.0, 50.0), "ripple": (0.0, 50.0), "late": (0.0, 1e3),
    "scale": (-10.0, 10.0), "old": (1.0, 1000.0), "replay": (1.0, 1000.0),
    "flood": (1.0, 1000.0), "unknown": (1.0, 1000.0), "noise": (0.0, 1e6), "slack": (0.0, 1000.0),
    "friction": (0.0, 1e4),
}  # fmt: skip
"""Allowed sizes of faults by kind. Kinds of fault without an entry have the range ``DEFAULT_FAULT_SIZE_RANGE``."""
TWO_MOTOR_FAULTS = ("swap", "cross")
"""Kinds of fault that act on two motors.

The text of a fault on two motors names the second motor in ``with=NAME``.
"""
DEFAULT_FAULT_SIZE_RANGE = (-1e6, 1e6)
"""Allowed sizes of a fault whose kind has no entry in ``FAULT_SIZE_RANGES``."""
DRIVE_ONLY_FAULTS = ("reset", "error", "watchdog", "voltage", "hot", "disobey", "runaway", "hold_on", "foreign",
             "forget", "ripple", "late", "swap", "cross")  # fmt: skip
"""Kinds of fault that only drives can have.

The sensor node cannot have these faults, because it has no power stage and receives only SYNC from
the host.
"""


@dataclass(frozen=True, slots=True)
class Fault:
    """The data of a fault, as parsed from the text.

    Attributes:
        kind: key of ``FAULT_KINDS``.
        component: type of the target component.
        instance: name of the target component.
        start_ns: start of the fault [ns].
        duration_ns: duration of the fault [ns].
        size: size of the fault. The kind of the fault determines the meaning and the unit of the
            size.
        p: probability with which the fault affects each frame.
        seed: seed of the random numbers of the fault.
        hz: frequency of the torque in a fault of kind ``ripple`` [Hz].
        text: text from which the fault was parsed.
        other: second motor if the fault acts on two motors, otherwise an empty text.
    """

    kind: str
    component: str
    instance: str
    start_ns: int
    duration_ns: int
    size: float
    p: float
    seed: int
    hz: float
    text: str
    other: str = ""


def parse_fault(fault_line: str, hand: Hand, now_ns: int = 0) -> Fault:
    """Parse the text of a fault.

    Args:
        fault_line: ``KIND COMPONENT=INSTANCE [with=NAME] [size=X] [p=X] [hz=X] [at=TIME] [for=TIME]
            [seed=N]``.
        hand: hand in which the fault will act.
        now_ns: present time, from which the time in ``at=TIME`` is counted [ns].

    Raises:
        SimulatorError: the text cannot be parsed, or the hand cannot have the fault.
    """
    kind, *pairs = fault_line.split() or [""]
    if kind not in FAULT_KINDS:
        raise SimulatorError(
            f"fault {fault_line!r}: no such kind {kind!r}; expected one of {', '.join(FAULT_KINDS)}"
        )
    option_values = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not value or key in option_values:
            raise SimulatorError(f"fault {fault_line!r}: {pair!r} is not a new KEY=VALUE")
        option_values[key] = value
    component = _target_component(fault_line, kind, option_values)
    instance = _target_instance(
        fault_line,
        instances_of_component(component, hand, kind),
        component,
        option_values.pop(component),
        hand,
    )
    fault = Fault(
        kind=kind,
        component=component,
        instance=instance,
        size=_number_from_text(
            fault_line,
            "size",
            option_values.pop("size", str(FAULT_KINDS[kind].size)),
            *FAULT_SIZE_RANGES.get(kind, DEFAULT_FAULT_SIZE_RANGE),
        ),
        p=_number_from_text(fault_line, "p", option_values.pop("p", "1"), 0.0, 1.0),
        start_ns=now_ns + _time_from_text(fault_line, "at", option_values.pop("at", "0s")),
        duration_ns=_time_from_text(fault_line, "for", option_values.pop("for"))
        if "for" in option_values
        else FOREVER_NS,
        seed=int(_number_from_text(fault_line, "seed", option_values.pop("seed", "0"), 0, 1e9)),
        hz=_number_from_text(fault_line, "hz", option_values.pop("hz", "25"), 0.0, 1e4),
        text=fault_line,
        other=_second_motor(fault_line, kind, instance, option_values, hand),
    )
    if option_values:
        raise SimulatorError(
            f"fault {fault_line!r}: unknown {next(iter(option_values))!r}; expected size, p, hz, at, for or seed"
        )
    return fault


def _target_component(fault_line: str, fault_kind: str, fault_options: dict[str, str]) -> str:
    """Return the type of the fault's target component."""
    components = [
        key
        for key in fault_options
        if key
        in (
            FAULT_TARGET_NODE,
            FAULT_TARGET_BUS,
            FAULT_TARGET_ENCODER,
            FAULT_TARGET_JOINT,
            FAULT_TARGET_CELL,
            FAULT_TARGET_TENDON,
            FAULT_TARGET_DIGIT,
        )
    ]
    allowed_components = FAULT_KINDS[fault_kind].components
    if len(components) != 1 or components[0] not in allowed_components:
        raise SimulatorError(
            f"fault {fault_line!r}: {fault_kind} needs {' or '.join(f'{name}=NAME' for name in allowed_components)}"
        )
    return components[0]


def _second_motor(
    fault_line: str, fault_kind: str, first_motor: str, fault_options: dict[str, str], hand: Hand
) -> str:
    """Return the second motor of a fault that acts on two motors.

    For other faults, return an empty string.
    """
    if fault_kind not in TWO_MOTOR_FAULTS:
        return ""
    if "with" not in fault_options:
        raise SimulatorError(f"fault {fault_line!r}: {fault_kind} needs with=NAME, the other motor")
    other_node = _target_instance(
        fault_line,
        instances_of_component(FAULT_TARGET_NODE, hand, fault_kind),
        FAULT_TARGET_NODE,
        fault_options.pop("with"),
        hand,
    )
    if other_node == first_motor:
        raise SimulatorError(
            f"fault {fault_line!r}: {fault_kind} needs two motors, not {first_motor!r} twice"
        )
    return other_node


def instances_of_component(component: str, hand: Hand, fault_kind: str = "") -> list[str]:
    """List the names of all components of one type in a hand.

    Args:
        component: type of component, one of the constants from ``FAULT_TARGET_NODE`` to ``FAULT_TARGET_DIGIT``.
        hand: hand whose components are listed.
        fault_kind: kind of fault that the listed components can have. If no kind is given, all
            components are listed.
    """
    motors = [motor.name for motor in hand.motors]
    return {
        FAULT_TARGET_NODE: [*motors, SENSOR_NODE_NAME]
        if hand.sensors and fault_kind not in DRIVE_ONLY_FAULTS
        else motors,
        FAULT_TARGET_BUS: hand.buses,
        FAULT_TARGET_ENCODER: motors,
        FAULT_TARGET_JOINT: hand.sensors.joints if hand.sensors else [],
        FAULT_TARGET_CELL: hand.sensors.tendons if hand.sensors else [],
        FAULT_TARGET_TENDON: [tendon.name for tendon in hand.all_tendons],
        FAULT_TARGET_DIGIT: [digit.name for digit in hand.digits],
    }[component]


def _target_instance(
    fault_line: str, component_names: list[str], component: str, name: str, hand: Hand
) -> str:
    """Return the name of a component. A motor can be given by its name or by its node number."""
    if component in (FAULT_TARGET_NODE, FAULT_TARGET_ENCODER):
        numbers = {str(motor.node_id): motor.name for motor in hand.motors}
        name = numbers.get(name, name)
    if name not in component_names:
        raise SimulatorError(
            f"fault {fault_line!r}: no {component} {name!r}; expected one of {', '.join(component_names) or 'none'}"
        )
    return name


def _number_from_text(
    text: str, key: str, value_text: str, minimum: float, maximum: float
) -> float:
    """Parse a number in a fault text. The number must lie in a given range."""
    try:
        value = float(int(value_text, 0)) if value_text.startswith("0x") else float(value_text)
    except ValueError:
        value = math.nan
    if not minimum <= value <= maximum:
        raise SimulatorError(
            f"fault {text!r}: {key}={value_text}: expected a number from {minimum:g} to {maximum:g}"
        )
    return value


def _time_from_text(text: str, key: str, value_text: str) -> int:
    """Parse a time with a unit, and return the time [ns]."""
    unit = next((unit for unit in _TIME_UNITS_NS if value_text.endswith(unit)), "")
    if not unit:
        raise SimulatorError(
            f"fault {text!r}: {key}={value_text}: expected a time with its unit, as in 3s or 200ms"
        )
    return round(
        _number_from_text(text, key, value_text.removesuffix(unit), 0.0, 1e9) * _TIME_UNITS_NS[unit]
    )
