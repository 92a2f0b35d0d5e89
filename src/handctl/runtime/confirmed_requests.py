"""Requests to a running controller. The controller confirms each request.

A request does not reach the controller in three cases: the controller is paused, the mailbox of the
controller is full, or the socket belongs to a killed process. Every request contains a unique name.
The controller confirms a request by a status line that contains the name of the request.
"""

import itertools
import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from handctl.core.tick_types import HandMode
from handctl.errors import REMOVE_POWER, BusError, PowerError, UnconfirmedError
from handctl.programs.requests import events_for_request
from handctl.runtime.buses.bus_opening import LOCAL_BUS_PREFIX
from handctl.runtime.mailbox import SEND_RETRY_PERIOD_S, SUBSCRIBE_REQUEST, StatusWatcher
from handctl.runtime.socket_paths import mailbox_path

CONFIRMATION_TIMEOUT_S = 2.0
"""Longest wait for a confirmation [s].

A controller that relaxes its hand after a stop request can also be silent for this time.
"""
REQUEST_REPEAT_PERIOD_S = 0.25
"""Time after which a request is sent again [s].

A request is repeated only if a second arrival of the request has no other effect.
"""
DISABLE_TIMEOUT_S = 10.0
"""Longest time from a stop request until all drives have confirmed that they are off, in the run's time [s]."""
CONTROLLER_SILENT_TEXT = "the controller is silent"
MAILBOX_FULL_TEXT = "its mailbox is full"
_request_counter = itertools.count(1)
"""Counter that numbers the requests of this process, so that the names of requests are unique."""

StatusLine = dict[str, Any]


def open_watcher(bus: str, command_word: str) -> StatusWatcher:
    """Open a socket to send one request to the controller of a bus, and to receive the controller's status lines.

    Raises:
        UnconfirmedError: the folder of the sockets cannot be trusted.
    """
    try:
        return StatusWatcher(bus)
    except BusError as error:
        raise UnconfirmedError(bus, command_word, str(error)) from None


@contextmanager
def report_absent_controller(bus: str) -> Iterator[None]:
    """Replace an UnconfirmedError by a BusError if the bus is local and has no mailbox.

    An UnconfirmedError tells the operator to switch off the power. The power of a simulated hand
    need not be switched off. A simulated bus without a mailbox has no controller. A killed
    controller leaves its mailbox behind, so the UnconfirmedError remains if a mailbox exists. On a
    real bus, the UnconfirmedError always remains, because the controller can belong to another
    user.

    Args:
        bus: bus to which the block sends a request.

    Raises:
        BusError: the bus is local, and had no mailbox before the block and none after it.
    """
    is_simulated = bus.startswith(LOCAL_BUS_PREFIX)
    mailbox_may_exist = not is_simulated or os.path.lexists(mailbox_path(bus))
    try:
        yield
    except UnconfirmedError:
        if mailbox_may_exist or os.path.lexists(mailbox_path(bus)):
            raise
        raise BusError(
            "no controller runs on this bus", f"bus {bus}", "the first bus of a running handctl run"
        ) from None


def send_with_confirmation(
    watcher: StatusWatcher, request: Mapping[str, Any], is_repeated: bool = False
) -> tuple[StatusLine, list[str]]:
    """Send a request, and wait for the controller's confirmation.

    Args:
        watcher: watcher of the controller.
        request: content of the request, without the name ``by`` of the sender.
        is_repeated: True to send the request repeatedly, even while no controller answers yet.
            Repetition is allowed only if a request that arrives twice has no other effect.

    Returns:
        the status line of the tick in which the controller took the request, and the texts of this
        tick's events about the request. An event text can be a refusal of the request.

    Raises:
        UnconfirmedError: the controller has not confirmed the request.
    """
    name = f"{os.getpid()}-{next(_request_counter)}"
    data = json.dumps({**request, "by": name}).encode()
    wait_end_s = time.monotonic() + CONFIRMATION_TIMEOUT_S
    is_sent = False
    failure_reason = CONTROLLER_SILENT_TEXT
    watcher.discard_status_lines()
    while (remaining_s := wait_end_s - time.monotonic()) > 0.0:
        if is_repeated or not is_sent:
            is_sent, failure_reason = _try_send_request(
                watcher,
                data,
                min(remaining_s, REQUEST_REPEAT_PERIOD_S) if is_repeated else remaining_s,
            )
        if not is_sent:
            if not (is_repeated or failure_reason == MAILBOX_FULL_TEXT):
                break
            time.sleep(min(remaining_s, SEND_RETRY_PERIOD_S))
            continue
        remaining_s = max(0.0, wait_end_s - time.monotonic())
        for line in watcher.status_lines(
            min(remaining_s, REQUEST_REPEAT_PERIOD_S) if is_repeated else remaining_s
        ):
            if (texts := events_for_request(name, line["events"])) is not None:
                return line, texts
    raise UnconfirmedError(watcher.name, str(request["do"]), failure_reason)


