"""Client of a hand for programs that use asyncio.

The asyncio client offers the methods of ``HandClient`` as coroutines.
"""

import asyncio
import os
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from types import TracebackType
from typing import Any, Self

from handctl.client.hand import DEFAULT_LEASE_S, HandClient, StreamSpace, connect
from handctl.client.observation import Observation
from handctl.client.stream import TargetStream, TargetValues
from handctl.hand.description import Hand
from handctl.programs.stream_plans import StreamStatus
from handctl.runtime.confirmed_requests import CONFIRMATION_TIMEOUT_S

OBSERVATION_POLL_PERIOD_S = 0.5e-3
"""Pause between two reads of the shared memory that contains the observations [s].

During the pause, the event loop runs other tasks.
"""


class AsyncHandClient:
    """Client of one hand, for programs that use asyncio. Use the client with ``async with``.

    Every method has the same effect as the ``HandClient`` method with the same name, and raises the
    same errors. Each call of a method runs in a thread, so that other tasks of the event loop
    continue. ``observe`` is not a coroutine, because it returns at once. If a task is cancelled
    during a call, the hand keeps its present goal. To bring the hand to rest after a cancellation,
    call ``hold``.

    Attributes:
        client: the ``HandClient`` whose methods are called.
    """

    def __init__(self, client: HandClient) -> None:
        """Create the asyncio client from a client that is not open yet.

        Programs call ``connect_async`` instead of this constructor.
        """
        self.client = client

    async def __aenter__(self) -> Self:
        """Wait until the hand accepts goals, and return the client.

        This method raises the errors of ``HandClient.open``.
        """
        return await self.open()

    async def open(self) -> Self:
        """Wait until the hand accepts goals, as ``async with`` does. Call ``close`` at the end.

        If the wait is cancelled, the client is closed. If the client stayed open after a
        cancellation, its thread would arm a hand, and no part of the program would relax this hand
        later.
        """
        try:
            await asyncio.to_thread(self.client.open)
        except asyncio.CancelledError as error:
            await self.__aexit__(type(error), error, None)
            raise
        return self

    async def __aexit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the client.

        If the block ends with an exception or a cancellation, no second exception is raised for a
        fault of the run.
        """
        await asyncio.shield(asyncio.to_thread(self.client.__exit__, error_type, error, traceback))

    async def close(self) -> None:
        """End the control of the hand, see ``HandClient.close``."""
        await asyncio.shield(asyncio.to_thread(self.client.close))

    @property
    def result(self) -> dict[str, Any]:
        """Return the output of the run that this client has started.

        The output of the run is available only after the run has ended.
        """
        return self.client.result

    @property
    def description(self) -> Hand:
        """Return the description of the hand."""
        return self.client.description

    async def move(
        self, goals: Mapping[str, float] | None = None, /, duration_s: float = 1.0, wait: bool = True,
        **angle_deg: float,
    ) -> None:  # fmt: skip
        """Move digits or joints to angles [deg], see ``HandClient.move``."""
        await asyncio.to_thread(self.client.move, goals, duration_s, wait, **angle_deg)

    async def hold(
        self,
        goals: Mapping[str, float] | None = None,
        /,
        rate_N_per_s: float = 100.0,
        **tension_N: float,
    ) -> None:
        """Hold tensions [N].

        If no tensions are given, bring moving digits to rest. See ``HandClient.hold``.
        """
        await asyncio.to_thread(self.client.hold, goals, rate_N_per_s, **tension_N)

    async def grasp(
        self, task: str | os.PathLike[str], wait: bool = True, timeout_s: float = 30.0
    ) -> Observation:
        """Execute a task up to its first hold phase, see ``HandClient.grasp``."""
        return await asyncio.to_thread(self.client.grasp, task, wait, timeout_s)

    async def release(self, wait: bool = True, timeout_s: float = 30.0) -> None:
        """End the hold phase that ``grasp`` has reached, see ``HandClient.release``."""
        await asyncio.to_thread(self.client.release, wait, timeout_s)

    async def take_over(self) -> None:
        """Take over the right to move the hand from another client, see ``HandClient.take_over``."""
        await asyncio.to_thread(self.client.take_over)

    async def stop(self) -> None:
        """Relax and disarm the hand, and end the run."""
        await asyncio.to_thread(self.client.stop)

    async def wait_for(
        self,
        contact: str | Sequence[str] | None = None,
        phase: str | None = None,
        timeout_s: float = 10.0,
    ) -> Observation:
        """Wait for contacts of digits or for a phase, see ``HandClient.wait_for``."""
        return await asyncio.to_thread(self.client.wait_for, contact, phase, timeout_s)

    def observe(self) -> Observation:
        """Return the latest observation without waiting."""
        return self.client.observe()

    async def observations(
        self, timeout_s: float = CONFIRMATION_TIMEOUT_S
    ) -> AsyncIterator[Observation]:
        """Yield the observations of all ticks from now until the run ends, in order.

        Args:
            timeout_s: longest time to wait for the next tick [s].

        Raises:
            BusError: the next tick of the controller does not arrive within ``timeout_s``.
        """
        for observation in self.client.poll_observations(timeout_s):
            if observation is None:
                await asyncio.sleep(OBSERVATION_POLL_PERIOD_S)
            else:
                yield observation

    async def stream(
        self,
        rate_Hz: float,
        space: StreamSpace = "joint",
        names: Sequence[str] | None = None,
        **options: Any,
    ) -> "AsyncTargetStream":
        """Open a stream of targets, as in ``async with await hand.stream(100) as stream``.

        Args:
            rate_Hz: rate of the targets in the time of the hand [Hz].
            space: kind of values in a target, see ``HandClient.stream``.
            names: joints, digits or tendons to which the values of a target belong, in order.
            options: further arguments of ``HandClient.stream``.
        """
        return AsyncTargetStream(
            await asyncio.to_thread(self.client.stream, rate_Hz, space, names, **options)
        )


class AsyncTargetStream:
    """Stream of targets, for programs that use asyncio. Use the stream with ``async with``.

    Attributes:
        stream: the ``TargetStream`` that does the work.
        names, rate_Hz, horizon_s: see ``TargetStream``.
    """

    def __init__(self, stream: TargetStream) -> None:
        """Create the asyncio stream from a stream that is open."""
        self.stream = stream
        self.names = stream.names
        self.rate_Hz = stream.rate_Hz
        self.horizon_s = stream.horizon_s

    async def __aenter__(self) -> Self:
        """Return the stream."""
        return self

    async def __aexit__(
        self,
        error_type: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the stream."""
        await asyncio.shield(self.close())

    def send(self, values: TargetValues) -> None:
        """Send a target at once, see ``TargetStream.send``."""
        self.stream.send(values)

    async def sleep(self) -> None:
        """Sleep until the next target is due."""
        await asyncio.sleep(max(0.0, self.stream.next_due_s() - time.monotonic()))

    @property
    def status(self) -> StreamStatus:
        """Return how many targets the controller has accepted, clipped, refused, and received too late."""
        return self.stream.status

    async def close(self) -> None:
        """End the stream, and let the digits of the stream come to rest."""
        await asyncio.to_thread(self.stream.close)


def connect_async(
    hand: str | os.PathLike[str] | None = None,
    bus: str | Sequence[str] = "local:demo",
    *arguments: str,
    lease_s: float | None = DEFAULT_LEASE_S,
    watchdog_s: float | None = None,
) -> AsyncHandClient:
    """Return a client of a hand for asyncio, as in ``async with handctl.connect_async() as hand``.

    Args:
        hand: see ``connect``.
        bus: see ``connect``.
        arguments: see ``connect``.
        lease_s: see ``connect``.
        watchdog_s: see ``connect``.

    Raises:
        ConfigError, BusError: see ``connect``.
    """
    return AsyncHandClient(connect(hand, bus, *arguments, lease_s=lease_s, watchdog_s=watchdog_s))
