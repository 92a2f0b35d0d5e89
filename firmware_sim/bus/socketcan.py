"""A port on a CAN interface of Linux.

The CAN interface is real or virtual, and uses classical CAN or CAN FD.
"""

import errno
import socket
import struct
from collections.abc import Collection

from firmware_sim.bus.frame import FDF, Frame
from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.wire.simulated_wire import NEVER_NS

_CAN_FRAME_STRUCT = struct.Struct("=IB3x8s")
"""``struct can_frame``: identifier, length, 3 bytes of padding, 8 bytes of payload. Source: Linux ``can.h``."""
_CANFD_FRAME_STRUCT = struct.Struct("=IBB2x64s")
"""``struct canfd_frame``: identifier, length, flags, 2 reserved bytes, 64 bytes of payload. Source: Linux ``can.h``."""
_MAX_FRAMES_PER_READ = 256
"""Maximum number of frames of one read.

Because of the limit, a flooded bus cannot stop the simulation.
"""


class SocketCanPort:
    """A port of the simulator on a SocketCAN interface.

    The class ``bus_ports.BusPort`` describes the methods.
    """

    due_ns = NEVER_NS

    def __init__(self, interface: str, bus: int) -> None:
        """Open the CAN interface.

        Args:
            interface: name of the interface, such as vcan0.
            bus: index of the bus in the list of the hand's buses.

        Raises:
            SimulatorError: the operating system has no SocketCAN, or the interface does not exist.
        """
        self._bus = bus
        self.lost_frame_count = 0
        if not hasattr(socket, "CAN_RAW_FD_FRAMES"):
            raise SimulatorError(
                f"socketcan:{interface}: this system has no SocketCAN; use local:NAME"
            )
        try:
            self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except OSError as error:
            raise SimulatorError(
                f"socketcan:{interface}: {error.strerror}; modprobe can-raw, or local:NAME"
            ) from error
        try:
            self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
            self._socket.bind((interface,))
        except OSError as error:
            self._socket.close()
            hint = f"ip link add dev {interface} type vcan; ip link set {interface} mtu 72 up"
            raise SimulatorError(
                f"socketcan:{interface}: {error.strerror}; for a virtual one: {hint}"
            ) from error
        self._socket.setblocking(False)

    def read_sockets(self) -> list[socket.socket]:
        """See ``bus_ports.BusPort.read_sockets``."""
        return [self._socket]

    def write_sockets(self) -> list[socket.socket]:
        """See ``bus_ports.BusPort.write_sockets``."""
        return []

    def receive(self, ready_sockets: Collection[socket.socket]) -> list[Frame]:
        """See ``bus_ports.BusPort.receive``."""
        frames: list[Frame] = []
        if self._socket not in ready_sockets:
            return frames
        try:
            while len(frames) < _MAX_FRAMES_PER_READ:
                frames.append(self._frame_from_bytes(self._socket.recv(_CANFD_FRAME_STRUCT.size)))
        except BlockingIOError:
            pass
        except OSError as error:
            if error.errno != errno.ENETDOWN:
                raise
            # The CAN interface is down. Frames can be read again after the interface has been set
            # up.
            self.lost_frame_count += 1
        return frames

    def _frame_from_bytes(self, struct_bytes: bytes) -> Frame:
        # The number of received bytes shows the format of the frame: 16 bytes for classical CAN, 72
        # bytes for CAN FD.
        if len(struct_bytes) == _CAN_FRAME_STRUCT.size:
            can_id, length, data = _CAN_FRAME_STRUCT.unpack(struct_bytes)
            return Frame(can_id, data[: min(length, 8)], 0, self._bus)
        can_id, length, flags, data = _CANFD_FRAME_STRUCT.unpack(struct_bytes)
        return Frame(can_id, data[:length], flags | FDF, self._bus)

    def send(self, frames: list[Frame]) -> None:
        """See ``bus_ports.BusPort.send``."""
        for frame in frames:
            fd = frame.flags & FDF
            raw_bytes = (
                _CANFD_FRAME_STRUCT.pack(frame.can_id, len(frame.data), frame.flags, frame.data)
                if fd
                else _CAN_FRAME_STRUCT.pack(frame.can_id, len(frame.data), frame.data)
            )
            try:
                self._socket.send(raw_bytes)
            except (
                OSError
            ):  # frame lost: the queue is full (ENOBUFS), or the interface is down or has no CAN FD
                self.lost_frame_count += 1

    def close(self) -> None:
        """See ``bus_ports.BusPort.close``."""
        self._socket.close()