def _try_send_request(
    watcher: StatusWatcher, request_bytes: bytes, timeout_s: float
) -> tuple[bool, str]:
    """Send a request once.

    Returns:
        True if the request was sent, and a text. The text is the reason that is reported to the
        user if no confirmation of the request follows.
    """
    try:
        watcher.send(request_bytes, timeout_s)
    except (TimeoutError, BlockingIOError):
        return False, MAILBOX_FULL_TEXT
    except OSError as error:
        return False, f"no controller answers ({os.strerror(error.errno or 0)})"
    return True, CONTROLLER_SILENT_TEXT


def request_action(bus: str, command_word: str) -> StatusLine:
    """Send the request ``clear``, ``stop`` or ``cut`` to a controller.

    After ``stop`` and ``cut``, wait until all drives are disabled.

    Args:
        bus: bus of the controller.
        command_word: request to send.

    Returns:
        the last status line of the controller.

    Raises:
        BusError: the bus is local, and no controller runs on it.
        UnconfirmedError: the controller has not confirmed the request, or has not reported that
            every drive is disabled.
        PowerError: a drive did not confirm that it is disabled.
    """
    watcher = open_watcher(bus, command_word)
    try:
        with report_absent_controller(bus):
            line, _ = send_with_confirmation(watcher, {"do": command_word}, is_repeated=True)
        return (
            line if command_word == "clear" else wait_until_drives_off(watcher, command_word, line)
        )
    finally:
        watcher.close()


def wait_until_drives_off(
    watcher: StatusWatcher, command_word: str, line: StatusLine
) -> StatusLine:
    """Wait until a controller that is stopping its hand reports that every drive is disabled.

    Args:
        watcher: watcher of the controller.
        command_word: the confirmed request.
        line: status line that confirmed the request.

    Returns:
        the last status line of the controller.

    Raises:
        UnconfirmedError: the controller has not reported that every drive is disabled.
        PowerError: a drive did not confirm that it is disabled.
    """
    start_s = float(line["t_s"])
    while True:
        if are_drives_off(line):
            return line
        if line["mode"] == HandMode.DONE.name:
            raise PowerError("; ".join(_mode_event_texts(line)), f"bus {watcher.name}")
        if line["t_s"] > start_s + DISABLE_TIMEOUT_S:
            raise UnconfirmedError(
                watcher.name,
                command_word,
                f"accepted, but the hand is still in mode {line['mode']}",
            )
        next_line = None
        wait_start_s = time.monotonic()
        while next_line is None:
            if time.monotonic() > wait_start_s + CONFIRMATION_TIMEOUT_S:
                raise UnconfirmedError(
                    watcher.name,
                    command_word,
                    f"accepted, but then {CONTROLLER_SILENT_TEXT} in mode {line['mode']}",
                )
            next_line = watcher.next_status_line(0.0) or _subscribe_again(watcher)
        line = next_line


def are_drives_off(line: StatusLine) -> bool:
    """Return True if a status line reports the end of the run, and all drives are disabled."""
    return bool(line["mode"] == HandMode.DONE.name) and not any(
        REMOVE_POWER in text for text in _mode_event_texts(line)
    )


def _mode_event_texts(line: StatusLine) -> list[str]:
    """Return the texts of the events about mode changes in a status line."""
    return [event["text"] for event in line["events"] if event["name"] == "mode"]


def _subscribe_again(watcher: StatusWatcher) -> StatusLine | None:
    """Subscribe to the status lines again, and return the next status line."""
    _try_send_request(watcher, SUBSCRIBE_REQUEST, REQUEST_REPEAT_PERIOD_S)
    return watcher.next_status_line(REQUEST_REPEAT_PERIOD_S)
