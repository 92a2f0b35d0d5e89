"""Virtual time for lockstep.

The control loop advances the simulator tick by tick, and never sleeps.

In lockstep, the simulator is called the peer. The peer is an object with the method ``step(t_ns,
frames) -> frames``. The name of the peer's class is given as text, because no module of handctl
imports a simulator. If the peer also has the method ``exchange(t_ns, records) -> records``, the
loop calls ``exchange`` instead of ``step``. With ``exchange``, the frames are rows of an array, and
no object is created for a frame.
"""

import importlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

from handctl.compiled import fast_loading_of_stored_code
from handctl.drives.frame import ERROR_FLAG, Frame
from handctl.drives.frame_records import (
    FRAME_RECORD_BYTES,
    Frames,
    RecordArray,
    concatenate_frames,
    frames_as_records,
)
from handctl.errors import ConfigError
from handctl.extras import missing_extra
from handctl.runtime.buses.bus_events import BusEvents
from handctl.runtime.buses.canfd_structs import data_and_error_frames

_FLAGS_BYTE_OFFSET = 11
"""Offset of the highest byte of the identifier, which contains the flags, in the record of a frame."""
_ERROR_FLAG_IN_BYTE = ERROR_FLAG >> 24
"""Flag of an error frame in the highest byte of the identifier."""
SIMULATED_HAND_ENTRY = "firmware_sim.lockstep_hand:LockstepHand"
"""Name ``module:Class`` of the simulator in the handctl repository."""


class LockstepSimulator(Protocol):
    """Interface of a simulator in lockstep."""

    def step(self, t_ns: int, frames: list[Any]) -> list[Any]:
        """Advance the simulator by one control period.

        Return the answers of the simulator to the frames that the host has sent at t_ns.
        """
        ...

    def close(self) -> None:
        """Complete and close the files of the simulator."""
        ...


def _exchange_objects(peer: LockstepSimulator, t_ns: int, records: RecordArray) -> RecordArray:
    """Exchange records with a simulator that does not have the method ``exchange``.

    The records of the host are converted to frame objects, and the answers are converted back to
    records.
    """
    return frames_as_records(
        Frame(*reply) for reply in peer.step(t_ns, list(Frames.from_records(records)))
    ).records


def load_simulator_object(entry: str, requester: str) -> Callable[..., Any]:
    """Import a class or a function of a simulator by its name ``module:name``, and return the object.

    Args:
        entry: name of the class or function, ``module:name``.
        requester: command or function that needs the class or function, for the error message.

    Raises:
        ConfigError: the class or function does not exist, or its optional package is not installed.
    """
    module, _, name = entry.partition(":")
    try:
        simulator_object: Callable[..., Any] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        missing_package = (
            missing_extra(requester, error) if isinstance(error, ImportError) else None
        )
        raise missing_package or ConfigError(
            f"cannot load the lockstep peer: {error}", entry, "module:Class"
        ) from None
    return simulator_object


def load_simulator(entry: str, **options: object) -> LockstepSimulator:
    """Load a simulator class from ``module:Class``, and return an object of the class.

    Raises:
        ConfigError: the module or class does not exist, or the class refuses the options.
    """
    make_simulated_hand = load_simulator_object(entry, "the simulated hand")
    try:
        # The simulator of handctl is compiled with numba, too.
        with fast_loading_of_stored_code():
            peer: LockstepSimulator = make_simulated_hand(**options)
    except (ValueError, OSError) as error:
        raise ConfigError(str(error), "the simulated hand") from None
    return peer


