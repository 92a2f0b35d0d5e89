"""Client that moves a running hand, streams targets to the hand, and reads the hand's observations.

The controller of the hand is a separate process. The client sends the same requests as the commands
of ``handctl``. The controller checks, limits and logs the requests of clients and commands in the
same way.
"""

import itertools
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from numbers import Real
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, get_args

from handctl.client.fingertips import Fingertips, FingertipStream
from handctl.client.heartbeat import HEARTBEATS_PER_LEASE, Heartbeat
from handctl.client.observation import Observation
from handctl.client.stream import TargetStream
from handctl.core.tick_types import SHUTDOWN_MODES
from handctl.document import validate_content
from handctl.errors import BusError, ConfigError, DriveError, PowerError, UnconfirmedError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_from_content, load_hand, parse_toml
from handctl.printing import escape_text
from handctl.programs.requests import (
    LONGEST_LEASE_S,
    REFUSAL_EVENT_PREFIX,
    SHORTEST_LEASE_S,
    HoldTensionRequest,
    MoveDigitsRequest,
    OpenStreamRequest,
)
from handctl.programs.stream_plans import target_horizon_s
from handctl.programs.task import HoldPhase
from handctl.runtime.confirmed_requests import (
    CONFIRMATION_TIMEOUT_S,
    are_drives_off,
    send_with_confirmation,
    wait_until_drives_off,
)
from handctl.runtime.mailbox import MAX_REQUEST_BYTES, StatusWatcher, is_running
from handctl.runtime.observations import ObservationReader
from handctl.runtime.target_socket import TargetSender, stream_name
from handctl.session.buses import parse_bus_arguments, refuse_default_hand
from handctl.session.default_hand import DEFAULT_HAND
from handctl.session.exit_codes import ExitCode
from handctl.session.task_loading import load_task_for_hand

StreamSpace = Literal["joint", "digit", "tension", "tip_force", "fingertip"]
"""Meaning of the values of a target, see ``HandClient.stream``."""
START_TIMEOUT_S = 300.0
"""Longest time until a controller accepts goals, if the client has started the controller [s].

The start timeout is enough for commissioning on a slow machine. If a controller cannot start, its
process ends much earlier, which ends the wait.
"""
ATTACH_TIMEOUT_S = 60.0
"""Longest time until a controller accepts goals, if another process has started the controller [s]."""
OBSERVATION_POLL_PERIOD_S = 50e-6
"""Pause between two reads of the shared memory that contains the observations [s]."""
STATE_POLL_PERIOD_S = 0.2
"""Longest wait for a status line of the controller [s].

If no status line arrives in this time, the client checks that the controller still runs.
"""
SENDER_NAME_BYTES = 64
"""Largest number of bytes that the name of the sending client adds to a request."""
DEFAULT_LEASE_S = 2.0
"""Default lease [s].

On a busy machine, the thread that renews the lease can be late. The default lease is longer than
such a delay.
"""
SHUTDOWN_MODE_NAMES = {mode.name for mode in SHUTDOWN_MODES}
"""Modes of the hand in which the controller follows no goals."""
EXPECTED_CONTROLLER_TEXT = "a running handctl run"
"""Text of the expected state in an error about a silent controller."""
CONFIRMATION_OPTION = "--yes"
"""Argument of ``handctl run`` by which the operator allows a hand on a real bus to move."""
_client_number_counter = itertools.count(1)
"""Counter that numbers the clients and streams of this process."""


