"""The local bus of a simulator, as an interface of python-can.

Every program that uses python-can can open the local bus.

Examples: ``can.Bus(interface="local", channel="NAME")``, ``can.viewer -i local``.
"""

import math
import select
import time
from collections import deque
from contextlib import suppress
from typing import Any

import can

from handctl.drives.frame import ERROR_FLAG, FDF, Frame
from handctl.errors import BusError
from handctl.runtime.buses.local_bus import LocalBus
from handctl.runtime.buses.pythoncan import frame_from_message, message_from_frame
from handctl.runtime.socket_paths import run_dir

SEND_RETRY_PERIOD_S = 1e-3
"""Pause after a full queue has refused a frame, before the frame is sent again [s]."""


class LocalCanBus(can.BusABC):
    """Local bus of a simulator, with the interface of ``can.BusABC``."""

    def __init__(
        self,
        channel: str,
        can_filters: Any = None,
        receive_own_messages: bool = False,
        fd: bool = True,
        **kwargs: Any,
    ) -> None:
        """Connect to the hub of the bus.

        Args:
            channel: name of the bus, as in ``local:NAME``.
            can_filters: filters in the format of python-can.
            receive_own_messages: True if this client also receives the messages that it has sent.
            fd: True to send and receive CAN FD frames in addition to classical frames.
            **kwargs: options of other interfaces, such as the bit rate. The interface ``local``
                ignores these options.

        Raises:
            can.CanInitializationError: no process serves a bus of this name.
        """
        offset = (
            time.time_ns() - time.monotonic_ns()
        )  # python-can stamps messages with the time of the wall clock
        try:
            # Each read takes only one record from the socket, so that a program that waits on
            # ``fileno`` can take one message and wait again.
            self._link = LocalBus(channel, 0, lambda t_ns: t_ns + offset, max_records=1)
        except BusError as error:
            raise can.CanInitializationError(str(error)) from None
        self.channel_info = f"handctl local bus {channel}"
        self._fd = fd
        self._receive_own = receive_own_messages
        self._waiting: deque[Frame] = deque()
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        """Return the next message, or None if the timeout [s] has passed.

        The second returned value is False, which makes python-can apply its filters.
        """
        if not self._waiting:
            if not self._link.early_frames:
                select.select([self._link], [], [], timeout)
            self._read()
        if not self._waiting:
            return None, False
        frame = self._waiting.popleft()
        return message_from_frame(frame, frame.t_ns / 1e9), False

    def _read(self) -> None:
        frame = self._link.receive_one()
        if frame is not None and (self._fd or not frame.flags & FDF):
            self._waiting.append(frame)
        self._raise_if_hub_lost()

    def _raise_if_hub_lost(self) -> None:
        if any(kind == "enodev" for kind, _, _ in self._link.take_events()):
            raise can.CanOperationError("the hub of the local bus is gone")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a message.

        Args:
            msg: message to send.
            timeout: longest time to wait for free space in the queue [s]. If ``timeout`` is None,
                the wait has no limit.

        Raises:
            can.CanOperationError: the queue stayed full, the hub has ended, or a CAN FD message was
                sent on a bus that was opened without CAN FD.
        """
        if msg.is_fd and not self._fd:
            raise can.CanOperationError("a CAN FD message on a bus that was opened without fd")
        frame = frame_from_message(msg, 0, time.time_ns())
        end = time.monotonic() + (math.inf if timeout is None else timeout)
        while not self._link.send((frame._replace(can_id=frame.can_id & ~ERROR_FLAG),)):
            self._raise_if_hub_lost()
            remaining_s = end - time.monotonic()
            if remaining_s <= 0:
                raise can.CanOperationError("the local bus accepts no more frames")
            select.select([self._link], [], [], min(remaining_s, SEND_RETRY_PERIOD_S))
        if self._receive_own:
            self._waiting.append(frame)

    def fileno(self) -> int:
        """Return the file descriptor that becomes readable when a message arrives."""
        return self._link.fileno()

    def shutdown(self) -> None:
        """Disconnect from the bus."""
        super().shutdown()
        self._link.close()

    @staticmethod
    def _detect_available_configs() -> list[Any]:
        """List the local buses of this user whose sockets exist on this machine."""
        # If the folder of the sockets cannot be trusted, no buses are listed.
        with suppress(BusError):
            return [
                {"interface": "local", "channel": path.stem}
                for path in sorted(run_dir().glob("*.bus"))
            ]
        return []
