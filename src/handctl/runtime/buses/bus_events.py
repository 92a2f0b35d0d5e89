"""Events of a CAN bus as tuples (kind, where, number), collected until the next tick takes the events.

Kinds:

- ``enobufs``: frames were refused, because a queue was full or for an unknown reason
- ``enetdown``: the interface is down
- ``enodev``: the interface or the hub of the simulator has disappeared, or reading fails for an
  unknown reason
- ``ebadf``: this program has closed the bus
- ``dropped``: received frames were lost before this program read them
- ``error_frame``, ``error_warning``, ``error_passive``, ``error_active``, ``bus_off``,
  ``restarted``: states reported by the CAN controller of the interface

The states ``bus_off``, ``error_passive`` and ``enodev`` are lasting states. Every call of
``take_events`` reports a lasting state again, until the state ends. A fault detector counts the
ticks in which a lasting state is reported.
"""

import errno

BusEvent = tuple[str, str, int]
"""Event of a bus: kind, name of the bus (followed by a detail, if there is one), and number of occurrences."""

EVENT_KIND_BY_ERRNO = {
    errno.ENOBUFS: "enobufs",
    errno.EAGAIN: "enobufs",
    errno.ENOMEM: "enobufs",
    errno.ENETDOWN: "enetdown",
    errno.ENODEV: "enodev",
    errno.ENXIO: "enodev",
    errno.EPIPE: "enodev",
    errno.ECONNRESET: "enodev",
    errno.ENOTCONN: "enodev",
    errno.EBADF: "ebadf",
}
"""Kind of event for each errno."""

(
    TX_TIMEOUT,
    LOST_ARBITRATION,
    CONTROLLER_ERROR,
    PROTOCOL_ERROR,
    TRANSCEIVER_ERROR,
    NO_ACK,
    BUS_OFF,
    BUS_ERROR,
    CONTROLLER_RESTARTED,
) = (1 << bit for bit in range(9))
"""Bits in the identifier of an error frame.

Each bit is a class of errors. Source: Linux ``can/error.h``.
"""
ERROR_CLASS_NAMES = (
    "tx timeout",
    "lost arbitration",
    "controller",
    "protocol",
    "transceiver",
    "no acknowledge",
    "bus off",
    "bus error",
    "restarted",
)
"""Names of the classes of errors in an error frame, in the order of their bits. The lowest bit comes first."""
OVERFLOW_MASK, TX_OVERFLOW_MASK, WARNING_MASK, PASSIVE_MASK, ACTIVE_MASK = (
    0x03,
    0x02,
    0x0C,
    0x30,
    0x40,
)
"""Masks for data[1] of an error frame of class CONTROLLER_ERROR.

OVERFLOW_MASK, WARNING_MASK and PASSIVE_MASK each have a receive bit and a transmit bit. TX_OVERFLOW_MASK is the
transmit bit of OVERFLOW_MASK. Source: Linux ``can/error.h``.
"""


class BusEvents:
    """Events of one bus with their counts, and the persistent events of the bus.

    The counts of events begin at the last call of ``take_events``.
    """

    def __init__(self, bus_name: str) -> None:
        """Start without events. Each event contains ``bus_name`` as the name of the bus."""
        self.where = bus_name
        self._counts: dict[tuple[str, str], int] = {}
        self._persistent_events: set[str] = set()

    def add_event(self, event_kind: str, occurrences: int = 1, detail_text: str = "") -> None:
        """Add a number of occurrences to the count of an event.

        Args:
            event_kind: kind of the event, as listed in the docstring of the module.
            occurrences: number of occurrences.
            detail_text: text to append to ``where`` of the event. Events with different details are
                counted separately.
        """
        key = event_kind, f"{self.where} {detail_text}" if detail_text else self.where
        self._counts[key] = self._counts.get(key, 0) + occurrences

    def count_failure(
        self, errno_code: int | None, default_kind: str, occurrences: int = 1
    ) -> None:
        """Count a failed operation on the bus.

        Args:
            errno_code: errno of the failure, or None for an unknown errno.
            default_kind: kind of event to count if the errno is not known or not in ``EVENT_KIND_BY_ERRNO``.
            occurrences: number of frames in the failed operation.
        """
        kind = EVENT_KIND_BY_ERRNO.get(errno_code or 0, default_kind)
        if EVENT_KIND_BY_ERRNO.get(errno_code or 0) == "enodev":
            self.set_persistent_event(kind, True)
            return
        if kind == "enetdown":  # an interface that is down has no error states
            self.set_persistent_event("bus_off", False)
            self.set_persistent_event("error_passive", False)
        self.add_event(kind, occurrences)

    def set_persistent_event(self, event_kind: str, is_present: bool) -> None:
        """Begin or end a persistent event of the bus, for example bus-off.

        From its beginning to its end, each call of ``take_events`` reports the persistent event again.
        """
        (self._persistent_events.add if is_present else self._persistent_events.discard)(event_kind)

    def add_error_frame(self, can_id: int, data: bytes) -> None:
        """Decode an error frame from the kernel, and count its events.

        Args:
            can_id: identifier of the error frame, with the bits of its error classes.
            data: payload of the error frame. data[1] is the state of the CAN controller.
        """
        names = [name for bit, name in enumerate(ERROR_CLASS_NAMES) if can_id >> bit & 1]
        self.add_event("error_frame", 1, ", ".join(names) or "unknown class")
        if can_id & CONTROLLER_RESTARTED:
            self.add_event("restarted")
            self.set_persistent_event("bus_off", False)
            self.set_persistent_event("error_passive", False)
        if can_id & BUS_OFF:
            self.set_persistent_event("bus_off", True)
        if can_id & CONTROLLER_ERROR and len(data) > 1:
            self._count_controller_status(data[1])

    def _count_controller_status(self, status: int) -> None:
        """Count the events in byte data[1] of an error frame of class CONTROLLER_ERROR."""
        if status & OVERFLOW_MASK:
            self.add_event("error_frame", 1, "controller overflow")
        if status & TX_OVERFLOW_MASK:
            self.add_event("enobufs")
        if status & WARNING_MASK:
            self.add_event("error_warning")
        if status & ACTIVE_MASK:
            self.add_event("error_active")
        if status & (PASSIVE_MASK | WARNING_MASK | ACTIVE_MASK):
            self.set_persistent_event("error_passive", bool(status & PASSIVE_MASK))

    def take_events(self) -> list[BusEvent]:
        """Return the events since the last call of this method, followed by the persistent events."""
        if not self._counts and not self._persistent_events:
            return []
        events = [(kind, location, number) for (kind, location), number in self._counts.items()]
        self._counts = {}
        return events + [(kind, self.where, 1) for kind in sorted(self._persistent_events)]
