"""Transfer of a file to the disk without waiting.

Under load the disk needs longer than the pipe can buffer.

A process forked from the recorder calls fdatasync. It holds only the file, and ends with the
recorder.
"""

import itertools
import os
from contextlib import suppress

_READ_BYTES = 1 << 10
"""Waiting requests read at once [bytes], one byte per request."""
_MAX_DESCRIPTORS = 1 << 16
"""Upper bound of the descriptors to close."""


def sync_now(descriptor: int) -> None:
    """Write a file to the disk and wait.

    Raises:
        OSError: the transfer failed.
    """
    getattr(os, "fdatasync", os.fsync)(descriptor)


class Syncer:
    """Transfers one file to the disk, once per call. An error appears at a later call."""

    def __init__(self) -> None:
        """Start without a process."""
        self._request_pipe = self._error_pipe = -1

    def __call__(self, descriptor: int) -> None:
        """Request a transfer of the file.

        Requests during a transfer are served by one further transfer.

        Raises:
            OSError: an earlier transfer failed.
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
        """Fork the process that transfers the file."""
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
    """Close all other descriptors in the forked process.

    Otherwise the controller would not notice the death of the recorder, and a full disk would not
    get its reserve back.
    """
    edges = [-1, *sorted(descriptors), _MAX_DESCRIPTORS]
    for low, high in itertools.pairwise(edges):
        os.closerange(low + 1, high)


def _serve(descriptor: int, requests: int, errors: int) -> None:
    """Wait for requests until the other end is closed.

    Several waiting requests need one transfer.
    """
    while os.read(requests, _READ_BYTES):
        try:
            sync_now(descriptor)
        except OSError as error:
            os.write(errors, bytes([min(error.errno or 255, 255)]))
            return