def connect(
    hand: str | os.PathLike[str] | None = None,
    bus: str | Sequence[str] = "local:demo",
    *arguments: str,
    lease_s: float | None = DEFAULT_LEASE_S,
    watchdog_s: float | None = None,
) -> "HandClient":
    """Return a client for the hand on a bus. If no controller runs on the bus, start a controller.

    If this function has started the controller, the controller ends when the calling program ends
    or crashes. Before the controller ends, it relaxes and disarms the hand. If another process has
    started the controller, a lease protects the hand.

    If the program that commands the hand is killed or suspended, it no longer renews the lease.
    When the lease of a client has expired, moving digits come to rest. If the lease is not renewed
    for twice the time ``lease_s``, the hand relaxes.

    Args:
        hand: name of a packaged hand, or path of a hand file, for a new controller. On a real bus,
            this argument is required. On other buses, the default is the packaged hand ``"jamia"``.
            If a controller is already running, it must control a hand of this name.
        bus: bus as for the option ``--bus``. For a hand with several buses, give all buses. The
            first bus of the hand comes first.
        arguments: further arguments of ``handctl run``, e.g. ``"--log", "run.mcap"``. On a real
            bus, ``"--yes"`` allows the hand to move. A controller that already runs has its own
            arguments, so a client of a running controller is allowed to give only ``"--yes"``.
        lease_s: longest time without a renewal of the lease, in the time of the hand [s], from 0.2
            to 3600. A thread of the client renews the lease. If ``lease_s`` is None, the hand keeps
            its last goal without a time limit.
        watchdog_s: longest time during which the program is allowed to neither call the client nor
            send a target [s]. After this time, the client's thread no longer renews the lease. As a
            result, a program that hangs also loses its lease. If ``watchdog_s`` is None, the
            program is allowed to be idle for any time.

    Raises:
        ConfigError: the bus, the lease or the watchdog is invalid, or the bus is real and no hand
            is given, or there are arguments for a controller that already runs.
        BusError: the socket for requests to the controller cannot be created.
    """
    _check_lease(lease_s, watchdog_s)
    buses = [bus] if isinstance(bus, str) else list(bus)
    bus_specs = list(parse_bus_arguments(buses).values())
    if not bus_specs:
        raise ConfigError("no bus", "bus", "one, as in 'local:demo'")
    if is_running(bus_specs[0]):
        if other_arguments := [text for text in arguments if text != CONFIRMATION_OPTION]:
            location = f"arguments for the controller that already runs on {bus_specs[0]}"
            remedy = f"none, or first handctl stop --bus {bus_specs[0]}"
            raise ConfigError(" ".join(other_arguments), location, remedy)
        expected_hand_name = None if hand is None else load_hand(os.fspath(hand)).name
        return HandClient(bus_specs[0], (), lease_s, watchdog_s, expected_hand_name)
    if hand is None:
        refuse_default_hand(bus_specs, "hand")
    options = [
        "--hand",
        os.fspath(hand or DEFAULT_HAND),
        *(option for text in buses for option in ("--bus", text)),
        "--json",
        "--until-eof",
    ]
    command = [sys.executable, "-m", "handctl.cli", "run", *options, *arguments]
    return HandClient(bus_specs[0], command, lease_s, watchdog_s)


def _check_lease(lease_s: float | None, watchdog_s: float | None) -> None:
    """Check the lease time and the watchdog time of a client.

    Raises:
        ConfigError: a time is not a number within its limits, or there is a watchdog but no lease.
    """
    limits = f"{SHORTEST_LEASE_S:g} to {LONGEST_LEASE_S:g} s"
    for name, seconds in (("lease_s", lease_s), ("watchdog_s", watchdog_s)):
        is_number = isinstance(seconds, Real) and not isinstance(seconds, bool)
        if seconds is not None and not (
            is_number and SHORTEST_LEASE_S <= seconds <= LONGEST_LEASE_S
        ):
            raise ConfigError(repr(seconds), name, f"{limits}, or None")
    if watchdog_s is not None and lease_s is None:
        raise ConfigError("no lease", "watchdog_s", f"lease_s of {limits}")