class LockstepClock:
    """Virtual clock of a run, which stands still while the controller and the simulator compute.

    A call of ``wait`` for the next tick advances the simulator by one control period.

    Attributes:
        simulator: the simulator.
        period_ns: control period [ns].
        frames_to_simulator: frames of the host that the next step of the simulator will receive.
        frames_from_simulator: answers of the simulator that ``LockstepBus.drain`` has not returned
            yet.
        k: number of the present tick.
        offset_ns: time of the simulator when the time of this run is 0 [ns].
    """

    def __init__(self, peer: LockstepSimulator, period_ns: int) -> None:
        """Set the clock to tick 0, and to the time 0 of the simulator.

        The argument ``period_ns`` is the control period [ns].
        """
        self.simulator = peer
        self.period_ns = period_ns
        self._exchange: Callable[[int, RecordArray], RecordArray]
        self._exchange = getattr(peer, "exchange", None) or partial(_exchange_objects, peer)
        self.frames_to_simulator: list[Frames] = []
        self.frames_from_simulator: list[Frames] = []
        self.k = 0
        self.offset_ns = 0

    def restart(self) -> None:
        """Begin another run.

        The new run begins one tick after the last frames of the previous run were sent. The
        simulator still receives the last frames of the previous run, because the last frames
        disable the drives. The simulator's answers to the last frames are discarded, because no bus
        is open between two runs.
        """
        if self.frames_to_simulator:
            self.wait(self.k + 1)
        self.offset_ns += self.k * self.period_ns
        self.k = 0
        self.frames_from_simulator = []

    def start(self) -> None:
        """Do nothing. The simulator's time begins with the first call of ``wait``."""

    def wait(self, k: int) -> int:
        """Advance the simulator from the previous tick to tick k, and return 0.

        The result is 0, because virtual time is never late.
        """
        if k > 0:
            frames = concatenate_frames(self.frames_to_simulator)
            replies = self._exchange(self.offset_ns + (k - 1) * self.period_ns, frames.records)
            if self.offset_ns:
                replies = replies.copy()
                replies["t_ns"] -= self.offset_ns
            self.frames_from_simulator.append(Frames.from_records(replies))
            self.frames_to_simulator = []
        self.k = k
        return 0

    def now_ns(self) -> int:
        """Return the scheduled time of the present tick [ns]."""
        return self.k * self.period_ns

    def clock_statistics(self) -> dict[str, str]:
        """Return an empty mapping, because virtual time has no statistics: it never pauses and is never late."""
        return {}


def _has_error_frame(frames: Frames) -> bool:
    """Return True if one of the frames is an error frame."""
    # For the few frames of a tick, operations with bytes take a third of the time of operations
    # with arrays.
    flags = frames.rows.tobytes()[_FLAGS_BYTE_OFFSET::FRAME_RECORD_BYTES]
    return max(flags, default=0) >= _ERROR_FLAG_IN_BYTE and any(
        byte & _ERROR_FLAG_IN_BYTE for byte in flags
    )


class LockstepBus:
    """Single object that represents all buses of a hand in lockstep.

    Each frame contains the index of its bus.
    """

    name = "lockstep"

    def __init__(self, clock: LockstepClock) -> None:
        """Connect to the simulator that ``clock`` advances."""
        self.clock = clock
        self._events: dict[int, BusEvents] = {}

    def drain(self) -> Frames:
        """Return the answers of the simulator. Error frames among the answers become events of the bus."""
        frames = concatenate_frames(self.clock.frames_from_simulator)
        self.clock.frames_from_simulator = []
        # If no frame is an error frame, as usual, the frames need not be examined one by one.
        if not _has_error_frame(frames):
            return frames
        frames, errors = data_and_error_frames(frames)
        for frame in errors:
            events = self._events.setdefault(frame.bus, BusEvents(f"{self.name}:{frame.bus}"))
            events.add_error_frame(frame.can_id, frame.data)
        return frames

    def send(self, frames: Sequence[Frame]) -> int:
        """Keep frames for the next step of the simulator, and return the number of frames."""
        self.clock.frames_to_simulator.append(frames_as_records(frames))
        return len(frames)

    def take_events(self) -> list[tuple[str, str, int]]:
        """Return the events of the simulated wires. A simulator without wires has no events."""
        return [event for events in self._events.values() for event in events.take_events()]

    def close(self) -> None:
        """Do nothing. The owner of the simulator closes the simulator."""
