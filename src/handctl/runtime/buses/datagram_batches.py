"""Sending and receiving of many datagrams in one system call.

The module uses ``sendmmsg`` and ``recvmmsg`` of Linux with reused buffers. The ``socket`` module of
Python offers neither ``sendmmsg`` nor ``recvmmsg``. With one system call for each frame, the system
calls would take longer than all other work of an exchange of frames. Source: man 2 recvmmsg, man 7
socket (SO_TIMESTAMPNS, SO_RXQ_OVFL), man 3 cmsg.
"""

import ctypes
import errno
import socket
import struct

import numpy as np
from numpy.typing import NDArray

SO_RCVBUFFORCE = 33
SO_TIMESTAMPNS = 35
SO_RXQ_OVFL = 40
_SOL_SOCKET = int(socket.SOL_SOCKET)
"""Level of the socket options above. Source of the numbers of the socket options: Linux ``asm-generic/socket.h``."""


class _Iovec(ctypes.Structure):
    """``struct iovec``: address and size of a buffer."""

    _fields_ = (("base", ctypes.c_void_p), ("len", ctypes.c_size_t))


class _MessageHeader(ctypes.Structure):
    """``struct msghdr``: peer address, buffers, control messages, flags."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("namelen", ctypes.c_uint32),
        ("iov", ctypes.c_void_p),
        ("iovlen", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("controllen", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _MultiMessageHeader(ctypes.Structure):
    """``struct mmsghdr``: a message and the number of bytes sent or received."""

    _fields_ = (("message", _MessageHeader), ("size", ctypes.c_uint))


CONTROL_MESSAGES_STRUCT = struct.Struct("@NiillNiiI12x")
"""Control messages added to a received datagram by the kernel, in native layout.

    length | level | SO_TIMESTAMPNS | s | ns
    length | level | SO_RXQ_OVFL | dropped 32 | padding 12
"""
TIME_STAMP_OFFSET = struct.calcsize("@Nii")
"""Offset of the time stamp's seconds in the control messages [bytes].

The nanoseconds of the time stamp follow its seconds.
"""
CONTROL_BYTES_WITH_TIME_STAMP = struct.calcsize("@Niill")
"""Length of the control messages if they have a time stamp and no loss counter [bytes].

Control messages with a loss counter but no time stamp are shorter.
"""
CONTROL_BYTES_WITH_COUNTER = struct.calcsize("@NiillNiiI")
"""Shortest length of the control messages if they have a time stamp and a loss counter [bytes].

The kernel also counts the padding after the counter, if it is within the buffer.
"""
COUNTER_OFFSET = struct.calcsize("@NiillNii")
"""Offset of the loss counter in the control messages [bytes]."""
_HEADER_PADDING_BYTES = (
    ctypes.sizeof(_MultiMessageHeader)
    - _MultiMessageHeader.size.offset
    - ctypes.sizeof(ctypes.c_uint)
)
_HEADER_GAP_BYTES = (
    _MultiMessageHeader.size.offset
    - _MessageHeader.controllen.offset
    - ctypes.sizeof(ctypes.c_size_t)
)
_HEADER_STRUCT = struct.Struct(
    f"@{_MessageHeader.controllen.offset}xN{_HEADER_GAP_BYTES}xI{_HEADER_PADDING_BYTES}x"
)
"""Values that the kernel writes into a header: length of the control messages, length of the datagram."""
_libc = ctypes.CDLL(None, use_errno=True)
for _call in ("sendmmsg", "recvmmsg"):
    getattr(_libc, _call).restype = ctypes.c_int
_libc.sendmmsg.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int)
_libc.recvmmsg.argtypes = (
    ctypes.c_int,
    ctypes.c_void_p,
    ctypes.c_uint,
    ctypes.c_int,
    ctypes.c_void_p,
)


NS_PER_SECOND = np.int64(1_000_000_000)
Datagram = tuple[int, int, int]
"""Received datagram: size [bytes], CLOCK_REALTIME [ns] (0 if missing), number of datagrams lost so far, modulo 2**32.

