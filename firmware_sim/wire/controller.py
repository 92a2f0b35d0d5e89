"""One CAN controller: its queue, its error counters and state, and what it tells its owner.

Source: ISO 11898-1:2015, fault confinement; Linux ``can/error.h`` for the error frames.
"""

import enum
from collections import deque
from collections.abc import Callable

from firmware_sim.bus.frame import ERROR, Frame
from firmware_sim.wire.bits import priority

WARNING_AT, PASSIVE_AT, BUS_OFF_AT = 96, 128, 256
HIT, COUNTER_TOP = 8, 255

CRTL, PROT, ACK, BUSOFF, BUSERROR, RESTARTED, CNT = 0x04, 0x08, 0x20, 0x40, 0x80, 0x100, 0x200
"""Classes of an error frame."""
TX_OVERFLOW, RX_WARNING, TX_WARNING, RX_PASSIVE, TX_PASSIVE, ACTIVE = 0x02, 0x04, 0x08, 0x10, 0x20, 0x40
"""Bits of data[1] of a CRTL error frame."""
LOC_ACK = 0x19
"""data[3] of a PROT error frame: in the acknowledge slot."""


class State(enum.IntEnum):
    """Of fault confinement."""

    ACTIVE = 0
    WARNING = 1
    PASSIVE = 2
    BUS_OFF = 3


class Controller:
    """Hangs on a wire; made by ``Wire.add``.

    Attributes:
        queue: frames to be sent, with the time from which each may [ns].
        tx_errors, rx_errors: the error counters.
        state: of fault confinement.
        refused: frames that found the queue full, or the controller off the bus.
        sent: frames that went out.
        heard: is called with each frame that this controller receives, error frames of its own included; None: by
            nobody.
        retry_ns: it does not send before this time [ns]: a passive sender lets others go first.
    """

    def __init__(self, depth: int, heard: Callable[[Frame, int], None] | None) -> None:
        """Args: frames that the queue can hold; who listens, if anybody."""
        self.queue: deque[tuple[int, int, Frame]] = deque()
        self.tx_errors = self.rx_errors = 0
        self.state = State.ACTIVE
        self.refused = self.sent = 0
        self.heard = heard
        self.retry_ns = 0
        self._depth = depth
        self._last = 0
        """What went wrong last: told once, until a frame goes well."""

    @property
    def on_bus(self) -> bool:
        """Whether it takes part."""
        return self.state != State.BUS_OFF

    def offer(self, frame: Frame, t_ns: int) -> bool:
        """Queue a frame at a time [ns]; whether there was room. Every refusal is told to the owner."""
        if self.on_bus and len(self.queue) < self._depth:
            self.queue.append((t_ns, priority(frame.can_id), frame))
            return True
        self.refused += 1
        self._tell(CRTL, t_ns, {1: TX_OVERFLOW})
        return False

    def ready_ns(self) -> int:
        """Return from when on the frame at the head may be sent [ns]; the queue must not be empty."""
        since_ns, retry_ns = self.queue[0][0], self.retry_ns
        return since_ns if since_ns > retry_ns else retry_ns

    def went_well(self, t_ns: int) -> None:
        """Count the frame at the head as sent."""
        self.queue.popleft()
        self.sent += 1
        self._last = 0
        if self.tx_errors:
            self.tx_errors -= 1
            self._update(t_ns)

    def received(self, frame: Frame, t_ns: int) -> None:
        """Count a frame of another as received."""
        if self.rx_errors:
            self.rx_errors = min(self.rx_errors, PASSIVE_AT) - 1
            self._update(t_ns)
        if self.heard:
            self.heard(frame, t_ns)

    def unanswered(self, t_ns: int) -> None:
        """Nobody acknowledged: a passive sender's counter stays, so that one who is alone never goes off the bus."""
        if self.state < State.PASSIVE:
            self.tx_errors += HIT
        self._went_wrong(ACK, t_ns)

    def hit(self, t_ns: int) -> None:
        """The frame at the head was destroyed on the wire."""
        self.tx_errors += HIT
        self._went_wrong(PROT | BUSERROR, t_ns)

    def saw_error(self, t_ns: int) -> None:
        """The frame of another was destroyed."""
        self.rx_errors = min(COUNTER_TOP, self.rx_errors + 1)
        self._update(t_ns)

    def restart(self, t_ns: int) -> None:
        """Take part again after bus-off."""
        self.tx_errors = self.rx_errors = 0
        self.state = State.ACTIVE
        self._last = 0
        self._tell(RESTARTED, t_ns)

    def _went_wrong(self, kind: int, t_ns: int) -> None:
        changed = self._update(t_ns, kind)
        if kind != self._last and not changed:
            self._tell(kind, t_ns)
        self._last = kind

    def _update(self, t_ns: int, kind: int = 0) -> bool:
        """Follow the counters; whether the state is another."""
        before, worst = self.state, max(self.tx_errors, self.rx_errors)
        if self.tx_errors >= BUS_OFF_AT:
            self.state = State.BUS_OFF
            self.queue.clear()
            self._tell(BUSOFF | kind, t_ns)
        else:
            self.state = State((worst >= WARNING_AT) + (worst >= PASSIVE_AT))
            if self.state != before:
                self._tell(CRTL | kind, t_ns, {1: self._status()})
        return self.state != before

    def _status(self) -> int:
        if self.state == State.ACTIVE:
            return ACTIVE
        limit, receive, send = (
            (WARNING_AT, RX_WARNING, TX_WARNING)
            if self.state == State.WARNING
            else (PASSIVE_AT, RX_PASSIVE, TX_PASSIVE)
        )
        return receive * (self.rx_errors >= limit) | send * (self.tx_errors >= limit)

    def _tell(self, kind: int, t_ns: int, more: dict[int, int] | None = None) -> None:
        if not self.heard:
            return
        data = bytearray(8)
        for i, value in (more or {}).items():
            data[i] = value
        if kind & ACK:
            data[3] = LOC_ACK
        data[6], data[7] = min(COUNTER_TOP, self.tx_errors), self.rx_errors
        self.heard(Frame(ERROR | CNT | kind, bytes(data)), t_ns)