class HandClient:
    """Client of one hand.

    Use the client as a context manager. Several threads of a program can share a client.

    At any time, only one client is allowed to move the hand. Any number of clients can observe the
    hand. The first client that moves the hand gets the right to move the hand. The client keeps the
    right to move the hand until the client closes, or until another client calls ``take_over``.

    If the client has started the controller, the hand is relaxed and disarmed when the client
    closes. If another process has started the controller, the hand stays armed. If the client was
    moving the hand when the client closed, the hand comes to rest.

    Attributes:
        bus: bus of the controller.
        name: name of this client, which the controller knows. Other clients see this name in error
            messages when the controller refuses their commands.
        child: controller process, or None if another process has started the controller.
        result: output of ``handctl run --json``, e.g. ``log`` and ``failure``. The output is
            available after the end of a run that this client has started.
    """

    def __init__(
        self,
        bus: str,
        command: Sequence[str] = (),
        lease_s: float | None = DEFAULT_LEASE_S,
        watchdog_s: float | None = None,
        hand: str | None = None,
    ) -> None:
        """Create the client.

        If ``command`` is given, the client starts a controller by executing this command. If
        ``hand`` is given, the controller must control a hand of this name. Programs call
        ``connect`` instead of this constructor.
        """
        self.bus = bus
        self._expected_hand = hand
        self._lease_s = lease_s
        self._watchdog_s = watchdog_s
        self._heartbeat: Heartbeat | None = None
        self.name = f"client-{os.getpid()}-{next(_client_number_counter)}"
        self.child: subprocess.Popen[bytes] | None = None
        self.result: dict[str, Any] = {}
        self._has_been_live = self._has_commanded = self._closed = self._error_raised = (
            self._is_hand_off
        ) = False
        self._lock = (
            threading.RLock()
        )  # at any time, only one call is allowed to wait for a status line
        # Only one call at a time is allowed to read the output of the controller.
        self._output_lock = threading.RLock()
        self._observations: ObservationReader | None = None
        self._description: Hand | None = None
        self._watcher = StatusWatcher(bus)
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115
        self._printed_bytes = 0
        self._last_message = ""
        if command:
            pipe = subprocess.PIPE
            self.child = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=self._stderr, start_new_session=True
            )  # Ctrl-C reaches only this program, and this program then ends the controller

    def __enter__(self) -> Self:
        """Wait until the hand accepts goals, and return the client.

        A hand without a calibration is commissioned first.

        Raises:
            ConfigError: the running controller controls another hand than the program expects.
            DriveError: the controller does not start or accepts no goals. The error message comes
                from the controller.
        """
        return self.open()

    def open(self) -> Self:
        """Wait until the hand accepts goals, as the start of a ``with`` block does.

        Notebooks, which cannot use a `with` block over several cells, need this method. This method
        raises the same errors as ``__enter__``. Call ``close`` at the end.
        """
        with ExitStack() as exit_stack:
            exit_stack.callback(self._finish_command, False)
            self.wait(phase="live", timeout_s=START_TIMEOUT_S if self.child else ATTACH_TIMEOUT_S)
            expected, found_name = self._expected_hand, self.description.name
            if expected not in (None, found_name):
                expected_hand = f"hand={found_name!r}, or the bus of {expected}"
                raise ConfigError(
                    f"controls {found_name}", f"the controller of {self.bus}", expected_hand
                )
            exit_stack.pop_all()
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop a hand that this client has started, or give up the right to move the hand."""
        self._finish_command(raises_error=error_type is None)

    def move(
        self, goals: Mapping[str, float] | None = None, /, duration_s: float = 1.0, wait: bool = True,
        **angle_deg: float,
    ) -> None:  # fmt: skip
        """Move digits or joints to angles [deg], as in ``hand.move(index=30, thumb_j1=10)``.

        A digit that is already moving continues smoothly from its present speed.

        Args:
            goals: goals as a mapping, e.g. ``hand.move({"index": 30})``. Keyword arguments add more
                goals to the mapping.
            duration_s: duration of the motion in the time of the hand [s].
            wait: True to return at the end of the motion, and False to return when the motion
                begins.
            angle_deg: target angle [deg] of a joint, or of all joints of a digit, by the name of
                the joint or digit.

        Raises:
            ConfigError: the controller has refused the goal, e.g. because of an unknown digit. The
                previous goal of the hand stays valid.
            DriveError: the run has ended, or it ends during the motion, e.g. because of a fault, or
                another client takes over during the motion. The error message contains the reason.
            BusError: the controller does not answer.
        """
        angles = _values_by_digit("move", goals, angle_deg)
        goal = {
            "do": "move",
            "angle_deg": _convert_to_floats(angles),
            **_convert_to_floats({"duration_s": duration_s}),
        }
        validate_content(goal, MoveDigitsRequest, "move")
        start_s = self._set_goal(goal)
        while wait and self._wait_as_commander() < start_s + goal["duration_s"]:
            pass

    def hold(
        self,
        goals: Mapping[str, float] | None = None,
        /,
        rate_N_per_s: float = 100.0,
        **tension_N: float,
    ) -> None:
        """Hold a tension [N] in every tendon of a digit, as in ``hand.hold(index=12)``.

        The method ``hold`` returns immediately, and does not wait until the tensions are reached.
        If no goals are given, all moving digits stop at their present positions.

        Args:
            goals: goals as a mapping, e.g. ``hand.hold({"index": 12})``. Keyword arguments add
                further goals to the mapping.
            rate_N_per_s: rate at which each tension approaches its goal [N/s].
            tension_N: tension of each digit [N], by the name of the digit.

        Raises:
            ConfigError, DriveError, BusError: see ``move``.
        """
        if not goals and not tension_N and (goals is None or isinstance(goals, Mapping)):
            self._set_goal({"do": "stay"})
            return
        tensions = _values_by_digit("hold", goals, tension_N)
        goal = {
            "do": "hold",
            "tension_N": _convert_to_floats(tensions),
            **_convert_to_floats({"rate_N_per_s": rate_N_per_s}),
        }
        validate_content(goal, HoldTensionRequest, "hold")
        self._set_goal(goal)

    def stream(
        self,
        rate_Hz: float,
        space: StreamSpace = "joint",
        names: Sequence[str] | None = None,
        interpolation: Literal["linear", "minimum_jerk"] = "minimum_jerk",
        unit: Literal["deg", "rad"] = "deg",
        stiffness_N_m_per_rad: float | None = None,
        damping_ratio: float = 1.0,
    ) -> TargetStream:
        """Open a stream of targets.

        Use the returned stream as a context manager, see ``TargetStream``.

        Args:
            rate_Hz: rate of the targets in the time of the hand [Hz], from 20 to the control rate.
            space: meaning of the values of a target. In space ``"joint"``, a target has one angle
                for each joint. In space ``"digit"``, a target has one angle for each digit, and all
                joints of the digit get this angle. In space ``"tension"``, a target has a tension
                for each tendon [N], and in space ``"tip_force"`` a force for each digit [N]. In
                space ``"fingertip"``, a target has the position of each fingertip in the palm
                frame, (D, 3) [m], see ``FingertipStream``.
            names: joints, digits or tendons to which the values of a target belong, in order. If
                ``names`` is None, a target has values for all joints, digits or tendons.
            interpolation: motion between two successive target angles. With ``"linear"`` the speed
                is constant, and with ``"minimum_jerk"`` the motion is smooth.
            unit: unit of the target angles. For prismatic joints, ``"deg"`` means mm, and ``"rad"``
                means m.
            stiffness_N_m_per_rad: stiffness of the streamed joints against a push, for impedance
                control. If ``stiffness_N_m_per_rad`` is None, the gains determine the stiffness. A
                larger stiffness than the stiffness that follows from the gains is not allowed.
            damping_ratio: damping ratio of the streamed joints, divided by the damping ratio of the
                gains, from 0.5 to 2.

        Raises:
            ConfigError: the controller has refused the stream, e.g. because of a name or a rate, or
                another client commands the hand.
            DriveError, BusError: see ``move``.
        """
        if space not in get_args(StreamSpace):
            raise ConfigError(repr(space), "stream.space", " or ".join(get_args(StreamSpace)))
        # A single text is refused, because each letter would count as a name.
        if isinstance(names, str):
            raise ConfigError(repr(names), "stream.names", f"a list, as in [{names!r}]")
        hand = self.description
        all_names = {"joint": hand.joints, "tension": hand.tendon_names}.get(
            space, hand.digit_names
        )
        fingertips = Fingertips(hand, names) if space == "fingertip" else None
        if fingertips is not None:
            names = fingertips.joints
        number = next(_client_number_counter)
        numbers = {"rate_Hz": rate_Hz, "damping_ratio": damping_ratio}
        if stiffness_N_m_per_rad is not None:
            numbers["stiffness_N_m_per_rad"] = stiffness_N_m_per_rad
        goal = {
            "do": "stream", "stream": stream_name(os.getpid(), number),
            "space": "joint" if fingertips else space,
            "names": list(all_names if names is None else names), "interpolation": interpolation,
            **_convert_to_floats(numbers),
        }  # fmt: skip
        validate_content(goal, OpenStreamRequest, "stream")
        with ExitStack() as exit_stack:
            sender = TargetSender(self.bus, os.getpid(), number)
            exit_stack.callback(sender.close)
            self._set_goal(goal)
            exit_stack.pop_all()
        constants = self._open_reader().description
        horizon_s = target_horizon_s(goal["rate_Hz"], 1.0 / constants["rate_Hz"])
        if fingertips is not None:
            return FingertipStream(
                self, sender, goal, fingertips, horizon_s, constants["time_scale"]
            )
        return TargetStream(self, sender, goal, unit, horizon_s, constants["time_scale"])

    def grasp(
        self, task: str | os.PathLike[str], wait: bool = True, timeout_s: float = 30.0
    ) -> Observation:
        """Execute a task up to the first hold phase, and return the observation at the start of this phase.

        The method ``release`` ends the hold phase and continues the task. If the program sets a
        goal during the hold phase, for example with ``move``, the task ends without its remaining
        phases.

        Args:
            task: packaged task, e.g. ``"grasp"``, or a task file.
            wait: True to return when the hold phase begins, and False to return at once. If the
                task has no hold phase, the method waits for the end of the task.
            timeout_s: longest time to wait [s].

        Raises:
            ConfigError: the task does not exist or does not suit the hand, or another client
                commands the hand.
            DriveError: the task has ended before its hold phase, the timeout has passed, or the run
                has ended.
        """
        grasp_task, _ = load_task_for_hand(Path(task), self.description)
        hold_phase_name = next(
            (phase.name for phase in grasp_task.phase if isinstance(phase, HoldPhase)), "live"
        )
        content = grasp_task.model_dump(by_alias=True, exclude_unset=True, mode="json")
        self._set_goal({"do": "grasp", "task": content})
        if not wait:
            return self.observe(wait=True)
        deadline_s = time.monotonic() + timeout_s
        observation = self.observe(wait=True)
        while observation.phase != hold_phase_name:
            if observation.phase == "live" or time.monotonic() > deadline_s:
                raise DriveError(
                    f"the hand does not hold an object: it is in phase {observation.phase!r}",
                    f"task {grasp_task.name}",
                )
            observation = self.observe(wait=True)
        return observation

    def release(self, wait: bool = True, timeout_s: float = 30.0) -> None:
        """End the hold phase that ``grasp`` has reached, and execute the remaining phases of the task.

        Args:
            wait: True to return at the end of the task, and False to return at once.
            timeout_s: longest time to wait [s].

        Raises:
            ConfigError: the hand is not in a hold phase, or another client commands the hand.
            DriveError: the timeout has passed, or the run has ended.
        """
        self._set_goal({"do": "release"})
        if wait:
            self.wait_for(phase="live", timeout_s=timeout_s)

    def end_stream(self, name: str) -> None:
        """End the stream with a given name. ``TargetStream.close`` calls this method."""
        self._set_goal({"do": "stream_end", "stream": name})

    def take_over(self) -> None:
        """Take over the right to move the hand from another client.

        All digits come to rest. If the client that loses the right has an open stream, the stream
        ends.

        Raises:
            DriveError, BusError: see ``move``.
        """
        self._set_goal({"do": "stay", "take_over": True})

    @property
    def description(self) -> Hand:
        """Return the description of the hand, with names, limits and geometry.

        Raises:
            DriveError, BusError: as for ``state``.
        """
        if self._description is None:
            self._description = hand_from_content(
                parse_toml(self._open_reader().description["hand_toml"], self.bus), self.bus
            )
        return self._description

    def observe(self, wait: bool = False, timeout_s: float = CONFIRMATION_TIMEOUT_S) -> Observation:
        """Read the observation of the latest tick from shared memory, and return the observation.

        Args:
            wait: True to wait for a tick that this client has not observed yet.
            timeout_s: longest time to wait [s].

        Raises:
            DriveError: the run has ended. The error message contains the reason.
            BusError: no tick of the controller arrives within ``timeout_s``, or this client is
                closed.
        """
        self._record_call_time()
        reader = self._open_reader()
        deadline_s = time.monotonic() + timeout_s
        while True:
            self._check_not_closed()
            record = (
                reader.latest_record()
                if not wait or reader.written_count > reader.last_read_number
                else None
            )
            if record is not None:
                return Observation(record, self.description)
            self._check_run_and_timeout(reader, deadline_s)
            time.sleep(OBSERVATION_POLL_PERIOD_S)

    def observations(self, timeout_s: float = CONFIRMATION_TIMEOUT_S) -> Iterator[Observation]:
        """Yield the observations of all ticks from now until the run ends, in order.

        A program that reads more than a second behind the controller misses ticks. After missed
        ticks, the tick number ``k`` of the next observation is larger by more than 1.

        Args:
            timeout_s: longest time to wait for the next tick [s].

        Raises:
            BusError: no tick of the controller arrives within ``timeout_s``.
        """
        for observation in self.poll_observations(timeout_s):
            if observation is None:
                time.sleep(OBSERVATION_POLL_PERIOD_S)
            else:
                yield observation

    def poll_observations(self, timeout_s: float) -> Iterator[Observation | None]:
        """Yield the observation of each tick. If there is no new observation yet, yield None.

        The returned iterator never waits.

        This method has the same argument as ``observations``, and raises the same errors.
        """
        reader = self._open_reader()
        reader.last_read_number = reader.written_count
        deadline_s = time.monotonic() + timeout_s
        while True:
            self._check_not_closed()
            if (record := reader.next_record()) is not None:
                deadline_s = time.monotonic() + timeout_s
                self._record_call_time()
                yield Observation(record, self.description)
            elif reader.has_run_ended:
                return
            else:
                self._check_run_and_timeout(reader, deadline_s)
                yield None

    def wait_for(
        self,
        contact: str | Sequence[str] | None = None,
        phase: str | None = None,
        timeout_s: float = 10.0,
    ) -> Observation:
        """Wait until digits are in contact or the hand is in a given phase, and return the observation at that time.

        If ``contact`` and ``phase`` are both given, both conditions must be true in the same tick.

        Args:
            contact: a digit, or several digits that must all be in contact.
            phase: name of the phase.
            timeout_s: longest time to wait [s].

        Raises:
            ConfigError: the hand has no such digit, or neither contacts nor a phase are given.
            DriveError: the run has ended, or the timeout has passed.
        """
        digits = [contact] if isinstance(contact, str) else list(contact or ())
        names = self.description.digit_names
        if unknown_digits := [digit for digit in digits if digit not in names]:
            raise ConfigError(
                f"no digit {unknown_digits[0]!r}", "wait_for", f"one of {', '.join(names)}"
            )
        if not digits and phase is None:
            raise ConfigError("no condition", "wait_for", "contact or phase")
        deadline_s = time.monotonic() + timeout_s
        while True:
            observation = self.observe(wait=True)
            are_all_in_contact = all(
                observation.contact[names.index(digit)] > 0.5 for digit in digits
            )
            if are_all_in_contact and (phase is None or observation.phase == phase):
                return observation
            if time.monotonic() > deadline_s:
                raise DriveError(
                    f"condition not met after {timeout_s:g} s: {observation.phase}",
                    f"bus {self.bus}: wait_for",
                )

    def _open_reader(self) -> ObservationReader:
        """Return the reader of the observations in shared memory.

        The first call of this method opens the reader, and must come before the run ends.
        """
        if self._observations is not None:
            if not self._observations.has_run_ended:
                return self._observations
            self._collect_result()
        self._check_run_active()
        if self._observations is None or self._observations.has_run_ended:
            self._observations = ObservationReader(self.bus)
        return self._observations

    def _check_run_and_timeout(self, reader: ObservationReader, deadline_s: float) -> None:
        """Raise an error if the run has ended, or if the deadline of a wait has passed."""
        if reader.has_run_ended:
            self._collect_result()
            self._check_run_active()
            raise DriveError("the run has ended", f"bus {self.bus}")
        if time.monotonic() >= deadline_s:
            self._check_run_active()
            raise BusError("the controller is silent", f"bus {self.bus}", EXPECTED_CONTROLLER_TEXT)

    def state(self, timeout_s: float = CONFIRMATION_TIMEOUT_S) -> dict[str, Any]:
        """Return the present state of the hand as plain Python values.

        The returned state is at most 20 ms old.

        ``observe`` is faster and returns more values.

        Args:
            timeout_s: longest time to wait [s].

        Returns:
            Lists in the order of the hand file, with None for unknown values: ``q_rad`` by joint
            [rad] with its standard deviation ``q_sigma_rad`` (large where a digit in contact has
            fewer tendons than joints), ``tension_N`` and ``tension_goal_N`` by tendon [N],
            ``tip_force_N`` with ``tip_force_sigma_N`` and ``contact`` (bool) by digit [N], ``t_s``
            time since the start of the run [s], ``k`` number of the tick, ``late_us`` lateness of
            the tick [us], ``mode``, ``phase``, ``commander`` (client that commands the hand, None
            if every client is allowed to), and ``events`` of the tick ``k``.

        Raises:
            DriveError: the run has ended. The error message contains the reason.
            BusError: the controller sends no status line within ``timeout_s``.
        """
        self._record_call_time()
        deadline_s = time.monotonic() + timeout_s
        while True:
            self._check_run_active()
            with self._lock:
                line = self._watcher.request_status_line(
                    max(0.0, min(STATE_POLL_PERIOD_S, deadline_s - time.monotonic()))
                )
            if line is not None:
                self._is_hand_off |= are_drives_off(line)
                return line
            if time.monotonic() >= deadline_s:
                raise BusError(
                    "the controller is silent", f"bus {self.bus}", EXPECTED_CONTROLLER_TEXT
                )

    def wait(self, phase: str, timeout_s: float) -> dict[str, Any]:
        """Wait until the hand is in a phase, and return the state of the hand.

        Args:
            phase: name of the phase. In the phase ``"live"``, the hand accepts goals.
            timeout_s: longest time to wait [s].

        Raises:
            DriveError: the run has ended, or the timeout has passed.
        """
        deadline_s = time.monotonic() + timeout_s
        last_phase = "no state received"
        while (remaining_s := deadline_s - time.monotonic()) > 0.0:
            self._check_run_active()
            with suppress(BusError):
                line = self.state(min(STATE_POLL_PERIOD_S, remaining_s))
                self._has_been_live |= line["phase"] == "live"
                if line["phase"] == phase:
                    return line
                last_phase = f"phase {line['phase']!r}"
        raise DriveError(
            f"not in phase {phase!r} after {timeout_s:g} s: {last_phase}", f"bus {self.bus}"
        )

    def stop(self) -> None:
        """Relax and disarm the hand, and end the run.

        The run also ends if another process than this program has started the controller.

        Raises:
            UnconfirmedError: the controller has not confirmed the request.
            PowerError: a drive did not confirm that it is disabled. If this error is raised, switch
                off the power of the drive.
        """
        with self._lock:
            line, _ = send_with_confirmation(self._watcher, {"do": "stop"}, is_repeated=True)
            wait_until_drives_off(self._watcher, "stop", line)
            self._is_hand_off = True

    def close(self) -> None:
        """Close the client, as the end of the ``with`` statement does.

        The attribute ``result`` is available after the client is closed.

        Raises:
            DriveError: a fault ended the run.
            PowerError: a drive did not confirm that it is disabled. Remove the power of the drive.
        """
        self._finish_command(raises_error=True)

    def _set_goal(self, goal: dict[str, Any]) -> float:
        """Send a goal, wait until the controller confirms it, and return the time of the confirming tick [s]."""
        self._wait_until_following(CONFIRMATION_TIMEOUT_S)
        if self._lease_s is not None:
            goal = {**goal, "lease_s": self._lease_s}
        if (size := len(json.dumps(goal).encode()) + SENDER_NAME_BYTES) > MAX_REQUEST_BYTES:
            raise ConfigError(
                f"{size} bytes", goal["do"], f"a request of at most {MAX_REQUEST_BYTES}"
            )
        try:
            with self._lock:
                line, replies = send_with_confirmation(self._watcher, {**goal, "client": self.name})
        except UnconfirmedError:
            self._check_run_active()
            raise
        if refused_replies := [text for text in replies if text.startswith(REFUSAL_EVENT_PREFIX)]:
            raise ConfigError(
                refused_replies[0].removeprefix(REFUSAL_EVENT_PREFIX),
                f"the controller of {self.bus}",
            )
        self._has_commanded = True
        self._start_heartbeat()
        return float(line["t_s"])

    def _start_heartbeat(self) -> None:
        """Start the thread that renews the lease. If there is no lease, or if the thread already runs, do nothing."""
        with self._lock:
            if self._lease_s is None or self._heartbeat is not None or self._closed:
                return
            time_scale = 1.0
            with suppress(BusError, DriveError):  # the run can have ended already
                time_scale = self._open_reader().description["time_scale"]
            self._heartbeat = Heartbeat(
                self.bus,
                self.name,
                self._lease_s / HEARTBEATS_PER_LEASE / time_scale,
                self._watchdog_s,
            )

    def _record_call_time(self) -> None:
        """Store the present time for the watchdog."""
        if self._heartbeat is not None:
            self._heartbeat.record_call_time()

    def _wait_until_following(self, timeout_s: float) -> dict[str, Any]:
        """Return the state of the hand if the hand follows goals, and raise an error otherwise."""
        line = self.state(timeout_s)
        if line["mode"] in SHUTDOWN_MODE_NAMES:
            self._collect_result()
            self._check_run_active()
            raise DriveError(f"the hand no longer accepts goals: {line['mode']}", f"bus {self.bus}")
        return line

    def _wait_as_commander(self) -> float:
        """Check that this client is allowed to command the hand, and return the time of the next status line [s].

        If another client commands the hand, raise an error.
        """
        line = self._wait_until_following(CONFIRMATION_TIMEOUT_S)
        if line["commander"] != self.name:
            other_client = line["commander"] or "another client"
            raise DriveError(
                f"{other_client} has taken over the hand", f"bus {self.bus}", "take_over"
            )
        return float(line["t_s"])

    def _check_run_active(self) -> None:
        """Raise an error if the controller or this client has ended.

        If the controller has ended, the method first waits for the result of the run.
        """
        self._check_not_closed()
        self._print_new_messages()
        if self.child is not None and (
            self.child.poll() is not None or (self._has_been_live and not is_running(self.bus))
        ):
            self._collect_result()
            self._error_raised = True
            raise self._run_error()

    def _check_not_closed(self) -> None:
        """Raise an error if this client is closed."""
        if self._closed:
            raise BusError("this client is closed", f"bus {self.bus}", "another handctl.connect")

    def _finish_command(self, raises_error: bool) -> None:
        """Stop the hand if this client has started the controller.

        If another process has started the controller, give up the right of this client to move the
        hand. Only the first call of this method has an effect.

        Args:
            raises_error: True to raise the error that ended the run. While another exception is
                handled, ``raises_error`` is False, and an error is raised only if a drive possibly
                still makes torque.
        """
        if self._closed:
            return
        self._closed = True
        if self._heartbeat is not None:
            self._heartbeat.end()
        try:
            if self.child is None and self._has_commanded and is_running(self.bus):
                with self._lock:
                    send_with_confirmation(
                        self._watcher, {"do": "leave", "client": self.name}, is_repeated=True
                    )
        finally:
            # Another thread possibly still reads the shared memory or waits for a status line. The
            # shared memory is unmapped after its last reader has ended.
            self._observations = None
            with self._lock:
                self._watcher.close()
            self._collect_result()
            with self._output_lock:
                self._stderr.close()
        exit_code = self.child.returncode if self.child else 0
        if (
            exit_code
            and not self._error_raised
            and (raises_error or exit_code == ExitCode.REMOVE_POWER)
        ):
            raise self._run_error()

    def _collect_result(self) -> None:
        """End the controller by closing its standard input, and read the result of the run.

        If another thread is already ending the controller, wait until that thread has read the
        result.
        """
        with self._output_lock:
            if self.child is None or self.child.stdout is None or self.child.stdout.closed:
                return
            output_text, _ = self.child.communicate()
            self._print_new_messages()
            # a controller process that was killed leaves no output or incomplete output
            with suppress(ValueError):
                self.result = json.loads(output_text)

    def _run_error(self) -> DriveError:
        """Return the exception for the error that ended the run."""
        exit_code = self.child.returncode if self.child else 0
        signal_text = f"killed by signal {-exit_code}" if exit_code < 0 else ""
        # If no failure ended the run, the last message of the controller is a notice that does not
        # explain the error.
        message = self._last_message if exit_code else ""
        reason = self.result.get("failure") or signal_text or message or "it was stopped"
        if exit_code == ExitCode.REMOVE_POWER:
            return PowerError(reason, f"bus {self.bus}", "its power removed")
        return DriveError(f"the controller ended: {reason}", f"bus {self.bus}")

    def _print_new_messages(self) -> None:
        """Print new messages of the controller to the standard error of this program."""
        with self._output_lock:
            if self._stderr.closed:
                return
            new_output = os.pread(self._stderr.fileno(), 1 << 16, self._printed_bytes)
            self._printed_bytes += len(new_output)
            if text := new_output.decode("utf-8", "replace"):
                self._last_message = (
                    text.strip().splitlines()[-1].removeprefix("handctl: ") if text.strip() else ""
                )
                print(escape_text(text, "\n\t"), end="", file=sys.stderr, flush=True)


def _values_by_digit(do: str, goals: object, keyword_goals: Mapping[str, Any]) -> dict[str, Any]:
    """Combine the values of a mapping and of keyword arguments, and return all values by the name of the digit.

    Raises:
        ConfigError: the goals are not a mapping, contain no digit, or contain a digit twice.
    """
    if goals is not None and not isinstance(goals, Mapping):
        raise ConfigError(repr(goals), do, 'digits by name, as in index=30 or {"index": 30}')
    values = {str(name): value for name, value in (goals or {}).items()}
    if repeated_names := values.keys() & keyword_goals.keys():
        raise ConfigError(f"{min(repeated_names)} is given twice", do, "one value for each digit")
    if not values and not keyword_goals:
        raise ConfigError("no digit", do, "one at least, as in index=30")
    return values | dict(keyword_goals)


def _convert_to_floats(values: Mapping[str, Any]) -> dict[str, Any]:
    """Convert all numbers among the given values to float, and return all values.

    The numbers can have any numeric type. Values that are not numbers stay unchanged, so that a
    later check can show the wrong value in the error message.
    """
    converted_values = dict(values)
    for key, value in values.items():
        if isinstance(value, Real) and not isinstance(value, bool):
            with suppress(OverflowError):
                converted_values[key] = float(value)
    return converted_values