The kernel omits the loss counter until the first loss of a datagram. A missing loss counter counts
as 0.
"""


class DatagramSlots:
    """Buffers of equal size for datagrams.

    The object also contains one ``struct mmsghdr`` per buffer, through which the kernel finds the
    buffer.

    Attributes:
        count: number of slots.
        size: size of each slot [bytes].
        data: memory of all slots.
        control: memory of all control messages.
        headers: address of the first header.
    """

    def __init__(self, count: int, size: int, has_control_data: bool) -> None:
        """Allocate the buffers.

        Args:
            count: number of slots.
            size: size of a slot [bytes].
            has_control_data: True to receive control messages, such as time stamps.
        """
        self.count = count
        self.size = size
        buffer = (ctypes.c_char * (count * size))()
        messages = (ctypes.c_char * (count * CONTROL_MESSAGES_STRUCT.size))()
        self._iovecs = (_Iovec * count)()
        headers = (_MultiMessageHeader * count)()
        for i in range(count):
            self._iovecs[i] = _Iovec(ctypes.addressof(buffer) + i * size, size)
            message = headers[i].message
            message.iov = ctypes.addressof(self._iovecs) + i * ctypes.sizeof(_Iovec)
            message.iovlen = 1
            if has_control_data:
                message.control = ctypes.addressof(messages) + i * CONTROL_MESSAGES_STRUCT.size
                message.controllen = CONTROL_MESSAGES_STRUCT.size
        self.data = memoryview(buffer).cast("B")
        self.control = memoryview(messages).cast("B")
        self.headers = ctypes.addressof(headers)
        self._view = memoryview(headers).cast("B")
        self._sizes = np.frombuffer(memoryview(self._iovecs).cast("B"), np.uintp).reshape(count, 2)[
            :, 1
        ]
        control_words = np.frombuffer(self.control, "l").reshape(count, -1)
        first_stamp_word = TIME_STAMP_OFFSET // control_words.itemsize
        self._seconds = control_words[:, first_stamp_word]
        self._nanoseconds = control_words[:, first_stamp_word + 1]
        counters = np.frombuffer(self.control, np.uint32).reshape(count, -1)
        self._loss_counters = counters[:, COUNTER_OFFSET // counters.itemsize]
        self._initial_headers = bytes(self._view)
        self._last_headers = b""
        self._last_size = 0
        self._last_has_counters = False

    def common_datagram_size(self, count: int, known_loss_count: int) -> int:
        """Return the common size of the first ``count`` datagrams [bytes].

        If the datagrams have no common size, return 0. The caller must then read each datagram
        separately. The datagrams have a common size if all of them have the same length and a time
        stamp, and if no loss counter has a new value. After the first lost datagram, the kernel
        adds the loss counter to every datagram. The method keeps the latest header bytes and their
        result, because the header bytes are usually the same in every tick.

        Args:
            count: number of received datagrams.
            known_loss_count: latest value of the loss counter that the caller knows.
        """
        raw_bytes = bytes(self._view[: count * _HEADER_STRUCT.size])
        if raw_bytes != self._last_headers:
            kinds = set(_HEADER_STRUCT.iter_unpack(raw_bytes))
            length, size = kinds.pop()
            self._last_has_counters = length >= CONTROL_BYTES_WITH_COUNTER
            has_time_stamp = self._last_has_counters or length == CONTROL_BYTES_WITH_TIME_STAMP
            self._last_size = size if has_time_stamp and not kinds else 0
            self._last_headers = raw_bytes
        if self._last_has_counters and (self._loss_counters[:count] != known_loss_count).any():
            return 0
        return self._last_size

    def datagrams(self, count: int) -> list[Datagram]:
        """Return the size, the time stamp and the loss counter of each of the first ``count`` datagrams."""
        sizes = _HEADER_STRUCT.iter_unpack(self._view[: count * _HEADER_STRUCT.size])
        control = CONTROL_MESSAGES_STRUCT.iter_unpack(
            self.control[: count * CONTROL_MESSAGES_STRUCT.size]
        )
        result = []
        for (length, size), (_, level, kind, s, ns, _, level2, kind2, dropped_count) in zip(
            sizes, control, strict=True
        ):
            is_timestamp = (
                length >= CONTROL_BYTES_WITH_TIME_STAMP
                and kind == SO_TIMESTAMPNS
                and level == _SOL_SOCKET
            )
            is_drop_counter = (
                length >= CONTROL_BYTES_WITH_COUNTER
                and kind2 == SO_RXQ_OVFL
                and level2 == _SOL_SOCKET
            )
            result.append(
                (
                    size,
                    s * 1_000_000_000 + ns if is_timestamp else 0,
                    dropped_count if is_drop_counter else 0,
                )
            )
        return result

    def reset_headers(self, count: int) -> None:
        """Reset the first ``count`` headers for the next reception."""
        end = count * _HEADER_STRUCT.size
        self._view[:end] = self._initial_headers[:end]

    def reception_stamps(self, count: int) -> NDArray[np.int64]:
        """Return the CLOCK_REALTIME stamps of the first ``count`` datagrams [ns].

        Each of the first ``count`` datagrams must have a time stamp.
        """
        times: NDArray[np.int64] = self._seconds[:count] * NS_PER_SECOND
        times += self._nanoseconds[:count]
        return times

    def set_datagram_lengths(self, lengths: NDArray[np.uint64]) -> None:
        """Set how many bytes of each slot the next call of ``send_datagrams`` sends.

        Element i of ``lengths`` is the number of bytes in slot i.
        """
        self._sizes[: len(lengths)] = lengths


def receive_datagrams(fd: int, slots: DatagramSlots) -> int:
    """Receive the waiting datagrams, at most one for each slot.

    Return the number of received datagrams.

    Before the slots can receive again, the caller must call ``DatagramSlots.reset_headers``.

    Raises:
        OSError: ``recvmmsg`` failed. If no datagram is waiting, no error is raised.
    """
    count: int = _libc.recvmmsg(fd, slots.headers, slots.count, socket.MSG_DONTWAIT, None)
    if count >= 0:
        return count
    code = ctypes.get_errno()
    if code in (0, errno.EAGAIN):
        return 0
    raise OSError(code, "recvmmsg")


def send_datagrams(
    fd: int, slots: DatagramSlots, first_slot: int, slot_end: int
) -> tuple[int, int]:
    """Send the slots from ``first_slot`` to the slot before ``slot_end``, without blocking.

    Returns:
        the number of accepted datagrams, and the errno of the first refused datagram (0 if all were
        accepted).
    """
    next_slot = first_slot
    while next_slot < slot_end:
        count = _libc.sendmmsg(
            fd,
            slots.headers + next_slot * _HEADER_STRUCT.size,
            slot_end - next_slot,
            socket.MSG_DONTWAIT,
        )
        if count <= 0:
            return next_slot - first_slot, ctypes.get_errno()
        next_slot += count
    return slot_end - first_slot, 0
