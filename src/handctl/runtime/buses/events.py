"""What happens to a bus, gathered until the tick asks: (kind, where, number).

Kinds: ``enobufs`` frames refused by a full queue (or without a reason), ``enetdown`` interface down, ``enodev``
interface or hub gone (or reading fails without a reason), ``ebadf`` closed, ``dropped`` received frames lost before
they were read, ``error_frame``, ``error_warning``, ``error_passive``, ``error_active``, ``bus_off``, ``restarted``.
States (``bus_off``, ``error_passive``, ``enodev``) are told anew at every call while they last, so that a debounce in
ticks can count them.
"""

import errno

Event = tuple[str, str, int]
"""Kind, where, number."""

ERRNO_KINDS = {
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

TX_TIMEOUT, LOST_ARBITRATION, CONTROLLER, PROTOCOL, TRANSCEIVER, NO_ACK, BUS_OFF, BUS_ERROR, RESTARTED = (
    1 << bit for bit in range(9)
)
"""Classes of an error frame, in its identifier. Source: Linux ``can/error.h``."""
CLASS_NAMES = (
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
OVERFLOW, TX_OVERFLOW, WARNING, PASSIVE, ACTIVE = 0x03, 0x02, 0x0C, 0x30, 0x40
"""Bits of data[1] of a CONTROLLER error frame, receive and transmit side; TX_OVERFLOW is one of OVERFLOW.
Source: Linux ``can/error.h``."""


class BusEvents:
    """Counts of what happened to one bus since the last ``take``."""

    def __init__(self, where: str) -> None:
        self.where = where
        self._counts: dict[tuple[str, str], int] = {}
        self._lasting: set[str] = set()

    def add(self, kind: str, number: int = 1, detail: str = "") -> None:
        """Count something that happened.

        Args:
            kind: see the module.
            number: how often.
            detail: what more is known of it.
        """
        key = kind, f"{self.where} {detail}" if detail else self.where
        self._counts[key] = self._counts.get(key, 0) + number

    def failed(self, code: int | None, otherwise: str, number: int = 1) -> None:
        """Count a failed operation.

        Args:
            code: its errno; None if not known.
            otherwise: kind where the errno tells nothing.
            number: frames that it failed for.
        """
        kind = ERRNO_KINDS.get(code or 0, otherwise)
        if ERRNO_KINDS.get(code or 0) == "enodev":
            self.lasting(kind, True)
            return
        if kind == "enetdown":
            self.lasting("bus_off", False)
            self.lasting("error_passive", False)
        self.add(kind, number)

    def lasting(self, kind: str, present: bool) -> None:
        """Begin or end a state that is told again at every ``take``."""
        (self._lasting.add if present else self._lasting.discard)(kind)

    def error_frame(self, can_id: int, data: bytes) -> None:
        """Decode an error frame of the kernel.

        Args:
            can_id: its identifier, the classes.
            data: its payload.
        """
        names = [name for bit, name in enumerate(CLASS_NAMES) if can_id >> bit & 1]
        self.add("error_frame", 1, ", ".join(names) or "unknown class")
        if can_id & RESTARTED:
            self.add("restarted")
            self.lasting("bus_off", False)
            self.lasting("error_passive", False)
        if can_id & BUS_OFF:
            self.lasting("bus_off", True)
        if can_id & CONTROLLER and len(data) > 1:
            self._controller(data[1])

    def _controller(self, status: int) -> None:
        if status & OVERFLOW:
            self.add("error_frame", 1, "controller overflow")
        if status & TX_OVERFLOW:
            self.add("enobufs")
        if status & WARNING:
            self.add("error_warning")
        if status & ACTIVE:
            self.add("error_active")
        if status & (PASSIVE | WARNING | ACTIVE):
            self.lasting("error_passive", bool(status & PASSIVE))

    def take(self) -> list[Event]:
        """What happened since the last call, and what lasts."""
        if not self._counts and not self._lasting:
            return []
        events = [(kind, where, number) for (kind, where), number in self._counts.items()]
        self._counts = {}
        return events + [(kind, self.where, 1) for kind in sorted(self._lasting)]
