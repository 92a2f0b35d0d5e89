"""Objects of a CiA 404 amplifier with the values that handctl requires before arming.

The host checks and writes the objects by SDO transfers.

Every TPDO with load cells has transmission type 1, so that the amplifier measures the load cells
and sends the TPDO at each SYNC. The host first reads the unit and the number of decimal digits of
the process value. The host writes the unit and the number of digits only if they differ from the
required values. Source: docs/facts/cia404.md.
"""

from handctl.drives.canopen import codec
from handctl.drives.canopen.discovery import CIA404_PROFILE
from handctl.drives.canopen.setup import PDO_DISABLED_BIT, ObjectCheck, SetupStep, pdo_steps
from handctl.drives.signals import SignalCoding

NEWTON_UNIT_CODE = 0x0021_0000
"""Code of the unit newton: prefix, numerator, denominator, and a reserved byte.

Source: CiA 303-2, newton is 0x21.
"""
HEARTBEAT_MS = 100
"""Period of an amplifier's heartbeat [ms]."""
TPDO_BASES = (0x180, 0x280, 0x380, 0x480)
"""Base identifiers of TPDOs 1 to 4. The sum of base identifier and node number is the identifier of a TPDO.

Source: CiA 301, predefined connection set.
"""
CHANNELS_PER_TPDO = 2
"""Number of process values in a TPDO: 8 bytes hold two values of 32 bits."""
CHANNEL_BYTES = 4
"""Size of a process value [bytes]."""
PROCESS_VALUES = {"int32": (0x9130, SignalCoding.SIGNED), "real32": (0x6130, SignalCoding.FLOAT)}
"""Object with the process value and coding of the process value, for each ``process_value`` in the hand file."""


def required_steps(
    node_id: int, channel_count: int, process_value: str, digits: int
) -> tuple[SetupStep, ...]:
    """Return the objects that the host checks or writes before arming, in the order of the SDO requests.

    Args:
        node_id: node number of the amplifier.
        channel_count: number of channels in use, from channel 1 on.
        process_value: key of ``PROCESS_VALUES``.
        digits: number of decimal digits of an ``int32`` process value.
    """
    write_if_different = ObjectCheck.WRITE_IF_DIFFERENT
    number, _ = PROCESS_VALUES[process_value]
    steps = [
        SetupStep(ObjectCheck.LOW_WORD_EQUAL, 0x1000, 0, CIA404_PROFILE, 4),
        SetupStep(write_if_different, 0x1005, 0, codec.SYNC, 4),
        SetupStep(write_if_different, 0x1017, 0, HEARTBEAT_MS, 2),
    ]
    for channel in range(1, channel_count + 1):
        steps.append(SetupStep(write_if_different, 0x6131, channel, NEWTON_UNIT_CODE, 4))
        if process_value == "int32":
            steps.append(SetupStep(write_if_different, 0x6132, channel, digits, 1))
        # Object 0x6150 is the status of the channel. Bit 0 of the status means that the value is
        # not valid. Bits 1 and 2 report a positive and a negative overload.
        steps.append(SetupStep(ObjectCheck.EQUAL_IF_PRESENT, 0x6150, channel, 0, 1))
    for i, base in enumerate(TPDO_BASES):
        first_channel = CHANNELS_PER_TPDO * i
        mapped_channels = range(
            first_channel + 1, min(first_channel + CHANNELS_PER_TPDO, channel_count) + 1
        )
        entries = tuple(
            number << 16 | channel << 8 | 8 * CHANNEL_BYTES for channel in mapped_channels
        )
        if entries:
            # An inhibit time of the PDO could delay the answers to SYNC. The host sets the inhibit
            # time to 0 while the PDO is off.
            inhibit_time_step = SetupStep(ObjectCheck.WRITE_IF_PRESENT, 0x1800 + i, 3, 0, 2)
            disable_step, *other_steps = pdo_steps(
                0x1800 + i, 0x1A00 + i, base + node_id, 1, entries
            )
            steps += [disable_step, inhibit_time_step, *other_steps]
        else:
            steps.append(
                SetupStep(
                    ObjectCheck.WRITE_IF_PRESENT,
                    0x1800 + i,
                    1,
                    PDO_DISABLED_BIT | base + node_id,
                    4,
                )
            )
    return tuple(steps)
