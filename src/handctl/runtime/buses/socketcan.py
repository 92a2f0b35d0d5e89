"""Linux SocketCAN, classical and FD: raw socket, whole batches in one system call, the kernel's receive stamps."""

import fcntl
import functools
import os
import socket
import struct
import time
from collections.abc import Iterator, Sequence
from typing import Any

from handctl.drives.frame import ERROR, FDF, Frame, make
from handctl.errors import BusError
from handctl.runtime.buses import mmsg
from handctl.runtime.buses.contract import Stamp, check_size
from handctl.runtime.buses.events import BusEvents, Event
from handctl.runtime.buses.interface import wrong_rate
from handctl.runtime.buses.wall import WallOffset

SLOTS = 128
"""Frames of one system call."""
CLASSICAL = struct.Struct("=IB3x8s")
FD = struct.Struct("=IBB2x64s")
"""``struct can_frame`` and ``struct canfd_frame``. Source: Linux ``can.h``."""
_SLOT = struct.Struct("=IBB2x8s56x")
"""Either of them on a socket that gets classical frames only: 8 bytes of payload are all there can be."""


@functools.lru_cache(maxsize=SLOTS)
def _batch(count: int) -> struct.Struct:
    """So many classical frames in slots as one struct: a tick sends the same number again and again."""
    return struct.Struct("=" + "IB3x8s56x" * count)


CLASSICAL_MOST = 8
"""Payload that any frame can carry [bytes]."""
READS = 64
"""Reads of one drain: a flood cannot make a tick long."""
RECEIVE_BUFFER = 4 << 20
SEND_BUFFER = 32 << 10
"""Small on purpose, about 80 frames: a command that cannot go out now must not go out late [bytes]."""
AHEAD_NS = 20_000_000
"""A stamp further than this from the one before is compared with the clock: silence, or the wall clock was set. Less
than this goes unnoticed until the offset of the clocks is measured again, which is soon [ns]."""
CAN_RAW_ERR_FILTER, ALL_ERRORS = 2, 0x1FFFFFFF
"""Source: Linux ``can/raw.h``, ``can/error.h``."""
SIOCGIFFLAGS, SIOCGIFMTU, SIOCGIFTXQLEN, IFF_UP = 0x8913, 0x8921, 0x8942, 1
"""Source: Linux ``sockios.h``, ``if.h``."""
QUEUE = 32
"""Fewest frames that a transmit queue must hold; eleven motors and SYNC go out at once, and the default is 10."""


