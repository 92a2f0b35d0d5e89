"""A running hand from Python: goals in, states out, over the controller's request socket.

The controller stays a process of its own; this module only sends it what a person could type, so that whatever a
program does is checked, limited and logged in the same way.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from numbers import Real
from types import TracebackType
from typing import Any, Self

from handctl.core.types import LETTING_GO
from handctl.document import validated
from handctl.errors import BusError, ConfigError, DriveError, PowerError, UnconfirmedError
from handctl.printing import escaped
from handctl.programs.requests import REFUSED, HoldTension, MoveDigits
from handctl.runtime.buses.open import real_buses
from handctl.runtime.confirm import ANSWER_S, follow_until_off, is_off, send_confirmed
from handctl.runtime.mailbox import LARGEST, Watcher, is_running
from handctl.session.buses import named_buses
from handctl.session.defaults import DEFAULT_HAND
from handctl.session.exit_codes import Exit

START_S = 300.0
"""Longest start: commissioning included, on a slow machine; a controller that cannot start ends long before [s]."""
ATTACH_S = 60.0
"""Longest time until a controller that somebody else has started is ready for goals [s]."""
POLL_S = 0.2
"""How long a line is waited for before the started controller is looked at [s]."""
NAME_OF_ASKER = 64
"""Bytes that the name of who asks may add to a request."""
LEAVING = {mode.name for mode in LETTING_GO}
"""Modes in which no goal counts any more."""
A_RUN = "a running handctl run"


def connect(
    hand: str | os.PathLike[str] | None = None, bus: str | Sequence[str] = "local:demo", *arguments: str
) -> "HandClient":
    """Connect to the controller of a bus, starting one if none runs there.

    A controller that is started here ends with this program, however that ends: the hand is relaxed and disarmed.

    Args:
        hand: packaged hand or file, for a controller that is started; needed on a real bus, else ``"jamia"``.
        bus: as ``--bus``; of a hand on several buses all of them, its first bus first.
        arguments: more words for ``handctl run``, e.g. ``"--log", "run.mcap"``; on a real bus ``"--yes"``,
            since nobody is there to be asked whether the hand may move.

    Raises:
        ConfigError: that is no bus, or a real one and no hand is named.
        BusError: there is no place for a socket.
    """
    given = [bus] if isinstance(bus, str) else list(bus)
    specs = list(named_buses(given).values())
    if not specs:
        raise ConfigError("no bus", "bus", "one, as in 'local:demo'")
    if is_running(specs[0]):
        return HandClient(specs[0])
    if hand is None and (real := real_buses(specs)):
        raise ConfigError(f"no hand is named, and {real[0]} may have real motors", "hand", "the hand that is there")
    words = [
        "--hand",
        os.fspath(hand or DEFAULT_HAND),
        *(word for text in given for word in ("--bus", text)),
        "--json",
        "--until-eof",
    ]
    return HandClient(specs[0], [sys.executable, "-m", "handctl.cli", "run", *words, *arguments])


class HandClient:
    """A hand that waits for goals; use as a context manager, from one thread.

    At the end the hand is relaxed and disarmed if its controller was started here or a goal was set; a client that has
    only looked leaves it as it is.

    Attributes:
        bus: by which the controller is called.
        child: the controller's process, if it was started here.
        result: what a run that was started here came to, once it has ended: what ``handctl run --json`` prints, such
            as ``log`` and ``failure``.
    """

    def __init__(self, bus: str, command: Sequence[str] = ()) -> None:
        """See ``connect``; the command starts a controller."""
        self.bus = bus
        self.child: subprocess.Popen[bytes] | None = None
        self.result: dict[str, Any] = {}
        self._live = self._asked = self._closed = self._told = self._off = False
        self._watcher = Watcher(bus)
        self._words = tempfile.TemporaryFile()  # noqa: SIM115
        self._shown, self._last_words = 0, ""
        if command:
            pipe = subprocess.PIPE
            self.child = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=self._words, start_new_session=True
            )  # Ctrl-C is for this program, which then ends the controller

    def __enter__(self) -> Self:
        """Wait until the hand takes goals; commissioning included.

        Raises:
            DriveError: the controller does not start, or takes no goals; in its own words.
        """
        with ExitStack() as undo:
            undo.callback(self._end, False)
            self.wait(phase="live", timeout_s=START_S if self.child else ATTACH_S)
            undo.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end(tell=kind is None)

    def move(
        self, goals: Mapping[str, float] | None = None, /, duration_s: float = 1.0, wait: bool = True,
        **angle_deg: float,
    ) -> None:  # fmt: skip
        """Move digits to joint angles, e.g. ``hand.move(index=30, thumb=10)`` [deg].

        Args:
            goals: the same as a mapping, e.g. ``hand.move({"index": 30})``; both together are one goal.
            duration_s: of the motion, in the hand's time [s].
            wait: return when it is over, not when it begins.
            angle_deg: mean joint angle by digit [deg].

        Raises:
            ConfigError: the goal is refused, e.g. a digit that the hand does not have; the last one stays.
            DriveError: the run has ended, or ends meanwhile, e.g. by a fault; it says why.
            BusError: the controller does not answer.
        """
        angles = _digits("move", goals, angle_deg)
        goal = {"do": "move", "angle_deg": _numbers(angles), **_numbers({"duration_s": duration_s})}
        validated(goal, MoveDigits, "move")
        began_s = self._set_goal(goal)
        while wait and self._acting(ANSWER_S)["t_s"] < began_s + goal["duration_s"]:
            pass

    def hold(
        self, goals: Mapping[str, float] | None = None, /, rate_N_per_s: float = 100.0, **tension_N: float
    ) -> None:
        """Hold tensions, one for all tendons of a digit, e.g. ``hand.hold(index=12)`` [N]; returns at once.

        Args:
            goals: the same as a mapping, e.g. ``hand.hold({"index": 12})``; both together are one goal.
            rate_N_per_s: how fast the tension changes [N/s].
            tension_N: by digit [N].

        Raises:
            ConfigError, DriveError, BusError: see ``move``.
        """
        tensions = _digits("hold", goals, tension_N)
        goal = {"do": "hold", "tension_N": _numbers(tensions), **_numbers({"rate_N_per_s": rate_N_per_s})}
        validated(goal, HoldTension, "hold")
        self._set_goal(goal)

    def state(self, timeout_s: float = ANSWER_S) -> dict[str, Any]:
        """The present state, at most 20 ms old.

        Args:
            timeout_s: how long it is waited for [s].

        Returns:
            Lists in the order of the hand file, None in them where nothing is known: ``q_rad`` by joint [rad]
            with its standard deviation ``q_sigma_rad`` (large where a digit in contact has fewer tendons than joints),
            ``tension_N`` and ``tension_goal_N`` by tendon [N], ``tip_force_N`` with ``tip_force_sigma_N``
            and ``contact`` (bool) by digit [N], ``t_s`` time of the run [s], ``k`` tick, ``late_us`` [us], ``mode``,
            ``phase``, ``events`` of this tick.

        Raises:
            DriveError: the run has ended; it says why.
            BusError: the controller does not say anything.
        """
        end = time.monotonic() + timeout_s
        while True:
            self._refuse_ended()
            line = self._watcher.fresh_line(max(0.0, min(POLL_S, end - time.monotonic())))
            if line is not None:
                self._off |= is_off(line)
                return line
            if time.monotonic() >= end:
                raise BusError("the controller is silent", f"bus {self.bus}", A_RUN)

    def wait(self, phase: str, timeout_s: float) -> dict[str, Any]:
        """Wait until the hand is in a phase; its state then.

        Args:
            phase: its name; ``"live"``: the hand takes goals.
            timeout_s: how long [s].

        Raises:
            DriveError: the run has ended, or it took too long.
        """
        end, seen = time.monotonic() + timeout_s, "nothing heard"
        while (left := end - time.monotonic()) > 0.0:
            self._refuse_ended()
            with suppress(BusError):
                line = self.state(min(POLL_S, left))
                self._live |= line["phase"] == "live"
                if line["phase"] == phase:
                    return line
                seen = f"phase {line['phase']!r}"
        raise DriveError(f"not in phase {phase!r} after {timeout_s:g} s: {seen}", f"bus {self.bus}")

    def close(self) -> None:
        """End as the ``with`` statement does; ``result`` is known after it.

        Raises:
            DriveError: a fault ended the run.
            PowerError: a drive did not confirm that it is disabled: remove its power.
        """
        self._end(tell=True)

    def _set_goal(self, goal: dict[str, Any]) -> float:
        """Ask, and hear what the tick that takes it says; the time of that tick [s]."""
        self._acting(ANSWER_S)
        if (size := len(json.dumps(goal).encode()) + NAME_OF_ASKER) > LARGEST:
            raise ConfigError(f"{size} bytes", goal["do"], f"a request of at most {LARGEST}")
        self._asked = True
        try:
            line, said = send_confirmed(self._watcher, goal)
        except UnconfirmedError:
            self._refuse_ended()
            raise
        if refused := [text for text in said if text.startswith(REFUSED)]:
            raise ConfigError(refused[0].removeprefix(REFUSED), f"the controller of {self.bus}")
        return float(line["t_s"])

    def _acting(self, timeout_s: float) -> dict[str, Any]:
        """The state of a hand that follows goals."""
        line = self.state(timeout_s)
        if line["mode"] in LEAVING:
            self._collect()
            self._refuse_ended()
            raise DriveError(f"the hand takes no goals any more: {line['mode']}", f"bus {self.bus}")
        return line

    def _refuse_ended(self) -> None:
        """Say so if there is nobody to ask any more; what a run says of itself at its end is waited for."""
        self._pass_on()
        if self.child is not None and (self.child.poll() is not None or (self._live and not is_running(self.bus))):
            self._collect()
            self._told = True
            raise self._error()
        if self._closed:
            raise BusError("this client is closed", f"bus {self.bus}", "another handctl.connect")

    def _end(self, tell: bool) -> None:
        """Stop what was started or moved from here, once.

        Args:
            tell: raise whatever ended the run; if not, because something else is being raised, only what needs hands.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if self.child is None and self._asked and not self._off:
                line, _ = send_confirmed(self._watcher, {"do": "stop"}, repeat=True)
                follow_until_off(self._watcher, "stop", line)
        finally:
            self._watcher.close()
            self._collect()
            self._words.close()
        if self.child and (code := self.child.returncode) and not self._told and (tell or code == Exit.REMOVE_POWER):
            raise self._error()

    def _collect(self) -> None:
        """Let a controller that was started here end; it does as soon as its standard input does."""
        if self.child is not None and self.child.stdout and not self.child.stdout.closed:
            out, _ = self.child.communicate()
            self._pass_on()
            with suppress(ValueError):  # one that was killed has said nothing, or half of it
                self.result = json.loads(out)

    def _error(self) -> DriveError:
        """Why the run has ended."""
        code = self.child.returncode if self.child else 0
        killed = f"killed by signal {-code}" if code < 0 else ""
        why = self.result.get("failure") or killed or self._last_words or "it was stopped"
        if code == Exit.REMOVE_POWER:
            return PowerError(why, f"bus {self.bus}", "its power removed")
        return DriveError(f"the controller ended: {why}", f"bus {self.bus}")

    def _pass_on(self) -> None:
        """Say what the controller has said since, where this program says what it has to."""
        if self._words.closed:
            return
        new = os.pread(self._words.fileno(), 1 << 16, self._shown)
        self._shown += len(new)
        if text := new.decode("utf-8", "replace"):
            self._last_words = text.strip().splitlines()[-1].removeprefix("handctl: ") if text.strip() else ""
            print(escaped(text, "\n\t"), end="", file=sys.stderr, flush=True)


def _digits(do: str, goals: object, named: Mapping[str, Any]) -> dict[str, Any]:
    """Values by digit, from a mapping and from keywords.

    Raises:
        ConfigError: no mapping, no digit, or one that is there twice.
    """
    if goals is not None and not isinstance(goals, Mapping):
        raise ConfigError(repr(goals), do, 'digits by name, as in index=30 or {"index": 30}')
    found = {str(name): value for name, value in (goals or {}).items()}
    if twice := found.keys() & named.keys():
        raise ConfigError(f"{min(twice)} is there twice", do, "one value for each digit")
    if not found and not named:
        raise ConfigError("no digit", do, "one at least, as in index=30")
    return found | dict(named)


def _numbers(values: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers of any kind, such as numpy's, as JSON has them; what is none stays, to be refused by its name."""
    plain = dict(values)
    for key, value in values.items():
        if isinstance(value, Real) and not isinstance(value, bool):
            with suppress(OverflowError):
                plain[key] = float(value)
    return plain
