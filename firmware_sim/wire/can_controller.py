"""A simulated CAN controller: queue, error counters, error state, and error frames to the owner of the controller.

Error frame (8 bytes):

    can_id   ERROR_FLAG and the error classes below
    data[1]  status bits of a CRTL frame
    data[3]  location of a protocol error
    data[6]  transmit error counter, at most 255
    data[7]  receive error counter

Source: ISO 11898-1:2015, fault confinement. Linux ``can/error.h`` for the error frames.
"""

import enum
from collections import deque
from collections.abc import Callable

from firmware_sim.bus.frame import ERROR_FLAG, Frame
from firmware_sim.wire.frame_bits import arbitration_priority

WARNING_ERROR_COUNT = 96
"""Value of an error counter at which the state becomes ERROR_WARNING."""
PASSIVE_ERROR_COUNT = 128
"""Value of an error counter at which the state becomes ERROR_PASSIVE."""
BUS_OFF_ERROR_COUNT = 256
"""Value of the transmit error counter at which the controller leaves the bus."""
TX_ERROR_INCREMENT = 8
"""Increment of the transmit error counter for one transmit error."""
MAX_REPORTED_ERROR_COUNT = 255
"""Largest value of an error counter in an error frame."""

CAN_ERR_CRTL = 0x04
"""Error class: change of the controller's state, details in data[1]."""
CAN_ERR_PROT = 0x08
"""Error class: protocol violation."""
CAN_ERR_ACK = 0x20
"""Error class: no controller has acknowledged the frame."""
CAN_ERR_BUSOFF = 0x40
"""Error class: the controller is off the bus."""
CAN_ERR_BUSERROR = 0x80
"""Error class: an error on the bus."""
CAN_ERR_RESTARTED = 0x100
"""Error class: the controller was restarted."""
CAN_ERR_CNT = 0x200
"""Error class: data[6] and data[7] hold the error counters."""
TX_OVERFLOW = 0x02
"""Bit of data[1]: the transmit queue is full."""
RX_WARNING = 0x04
"""Bit of data[1]: receive errors reached the warning level."""
TX_WARNING = 0x08
"""Bit of data[1]: transmit errors reached the warning level."""
RX_PASSIVE = 0x10
"""Bit of data[1]: receive errors reached the passive level."""
TX_PASSIVE = 0x20
"""Bit of data[1]: transmit errors reached the passive level."""
ERROR_ACTIVE = 0x40
"""Bit of data[1]: the controller is error-active again."""
ACK_SLOT_ERROR = 0x19
"""Value of data[3]: the error is in the acknowledge slot."""


class CanErrorState(enum.IntEnum):
    """Error states of a CAN controller."""

    ERROR_ACTIVE = 0
    ERROR_WARNING = 1
    ERROR_PASSIVE = 2
    BUS_OFF = 3


