"""Faults as data, and as a line of text: ``drop node=3 p=0.05 at=3s for=2s``."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from firmware_sim.description import Hand, SimulatorError

NODE, BUS, ENCODER, JOINT, CELL, TENDON, DIGIT = "node", "bus", "encoder", "joint", "cell", "tendon", "digit"
SENSORS = "sensors"
"""Name of the sensor node among the nodes."""
FOREVER_NS = 1 << 62
_TIMES = {"ns": 1, "us": 1_000, "ms": 1_000_000, "s": 1_000_000_000}


class Kind(NamedTuple):
    """What a kind of fault may be put on, its size unless told otherwise, and what it does."""

    components: tuple[str, ...]
    size: float
    text: str


KINDS = {
    "drop": Kind((NODE, BUS), 0, "what a node sends is lost"),
    "deaf": Kind((NODE, BUS), 0, "what a node is sent is lost"),
    "delay": Kind((NODE, BUS), 4, "what a node sends comes later by size [ms]"),
    "duplicate": Kind((NODE, BUS), 0, "what a node sends comes twice"),
    "twin": Kind((NODE,), 0, "a second node with its identifier answers, too, with other values"),
    "reorder": Kind((NODE, BUS), 0, "what a node sends comes after its next frame"),
    "corrupt": Kind((NODE, BUS), 1, "size bits of the payload are flipped"),
    "shorten": Kind((NODE, BUS), 1, "the payload lacks size bytes"),
    "extend": Kind((NODE, BUS), 0, "the identifier is marked as one of 29 bits"),
    "slow": Kind((NODE,), 2, "a node answers every size-th time only"),
    "off": Kind((NODE,), 0, "a node has no power: no torque, no answer"),
    "reset": Kind((NODE,), 0, "a node restarts, once"),
    "error": Kind((NODE,), 0, "a node enters fault with code size, once (0: over-temperature)"),
    "watchdog": Kind((NODE,), 0, "a node's watchdog fires, once"),
    "voltage": Kind((NODE,), 0, "a node reports under-voltage, once"),
    "hot": Kind((NODE,), 90, "a node's winding is at size [degC]"),
    "disobey": Kind((NODE,), 0, "a node makes size times the torque that it is asked for"),
    "runaway": Kind((NODE,), 1, "a node makes size times its largest torque, whatever it is asked for"),
    "hold_on": Kind((NODE,), 0, "a node says that it is disabled, and keeps its torque"),
    "forget": Kind((NODE,), 0, "a node loses its registers, once, and stays enabled (size > 0: TMAX is size [N m])"),
    "ripple": Kind((NODE,), 0.1, "a motor's torque has a ripple of amplitude size [N m] at hz"),
    "late": Kind((NODE,), 50, "a node obeys each command size [ms] later"),
    "swap": Kind((NODE,), 0, "two drives report each other's encoder and current"),
    "cross": Kind((NODE,), 0, "two drives make each other's torque, and report what they were told"),
    "flood": Kind((BUS,), 100, "size frames of identifier 0x000 every millisecond"),
    "unknown": Kind((BUS,), 1, "size frames of an unknown identifier every millisecond"),
    "foreign": Kind((NODE,), 0, "somebody else sends a node commands, every 10 ms"),
    "mute": Kind((JOINT, CELL), 0, "the frame that carries a reading is not sent"),
    "stuck": Kind((ENCODER, JOINT, CELL), 0, "a reading stays where it is"),
    "offset": Kind((ENCODER, JOINT, CELL), 1, "a reading jumps by size [rad, N]"),
    "drift": Kind((ENCODER, JOINT, CELL), 1, "a reading drifts by size a second [rad/s, N/s]"),
    "scale": Kind((ENCODER,), 1.5, "a reading moves size times as far as what it measures"),
    "old": Kind((CELL,), 16, "a reading is as it was size samples ago, under a fresh counter"),
    "replay": Kind((NODE,), 16, "a node sends the frames of size answers ago"),
    "noise": Kind((ENCODER, JOINT, CELL), 1, "a reading has noise of standard deviation size [rad, N]"),
    "saturate": Kind((CELL,), 1, "a load cell is at its upper rail (size > 0) or its lower one"),
    "snap": Kind((TENDON,), 0, "a rope tears"),
    "slack": Kind((TENDON,), 2, "a rope is longer by size [mm]"),
    "friction": Kind((TENDON,), 3, "a motor has size newtons more Coulomb friction at its rope"),
    "block": Kind((DIGIT,), 0, "a digit cannot move"),
}  # fmt: skip
"""Everything that can be injected."""
SIZES = {
    "delay": (0.0, 1e5), "corrupt": (1.0, 512.0), "shorten": (1.0, 64.0), "slow": (2.0, 1e6),
    "error": (0.0, 2.0**32 - 1), "hot": (-40.0, 1000.0), "disobey": (-10.0, 10.0), "runaway": (-4.0, 4.0),
    "forget": (0.0, 50.0), "ripple": (0.0, 50.0), "late": (0.0, 1e3),
    "scale": (-10.0, 10.0), "old": (1.0, 1000.0), "replay": (1.0, 1000.0),
    "flood": (1.0, 1000.0), "unknown": (1.0, 1000.0), "noise": (0.0, 1e6), "slack": (0.0, 1000.0),
    "friction": (0.0, 1e4),
}  # fmt: skip
"""Sizes that mean something; of the others a million either way."""
OF_TWO = ("swap", "cross")
"""Kinds that take a second motor, ``with=NAME``."""
ANY_SIZE = (-1e6, 1e6)
OF_DRIVES = ("reset", "error", "watchdog", "voltage", "hot", "disobey", "runaway", "hold_on", "foreign", "forget",
             "ripple", "late", "swap", "cross")  # fmt: skip
"""Kinds that the sensor node cannot have: it has no power stage, and the host sends it nothing but SYNC."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes:
        kind: of ``KINDS``. component: what it is put on. instance: its name.
        start_ns, duration_ns: when it begins and how long it lasts [ns].
        size: see its kind. p: probability for each frame. seed: of its chance. hz: frequency of a ripple [Hz].
        text: as it was written.
        other: the second motor, of a kind that takes one.
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


