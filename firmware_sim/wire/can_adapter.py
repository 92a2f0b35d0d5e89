"""Latency of a CAN adapter, the device between a host and the CAN controller on the wire.

The USB controller of a host transfers data only at the start of a USB frame. For a full-speed
device, a USB frame starts every 1 ms. For a high-speed device, a USB frame starts every 125 us. In
both directions, a CAN frame must wait for the start of the next USB frame. A serial bus inside an
adapter transfers one CAN frame at a time. Source of the USB times: USB 2.0 specification, 5.3.3
(frames and microframes).
"""

import random
from typing import NamedTuple

CLOCK_DRIFT = 1e-4
"""Relative difference between the clocks of USB and host.

Because of the difference, the starts of the USB frames pass through all positions relative to the
clock of the host.
"""


class AdapterClass(NamedTuple):
    """A class of CAN adapters with similar latency.

    Attributes:
        send_period_ns: period of the times at which frames can leave the host [ns], or 0 if frames
            do not wait.
        receive_period_ns: period of the times at which received frames can reach the host [ns], or
            0 if frames do not wait.
        frame_duration_ns: duration of a frame on a serial bus inside the adapter, in either direction [ns].
        text: description of the class of adapters, with examples.
    """

    send_period_ns: int
    receive_period_ns: int
    frame_duration_ns: int
    text: str


ADAPTER_CLASSES = {
    "none": AdapterClass(0, 0, 0, "controller on the processor's own bus, as on Jetson"),
    "spi": AdapterClass(
        0, 0, 100_000, "controller behind SPI, as on Pi hats; 100 us a frame are an assumption"
    ),
    "usb-hs": AdapterClass(125_000, 125_000, 0, "high-speed USB: PCAN-USB Pro FD, Kvaser Leaf v3"),
    "usb-fs": AdapterClass(
        1_000_000, 1_000_000, 0, "full-speed USB: candleLight, CANable, also with slcan"
    ),
    "ftdi": AdapterClass(
        1_000_000,
        16_000_000,
        0,
        "serial adapter with FTDI chip, latency timer at its default of 16 ms",
    ),
}
"""Classes of adapters by name."""
NO_LATENCY_CLASS = "none"
"""Name of the class without latency."""


class AdapterLatency:
    """Latency of one CAN adapter in both directions.

    The times passed to a method must not decrease from call to call.
    """

    def __init__(self, adapter_class: str, seed: int = 0) -> None:
        """Initialise the latency of a CAN adapter. The first USB frame of the adapter starts at a random time.

        Args:
            adapter_class: key of ``ADAPTER_CLASSES``.
            seed: seed of the random start time.
        """
        self._adapter = ADAPTER_CLASSES[adapter_class]
        self._phase = random.Random(f"adapter {adapter_class} {seed}").random()
        self._sent_ns = self._received_ns = 0

    def send(self, t_ns: int) -> int:
        """Return the time when a frame of the host arrives at the CAN controller [ns].

        The argument ``t_ns`` is the time when the host sends the frame.
        """
        adapter = self._adapter
        start_ns = self._next_period_start(t_ns, adapter.send_period_ns)
        self._sent_ns = max(start_ns, self._sent_ns) + adapter.frame_duration_ns
        return self._sent_ns

    def receive(self, t_ns: int) -> int:
        """Return the time when a frame from the wire arrives at the host [ns].

        The argument ``t_ns`` is the time when the CAN controller receives the frame.
        """
        adapter = self._adapter
        start_ns = self._next_period_start(t_ns, adapter.receive_period_ns)
        self._received_ns = max(start_ns, self._received_ns) + adapter.frame_duration_ns
        return self._received_ns

    def _next_period_start(self, t_ns: int, period_ns: int) -> int:
        """Return the start of the next transfer period of the adapter [ns]."""
        if not period_ns:
            return t_ns
        period = period_ns * (1.0 + CLOCK_DRIFT)
        elapsed_fraction = (t_ns / period - self._phase) % 1.0
        return t_ns + round((1.0 - elapsed_fraction) * period)
