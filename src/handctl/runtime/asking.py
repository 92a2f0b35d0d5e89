"""Asking a running controller for something: done only when the controller itself has said so.

A datagram that was sent says nothing: the controller may be paused, its mailbox full, or its socket left behind by one
that was killed. So every request bears the name of who asks, and counts once a status line repeats that name.
"""

import itertools
import json
import os
import time
from collections.abc import Mapping
from typing import Any

from handctl.core.types import Mode
from handctl.errors import REMOVE_POWER, BusError, PowerError, UnconfirmedError
from handctl.programs.requests import said_of
from handctl.runtime.mailbox import NOT_THERE_S, WATCH, Watcher

ANSWER_S = 2.0
"""Longest time in which a controller takes a request, and longest silence of one that lets go [s]."""
AGAIN_S = 0.25
"""A request that may come twice is repeated after this time [s]."""
LET_GO_S = 10.0
"""Longest way of a hand from the stop to the last drive's confirmation, in the hand's time [s]."""
SILENT, FULL = "the controller is silent", "its mailbox is full"
_numbers = itertools.count(1)
"""Of this process: every request has a name of its own."""

Line = dict[str, Any]


def watching(bus: str, word: str) -> Watcher:
    """Return a watcher of the controller that is to be asked for something.

    Raises:
        UnconfirmedError: there is no place for a socket that can be trusted.
    """
    try:
        return Watcher(bus)
    except BusError as error:
        raise UnconfirmedError(bus, word, str(error)) from None


def confirmed(watcher: Watcher, request: Mapping[str, Any], repeat: bool = False) -> tuple[Line, list[str]]:
    """Send a request, and wait until the controller says that it has taken it.

    Args:
        watcher: of the controller.
        request: without ``by``.
        repeat: send it again and again, also to a controller that is not there yet: for what may arrive twice.

    Returns:
        the status line of the tick that took the request, and what that tick says of it: possibly a refusal.

    Raises:
        UnconfirmedError: the controller has not said that it has.
    """
    me = f"{os.getpid()}-{next(_numbers)}"
    data = json.dumps({**request, "by": me}).encode()
    end, sent, why = time.monotonic() + ANSWER_S, False, SILENT
    watcher.forget()
    while (left := end - time.monotonic()) > 0.0:
        if repeat or not sent:
            sent, why = _sent(watcher, data, min(left, AGAIN_S) if repeat else left)
        if not sent:
            if not (repeat or why == FULL):
                break
            time.sleep(min(left, NOT_THERE_S))
            continue
        left = max(0.0, end - time.monotonic())
        for line in watcher.heard(min(left, AGAIN_S) if repeat else left):
            if (said := said_of(me, line["events"])) is not None:
                return line, said
    raise UnconfirmedError(watcher.name, str(request["do"]), why)


def _sent(watcher: Watcher, data: bytes, timeout_s: float) -> tuple[bool, str]:
    """Send once; whether it was sent, and what is wrong if nothing more comes."""
    try:
        watcher.send(data, timeout_s)
    except (TimeoutError, BlockingIOError):
        return False, FULL
    except OSError as error:
        return False, f"no controller answers ({os.strerror(error.errno or 0)})"
    return True, SILENT


def ordered(bus: str, word: str) -> Line:
    """Order a controller to ``clear``, or to ``stop`` or ``cut`` and follow the hand until it has let go.

    Args:
        bus: of the controller.
        word: the order.

    Returns:
        the controller's last status line.

    Raises:
        UnconfirmedError: the controller has not taken the order, or has fallen silent before the hand had let go.
        PowerError: a drive did not confirm that it is disabled.
    """
    watcher = watching(bus, word)
    try:
        line, _ = confirmed(watcher, {"do": word}, repeat=True)
        return line if word == "clear" else follow_to_the_end(watcher, word, line)
    finally:
        watcher.close()


def follow_to_the_end(watcher: Watcher, word: str, line: Line) -> Line:
    """Follow a hand that lets go until its controller says that every drive is off; the last line.

    Args:
        watcher: of the controller.
        word: what was ordered.
        line: with which the order was confirmed.

    Raises:
        UnconfirmedError: nobody has said so.
        PowerError: a drive did not confirm that it is disabled.
    """
    began_s = float(line["t_s"])
    while True:
        if is_off(line):
            return line
        if line["mode"] == Mode.DONE.name:
            raise PowerError("; ".join(_told_of_modes(line)), f"bus {watcher.name}")
        if line["t_s"] > began_s + LET_GO_S:
            raise UnconfirmedError(watcher.name, word, f"taken, and the hand is still in mode {line['mode']}")
        new, heard = None, time.monotonic()
        while new is None:
            if time.monotonic() > heard + ANSWER_S:
                raise UnconfirmedError(watcher.name, word, f"taken, and then {SILENT} in mode {line['mode']}")
            new = watcher.following(0.0) or _watched(watcher)
        line = new


def is_off(line: Line) -> bool:
    """Return whether a controller says in a line that its run is over and every drive is off."""
    return bool(line["mode"] == Mode.DONE.name) and not any(REMOVE_POWER in text for text in _told_of_modes(line))


def _told_of_modes(line: Line) -> list[str]:
    """Return the texts of a line's changes of mode."""
    return [event["text"] for event in line["events"] if event["name"] == "mode"]


def _watched(watcher: Watcher) -> Line | None:
    """Ask for lines again, and wait for one."""
    _sent(watcher, WATCH, AGAIN_S)
    return watcher.following(AGAIN_S)
