"""Mailbox of a running controller.

The mailbox is a Unix datagram socket that receives requests.

The controller reads the socket without blocking. The name of the socket contains the name of the
bus. A program can send ``{"do": "watch"}`` from its own socket. With the request ``watch``, the
program subscribes to status lines. This module handles the request ``watch``, which has no effect
on the tick. After any other request, the program gets one status line, which belongs to the tick
that took the request. The status line after a request is the controller's confirmation. On Linux
the kernel reports the user who sends a datagram. Controller and program accept only datagrams from
their own user and from root.
"""

import fcntl
import itertools
import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from handctl.errors import BusError
from handctl.runtime.socket_paths import is_socket_served, mailbox_path, watcher_path
from handctl.runtime.socket_peers import receive_datagram, request_sender_credentials

MAX_REQUEST_BYTES = 4096
"""Largest size of a request [bytes].

A larger request is truncated, and then refused as invalid JSON.
"""
STOP_REQUEST, CUT_REQUEST, CLEAR_REQUEST = (
    f'{{"do": "{word}"}}' for word in ("stop", "cut", "clear")
)
"""Requests as texts, for the modules that send them."""
SUBSCRIBE_REQUEST = b'{"do": "watch"}'
MAX_WATCHERS = 16
"""Largest number of programs that are allowed to subscribe to status lines.

Each further program gets a single status line for each ``watch`` that it sends.
"""
MAX_STATUS_BYTES = 65536
"""Longest status line [bytes]."""
SEND_RETRY_PERIOD_S = 0.05
"""Pause before a request is sent again [s], because the controller has not started yet or its mailbox is full."""
MAX_REQUESTS_PER_TICK = 16
"""Largest number of requests that the controller reads in a tick.

Because of the limit, a flood of requests cannot delay a tick.
"""
RUN_FOLDER_ADVICE = "HANDCTL_RUN_DIR with a short path to a writable folder"


class Mailbox:
    """Receiving end of the mailbox, owned by the controller.

    Attributes:
        path: path of the socket.
        socket: Unix datagram socket.
        watchers: socket paths of the programs that have subscribed to status lines.
        askers: socket paths of the programs that get only the next status line, because the last
            call of ``read_requests`` took their requests.
    """

    def __init__(self, name: str) -> None:
        """Bind the socket of the controller of bus ``name``, and lock the bus.

        Raises:
            BusError: another controller is running on this bus, or the socket cannot be created.
        """
        self.path = mailbox_path(name)
        with ExitStack() as exit_stack:
            try:
                self._lock = _lock_bus(name)
                exit_stack.callback(os.close, self._lock)
                self.path.unlink(missing_ok=True)
                self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
                exit_stack.callback(self.socket.close)
                request_sender_credentials(self.socket)
                self.socket.bind(str(self.path))
            except OSError as error:
                raise _lock_error(name, error) from None
            exit_stack.pop_all()
        self.socket.setblocking(False)
        self.watchers: list[str] = []
        self.askers: list[str] = []

    def read_requests(self) -> tuple[str, ...]:
        """Return the waiting requests, the oldest first, but at most ``MAX_REQUESTS_PER_TICK``."""
        texts: list[str] = []
        if self.askers:
            self.askers = []
        for _ in range(MAX_REQUESTS_PER_TICK):
            try:
                data, sender, is_own_user = receive_datagram(self.socket, MAX_REQUEST_BYTES)
            except BlockingIOError:
                break
            if not is_own_user:
                continue
            if data == SUBSCRIBE_REQUEST and sender:
                if sender in self.watchers:
                    continue
                if len(self.watchers) < MAX_WATCHERS:
                    self.watchers.append(sender)
                else:  # no more programs can subscribe, so the sender of the request gets a single status line
                    self.askers.append(sender)
                continue
            texts.append(data.decode("utf-8", "replace"))
            if sender:
                self.askers.append(sender)
        return tuple(texts)

    def publish_status(self, status_line: dict[str, Any]) -> None:
        """Send a status line to all programs that have subscribed to status lines or have sent a request.

        If the socket of a watcher no longer exists, the watcher is removed from ``watchers``.
        """
        line = json.dumps(status_line).encode()
        for listener in {*self.watchers, *self.askers}:
            try:
                self.socket.sendto(line, socket.MSG_DONTWAIT, listener)
            except BlockingIOError:  # a program that reads too slowly misses this status line
                continue
            except OSError:
                self.watchers = [watcher for watcher in self.watchers if watcher != listener]

    def close(self) -> None:
        """Remove the socket of the controller, and release the lock of the bus."""
        self.socket.close()
        self.path.unlink(missing_ok=True)
        os.close(self._lock)


