"""Sync of a file to disk without waiting.

Under load, a sync takes longer than the pipe can buffer records.

A process forked from the recorder calls fdatasync. This process has only the file open, and ends
with the recorder.
"""

import itertools
import os
from contextlib import suppress

_READ_BYTES = 1 << 10
"""Largest number of waiting requests read at once. Each request is one byte."""
_MAX_DESCRIPTORS = 1 << 16
"""Upper limit of the file descriptors to close."""


def sync_now(descriptor: int) -> None:
    """Sync a file to disk, and wait until this is done.

    Raises:
        OSError: the sync failed.
    """
    getattr(os, "fdatasync", os.fsync)(descriptor)


class Syncer:
    """Function object that starts a sync of a file to disk. An error is raised at a later call."""

    def __init__(self) -> None:
        """Start without a sync process."""
        self._request_pipe = self._error_pipe = -1

    def __call__(self, descriptor: int) -> None:
        """Request a sync of the file to disk.

        All requests during a sync are served by one further sync.

        Raises:
            OSError: an earlier sync failed.
        """
        if self._request_pipe < 0:
            self._start(descriptor)
        with suppress(BlockingIOError):
            error = os.read(self._error_pipe, 1)
            if error and error[0]:
                raise OSError(error[0], os.strerror(error[0]))
        with suppress(BlockingIOError, BrokenPipeError):
            os.write(self._request_pipe, b"\0")

    def _start(self, descriptor: int) -> None:
        """Fork the process that syncs the file."""
        requests, self._request_pipe = os.pipe()
        self._error_pipe, errors = os.pipe()
        if os.fork() == 0:
            try:
                _close_all_but(descriptor, requests, errors)
                _serve(descriptor, requests, errors)
            finally:
                os._exit(0)
        os.close(requests)
        os.close(errors)
        os.set_blocking(self._request_pipe, False)
        os.set_blocking(self._error_pipe, False)


def _close_all_but(*descriptors: int) -> None:
    """Close all other file descriptors in the forked process.

    With these descriptors open, the controller would not notice a dead recorder, and the disk space
    reserved by the recorder could not be freed.
    """
    edges = [-1, *sorted(descriptors), _MAX_DESCRIPTORS]
    for low, high in itertools.pairwise(edges):
        os.closerange(low + 1, high)


def _serve(descriptor: int, requests: int, errors: int) -> None:
    """Serve sync requests until the other end of the pipe is closed.

    One sync to disk serves all waiting requests.
    """
    while os.read(requests, _READ_BYTES):
        try:
            sync_now(descriptor)
        except OSError as error:
            os.write(errors, bytes([min(error.errno or 255, 255)]))
            return
