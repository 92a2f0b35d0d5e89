"""Bus specifications from the command line, for commands without a hand file."""

from collections.abc import Sequence

from handctl.errors import ConfigError
from handctl.hand.file.quantity_types import NAME_PATTERN
from handctl.runtime.buses.bus_opening import check_bus_spec, real_buses
from handctl.session.default_hand import DEFAULT_HAND


def parse_bus_arguments(bus_arguments: Sequence[str]) -> dict[str, str]:
    """Return the specification of each bus by its name.

    The specifications come from the command line. Each argument of ``--bus`` is either a
    specification SPEC, or a bus name with a specification, NAME=SPEC. A bus without a name is named
    after its position in the command: main, bus1, bus2.

    Raises:
        ConfigError: a name is given twice or is not a valid bus name.
    """
    specs: dict[str, str] = {}
    for number, text in enumerate(bus_arguments):
        name_part, equals_sign, spec = text.partition("=")
        has_bus_name = bool(equals_sign) and ":" not in name_part
        name = name_part if has_bus_name else "main" if number == 0 else f"bus{number}"
        if name in specs or not NAME_PATTERN.fullmatch(name):
            raise ConfigError(
                repr(text),
                "--bus",
                "SPEC, or NAME=SPEC with every name once, of letters, digits and _",
            )
        specs[name] = spec if has_bus_name else text
        check_bus_spec(specs[name])
    return specs


def refuse_default_hand(bus_specs: Sequence[str], location: str) -> None:
    """Raise an error if a bus may have real motors. Commands call this function if the operator has named no hand.

    On a bus with real motors, the operator must name the hand, because the limits of the default
    hand belong to other motors and tendons.

    Args:
        bus_specs: specifications of the buses.
        location: name of the argument that is missing, for the error message.

    Raises:
        ConfigError: a bus may have real motors.
    """
    if hardware_buses := real_buses(bus_specs):
        expected = f"the file of the connected hand; the default {DEFAULT_HAND!r} is only for simulated buses"
        raise ConfigError(
            f"no hand is given, and {hardware_buses[0]} may have real motors", location, expected
        )