@contextmanager
def bus_lock(name: str) -> Iterator[None]:
    """Lock a bus, so that no other controller can use the bus. This function opens no mailbox for requests.

    Raises:
        BusError: another controller uses the bus, or the lock cannot be created.
    """
    try:
        lock = _lock_bus(name)
    except OSError as error:
        raise _lock_error(name, error) from None
    try:
        yield
    finally:
        os.close(lock)


def _lock_error(name: str, error: OSError) -> BusError:
    """Return the error for a bus that cannot be locked."""
    if isinstance(error, BlockingIOError):
        return BusError(
            "another controller runs here", f"bus {name}", "one controller per bus: handctl stop"
        )
    return BusError(
        f"cannot receive requests: {error}", str(mailbox_path(name).parent), RUN_FOLDER_ADVICE
    )


def _lock_bus(name: str) -> int:
    """Lock a bus, and return the file descriptor of the lock.

    When this process ends, the kernel releases the lock.

    Raises:
        BlockingIOError: another process has locked the bus.
    """
    path = mailbox_path(name).with_suffix(".lock")
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def is_running(name: str) -> bool:
    """Return True if a running controller takes requests for a bus.

    A socket that a killed controller has left behind does not count.
    """
    return is_socket_served(mailbox_path(name))


class RequestSender:
    """Sender of requests that need no reply from the controller."""

    def __init__(self, name: str) -> None:
        """Open a socket for requests to the controller of bus ``name``. The controller can also start later."""
        self._path = str(mailbox_path(name))
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self, data: bytes) -> bool:
        """Send a request. If the mailbox of the controller is full, return False.

        Raises:
            OSError: no controller is running.
        """
        try:
            self._socket.sendto(data, self._path)
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class StatusWatcher:
    """Socket on which a program receives the status lines of a running controller.

    Attributes:
        name: bus of the controller.
        path: path of the socket of this watcher.
        socket: Unix datagram socket.
    """

    _numbers = itertools.count()

    def __init__(self, name: str) -> None:
        """Bind a socket to watch the controller of bus ``name``. The controller can also start later.

        Raises:
            BusError: the socket cannot be created.
        """
        self.name = name
        self.path = watcher_path(next(self._numbers))
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self.path.unlink(missing_ok=True)
            request_sender_credentials(self.socket)
            self.socket.bind(str(self.path))
        except OSError as error:
            self.socket.close()
            raise BusError(
                f"cannot receive replies: {error}", str(self.path.parent), RUN_FOLDER_ADVICE
            ) from None

    def request_status_line(self, timeout_s: float) -> dict[str, Any] | None:
        """Request a new status line from the controller, and return the status line.

        If the status line does not arrive within the timeout [s], return None.
        """
        self.discard_status_lines()
        try:
            self.send(SUBSCRIBE_REQUEST, timeout_s)
        except OSError:
            time.sleep(min(timeout_s, SEND_RETRY_PERIOD_S))
            return None
        return self.next_status_line(timeout_s)

    def send(self, data: bytes, timeout_s: float) -> None:
        """Send a datagram to the controller.

        The datagram is sent from the socket of the watcher, so that the controller can answer.

        Args:
            data: content of the datagram.
            timeout_s: longest time to wait for free space in the mailbox of the controller [s].

        Raises:
            OSError: no controller is running, or the mailbox stayed full.
        """
        self.socket.settimeout(timeout_s)
        self.socket.sendto(data, str(mailbox_path(self.name)))

    def next_status_line(self, timeout_s: float) -> dict[str, Any] | None:
        """Return the next unread status line, or None if no status line arrives within the timeout [s]."""
        self.socket.settimeout(timeout_s)
        try:
            data, _, is_own_user = receive_datagram(self.socket, MAX_STATUS_BYTES)
        # With a timeout of 0, the error is a BlockingIOError.
        except (TimeoutError, BlockingIOError):
            return None
        if not is_own_user:
            return None
        line: dict[str, Any] = json.loads(data)
        return line

    def status_lines(self, timeout_s: float) -> Iterator[dict[str, Any]]:
        """Yield the status lines that arrive until the timeout [s] has passed."""
        end = time.monotonic() + timeout_s
        while (remaining_s := end - time.monotonic()) > 0.0:
            line = self.next_status_line(remaining_s)
            if line is not None:
                yield line

    def discard_status_lines(self) -> None:
        """Discard the status lines that have arrived but were not read."""
        self.socket.setblocking(False)
        try:
            while self.socket.recv(MAX_STATUS_BYTES):
                pass
        except BlockingIOError:
            return

    def close(self) -> None:
        """Remove the socket.

        When the controller sends the next status line, the controller removes this watcher from its
        list.
        """
        self.socket.close()
        self.path.unlink(missing_ok=True)