class SocketCanBus:
    """A raw CAN socket; see ``bus.Bus``."""

    def __init__(self, link: socket.socket, name: str, index: int, fd_mode: bool, stamp: Stamp) -> None:
        """Take over an open socket.

        Args:
            link: raw CAN socket, or any datagram socket that carries the same structs.
            name: specification of the bus.
            index: of the bus in the hand's list.
            fd_mode: whether FD frames can come.
            stamp: makes the run's time of a CLOCK_MONOTONIC time.
        """
        _prepare(link)
        self.name = name
        self._socket, self._index, self._fd_mode, self._stamp = link, index, fd_mode, stamp
        self._events = BusEvents(name)
        self._in = mmsg.Slots(SLOTS, FD.size, control=True)
        self._out = mmsg.Slots(SLOTS, FD.size, control=False)
        self._dropped = 0
        self._latest = 0
        self._offset = WallOffset()

    def drain(self) -> list[Frame]:
        """See ``bus.Bus``."""
        frames: list[Frame] = []
        for _ in range(READS):
            try:
                count = mmsg.receive(self._socket.fileno(), self._in)
            except OSError as error:
                self._events.failed(error.errno, "enodev")
                break
            if count:
                self._take(frames, count)
                self._in.renew(count)
            if count < SLOTS:
                break
        return frames

    def _take(self, frames: list[Frame], count: int) -> None:
        """Make frames of what was received; usually all datagrams are alike, and their stamps follow the last ones."""
        size = self._in.even(count)
        if not (size and self._take_even(frames, count, FDF if size == FD.size else 0)):
            self._offset.renew()
            self._take_each(frames, self._in.datagrams(count), time.monotonic_ns())

    def _rows(self, count: int) -> Iterator[tuple[Any, ...]]:
        """Identifier, length, flags and padded payload of the frames received."""
        return (FD if self._fd_mode else _SLOT).iter_unpack(self._in.data[: count * FD.size])

    def _take_even(self, frames: list[Frame], count: int, fd_flag: int) -> bool:
        """Frames of one kind, all stamped; False, and none taken, if one is an error frame or a stamp needs a look."""
        index, stamp, error, kept_flags = self._index, self._stamp, ERROR, 0xFF if fd_flag else 0
        t_ns, earliest, offset, taken = 0, self._latest, self._offset.ns(), []
        latest = earliest + AHEAD_NS
        stamps = mmsg.STAMP.iter_unpack(self._in.control[: count * mmsg.CONTROL.size])
        for (s, ns), (can_id, length, flags, data) in zip(stamps, self._rows(count), strict=True):
            t_ns = s * 1_000_000_000 + ns + offset
            if can_id & error or not earliest <= t_ns <= latest:
                return False
            taken.append(make(Frame, (can_id, data[:length], flags & kept_flags | fd_flag, index, stamp(t_ns))))
        frames += taken
        self._latest = t_ns
        return True

    def _take_each(self, frames: list[Frame], told: list[mmsg.Datagram], now: int) -> None:
        """Frames of any kind, error frames, and the count of what was lost."""
        index, stamp, earliest, offset = self._index, self._stamp, self._latest, self._offset.ns()
        for (size, realtime, dropped), (can_id, length, flags, data) in zip(told, self._rows(len(told)), strict=True):
            if dropped != self._dropped and dropped:
                self._events.add("dropped", (dropped - self._dropped) & 0xFFFFFFFF)
                self._dropped = dropped
            if can_id & ERROR:
                self._events.error_frame(can_id, data[:length])
                continue
            fd_flags = flags | FDF if size == FD.size else 0
            t_ns = realtime + offset
            if not earliest <= t_ns <= now:
                t_ns = now  # not told, or the wall clock was set meanwhile
            frames.append(Frame(can_id, data[:length], fd_flags, index, stamp(t_ns)))
            self._latest = max(self._latest, t_ns)

    def send(self, frames: Sequence[Frame]) -> int:
        """See ``bus.Bus``."""
        accepted = 0
        for first in range(0, len(frames), SLOTS):
            batch = frames[first : first + SLOTS]
            self._pack(batch)
            sent, code = mmsg.send(self._socket.fileno(), self._out, 0, len(batch))
            accepted += sent
            if code:
                self._events.failed(code, "enobufs", len(frames) - accepted)
                break
        return accepted

    def _pack(self, frames: Sequence[Frame]) -> None:
        """Fill the slots; classical frames, as nearly always, in one go."""
        values: list[int | bytes] = []
        for can_id, data, flags, _, _ in frames:
            size = len(data)
            if flags or size > CLASSICAL_MOST:
                return self._pack_each(frames)
            values += (can_id, size, data)
        _batch(len(frames)).pack_into(self._out.data, 0, *values)
        self._out.set_lengths(len(frames), CLASSICAL.size)
        return None

    def _pack_each(self, frames: Sequence[Frame]) -> None:
        buffer, offset = self._out.data, 0
        for i, frame in enumerate(frames):
            can_id, data, flags, _, _ = frame
            check_size(frame)
            layout = FD if flags & FDF else CLASSICAL
            values = (can_id, len(data), flags, data) if layout is FD else (can_id, len(data), data)
            layout.pack_into(buffer, offset, *values)
            self._out.set_length(i, layout.size)
            offset += FD.size

    def take_events(self) -> list[Event]:
        """See ``bus.Bus``."""
        return self._events.take()

    def fileno(self) -> int:
        """See ``bus.Bus``."""
        return self._socket.fileno()

    def close(self) -> None:
        """See ``bus.Bus``."""
        self._socket.close()


