"""CAN bus of the Linux kernel (SocketCAN) on a raw socket, for classical frames and CAN FD.

A batch of frames is sent or read with a single system call. The kernel adds the time of reception
to each received frame.
"""

import fcntl
import os
import socket
import struct
import time
from collections.abc import Sequence

import numpy as np

from handctl.drives.frame import ERROR_FLAG, FDF, Frame
from handctl.drives.frame_records import Frames, concatenate_frames, frames_as_records
from handctl.errors import BusError
from handctl.runtime.buses import datagram_batches
from handctl.runtime.buses.bus_events import BusEvent, BusEvents
from handctl.runtime.buses.canfd_structs import ALL_FLAGS, CANFD_FRAME_BYTES, FrameStructs
from handctl.runtime.buses.clock_offset import ClockOffset
from handctl.runtime.buses.contract import TimeConversion
from handctl.runtime.buses.interface_setup import (
    interface_names,
    interface_setup_text,
    wrong_bit_rate_text,
)

MAX_FRAMES_PER_CALL = 128
"""Largest number of frames in one system call."""
MAX_READS_PER_DRAIN = 64
"""Largest number of reads in one ``drain``.

Because of the limit, a flood of frames cannot delay a tick.
"""
RECEIVE_BUFFER_BYTES = 4 << 20
"""Size of the receive buffer requested from the kernel [bytes]."""
SEND_BUFFER_BYTES = 32 << 10
"""Size of the send buffer [bytes].

About 80 frames fit into the send buffer. The send buffer is small, because a command must not be
sent late.
"""
MAX_STAMP_STEP_NS = 20_000_000
"""Largest step from one time stamp to the next that is accepted without a reading of the clock [ns].

A larger step means that the bus was silent or that the wall clock was set. If the wall clock is set
by a smaller step, the next measurement of the clock offset detects the step.
"""
CAN_RAW_ERR_FILTER, ALL_ERRORS = 2, 0x1FFFFFFF
"""Socket option that selects error frames, and the mask of all classes of error frames.

Source: Linux ``can/raw.h``, ``can/error.h``.
"""
SIOCGIFFLAGS, SIOCGIFMTU, SIOCGIFTXQLEN, IFF_UP = 0x8913, 0x8921, 0x8942, 1
"""Requests to the kernel for the flags, MTU and queue length of an interface.

IFF_UP is the flag of an interface that is up.

Source: Linux ``sockios.h``, ``if.h``.
"""
MIN_QUEUE_FRAMES = 32
"""Shortest accepted transmit queue [frames].

A tick sends the frames of 11 motors and a SYNC together. The default queue of 10 frames is too
short for all frames of a tick.
"""


