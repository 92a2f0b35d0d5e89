"""The drives whose replies are fuzzed: one per protocol, and one per set of options that changes the decoding."""

from typing import NamedTuple

from handctl.drives.registry import PROTOCOLS


class Fuzzed(NamedTuple):
    """A drive to be fuzzed.

    Attributes:
        protocol: name of the protocol.
        options: additional options, as lines of a hand file.
        without: beginning of the names of options that this drive does not have.
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
