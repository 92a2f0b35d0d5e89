"""Sync of a file to disk.

The caller does not wait for the sync. On a busy machine, a sync can take so long that the pipe to
the recorder becomes full. For this reason, a process that the recorder has forked calls
``fdatasync`` for the log file. In the forked process, only the log file and two pipes are open. The
forked process ends when the recorder ends.
"""

import itertools
import os
from contextlib import suppress

_MAX_READ_BYTES = 1 << 10
"""Largest number of waiting sync requests that one read takes. Each request is one byte."""
_MAX_FILE_DESCRIPTORS = 1 << 16
"""Upper limit of the file descriptors that are closed. All open descriptors are below this limit."""


def sync_to_disk(descriptor: int) -> None:
    """Sync a file to disk, and wait until the sync is done.

    Raises:
        OSError: the sync failed.
    """
    getattr(os, "fdatasync", os.fsync)(descriptor)


class DiskSyncer:
    """Callable object. Each call starts a sync of a file to the disk and does not wait for its end.

    If a sync fails, a later call raises the error.
    """

    def __init__(self) -> None:
        """Start without a sync process."""
        self._request_pipe = self._error_pipe = -1

    def __call__(self, descriptor: int) -> None:
        """Request a sync of the file to disk.

        While a sync is running, new requests for a sync can arrive. One further sync is then
        sufficient for all of the new requests.

        Raises:
            OSError: an earlier sync failed.
        """
        if self._request_pipe < 0:
            self._fork_sync_process(descriptor)
        with suppress(BlockingIOError):
            error = os.read(self._error_pipe, 1)
            if error and error[0]:
                raise OSError(error[0], os.strerror(error[0]))
        with suppress(BlockingIOError, BrokenPipeError):
            os.write(self._request_pipe, b"\0")

    def _fork_sync_process(self, descriptor: int) -> None:
        """Fork the process that syncs the file on request."""
        requests, self._request_pipe = os.pipe()
        self._error_pipe, errors = os.pipe()
        if os.fork() == 0:
            try:
                _close_other_descriptors(descriptor, requests, errors)
                _serve_sync_requests(descriptor, requests, errors)
            finally:
                os._exit(0)
        os.close(requests)
        os.close(errors)
        os.set_blocking(self._request_pipe, False)
        os.set_blocking(self._error_pipe, False)


def _close_other_descriptors(*descriptors: int) -> None:
    """Close all file descriptors of the forked process except the given ones.

    If the forked process kept the pipes of the recorder open, the controller would not notice the
    death of the recorder. If the forked process kept the file of the reserved disk space open, the
    space could not be freed.
    """
    edges = [-1, *sorted(descriptors), _MAX_FILE_DESCRIPTORS]
    for low, high in itertools.pairwise(edges):
        os.closerange(low + 1, high)


def _serve_sync_requests(descriptor: int, requests: int, errors: int) -> None:
    """Serve sync requests until the recorder closes its end of the request pipe, or until a sync fails.

    A single sync serves all requests that are waiting.
    """
    while os.read(requests, _MAX_READ_BYTES):
        try:
            sync_to_disk(descriptor)
        except OSError as error:
            os.write(errors, bytes([min(error.errno or 255, 255)]))
            return
