"""Serial numbers of simulated drives: two hands of one design differ in nothing else that a drive tells."""

from collections.abc import Iterable
from dataclasses import replace

from firmware_sim.description import Hand, SimulatorError

BITS = {"mit": 32, "cia402": 32, "odrive": 48}
"""Of a protocol's serial number; a protocol that is not here has none."""
RIGHT = "expected a number, or MOTOR=NUMBER, as in --serial 0x4000 or --serial index_motor=0x4001"


def numbered(hand: Hand, words: Iterable[str]) -> Hand:
    """Return the hand with serial numbers.

    Args:
        hand: as described.
        words: NUMBER, to which each drive adds its number on the bus, or MOTOR=NUMBER; the later word wins.

    Raises:
        SimulatorError: no such motor, no number, or one that a drive of that protocol cannot have.
    """
    serials: dict[str, int | None] = {motor.name: motor.serial for motor in hand.motors}
    for word in words:
        name, equals, text = word.rpartition("=")
        if equals and name not in serials:
            raise SimulatorError(f"--serial {word}: no motor {name!r}; expected one of {', '.join(serials)}")
        try:
            number = int(text, 0)
        except ValueError:
            raise SimulatorError(f"--serial {word}: {RIGHT}") from None
        named = [motor for motor in hand.motors if not equals or motor.name == name]
        serials |= {motor.name: number if equals else number + motor.node_id for motor in named}
    for motor in hand.motors:
        given = serials[motor.name]
        if given is not None and not 0 <= given < 1 << BITS.get(motor.protocol, 64):
            most = (1 << BITS[motor.protocol]) - 1
            raise SimulatorError(f"--serial: {motor.name} would have {given}; expected 0 to {most:#x}")
    return replace(hand, motors=[replace(motor, serial=serials[motor.name]) for motor in hand.motors])
