"""Command-line words of a simulated wire, such as ``--wire queue=10 stuffing=actual``."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.wire.can_adapter import ADAPTER_CLASSES, NO_LATENCY_CLASS, AdapterLatency
from firmware_sim.wire.frame_bits import BitRates
from firmware_sim.wire.simulated_wire import WireOptions

WIRE_OPTION_KEYS = {
    "bitrate": "nominal bit rate [bit/s] (the hand file's)",
    "data_bitrate": "bit rate of CAN FD's data phase [bit/s] (the hand file's)",
    "stuffing": "worst: maximum stuff bits for the length, actual: those of each frame (worst)",
    "queue": "capacity of each controller's queue [frames] (128)",
    "error_rate": "fraction of frames destroyed on the wire (0)",
    "restart_ms": "delay of a controller's restart after bus-off [ms] (never)",
    "seed": "seed of the errors and of the adapter's phase (0)",
    "adapter": f"latency of the host's CAN adapter: {', '.join(ADAPTER_CLASSES)} ({NO_LATENCY_CLASS})",
}
"""Meaning and default of each key of ``--wire``."""
_MAX_BITRATE = 20_000_000
"""Maximum bit rate of arbitration or data phase [bit/s]."""


@dataclass(frozen=True, slots=True)
class WireSpec:
    """Options of simulated wires from the command line.

    Attributes:
        options: options of the wires.
        are_stuff_bits_counted: True to count the actual stuff bits of each frame.
        bitrate: nominal bit rate that replaces the rate in the hand file [bit/s], 0 to keep
            the rate in the hand file.
        data_bitrate: data bit rate that replaces the rate in the hand file [bit/s], 0 to keep
            the rate in the hand file.
        adapter_class: class of the CAN adapters of the hosts, a key of ``ADAPTER_CLASSES``.
    """

    options: WireOptions = field(default_factory=WireOptions)
    are_stuff_bits_counted: bool = False
    bitrate: int = 0
    data_bitrate: int = 0
    adapter_class: str = NO_LATENCY_CLASS

    def latency(self, adapter_number: int) -> AdapterLatency:
        """Return the latency of a host's CAN adapter.

        Args:
            adapter_number: number of the adapter. The number of the adapter determines at which
                random time of the period its USB frames start.
        """
        return AdapterLatency(self.adapter_class, self.options.seed + adapter_number)

    def bit_rates(self, bitrate: int, data_bitrate: int) -> BitRates:
        """Return the bit rates of a bus. Rates on the command line replace the rates in the hand file.

        Args:
            bitrate: nominal bit rate in the hand file [bit/s].
            data_bitrate: bit rate of the data phase in the hand file [bit/s].
        """
        return BitRates(
            self.bitrate or bitrate, self.data_bitrate or data_bitrate, self.are_stuff_bits_counted
        )


def parse_wire_options(words: Sequence[str]) -> WireSpec:
    """Parse the words KEY=VALUE after the option ``--wire``.

    Raises:
        SimulatorError: a key is unknown, or a value is out of range.
    """
    spec = WireSpec()
    for word in words:
        spec = _updated_spec(spec, word)
    return spec


def _updated_spec(spec: WireSpec, option_text: str) -> WireSpec:
    """Return a copy of a wire specification, with one value changed by a command-line word."""
    key, _, text = option_text.partition("=")
    if key not in WIRE_OPTION_KEYS:
        raise SimulatorError(
            f"--wire {option_text}: expected one of {', '.join(WIRE_OPTION_KEYS)}, as in queue=10"
        )
    if key == "stuffing":
        if text not in ("worst", "actual"):
            raise SimulatorError(
                f"--wire {option_text}: expected stuffing=worst or stuffing=actual"
            )
        return replace(spec, are_stuff_bits_counted=text == "actual")
    if key == "adapter":
        if text not in ADAPTER_CLASSES:
            raise SimulatorError(
                f"--wire {option_text}: expected one of {', '.join(ADAPTER_CLASSES)}"
            )
        return replace(spec, adapter_class=text)
    if key == "error_rate":
        return replace(
            spec,
            options=replace(spec.options, error_rate=_number_in_range(option_text, text, 0.0, 1.0)),
        )
    if key == "restart_ms":
        return replace(
            spec,
            options=replace(spec.options, restart_ms=_number_in_range(option_text, text, 0.0, 1e6)),
        )
    if key == "queue":
        return replace(
            spec,
            options=replace(
                spec.options, queue=int(_number_in_range(option_text, text, 1, 100_000))
            ),
        )
    if key == "seed":
        return replace(
            spec,
            options=replace(
                spec.options, seed=int(_number_in_range(option_text, text, 0, 1 << 32))
            ),
        )
    rate = int(_number_in_range(option_text, text, 1_000, _MAX_BITRATE))
    return replace(spec, bitrate=rate) if key == "bitrate" else replace(spec, data_bitrate=rate)


def _number_in_range(option_text: str, text: str, minimum: float, maximum: float) -> float:
    """Parse a number that must lie in a given range."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not minimum <= value <= maximum:
        raise SimulatorError(
            f"--wire {option_text}: expected a number from {minimum:g} to {maximum:g}"
        )
    return value
