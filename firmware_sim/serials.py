"""Serial numbers of simulated drives. Only the serial numbers distinguish two hands of one design."""

from collections.abc import Iterable
from dataclasses import replace

from firmware_sim.description import Hand, SimulatorError

SERIAL_NUMBER_BITS = {"mit": 32, "cia402": 32, "odrive": 48, "moteus": 96, "robstride": 64}
"""Size of the serial number of each protocol [bit]. Other protocols have none."""
EXPECTED_FORM = "expected a number, or MOTOR=NUMBER, as in --serial 0x4000 or --serial index_motor=0x4001"
"""Help text of an error."""


def with_serial_numbers(hand: Hand, words: Iterable[str]) -> Hand:
    """Return the hand with serial numbers.

    Args:
        hand: description of the hand.
        words: NUMBER, to which each drive adds its node number, or MOTOR=NUMBER. A later word
            overrides an earlier one.

    Raises:
        SimulatorError: the motor does not exist, or the number is not valid for its protocol.
    """
    serials: dict[str, int | None] = {motor.name: motor.serial for motor in hand.motors}
    for word in words:
        name, equals, text = word.rpartition("=")
        if equals and name not in serials:
            raise SimulatorError(f"--serial {word}: no motor {name!r}; expected one of {', '.join(serials)}")
        try:
            number = int(text, 0)
        except ValueError:
            raise SimulatorError(f"--serial {word}: {EXPECTED_FORM}") from None
        named = [motor for motor in hand.motors if not equals or motor.name == name]
        serials |= {motor.name: number if equals else number + motor.node_id for motor in named}
    for motor in hand.motors:
        given = serials[motor.name]
        if given is not None and not 0 <= given < 1 << SERIAL_NUMBER_BITS.get(motor.protocol, 64):
            highest = (1 << SERIAL_NUMBER_BITS[motor.protocol]) - 1
            raise SimulatorError(f"--serial: {motor.name} would have {given}; expected 0 to {highest:#x}")
    return replace(hand, motors=[replace(motor, serial=serials[motor.name]) for motor in hand.motors])
