"""Signs of life that a client sends to the controller. A sign of life is a request that renews the client's lease.

A thread of the client sends signs of life while the program runs.
"""

import threading
import time
from contextlib import closing, suppress

from handctl.programs.requests import keep_alive_text
from handctl.runtime.mailbox import RequestSender

HEARTBEATS_PER_LEASE = 4
"""Number of signs of life that a client sends in the time of one lease.

The lease stays valid even if three successive signs of life are late or lost.
"""


class Heartbeat:
    """Thread that renews the lease of a client.

    If a watchdog time is given, the thread sends signs of life only while the program calls methods
    of the client often enough. A program that hangs then loses the lease, even if its other threads
    continue.
    """

    def __init__(self, bus: str, client: str, period_s: float, watchdog_s: float | None) -> None:
        """Start the thread.

        Args:
            bus: bus of the controller.
            client: name of the client.
            period_s: time between two signs of life [s].
            watchdog_s: longest time within which the program must call the client again [s]. If
                ``watchdog_s`` is None, the program is allowed to be idle for any time.
        """
        self._bus = bus
        self._heartbeat_request = keep_alive_text(client).encode()
        self._period_s = period_s
        self._watchdog_s = watchdog_s
        self._last_call_s = time.monotonic()
        self._ended = threading.Event()
        self._thread = threading.Thread(
            target=self._send_regularly, name=f"heartbeat of {client}", daemon=True
        )
        self._thread.start()

    def record_call_time(self) -> None:
        """Store the present time as the time at which the program last called the client."""
        self._last_call_s = time.monotonic()

    def end(self) -> None:
        """End the thread."""
        self._ended.set()
        self._thread.join()

    def _send_regularly(self) -> None:
        """Send signs of life until ``end``, or until the controller has ended."""
        with closing(RequestSender(self._bus)) as sender, suppress(OSError):
            while not self._ended.wait(self._period_s):
                if (
                    self._watchdog_s is None
                    or time.monotonic() - self._last_call_s <= self._watchdog_s
                ):
                    # If the controller's mailbox is full, this sign of life is lost, and the next
                    # sign of life renews the lease.
                    sender.send(self._heartbeat_request)
