"""Serial numbers of simulated drives.

Two hands of the same design can be distinguished only by the serial numbers of their drives.
"""

from collections.abc import Iterable
from dataclasses import replace

from firmware_sim.description.hand_description import Hand, SimulatorError

SERIAL_NUMBER_BITS = {"mit": 32, "cia402": 32, "odrive": 48, "moteus": 96, "robstride": 64}
"""Size of a drive's serial number, by protocol [bit].

Drives of other protocols have no serial number.
"""
EXPECTED_FORM_TEXT = (
    "expected a number, or MOTOR=NUMBER, as in --serial 0x4000 or --serial index_motor=0x4001"
)
"""Part of the error message for a wrong serial number."""


def with_serial_numbers(hand: Hand, serial_options: Iterable[str]) -> Hand:
    """Return the description of a hand in which the drives have the given serial numbers.

    Args:
        hand: description of the hand.
        serial_options: NUMBER for all drives, where each drive has NUMBER plus its node number, or
            MOTOR=NUMBER for a single drive. If two options concern the same drive, the later option
            applies.

    Raises:
        SimulatorError: the motor does not exist, or the protocol of the drive does not allow the
            serial number.
    """
    serials: dict[str, int | None] = {motor.name: motor.serial for motor in hand.motors}
    for word in serial_options:
        name, equals, text = word.rpartition("=")
        if equals and name not in serials:
            raise SimulatorError(
                f"--serial {word}: no motor {name!r}; expected one of {', '.join(serials)}"
            )
        try:
            number = int(text, 0)
        except ValueError:
            raise SimulatorError(f"--serial {word}: {EXPECTED_FORM_TEXT}") from None
        motors = [motor for motor in hand.motors if not equals or motor.name == name]
        serials |= {motor.name: number if equals else number + motor.node_id for motor in motors}
    for motor in hand.motors:
        serial_number = serials[motor.name]
        if serial_number is not None and not 0 <= serial_number < 1 << SERIAL_NUMBER_BITS.get(
            motor.protocol, 64
        ):
            max_serial_number = (1 << SERIAL_NUMBER_BITS[motor.protocol]) - 1
            raise SimulatorError(
                f"--serial: {motor.name} would have {serial_number}; expected 0 to {max_serial_number:#x}"
            )
    return replace(
        hand, motors=[replace(motor, serial=serials[motor.name]) for motor in hand.motors]
    )