def _prepare(link: socket.socket) -> None:
    """Room for what comes while a tick computes, stamps, and the count of what did not fit."""
    link.setblocking(False)
    link.setsockopt(socket.SOL_SOCKET, mmsg.SO_TIMESTAMPNS, 1)
    link.setsockopt(socket.SOL_SOCKET, mmsg.SO_RXQ_OVFL, 1)
    link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
    try:
        link.setsockopt(socket.SOL_SOCKET, mmsg.SO_RCVBUFFORCE, RECEIVE_BUFFER)
    except PermissionError:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)


def open_socketcan(channel: str, index: int, bitrate: int, data_bitrate: int | None, stamp: Stamp) -> SocketCanBus:
    """Open an interface of the kernel.

    Args:
        channel: name of the interface, which must be up.
        index: of the bus in the hand's list.
        bitrate, data_bitrate: what the interface should run at, for the advice when it is not there [bit/s].
        stamp: makes the run's time of a CLOCK_MONOTONIC time.

    Raises:
        BusError: no SocketCAN here, or the interface is missing, down, not FD as needed, set to another
            bit rate, or has too short a queue.
    """
    name, fd_mode = f"socketcan:{channel}", data_bitrate is not None
    there = channel in [known for _, known in socket.if_nameindex()]
    hint = "type: " + advice(channel, bitrate, data_bitrate, there)
    try:
        link = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        right = "modprobe can-raw, or --bus local:NAME with python -m firmware_sim"
        raise BusError(f"this kernel has no SocketCAN: {os.strerror(error.errno or 0)}", name, right) from None
    try:
        link.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, ALL_ERRORS)
        link.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, int(fd_mode))
        link.bind((channel,))
        problem = _problem(link, channel, fd_mode) or wrong_rate(channel, bitrate, data_bitrate)
    except OSError as error:
        problem = f"cannot be opened: {os.strerror(error.errno or 0)}"
    if problem:
        link.close()
        raise BusError(problem, name, hint)
    return SocketCanBus(link, name, index, fd_mode, stamp)


def _problem(link: socket.socket, channel: str, fd_mode: bool) -> str:
    """What is wrong with an interface that exists; empty if nothing is."""
    if not _ask(link, channel, SIOCGIFFLAGS) & IFF_UP:
        return "the interface is down"
    if fd_mode and _ask(link, channel, SIOCGIFMTU) < FD.size:
        return "the interface is not in CAN FD mode"
    if 0 < (length := _ask(link, channel, SIOCGIFTXQLEN)) < QUEUE:
        return f"its transmit queue holds {length} frames, less than a tick may send at once"
    return ""


def _ask(link: socket.socket, channel: str, request: int) -> int:
    """A number that the kernel keeps of an interface, in the network namespace of the socket."""
    answer = fcntl.ioctl(link, request, struct.pack("=16sI20x", channel.encode(), 0))
    (number,) = struct.unpack_from("=H" if request == SIOCGIFFLAGS else "=i", answer, 16)
    return int(number)


def advice(channel: str, bitrate: int, data_bitrate: int | None, there: bool = False) -> str:
    """Command that sets an interface up as the hand needs it, ``there`` if there is one already."""
    if channel.startswith("vcan"):
        steps = ["sudo ip link set {0} down" if there else "sudo ip link add {0} type vcan"]
        steps += ["sudo ip link set {0} mtu 72"] * bool(data_bitrate) + ["sudo ip link set {0} up"]
        return " && ".join(steps).format(channel)
    fd = f" dbitrate {data_bitrate} fd on" if data_bitrate else ""
    down = f"sudo ip link set {channel} down; "
    return f"{down}sudo ip link set {channel} up txqueuelen 128 type can bitrate {bitrate}{fd}"
