"""The drives whose replies are fuzzed.

The list has a drive for each protocol, and one for each set of options that changes the decoding.
"""

from typing import NamedTuple

from handctl.drives.protocol_registry import PROTOCOL_ENTRIES


class FuzzedDrive(NamedTuple):
    """A drive whose replies are fuzzed.

    Attributes:
        protocol: name of the protocol.
        options: options of the drive to add to the hand file, as lines of the file.
        without: prefix of the names of options to remove from the hand file.
    """

    protocol: str
    options: str = ""
    without: str = "-"


FUZZED_DRIVES = {
    **{name: FuzzedDrive(name) for name in PROTOCOL_ENTRIES},
    "odrive-0.5": FuzzedDrive("odrive", 'firmware = "0.5"\n', "endpoint_"),
    "odrive-cyclic": FuzzedDrive("odrive", "encoder_period_ms = 10\ntorque_feedback = true\n"),
    "cia402-sync": FuzzedDrive("cia402", "sync = true\n"),
}
