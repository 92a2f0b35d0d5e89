"""CAN buses of all interfaces supported by python-can.

Examples: ``virtual:x``, ``slcan:/dev/ttyACM0@115200``, ``pcan:PCAN_USBBUS1``. In each interface of
python-can, time stamps start at a different zero. Therefore a frame from python-can gets the time
at which the host has read it.
"""

import time
from collections.abc import Sequence
from typing import Any

import can

from handctl.drives.frame import BRS, ERROR_FLAG, ESI, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame
from handctl.drives.frame_records import Frames, frames_as_records
from handctl.errors import BusError
from handctl.runtime.buses.bus_events import BusEvent, BusEvents
from handctl.runtime.buses.contract import TimeConversion, check_payload_size

MAX_FRAMES_PER_DRAIN = 4096
"""Largest number of frames in one ``drain``.

Because of the limit, a flood of frames cannot delay a tick.
"""
IDENTIFIER_MASK = 0x1FFFFFFF
"""Mask of the 29 bits of an identifier, without flag bits."""


def frame_from_message(message: can.Message, index: int, t_ns: int) -> Frame:
    """Convert a python-can message to a frame.

    Args:
        message: classical or CAN FD message. Remote requests are allowed.
        index: index of the bus.
        t_ns: time of reception [ns].
    """
    can_id = (
        message.arbitration_id
        | EXTENDED_FLAG * message.is_extended_id
        | REMOTE_FLAG * message.is_remote_frame
    )
    flags = (
        FDF | BRS * message.bitrate_switch | ESI * message.error_state_indicator
        if message.is_fd
        else 0
    )
    data = bytes(message.dlc) if message.is_remote_frame else bytes(message.data)
    return Frame(can_id | ERROR_FLAG * message.is_error_frame, data, flags, index, t_ns)


def message_from_frame(frame: Frame, timestamp: float = 0.0) -> can.Message:
    """Convert a frame to a python-can message.

    Args:
        frame: classical or CAN FD frame. Remote requests are allowed.
        timestamp: time stamp of the message [s].
    """
    is_remote = bool(frame.can_id & REMOTE_FLAG)
    return can.Message(
        timestamp=timestamp,
        arbitration_id=frame.can_id & IDENTIFIER_MASK,
        is_extended_id=bool(frame.can_id & EXTENDED_FLAG),
        is_remote_frame=is_remote,
        is_error_frame=bool(frame.can_id & ERROR_FLAG),
        dlc=len(frame.data),
        data=None if is_remote else frame.data,
        is_fd=bool(frame.flags & FDF),
        bitrate_switch=bool(frame.flags & BRS),
        error_state_indicator=bool(frame.flags & ESI),
    )


def open_python_can(
    interface: str, channel: str, bitrate: int, data_bitrate: int | None = None
) -> can.BusABC:
    """Open a CAN interface with python-can.

    Args:
        interface: name of the interface in python-can.
        channel: name of the channel in python-can.
        bitrate: nominal bit rate [bit/s].
        data_bitrate: bit rate of the data phase of CAN FD [bit/s], or None for a classical bus.

    Raises:
        BusError: python-can has no such interface, or cannot open it.
    """
    options: dict[str, Any] = {"interface": interface, "bitrate": bitrate, "ignore_config": True}
    if data_bitrate:
        options |= {"fd": True, "data_bitrate": data_bitrate}
    try:
        return can.Bus(channel, **options)
    except (
        can.CanError,
        OSError,
        ValueError,
        TypeError,
        ImportError,
        NotImplementedError,
    ) as error:
        expected = "an interface of python-can that is connected, or local:NAME, or socketcan:can0"
        raise BusError(f"cannot be opened: {error}", f"{interface}:{channel}", expected) from None


class PythonCanBus:
    """A bus of python-can. The interface ``contract.Bus`` describes the methods of the class."""

    def __init__(
        self,
        interface: str,
        channel: str,
        index: int,
        bitrate: int,
        data_bitrate: int | None,
        convert_time: TimeConversion,
    ) -> None:
        """Open the CAN interface with python-can.

        Args:
            interface: name of the interface in python-can.
            channel: name of the channel in python-can.
            index: index of the bus in the list of the hand's buses.
            bitrate: nominal bit rate [bit/s].
            data_bitrate: bit rate of the data phase of CAN FD [bit/s], or None for a classical bus.
            convert_time: function that converts a CLOCK_MONOTONIC time to the time of the run [ns].

        Raises:
            BusError: python-can has no such interface, or cannot open it.
        """
        self.name = f"{interface}:{channel}"
        self._index = index
        self._convert_time = convert_time
        self._events = BusEvents(self.name)
        self._bus = open_python_can(interface, channel, bitrate, data_bitrate)

    def drain(self) -> Frames:
        """Return all received frames, see ``contract.Bus``."""
        frames: list[Frame] = []
        for _ in range(MAX_FRAMES_PER_DRAIN):
            try:
                message = self._bus.recv(0)
            except (can.CanError, OSError) as error:
                self._events.count_failure(_error_number(error), "enodev")
                break
            except (
                ValueError,
                IndexError,
            ):  # the interface slcan raises these errors if it cannot decode the received characters
                self._events.add_event("error_frame", 1, "garbled")
                continue
            if message is None:
                break
            self._take_message(frames, message)
        return frames_as_records(frames)

    def _take_message(self, frames: list[Frame], message: can.Message) -> None:
        """Append a received message to ``frames``.

        If the message is an error frame, count it as an event of the bus instead.
        """
        if message.is_error_frame:
            self._events.add_error_frame(message.arbitration_id, bytes(message.data))
        elif (
            message.is_rx
        ):  # the interfaces gs_usb and cantact also return the frames that this host has sent
            frames.append(
                frame_from_message(message, self._index, self._convert_time(time.monotonic_ns()))
            )

    def send(self, frames: Sequence[Frame]) -> int:
        """Send a batch of frames, and return the number of accepted frames, see ``contract.Bus``."""
        for number, frame in enumerate(frames):
            check_payload_size(frame)
            try:
                self._bus.send(message_from_frame(frame), 0)
            except (can.CanError, OSError) as error:
                self._events.count_failure(_error_number(error), "enobufs", len(frames) - number)
                return number
        return len(frames)

    def take_events(self) -> list[BusEvent]:
        """Return the events since the last call, see ``contract.Bus``."""
        return self._events.take_events()

    def fileno(self) -> int:
        """Return a file descriptor that becomes readable when a frame arrives, or -1 if the interface has none."""
        try:
            return self._bus.fileno()
        except NotImplementedError:
            return -1

    def close(self) -> None:
        """Close the bus."""
        self._bus.shutdown()


def _error_number(error: Exception) -> int | None:
    """Return the errno of an error from python-can, or None if the error has no errno.

    The errno can be in the error itself, in the attribute ``error_code`` of the error, or in the
    cause of the error.
    """
    code = error.errno if isinstance(error, OSError) else getattr(error, "error_code", None)
    if code is None and isinstance(error.__cause__, OSError):
        code = error.__cause__.errno
    return code if isinstance(code, int) else None
