"""Virtual time for lockstep: the loop itself steps the peer on the other side of the wire, without sleeping.

The peer is an object with ``step(t_ns, frames) -> frames``. It is loaded by name, because handctl never
imports a simulator. A peer with ``exchange(t_ns, records) -> records`` gets this call instead, and no
frame becomes an object.
"""

import importlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np

from handctl.drives.frame import ERROR, Frame
from handctl.drives.records import Frames, Records, frames_of, joined
from handctl.errors import ConfigError
from handctl.extras import missing_extra
from handctl.runtime.buses.canfd import without_errors
from handctl.runtime.buses.events import BusEvents

SIMULATED_HAND = "firmware_sim.rig:Rig"
"""Name of the peer that comes with handctl."""


class Peer(Protocol):
    """The other side of the wire in lockstep."""

    def step(self, t_ns: int, frames: list[Any]) -> list[Any]:
        """Take the host's frames of the tick at t_ns, advance one period, and return the answers."""
        ...

    def close(self) -> None:
        """Complete and close the files of the peer."""
        ...


def _exchange_objects(peer: Peer, t_ns: int, records: Records) -> Records:
    """Exchange records with a peer that handles frames only as objects."""
    return frames_of(Frame(*reply) for reply in peer.step(t_ns, list(Frames(records)))).records


def load_peer(entry: str, **options: object) -> Peer:
    """Load and construct a peer from ``module:Class``.

    Raises:
        ConfigError: the module or class does not exist, or the class refuses the options.
    """
    module, _, name = entry.partition(":")
    try:
        factory = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        missing = missing_extra("the simulated hand", error) if isinstance(error, ImportError) else None
        raise missing or ConfigError(f"cannot load the lockstep peer: {error}", entry, "module:Class") from None
    try:
        peer: Peer = factory(**options)
    except (ValueError, OSError) as error:
        raise ConfigError(str(error), "the simulated hand") from None
    return peer


class LockstepClock:
    """A clock that stands still while controller and peer compute.

    Waiting for a tick steps the peer through the tick before it.

    Attributes:
        peer: the other side of the wire.
        period_ns: control period [ns].
        outgoing: frames of the host for the next step.
        incoming: answers that ``LockstepBus.drain`` has not taken yet.
        k: present tick.
        offset_ns: the peer's time at this run's t = 0 [ns].
    """

    def __init__(self, peer: Peer, period_ns: int) -> None:
        """Start at tick 0 of the peer's time, with a control period [ns]."""
        self.peer = peer
        self.period_ns = period_ns
        self._exchange: Callable[[int, Records], Records]
        self._exchange = getattr(peer, "exchange", None) or partial(_exchange_objects, peer)
        self.outgoing: list[Frames] = []
        self.incoming: list[Frames] = []
        self.k = 0
        self.offset_ns = 0

    def restart(self) -> None:
        """Begin another run, one tick after the last frames of the run before were sent.

        The peer receives these frames, because drives are disarmed by them. Its answers are discarded: they arrive
        between two runs, when no bus is open.
        """
        if self.outgoing:
            self.wait(self.k + 1)
        self.offset_ns += self.k * self.period_ns
        self.k = 0
        self.incoming = []

    def start(self) -> None:
        """Do nothing. The peer's time stands still until the first step."""

    def wait(self, k: int) -> int:
        """Step the peer from the last tick to tick k. Returns 0, since virtual time is never late."""
        if k > 0:
            frames = joined(self.outgoing)
            replies = self._exchange(self.offset_ns + (k - 1) * self.period_ns, frames.records)
            if self.offset_ns:
                replies = replies.copy()
                replies["t_ns"] -= self.offset_ns
            self.incoming.append(Frames(replies))
            self.outgoing = []
        self.k = k
        return 0

    def now_ns(self) -> int:
        """Return the scheduled time of the present tick [ns]."""
        return self.k * self.period_ns


class LockstepBus:
    """All buses of a hand in lockstep as one object. Frames carry the bus index."""

    name = "lockstep"

    def __init__(self, clock: LockstepClock) -> None:
        """Connect to the peer that the clock steps."""
        self.clock = clock
        self._events: dict[int, BusEvents] = {}

    def drain(self) -> Frames:
        """Return the answers of the peer. Error frames become events."""
        frames = joined(self.clock.incoming)
        self.clock.incoming = []
        # One OR over all identifiers: a tick without error frames needs no look at each frame.
        if not len(frames) or not int(np.bitwise_or.reduce(frames.records["can_id"])) & ERROR:
            return frames
        frames, errors = without_errors(frames.records)
        for frame in errors:
            events = self._events.setdefault(frame.bus, BusEvents(f"{self.name}:{frame.bus}"))
            events.error_frame(frame.can_id, frame.data)
        return frames

    def send(self, frames: Sequence[Frame]) -> int:
        """Queue frames for the next step of the peer and return their number."""
        self.clock.outgoing.append(frames_of(frames))
        return len(frames)

    def take_events(self) -> list[tuple[str, str, int]]:
        """Return the events of the simulated wires. A peer without wires has none."""
        return [event for events in self._events.values() for event in events.take()]

    def close(self) -> None:
        """Do nothing. The peer is closed by its owner."""
