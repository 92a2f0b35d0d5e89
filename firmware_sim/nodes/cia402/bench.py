"""CiA 402 drives on a test bench, with the settings of a drive as delivered.

The motor data of the free shaft are assumed.
"""

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes.cia402.kernels import apply_torque
from firmware_sim.nodes.cia402.node import Cia402Node, Cia402NodeRow
from firmware_sim.nodes.protocol_spec import CIA402_KIND, FRAME_FOR_NO_NODE, ProtocolSpec, ShaftSpec

VALID_NODE_NUMBERS = range(1, 0x7F)
"""Valid node numbers of drives. The last node number of CANopen, 127, is the node number of handctl."""


TEST_BENCH_SHAFT = ShaftSpec(1.0, 5e-5, 0.08, top_speed=24.0 / 0.08, stall_torque=4.0)
"""Shaft of the default motor at 24 V.

The voltage constant [V s/rad] and the torque constant [N m/A] of the motor are equal.
"""


def _host_frame(node_id: int) -> tuple[int, bytes]:
    """Return an SDO request that reads the device type, object 0x1000."""
    return 0x600 + node_id, b"\x40\x00\x10" + bytes(5)


def _make_ineffective_disable(frame: Frame) -> Frame:
    """Replace a command that switches the torque off by a frame that no node receives."""
    # The replaced frames are RPDOs with a control word in which bit 1 (enable voltage) is 0.
    is_disable_command = (
        0x200 < frame.can_id < 0x280 and len(frame.data) >= 2 and not frame.data[0] & 0x02
    )
    # The NMT commands below are 2 stop, 0x80 pre-operational, 0x81 reset node and 0x82 reset
    # communication.
    is_release_command = is_disable_command or (
        frame.can_id == 0 and frame.data[:1] in (b"\2", b"\x80", b"\x81", b"\x82")
    )
    return FRAME_FOR_NO_NODE if is_release_command else frame


def _corrupt_reply(frame: Frame) -> Frame:
    """Replace the value of object 0x6072 (maximum torque) by 65535 in the reply to a read request."""
    # The compared bytes are the first bytes of an SDO upload reply with two bytes (0x4B) from
    # object 0x6072.
    is_corrupted = 0x580 < frame.can_id < 0x600 and frame.data[:4] == b"\x4b\x72\x60\x00"
    return (
        frame._replace(data=frame.data[:4] + b"\xff\xff\0\0") if is_corrupted else frame
    )  # the value of object 0x6072 becomes 65535


def _force_command(node: Cia402Node, frame: Frame) -> None:
    """Follow the target torque of an RPDO in any state of the drive."""
    if frame.can_id == node.rpdo_id and len(frame.data) >= 4:
        apply_torque(node, node.motor.servo)


CIA402_SPEC = ProtocolSpec(
    Cia402Node, VALID_NODE_NUMBERS, TEST_BENCH_SHAFT, _host_frame,
    _make_ineffective_disable, _corrupt_reply, Cia402NodeRow,
    CIA402_KIND,
    _force_command,
)  # fmt: skip
"""Specification of the protocol CiA 402 for simulated drives."""