def parse_fault(text: str, hand: Hand, now_ns: int = 0) -> Fault:
    """Read a fault.

    Args:
        text: ``KIND COMPONENT=INSTANCE [with=NAME] [size=X] [p=X] [hz=X] [at=TIME] [for=TIME] [seed=N]``.
        hand: whose it is.
        now_ns: what ``at`` counts from [ns].

    Raises:
        SimulatorError: it cannot be read, or there is no such fault in this hand.
    """
    kind, *pairs = text.split() or [""]
    if kind not in KINDS:
        raise SimulatorError(f"fault {text!r}: no such kind {kind!r}; expected one of {', '.join(KINDS)}")
    given = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals or not value or key in given:
            raise SimulatorError(f"fault {text!r}: {pair!r} is not one new KEY=VALUE")
        given[key] = value
    component = _component(text, kind, given)
    instance = _instance(text, instances(component, hand, kind), component, given.pop(component), hand)
    fault = Fault(
        kind=kind,
        component=component,
        instance=instance,
        size=_number(text, "size", given.pop("size", str(KINDS[kind].size)), *SIZES.get(kind, ANY_SIZE)),
        p=_number(text, "p", given.pop("p", "1"), 0.0, 1.0),
        start_ns=now_ns + _time(text, "at", given.pop("at", "0s")),
        duration_ns=_time(text, "for", given.pop("for")) if "for" in given else FOREVER_NS,
        seed=int(_number(text, "seed", given.pop("seed", "0"), 0, 1e9)),
        hz=_number(text, "hz", given.pop("hz", "25"), 0.0, 1e4),
        text=text,
        other=_other(text, kind, instance, given, hand),
    )
    if given:
        raise SimulatorError(f"fault {text!r}: unknown {next(iter(given))!r}; expected size, p, hz, at, for or seed")
    return fault


def _component(text: str, kind: str, given: dict[str, str]) -> str:
    found = [key for key in given if key in (NODE, BUS, ENCODER, JOINT, CELL, TENDON, DIGIT)]
    allowed = KINDS[kind].components
    if len(found) != 1 or found[0] not in allowed:
        raise SimulatorError(f"fault {text!r}: {kind} needs {' or '.join(f'{name}=NAME' for name in allowed)}")
    return found[0]


def _other(text: str, kind: str, first: str, given: dict[str, str], hand: Hand) -> str:
    """Return the second motor of a kind that takes two; empty for the others."""
    if kind not in OF_TWO:
        return ""
    if "with" not in given:
        raise SimulatorError(f"fault {text!r}: {kind} needs with=NAME, the other motor")
    other = _instance(text, instances(NODE, hand, kind), NODE, given.pop("with"), hand)
    if other == first:
        raise SimulatorError(f"fault {text!r}: {kind} needs two motors, not {first!r} twice")
    return other


def instances(component: str, hand: Hand, kind: str = "") -> list[str]:
    """Names that a component may have in a hand, for a kind of fault or for any."""
    motors = [motor.name for motor in hand.motors]
    return {
        NODE: [*motors, SENSORS] if hand.sensors and kind not in OF_DRIVES else motors,
        BUS: hand.buses,
        ENCODER: motors,
        JOINT: hand.sensors.joints if hand.sensors else [],
        CELL: hand.sensors.tendons if hand.sensors else [],
        TENDON: [tendon.name for tendon in hand.tendons],
        DIGIT: [digit.name for digit in hand.digits],
    }[component]


def _instance(text: str, known: list[str], component: str, name: str, hand: Hand) -> str:
    """A name, or the node number of a motor."""
    if component in (NODE, ENCODER):
        numbers = {str(motor.node_id): motor.name for motor in hand.motors}
        name = numbers.get(name, name)
    if name not in known:
        raise SimulatorError(f"fault {text!r}: no {component} {name!r}; expected one of {', '.join(known) or 'none'}")
    return name


def _number(text: str, key: str, word: str, low: float, high: float) -> float:
    try:
        value = float(int(word, 0)) if word.startswith("0x") else float(word)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise SimulatorError(f"fault {text!r}: {key}={word}: expected a number from {low:g} to {high:g}")
    return value


def _time(text: str, key: str, word: str) -> int:
    """A time with its unit [ns]."""
    unit = next((unit for unit in _TIMES if word.endswith(unit)), "")
    if not unit:
        raise SimulatorError(f"fault {text!r}: {key}={word}: expected a time with its unit, as in 3s or 200ms")
    return round(_number(text, key, word.removesuffix(unit), 0.0, 1e9) * _TIMES[unit])
