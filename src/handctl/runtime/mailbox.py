"""The request socket of a running controller: a Unix datagram socket per bus name, read without blocking.

A program that sends ``{"do": "watch"}`` from a socket of its own gets a status line now and then; that one request
changes nothing, so it ends here and is not given to the tick. Whoever asks anything else from a socket of its own gets
the status line of the tick that took the request: this is the controller's confirmation. On Linux the kernel names the
user of every sender, and only this user and root are heard on either side.
"""

import fcntl
import itertools
import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from handctl.errors import BusError
from handctl.runtime.peers import name_senders, receive
from handctl.runtime.places import mailbox_path, watcher_path

LARGEST = 4096
"""Bytes of a request; the rest of a longer one is lost, and it is refused as not being JSON."""
STOP, CUT, CLEAR = (f'{{"do": "{word}"}}' for word in ("stop", "cut", "clear"))
"""Requests that are sent from several places."""
WATCH = b'{"do": "watch"}'
WATCHERS = 4
"""Programs that may watch at once."""
LARGEST_STATUS = 65536
NOT_THERE_S = 0.05
"""Pause before a controller that is not there yet is asked again [s]."""
PER_TICK = 16
"""Requests read in one tick, so that a flood cannot make a tick long."""
A_FOLDER = "a short path of a folder that can be written in HANDCTL_RUN_DIR"


class Mailbox:
    """Receiving end, owned by the controller."""

    def __init__(self, name: str) -> None:
        """Bind the socket of controller ``name``.

        Raises:
            BusError: another controller of this name is running.
        """
        self.path = mailbox_path(name)
        try:
            self._lock = _taken(name)
            self.path.unlink(missing_ok=True)
            self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            name_senders(self.socket)
            self.socket.bind(str(self.path))
        except OSError as error:
            raise _refused(name, error) from None
        self.socket.setblocking(False)
        self.watchers: list[str] = []
        self.askers: list[str] = []
        """Programs whose requests the last ``read`` has returned."""

    def read(self) -> tuple[str, ...]:
        """All requests that wait, oldest first."""
        texts: list[str] = []
        if self.askers:
            self.askers = []
        for _ in range(PER_TICK):
            try:
                data, sender, ours = receive(self.socket, LARGEST)
            except BlockingIOError:
                break
            if not ours:
                continue
            if data == WATCH and sender:
                others = [watcher for watcher in self.watchers if watcher != sender]
                self.watchers = [*others[-WATCHERS + 1 :], sender]
                continue
            texts.append(data.decode("utf-8", "replace"))
            if sender:
                self.askers.append(sender)
        return tuple(texts)

    def publish(self, status: dict[str, Any]) -> None:
        """Send a status line to everybody who watches or has just asked; whoever is gone is forgotten."""
        line = json.dumps(status).encode()
        for listener in {*self.watchers, *self.askers}:
            try:
                self.socket.sendto(line, socket.MSG_DONTWAIT, listener)
            except BlockingIOError:
                continue
            except OSError:
                self.watchers = [watcher for watcher in self.watchers if watcher != listener]

    def close(self) -> None:
        """Give the name back."""
        self.socket.close()
        self.path.unlink(missing_ok=True)
        os.close(self._lock)


@contextmanager
def held(name: str) -> Iterator[None]:
    """Keep other controllers off a further bus of a hand, on which none takes requests.

    Raises:
        BusError: another controller uses it.
    """
    try:
        lock = _taken(name)
    except OSError as error:
        raise _refused(name, error) from None
    try:
        yield
    finally:
        os.close(lock)


def _refused(name: str, error: OSError) -> BusError:
    """Why a bus cannot be had."""
    if isinstance(error, BlockingIOError):
        return BusError("another controller runs here", f"bus {name}", "one controller a bus: handctl stop")
    return BusError(f"cannot take requests there: {error}", str(mailbox_path(name).parent), A_FOLDER)


def _taken(name: str) -> int:
    """Descriptor of a bus's lock, which lives as long as this process, however it ends.

    Raises:
        BlockingIOError: another process has it.
    """
    path = mailbox_path(name).with_suffix(".lock")
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def answers(name: str) -> bool:
    """Whether a controller takes requests there now; a socket that a killed one left behind does not count."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
        try:
            out.connect(str(mailbox_path(name)))
        except OSError:
            return False
    return True


class Watcher:
    """Receiving end of a program that watches a running controller."""

    _numbers = itertools.count()

    def __init__(self, name: str) -> None:
        """Watch controller ``name``; it need not run yet.

        Raises:
            BusError: there is no place for a socket.
        """
        self.name, self.path = name, watcher_path(next(self._numbers))
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self.path.unlink(missing_ok=True)
            name_senders(self.socket)
            self.socket.bind(str(self.path))
        except OSError as error:
            self.socket.close()
            raise BusError(f"cannot listen there: {error}", str(self.path.parent), A_FOLDER) from None

    def next(self, timeout_s: float) -> dict[str, Any] | None:
        """A status line that is not older than this call; None if none came in time [s]."""
        self.forget()
        try:
            self.send(WATCH, timeout_s)
        except OSError:
            time.sleep(min(timeout_s, NOT_THERE_S))
            return None
        return self.following(timeout_s)

    def send(self, data: bytes, timeout_s: float) -> None:
        """Send a datagram to the controller from this socket, so that the controller can answer.

        Args:
            data: to send.
            timeout_s: longest wait for room in the mailbox [s].

        Raises:
            OSError: nobody is there, or there was no room in time.
        """
        self.socket.settimeout(timeout_s)
        self.socket.sendto(data, str(mailbox_path(self.name)))

    def following(self, timeout_s: float) -> dict[str, Any] | None:
        """The line after the last one, whenever it came; None if none comes in time [s]."""
        self.socket.settimeout(timeout_s)
        try:
            data, _, ours = receive(self.socket, LARGEST_STATUS)
        except (TimeoutError, BlockingIOError):  # the latter if it may take no time at all
            return None
        if not ours:
            return None
        line: dict[str, Any] = json.loads(data)
        return line

    def heard(self, timeout_s: float) -> Iterator[dict[str, Any]]:
        """Each line that comes from now on, as long as somebody listens and time is left [s]."""
        end = time.monotonic() + timeout_s
        while (left := end - time.monotonic()) > 0.0:
            line = self.following(left)
            if line is not None:
                yield line

    def forget(self) -> None:
        """Throw lines away that wait from before."""
        self.socket.setblocking(False)
        try:
            while self.socket.recv(LARGEST_STATUS):
                pass
        except BlockingIOError:
            return

    def close(self) -> None:
        """Watch no more."""
        self.socket.close()
        self.path.unlink(missing_ok=True)
