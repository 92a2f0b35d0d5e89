"""What a log tells of single moments."""

from typing import NamedTuple

from handctl.controller.types import Event


class LoggedEvent(NamedTuple):
    """An event with its time: tick number, time [ns], event."""

    k: int
    t_ns: int
    event: Event


class Gap(NamedTuple):
    """Ticks that are not in the log: the last before and the first after."""

    before: int
    after: int


class PhaseChange(NamedTuple):
    """A grasp phase that begins: tick number, time [ns], name."""

    k: int
    t_ns: int
    name: str
