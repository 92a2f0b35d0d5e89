"""List the drives whose replies are fuzzed.

The list has one drive for each drive protocol, and one more drive for each set of options that
changes how handctl decodes replies.
"""

from typing import NamedTuple

from handctl.drives.protocol_registry import PROTOCOL_ENTRIES


class FuzzedDrive(NamedTuple):
    """A drive whose replies the fuzzer generates.

    Attributes:
        protocol: name of the drive protocol.
        options: lines with options of the drive, which are added to the hand file.
        skipped_option: prefix of the lines that are removed from the hand file.
    """

    protocol: str
    options: str = ""
    skipped_option: str = "-"


FUZZED_DRIVES = {
    **{name: FuzzedDrive(name) for name in PROTOCOL_ENTRIES},
    "odrive-0.5": FuzzedDrive("odrive", 'firmware = "0.5"\n', "endpoint_"),
    "odrive-cyclic": FuzzedDrive("odrive", "encoder_period_ms = 10\ntorque_feedback = true\n"),
    "cia402-sync": FuzzedDrive("cia402", "sync = true\n"),
}
