"""The interface between a drive protocol and the simulator: the simulated node, and the motors as delivered."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from firmware_sim.bus.frame import EXTENDED_FLAG, Frame
from firmware_sim.description.hand_description import MotorSpec
from firmware_sim.plant.motor import Motor

SENSOR_NODE_KIND, MIT_KIND, ODRIVE_KIND, CIA402_KIND = range(4)
"""Numbers of the kinds of nodes in compiled kernels: sensor node, MIT drive, ODrive, CiA 402 drive."""


class SimulatedNode(Protocol):
    """A simulated node on the bus.

    The methods of a node get the present time as an argument.

    Attributes:
        wake_ns: time of the next call of ``wake`` [ns].
        malformed: number of frames with an identifier of the node that the node could not decode.
        ids: identifiers of the frames that the node answers. After each change of the identifiers,
            the set of identifiers is a different object. The attribute is None if the node must
            receive every frame.
    """

    @property
    def wake_ns(self) -> int:
        """Return the time of the next call of ``wake`` [ns]."""
        ...

    @property
    def ids(self) -> frozenset[int] | None:
        """Return the identifiers of the frames that the node answers, or None if the node must receive every frame."""
        ...

    @property
    def malformed_frame_count(self) -> int:
        """Return the number of frames that the node could not decode.

        The number includes only frames with an identifier of the node.
        """
        ...

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Process a frame from the bus, and answer it.

        Returns:
            The answers, or None if the frame is not meant for this node.
        """
        ...

    def wake(self, t_ns: int) -> list[Frame] | None:
        """Do the work of the node that is due, such as updates of watchdog and temperatures.

        Returns:
            The unsolicited frames to send, or None if the node never sends unsolicited frames.
        """
        ...


class DriveNode(SimulatedNode, Protocol):
    """A simulated node that drives a motor.

    Attributes:
        watchdog_fed_ns: time of the last frame that fed the watchdog [ns], negative if the
            drive has no watchdog.
    """

    watchdog_fed_ns: int


class ShaftSpec(NamedTuple):
    """Data of a motor as the maker delivers it.

    All data are converted to the output shaft.

    Attributes:
        peak: torque at the full scale of the torque field in frames [N m].
        inertia: inertia of the free shaft [kg m2].
        torque_constant: torque constant of the motor [N m/A].
        position: largest position in frames [rad].
        velocity: largest velocity in frames [rad/s].
        options: options of the motor, as in a hand file.
        limit: largest torque that the motor can make [N m].
        top_speed: speed of the motor without load [rad/s].
        stall_torque: torque of the motor at standstill, if only the supply voltage limits the
            torque [N m].
    """

    peak: float
    inertia: float
    torque_constant: float
    position: float = 12.5
    velocity: float = 30.0
    options: dict[str, Any] = {}  # noqa: RUF012 - read only
    limit: float = math.inf
    top_speed: float = 0.0
    stall_torque: float = 0.0


def unchanged_frame(frame: Frame) -> Frame:
    """Return the frame without any change."""
    return frame


FRAME_FOR_NO_NODE = Frame(EXTENDED_FLAG, b"")
"""A frame whose identifier belongs to no node."""


class ProtocolSpec(NamedTuple):
    """Specification of a drive protocol for the simulator.

    Attributes:
        node: function that makes a node from the description of a motor, the rotor, and the encoder
            angle when the spool angle theta is 0 [rad].
        numbers: valid node numbers of drives.
        shaft: shaft of the default motor on a test bench.
        host_frame: function that takes a node number, and returns the identifier and the payload of
            a frame. Only hosts send this frame, and it has no effect on the drive.
        make_ineffective_disable: function that makes the command *disable* ineffective, for a faulty drive.
        corrupt_reply: function that changes a value in the reply to a read request, for a faulty
            drive.
        force_command: function that makes a drive follow a torque command in any state, for a
            faulty drive. None if the protocol has no such function.
        row: class of a node that keeps its state in a row of an array, for compiled kernels. None
            if the protocol has no such class.
        node_kind: kind of node in compiled kernels, see ``cyclic_kernels.ReceiverStruct``.
    """

    node: Callable[[MotorSpec, Motor, float], DriveNode]
    numbers: range
    shaft: ShaftSpec
    host_frame: Callable[[int], tuple[int, bytes]]
    make_ineffective_disable: Callable[[Frame], Frame]
    corrupt_reply: Callable[[Frame], Frame] = unchanged_frame
    row: Any = None
    node_kind: int = -1
    force_command: Callable[[Any, Frame], None] | None = None
