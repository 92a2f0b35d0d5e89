"""The drives whose answers are fuzzed: one of each protocol, and of each set of options that reads other answers."""

from typing import NamedTuple

from handctl.drives.registry import PROTOCOLS


class Fuzzed(NamedTuple):
    """A drive.

    Attributes:
        protocol: its name.
        options: more of them, as lines of a hand file.
        without: options that this drive does not have, by how their names begin.
    """

    protocol: str
    options: str = ""
    without: str = "-"


DRIVES = {
    **{name: Fuzzed(name) for name in PROTOCOLS},
    "odrive-0.5": Fuzzed("odrive", 'firmware = "0.5"\n', "endpoint_"),
    "odrive-cyclic": Fuzzed("odrive", "encoder_period_ms = 10\ntorque_feedback = true\n"),
    "cia402-sync": Fuzzed("cia402", "sync = true\n"),
}
