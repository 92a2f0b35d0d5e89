"""Virtual time: the peer on the other side of the wire is stepped by the loop itself, and nobody sleeps.

The peer is an object with ``step(t_ns, frames) -> frames``, loaded by name, so that handctl never imports a simulator.
If it has ``exchange(t_ns, records) -> records`` besides, this is called instead, and no frame becomes an object.
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
"""The peer that comes with handctl, by name."""


class Peer(Protocol):
    """The other side of the wire in lockstep."""

    def step(self, t_ns: int, frames: list[Any]) -> list[Any]:
        """Take the host's frames of the tick that begins at t_ns, answer, and advance one period."""
        ...

    def close(self) -> None:
        """Finish files."""
        ...


def _exchange_objects(peer: Peer, t_ns: int, records: Records) -> Records:
    """Exchange records with a peer that knows frames only as objects."""
    return frames_of(Frame(*reply) for reply in peer.step(t_ns, list(Frames(records)))).records


def load_peer(entry: str, **options: object) -> Peer:
    """Make a peer from ``module:Class``.

    Raises:
        ConfigError: there is no such module or class, or it refuses the options.
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
    """Time that stands still while anybody computes; waiting for a tick steps the peer through the one before.

    Attributes:
        offset_ns: the peer's time at this run's t = 0 [ns].
    """

    def __init__(self, peer: Peer, period_ns: int) -> None:
        self.peer, self.period_ns = peer, period_ns
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

    def begin(self) -> None:
        """Nothing to begin: the peer's time stands still."""

    def wait(self, k: int) -> int:
        """Step the peer from the last tick to tick k; never late."""
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
        """Scheduled time of the present tick [ns]."""
        return self.k * self.period_ns


class LockstepBus:
    """The buses of a hand in lockstep, as one; frames carry the bus index."""

    name = "lockstep"

    def __init__(self, clock: LockstepClock) -> None:
        self.clock = clock
        self._events: dict[int, BusEvents] = {}

    def drain(self) -> Frames:
        """Frames that the peer answered; error frames become events."""
        parts, self.clock.incoming = self.clock.incoming, []
        frames = joined(parts)
        if not len(frames) or not int(np.bitwise_or.reduce(frames.records["can_id"])) & ERROR:
            return frames
        frames, errors = without_errors(frames.records)
        for frame in errors:
            events = self._events.setdefault(frame.bus, BusEvents(f"{self.name}:{frame.bus}"))
            events.error_frame(frame.can_id, frame.data)
        return frames

    def send(self, frames: Sequence[Frame]) -> int:
        """Keep frames for the peer's next step; all are accepted."""
        self.clock.outgoing.append(frames_of(frames))
        return len(frames)

    def take_events(self) -> list[tuple[str, str, int]]:
        """What the peer's wires have told; nothing if it simulates none."""
        return [event for events in self._events.values() for event in events.take()]

    def close(self) -> None:
        """Nothing to close."""
