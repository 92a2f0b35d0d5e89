"""A running hand from Python: goals in, states out, over the controller's request socket.

The controller stays a process of its own; this module only sends it what a person could type, so that whatever a
program does is checked, limited and logged in the same way.
"""

import json
import subprocess
import sys
import time
from types import TracebackType
from typing import Any, Self

from handctl.errors import BusError, ConfigError, DriveError
from handctl.runtime.mailbox import Watcher, answers, send_request

START_S = 60.0
"""Longest start: commissioning included."""
STOP_S = 10.0
ANSWER_S = 2.0
"""Longest time in which a controller takes a goal, or refuses it [s]."""
TAKEN, REFUSED = "asked: ", "refused: "
"""How the events begin by which it does; what it cannot read has neither."""
POLL_S = 0.2
"""How long a line is waited for before the started controller is looked at [s]."""


def connect(hand: str = "jamia", bus: str = "local:demo", *arguments: str) -> "HandClient":
    """Connect to the controller of a bus, starting one if none runs there.

    Args:
        hand: packaged hand or file; for a controller that is started.
        bus: as ``--bus``.
        arguments: more words for ``handctl run``, e.g. ``"--log", "run.mcap"``.

    Raises:
        DriveError: the controller does not start; its own words say why.
    """
    child = None
    if not answers(bus):
        command = [sys.executable, "-m", "handctl.cli", "run", "--hand", hand, "--bus", bus, "--json", *arguments]
        child = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
    return HandClient(bus, child)


class HandClient:
    """A hand that waits for goals; use as a context manager: it is relaxed and disarmed at the end."""

    def __init__(self, bus: str, child: "subprocess.Popen[bytes] | None") -> None:
        self.bus, self.child = bus, child
        self.result: dict[str, Any] = {}
        self._watcher = Watcher(bus)

    def __enter__(self) -> Self:
        try:
            self.wait(phase="live", timeout_s=START_S)
        except DriveError:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def move(self, duration_s: float = 1.0, wait: bool = True, **angle_deg: float) -> None:
        """Move digits to joint angles, e.g. ``hand.move(index=30, thumb=10)`` [deg]; returns when that time is over.

        Raises:
            ConfigError: the controller refuses, e.g. a digit that the hand does not have.
            BusError: it does not answer.
        """
        self._set_goal({"do": "move", "angle_deg": angle_deg, "duration_s": duration_s})
        if wait:
            time.sleep(duration_s)

    def hold(self, rate_N_per_s: float = 100.0, **tension_N: float) -> None:
        """Hold tensions, one for all tendons of a digit, e.g. ``hand.hold(index=12)`` [N].

        Raises:
            ConfigError, BusError: see ``move``.
        """
        self._set_goal({"do": "hold", "tension_N": tension_N, "rate_N_per_s": rate_N_per_s})

    def state(self, timeout_s: float = 2.0) -> dict[str, Any]:
        """The next status line: mode, phase, q_rad, tension_N, tip_force_N, contact.

        Raises:
            BusError: the controller does not say anything.
        """
        line = self._watcher.next(timeout_s)
        if line is None:
            raise BusError("the controller is silent", f"bus {self.bus}", "a running handctl run")
        return line

    def wait(self, phase: str, timeout_s: float) -> dict[str, Any]:
        """Wait until the hand is in a phase; its state then.

        Raises:
            DriveError: the controller ended, or it took too long.
        """
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            if self.child is not None and self.child.poll() is not None:
                raise DriveError("the controller ended", f"bus {self.bus}", "see its message above")
            line = self._watcher.next(POLL_S)
            if line is not None and line["phase"] == phase:
                return line
        raise DriveError(f"not in phase {phase!r} after {timeout_s:g} s", f"bus {self.bus}")

    def close(self) -> None:
        """Relax, disarm; wait for a controller that was started here, whose result is then in ``result``."""
        try:
            self._ask({"do": "stop"})
        except BusError:
            pass
        finally:
            self._watcher.close()
        if self.child is not None:
            out, _ = self.child.communicate(timeout=STOP_S + START_S)
            self.result = json.loads(out) if out else {}

    def _set_goal(self, request: dict[str, Any]) -> None:
        """Ask, and hear what the tick that takes it says."""
        self._watcher.next(ANSWER_S)
        self._ask(request)
        for events in self._watcher.heard(ANSWER_S):
            said = [event["text"] for event in events if event["name"] == "request"]
            unread = [] if any(text.startswith(TAKEN) for text in said) else said
            if refused := [text for text in said if text.startswith(REFUSED)] or unread:
                raise ConfigError(refused[0].removeprefix(REFUSED), f"the controller of {self.bus}")
            if said:
                return
        raise BusError("the controller does not answer", f"bus {self.bus}", "a running handctl run")

    def _ask(self, request: dict[str, Any]) -> None:
        send_request(self.bus, json.dumps(request))
