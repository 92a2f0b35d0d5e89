"""Stream of targets that a program sends to a running hand."""

import math
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from handctl.client.observation import Observation
from handctl.errors import ConfigError, DriveError
from handctl.hand.description import Hand
from handctl.programs.stream_plans import TARGET_UNIT_BY_SPACE, StreamStatus
from handctl.runtime.target_socket import TargetSender

TargetValues = (
    Mapping[str, float | Sequence[float] | NDArray[np.floating[Any]]]
    | Sequence[float]
    | NDArray[np.floating[Any]]
)
"""Values of a target, either in the order of the stream's names or by name.

A name that is left out keeps its last value. A target has three values for each fingertip, and one
value for each joint, digit or tendon.
"""


class StreamOwner(Protocol):
    """Methods of a ``HandClient`` that a target stream uses."""

    bus: str

    @property
    def description(self) -> Hand:
        """Return the description of the hand."""
        ...

    def observe(self) -> Observation:
        """Return the latest observation."""
        ...

    def state(self) -> dict[str, Any]:
        """Return the present state of the hand.

        If the run has ended, raise the error that ended the run.
        """
        ...

    def end_stream(self, name: str) -> None:
        """End the stream with a given name."""
        ...


class TargetStream:
    """Stream of targets that a program sends to a hand. Use the stream as a context manager.

    The hand reaches a target ``horizon_s`` after the target was sent, and then continues to the
    next target. A program that knows the trajectory in advance should send each target
    ``horizon_s`` before the hand must reach the target. The hand then follows the trajectory
    without delay.

    If no more targets arrive, the hand stays at the last target that has arrived. After the time
    ``hold_after_ms`` without a target, the hand holds its position. After the time
    ``relax_after_ms``, the hand relaxes. The times ``hold_after_ms`` and ``relax_after_ms`` are in
    the section ``[stream]`` of the hand file.

    The controller clips targets outside the range of a joint, and limits the speed and the
    acceleration of the motion. The method ``status`` reports how many targets the controller has
    clipped.

    Attributes:
        name: name of the stream.
        space: kind of values in a target, see ``HandClient.stream``.
        names: joints, digits or tendons to which the values of a target belong, in order.
        rate_Hz: rate of the targets in the time of the hand [Hz].
        horizon_s: time from the sending of a target until the hand should reach this target [s].
        sent: number of targets sent.
        skipped: number of targets that were not sent, because the controller had not yet read
            earlier targets.
    """

    def __init__(
        self, hand: StreamOwner, sender: TargetSender, goal: Mapping[str, Any], unit: str, horizon_s: float,
        time_scale: float,
    ) -> None:  # fmt: skip
        """Create a stream with which the client sends targets to the controller.

        Programs call ``HandClient.stream`` instead of this constructor.
        """
        self._hand = hand
        self._sender = sender
        self.space: str = goal["space"]
        self.name: str = goal["stream"]
        self.names: tuple[str, ...] = tuple(goal["names"])
        takes_si_units = unit == "rad" and TARGET_UNIT_BY_SPACE[self.space] == "deg"
        self._unit_factor: Any = self._display_unit_factors() if takes_si_units else 1.0
        self.rate_Hz: float = goal["rate_Hz"]
        self.horizon_s = horizon_s
        self.sent = self.skipped = 0
        self._period_ns = 1e9 / self.rate_Hz / time_scale
        self._next_due_ns = float(time.monotonic_ns())
        self._last: NDArray[np.float64] | None = None
        self._closed = False

    def __enter__(self) -> Self:
        """Return the stream."""
        return self

    def __exit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the stream."""
        self.close()

    def send(self, values: TargetValues) -> None:
        """Send a target to the hand, without waiting for the motion.

        Args:
            values: (V,) values in the order of ``names``, or a mapping with a value for each name.

        Raises:
            ConfigError: the number of values is wrong, a name is unknown, or a value is not finite.
            DriveError: the stream is closed, or the run has ended. The error message contains the
                reason.
        """
        if self._closed:
            raise DriveError("this stream is closed", self.name, "another hand.stream")
        target = self._ordered_values(values)
        try:
            accepted = self._sender.send(self.sent, time.monotonic_ns(), target * self._unit_factor)
        except OSError:
            self._hand.state()  # if the run has ended, the following call raises an error with the reason
            raise DriveError("the controller no longer accepts targets", self._hand.bus) from None
        self._last = target
        self.sent += accepted
        self.skipped += not accepted

    def sleep(self) -> None:
        """Sleep until the next target is due.

        If the program is late, the method returns at once. The next targets are due at the rate of
        the stream. A program that is late should skip the targets whose time has passed.
        """
        time.sleep(max(0.0, self.next_due_s() - time.monotonic()))

    def next_due_s(self) -> float:
        """Return the time at which the next target is due, on the clock ``time.monotonic`` [s].

        Each call of this method adds one period of the stream to the time at which the next target
        is due.
        """
        self._next_due_ns = max(self._next_due_ns + self._period_ns, float(time.monotonic_ns()))
        return self._next_due_ns / 1e9

    @property
    def status(self) -> StreamStatus:
        """Return how many targets the controller has accepted, clipped, refused, and received too late."""
        return self._hand.observe().stream

    def close(self) -> None:
        """End the stream, and let the digits of the stream come to rest."""
        if self._closed:
            return
        self._closed = True
        self._sender.close()
        self._hand.end_stream(self.name)

    def _ordered_values(self, values: TargetValues) -> NDArray[np.float64]:
        """Return the values of a target in the order of the stream's names.

        The returned values have the unit that the program uses.

        Raises:
            ConfigError: as for ``send``.
        """
        if isinstance(values, Mapping):
            if unknown_names := [str(name) for name in values if name not in self.names]:
                raise ConfigError(
                    f"no {unknown_names[0]!r} in this stream",
                    "send",
                    f"some of {', '.join(self.names)}",
                )
            target = self._present_values() if self._last is None else self._last.copy()
            for name, value in values.items():
                number = _number_array(value)
                if number.shape:
                    raise ConfigError(f"{number.size} values for {name}", "send", "one number")
                target[self.names.index(name)] = number
        else:
            target = _number_array(values)
        if target.shape != (len(self.names),):
            raise ConfigError(
                f"values of shape {target.shape}", "send", f"{len(self.names)} values"
            )
        if not all(map(math.isfinite, target.tolist())):
            name = self.names[int(np.flatnonzero(~np.isfinite(target))[0])]
            raise ConfigError(f"{name} is not finite", "send", "a finite number")
        return target

    def _display_unit_factors(self) -> NDArray[np.float64]:
        """Return the factors (V,) that convert a target from SI units to displayed units [deg/rad or mm/m]."""
        hand = self._hand.description
        factors = dict(zip(hand.joints, hand.display_units.factor.tolist(), strict=True))
        factors |= {name: hand.mean_position_units(name).factor[0] for name in hand.digit_names}
        return np.array([factors[name] for name in self.names])

    def _present_values(self) -> NDArray[np.float64]:
        """Return the present values of the hand.

        If the first target of a stream leaves out a value, the present value of the hand is used.
        """
        observation = self._hand.observe()
        if TARGET_UNIT_BY_SPACE[self.space] != "deg":
            present_values = observation.named(
                "tension_N" if self.space == "tension" else "tip_force_N"
            )
            return np.array([present_values[name] for name in self.names])
        hand = self._hand.description
        displayed_angles = hand.display_units.to_display_units(observation.q_rad)
        angles = dict(zip(hand.joints, displayed_angles.tolist(), strict=True))
        for name, joints_of_digit in hand.digit_joints.items():
            angles[name] = float(displayed_angles[joints_of_digit].mean())
        return np.asarray(np.array([angles[name] for name in self.names]) / self._unit_factor)


def _number_array(values: object) -> NDArray[np.float64]:
    """Return a copy of the values that a program gives to the stream.

    If the stream kept the array of the program, a later change of the array would change the stored
    target.

    Raises:
        ConfigError: the values are not numbers.
    """
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigError(repr(values)[:80], "send", "numbers") from None