class CanController:
    """A CAN controller on a simulated wire. ``SimulatedWire.add_controller`` creates the controller.

    Attributes:
        queue: queued frames, each with earliest start [ns] and priority.
        tx_errors: value of the transmit error counter.
        rx_errors: value of the receive error counter.
        state: error state of the controller.
        refused: number of frames that were refused because the queue was full or the controller was
            off the bus.
        sent: number of frames sent successfully.
        on_receive: function that is called with each received frame and its time [ns], and with
            error frames of the controller. If None, the controller ignores received frames.
        retry_ns: earliest time of the next transmission [ns]. An error-passive sender must wait
            longer than other senders.
    """

    def __init__(self, queue_depth: int, on_receive: Callable[[Frame, int], None] | None) -> None:
        """Create a CAN controller whose queue is empty.

        Args:
            queue_depth: largest number of frames in the queue.
            on_receive: function called with each received frame and its time [ns], or None.
        """
        self.queue: deque[tuple[int, int, Frame]] = deque()
        self.tx_errors = self.rx_errors = 0
        self.state = CanErrorState.ERROR_ACTIVE
        self.refused = self.sent = 0
        self.on_receive = on_receive
        self.retry_ns = 0
        self._depth = queue_depth
        self._last_error = 0
        """Classes of the last transmit error.

        The controller reports an error of the same classes again only after it has sent a frame.
        """

    @property
    def is_on_bus(self) -> bool:
        """Return True if the controller can send and receive on the bus, and False in the state bus-off."""
        return self.state != CanErrorState.BUS_OFF

    def queue_frame(self, frame: Frame, t_ns: int) -> bool:
        """Queue a frame for sending.

        If the controller refuses the frame, the owner of the controller gets an error frame.

        Args:
            frame: frame to send.
            t_ns: earliest start of the frame on the wire [ns].

        Returns:
            True if the frame was queued.
        """
        if self.is_on_bus and len(self.queue) < self._depth:
            self.queue.append((t_ns, arbitration_priority(frame.can_id), frame))
            return True
        self.refused += 1
        self._send_error_frame(CAN_ERR_CRTL, t_ns, {1: TX_OVERFLOW})
        return False

    def ready_ns(self) -> int:
        """Return the earliest start of the first frame in the queue [ns].

        The queue must not be empty.
        """
        start_ns = self.queue[0][0]
        retry_ns = self.retry_ns
        return start_ns if start_ns > retry_ns else retry_ns

    def count_sent_frame(self, t_ns: int) -> None:
        """Remove the first frame from the queue, because it has been sent."""
        self.queue.popleft()
        self.sent += 1
        self._last_error = 0
        if self.tx_errors:
            self.tx_errors -= 1
            self._update_error_state(t_ns)

    def deliver(self, frame: Frame, t_ns: int) -> None:
        """Count a frame of another controller as received, and pass the frame to the owner."""
        if self.rx_errors:
            # According to ISO 11898-1, a received frame reduces the receive error counter. In an
            # error-passive receiver, the counter falls below the error-passive level. In any other
            # receiver, the counter falls by one.
            self.rx_errors = min(self.rx_errors, PASSIVE_ERROR_COUNT) - 1
            self._update_error_state(t_ns)
        if self.on_receive:
            self.on_receive(frame, t_ns)

    def count_unacknowledged_frame(self, t_ns: int) -> None:
        """Count a transmit error, because no controller has acknowledged the sent frame.

        If the sender is error-passive, a missing acknowledgement does not change its transmit error
        counter. So a controller that is alone on a bus never reaches the state bus-off.
        """
        if self.state < CanErrorState.ERROR_PASSIVE:
            self.tx_errors += TX_ERROR_INCREMENT
        self._report_transmit_error(CAN_ERR_ACK, t_ns)

    def count_destroyed_frame(self, t_ns: int) -> None:
        """Count a transmit error, because the first frame in the queue was destroyed on the wire."""
        self.tx_errors += TX_ERROR_INCREMENT
        self._report_transmit_error(CAN_ERR_PROT | CAN_ERR_BUSERROR, t_ns)

    def count_received_error(self, t_ns: int) -> None:
        """Count a receive error, because a frame of another controller was destroyed on the wire."""
        self.rx_errors = min(MAX_REPORTED_ERROR_COUNT, self.rx_errors + 1)
        self._update_error_state(t_ns)

    def restart(self, t_ns: int) -> None:
        """Restart the controller after the state bus-off, with all error counters at zero."""
        self.tx_errors = self.rx_errors = 0
        self.state = CanErrorState.ERROR_ACTIVE
        self._last_error = 0
        self._send_error_frame(CAN_ERR_RESTARTED, t_ns)

    def _report_transmit_error(self, error_class: int, t_ns: int) -> None:
        """Update the error state after a transmit error.

        The controller reports repeated errors of the same kind only once, until it has sent a frame
        successfully.
        """
        is_state_changed = self._update_error_state(t_ns, error_class)
        if error_class != self._last_error and not is_state_changed:
            self._send_error_frame(error_class, t_ns)
        self._last_error = error_class

    def _update_error_state(self, t_ns: int, error_class: int = 0) -> bool:
        """Update the error state from the error counters.

        If the error state changes, report the change to the owner of the controller.

        Args:
            t_ns: present time [ns].
            error_class: error classes to add to the error frame of the report.

        Returns:
            True if the state changed.
        """
        state_before = self.state
        max_error_count = max(self.tx_errors, self.rx_errors)
        if self.tx_errors >= BUS_OFF_ERROR_COUNT:
            self.state = CanErrorState.BUS_OFF
            self.queue.clear()
            self._send_error_frame(CAN_ERR_BUSOFF | error_class, t_ns)
        else:
            # The states are numbered so that the sum of the two comparisons below is the number of
            # the present state.
            self.state = CanErrorState(
                (max_error_count >= WARNING_ERROR_COUNT) + (max_error_count >= PASSIVE_ERROR_COUNT)
            )
            if self.state != state_before:
                self._send_error_frame(CAN_ERR_CRTL | error_class, t_ns, {1: self._status_bits()})
        return self.state != state_before

    def _status_bits(self) -> int:
        """Return the value of payload byte 1 in an error frame that reports the present error state."""
        if self.state == CanErrorState.ERROR_ACTIVE:
            return ERROR_ACTIVE
        limit, receive, send = (
            (WARNING_ERROR_COUNT, RX_WARNING, TX_WARNING)
            if self.state == CanErrorState.ERROR_WARNING
            else (PASSIVE_ERROR_COUNT, RX_PASSIVE, TX_PASSIVE)
        )
        return receive * (self.rx_errors >= limit) | send * (self.tx_errors >= limit)

    def _send_error_frame(
        self, error_class: int, t_ns: int, extra_bytes: dict[int, int] | None = None
    ) -> None:
        """Send an error frame to the owner of the controller.

        Args:
            error_class: error classes.
            t_ns: present time [ns].
            extra_bytes: further bytes of the payload, by the position of the byte.
        """
        if not self.on_receive:
            return
        payload = bytearray(8)
        for i, value in (extra_bytes or {}).items():
            payload[i] = value
        if error_class & CAN_ERR_ACK:
            payload[3] = ACK_SLOT_ERROR
        payload[6] = min(MAX_REPORTED_ERROR_COUNT, self.tx_errors)
        payload[7] = self.rx_errors
        self.on_receive(Frame(ERROR_FLAG | CAN_ERR_CNT | error_class, bytes(payload)), t_ns)
