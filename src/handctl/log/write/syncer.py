"""Brings a file to the disk without waiting for the disk, which under load takes longer than the pipe has room.

A process forked off the recorder calls fdatasync; it holds nothing but the file, and ends with the recorder.
"""

import itertools
import os
from contextlib import suppress

_ROOM = 1 << 10
_MOST_DESCRIPTORS = 1 << 16


def sync_now(descriptor: int) -> None:
    """Bring a file to the disk and wait for it.

    Raises:
        OSError: it could not be.
    """
    getattr(os, "fdatasync", os.fsync)(descriptor)


class Syncer:
    """Called with the descriptor of one file again and again; errors come with a later call."""

    def __init__(self) -> None:
        self._ask = self._told = -1

    def __call__(self, descriptor: int) -> None:
        """Ask for the file to be brought to the disk; it may still be asked for by the call before.

        Raises:
            OSError: an earlier call failed.
        """
        if self._ask < 0:
            self._start(descriptor)
        with suppress(BlockingIOError):
            found = os.read(self._told, 1)
            if found and found[0]:
                raise OSError(found[0], os.strerror(found[0]))
        with suppress(BlockingIOError, BrokenPipeError):
            os.write(self._ask, b"\0")

    def _start(self, descriptor: int) -> None:
        asked, self._ask = os.pipe()
        self._told, telling = os.pipe()
        if os.fork() == 0:
            try:
                _close_all_but(descriptor, asked, telling)
                _serve(descriptor, asked, telling)
            finally:
                os._exit(0)
        os.close(asked)
        os.close(telling)
        os.set_blocking(self._ask, False)
        os.set_blocking(self._told, False)


def _close_all_but(*kept: int) -> None:
    """Else the controller would not notice the death of the recorder, and a full disk not get its ballast back."""
    edges = [-1, *sorted(kept), _MOST_DESCRIPTORS]
    for low, high in itertools.pairwise(edges):
        os.closerange(low + 1, high)


def _serve(descriptor: int, asked: int, telling: int) -> None:
    """Until the other end is gone; what was asked for meanwhile is done once."""
    while os.read(asked, _ROOM):
        try:
            sync_now(descriptor)
        except OSError as error:
            os.write(telling, bytes([min(error.errno or 255, 255)]))
            return