class SocketCanBus:
    """CAN bus on a raw CAN socket of Linux.

    The interface ``contract.Bus`` describes the methods of the class.
    """

    def __init__(
        self, link: socket.socket, name: str, index: int, convert_time: TimeConversion
    ) -> None:
        """Set up an open socket for use as a bus.

        Args:
            link: raw CAN socket, or a datagram socket that carries the same structs.
            name: specification of the bus.
            index: index of the bus in the list of the hand's buses.
            convert_time: function that converts a CLOCK_MONOTONIC time to the time of the run [ns].
        """
        _set_socket_options(link)
        self.name = name
        self._socket = link
        self._index = index
        self._convert_time = convert_time
        self._events = BusEvents(name)
        self._in = datagram_batches.DatagramSlots(
            MAX_FRAMES_PER_CALL, CANFD_FRAME_BYTES, has_control_data=True
        )
        self._out = datagram_batches.DatagramSlots(
            MAX_FRAMES_PER_CALL, CANFD_FRAME_BYTES, has_control_data=False
        )
        self._structs = FrameStructs(self._in.data)
        self._out_structs = FrameStructs(self._out.data)
        self._dropped = 0
        self._latest = 0
        self._offset = ClockOffset()

    def drain(self) -> Frames:
        """Return all received frames, see ``contract.Bus``."""
        frame_batches: list[Frames] = []
        for _ in range(MAX_READS_PER_DRAIN):
            try:
                count = datagram_batches.receive_datagrams(self._socket.fileno(), self._in)
            except OSError as error:
                self._events.count_failure(error.errno, "enodev")
                break
            if count:
                frame_batches.append(self._convert_datagrams(count))
                self._in.reset_headers(count)
            if count < MAX_FRAMES_PER_CALL:
                break
        return concatenate_frames(frame_batches)

    def _convert_datagrams(self, count: int) -> Frames:
        """Convert the received datagrams to frames.

        Usually all datagrams are of the same kind (classical or CAN FD) and have similar time
        stamps, and no frame was lost before them. If the received datagrams have these properties,
        the function converts all datagrams at once. Without these properties, the function converts
        each datagram separately.
        """
        size = self._in.common_datagram_size(count, self._dropped)
        frames = (
            self._convert_uniform_batch(count, FDF if size == CANFD_FRAME_BYTES else 0)
            if size
            else None
        )
        if frames is None:
            self._offset.request_measurement()
            frames = self._convert_one_by_one(self._in.datagrams(count), time.monotonic_ns())
        return frames

    def _convert_uniform_batch(self, count: int, fd_flag: int) -> Frames | None:
        """Convert a batch of datagrams that are all of the same kind (classical or CAN FD), and return the frames.

        If the batch contains an error frame, or if the time stamps are not in a plausible range,
        return None. If the result is None, the caller converts each frame separately.
        """
        frames, has_error_frames = self._structs.read(
            count, 0, self._index, ALL_FLAGS if fd_flag else 0, fd_flag
        )
        if has_error_frames:
            return None
        times = self._in.reception_stamps(count)
        times += self._offset.offset_ns()
        receive_times = times.tolist()
        min_stamp_ns = self._latest
        first_time_ns = min(receive_times)
        last_time_ns = max(receive_times)
        if not min_stamp_ns <= first_time_ns <= last_time_ns <= min_stamp_ns + MAX_STAMP_STEP_NS:
            return None
        convert_time = self._convert_time
        first_run_time_ns = convert_time(first_time_ns)
        if (
            convert_time(last_time_ns) - first_run_time_ns == last_time_ns - first_time_ns
        ):  # between the time stamps of a batch, the time of the run is neither scaled nor paused
            times += first_run_time_ns - first_time_ns
        else:
            times = np.array([convert_time(t_ns) for t_ns in receive_times])
        self._latest = receive_times[-1]
        frames.records["t_ns"] = times
        return frames

    def _convert_one_by_one(
        self, datagrams: list[datagram_batches.Datagram], now_ns: int
    ) -> Frames:
        """Convert datagrams of any kind, one after the other, and return their frames.

        Error frames and lost frames are not returned, but counted as events of the bus.
        """
        convert_time = self._convert_time
        min_stamp_ns = self._latest
        offset = self._offset.offset_ns()
        count = len(datagrams)
        stamps = []
        frames, _ = self._structs.read(count, 0, self._index)
        is_data_frame = np.ones(count, bool)
        for i, ((size, wall_time_ns, dropped_count), frame) in enumerate(
            zip(datagrams, frames, strict=True)
        ):
            # The loss counter 0 means that the kernel has reported no lost frames.
            if dropped_count != self._dropped and dropped_count:
                self._events.add_event("dropped", (dropped_count - self._dropped) & 0xFFFFFFFF)
                self._dropped = dropped_count
            if frame.can_id & ERROR_FLAG:
                self._events.add_error_frame(frame.can_id, frame.data)
                is_data_frame[i] = False
                continue
            frames.records["flags"][i] = frame.flags | FDF if size == CANFD_FRAME_BYTES else 0
            t_ns = wall_time_ns + offset
            if not min_stamp_ns <= t_ns <= now_ns:
                # The time stamp is missing, or the wall clock has been set in the meantime.
                t_ns = now_ns
            stamps.append(convert_time(t_ns))
            self._latest = max(self._latest, t_ns)
        records = frames.records[is_data_frame]
        records["t_ns"] = stamps
        return Frames.from_records(records)

    def send(self, frames: Sequence[Frame]) -> int:
        """Send a batch of frames, and return the number of accepted frames, see ``contract.Bus``."""
        frames = frames_as_records(frames)
        accepted = 0
        for first_frame in range(0, len(frames), MAX_FRAMES_PER_CALL):
            batch = (
                frames[first_frame : first_frame + MAX_FRAMES_PER_CALL]
                if len(frames) > MAX_FRAMES_PER_CALL
                else frames
            )
            self._out.set_datagram_lengths(self._out_structs.write(batch))
            sent_count, code = datagram_batches.send_datagrams(
                self._socket.fileno(), self._out, 0, len(batch)
            )
            accepted += sent_count
            if code:
                self._events.count_failure(code, "enobufs", len(frames) - accepted)
                break
        return accepted

    def take_events(self) -> list[BusEvent]:
        """Return the events since the last call, see ``contract.Bus``."""
        return self._events.take_events()

    def fileno(self) -> int:
        """Return the file descriptor of the socket."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _set_socket_options(can_socket: socket.socket) -> None:
    """Set the buffer sizes of a socket, and switch on its time stamps of reception and its counter of lost frames."""
    can_socket.setblocking(False)
    can_socket.setsockopt(socket.SOL_SOCKET, datagram_batches.SO_TIMESTAMPNS, 1)
    can_socket.setsockopt(socket.SOL_SOCKET, datagram_batches.SO_RXQ_OVFL, 1)
    can_socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
    try:  # only root can request a buffer that is larger than net.core.rmem_max
        can_socket.setsockopt(
            socket.SOL_SOCKET, datagram_batches.SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES
        )
    except PermissionError:
        can_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)


def open_socketcan(
    channel: str, index: int, bitrate: int, data_bitrate: int | None, convert_time: TimeConversion
) -> SocketCanBus:
    """Open a CAN interface of the Linux kernel.

    Args:
        channel: name of the interface. The interface must already be up.
        index: index of the bus in the list of the hand's buses.
        bitrate: required nominal bit rate [bit/s].
        data_bitrate: required bit rate of the data phase of CAN FD [bit/s]. None for a classical
            bus.
        convert_time: function that converts a CLOCK_MONOTONIC time to the time of the run [ns].

    Raises:
        BusError: the kernel has no SocketCAN, or the interface is missing or down, is not in CAN FD
            mode although the hand needs CAN FD, has another bit rate, or has too short a transmit
            queue.
    """
    name = f"socketcan:{channel}"
    fd_mode = data_bitrate is not None
    exists = channel in interface_names()
    hint = "type: " + interface_setup_text(channel, bitrate, data_bitrate, exists)
    try:
        link = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        expected = "modprobe can-raw, or --bus local:NAME with handctl sim"
        raise BusError(
            f"this kernel has no SocketCAN: {os.strerror(error.errno or 0)}", name, expected
        ) from None
    try:
        link.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, ALL_ERRORS)
        link.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, int(fd_mode))
        link.bind((channel,))
        problem = _interface_problem(link, channel, fd_mode) or wrong_bit_rate_text(
            channel, bitrate, data_bitrate
        )
    except OSError as error:
        problem = f"cannot be opened: {os.strerror(error.errno or 0)}"
    if problem:
        link.close()
        raise BusError(problem, name, hint)
    return SocketCanBus(link, name, index, convert_time)


def _interface_problem(can_socket: socket.socket, channel: str, fd_mode: bool) -> str:
    """Return a message if an existing interface cannot be used.

    If the interface can be used, the message is empty.
    """
    if not _read_interface_number(can_socket, channel, SIOCGIFFLAGS) & IFF_UP:
        return "the interface is down"
    if fd_mode and _read_interface_number(can_socket, channel, SIOCGIFMTU) < CANFD_FRAME_BYTES:
        return "the interface is not in CAN FD mode"
    if (
        0
        < (length := _read_interface_number(can_socket, channel, SIOCGIFTXQLEN))
        < MIN_QUEUE_FRAMES
    ):
        return f"its transmit queue holds {length} frames, less than a tick may send at once"
    return ""


def _read_interface_number(can_socket: socket.socket, channel: str, request: int) -> int:
    """Read the flags, the MTU or the queue length of an interface in the socket's network namespace."""
    # Layout of struct ifreq: name 16 bytes | flags 16 bits, or MTU 32 bits, or queue length 32 bits
    # | padding
    answer = fcntl.ioctl(can_socket, request, struct.pack("=16sI20x", channel.encode(), 0))
    (number,) = struct.unpack_from("=H" if request == SIOCGIFFLAGS else "=i", answer, 16)
    return int(number)
