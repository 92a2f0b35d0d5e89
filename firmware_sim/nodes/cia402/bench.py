"""CiA 402 drives out of the box; a free shaft is an assumption."""

from firmware_sim.bus.frame import Frame
from firmware_sim.nodes.cia402.node import Cia402Node, Cia402NodeRow
from firmware_sim.nodes.kind import CIA402, NOTHING, Kind, Shaft

NUMBERS = range(1, 0x7F)
"""The last of CANopen's is handctl's own."""


def _host_frame(node_id: int) -> tuple[int, bytes]:
    return 0x600 + node_id, b"\x40\x00\x10" + bytes(5)


def _mishear(frame: Frame) -> Frame:
    let_go = 0x200 < frame.can_id < 0x280 and len(frame.data) >= 2 and not frame.data[0] & 0x02
    order = let_go or (frame.can_id == 0 and frame.data[:1] in (b"\2", b"\x80", b"\x81", b"\x82"))
    return NOTHING if order else frame


def _spoil(frame: Frame) -> Frame:
    told = 0x580 < frame.can_id < 0x600 and frame.data[:4] == b"\x4b\x72\x60\x00"
    return frame._replace(data=frame.data[:4] + b"\xff\xff\0\0") if told else frame  # 0x6072 reads 65535


KIND = Kind(Cia402Node, NUMBERS, Shaft(1.0, 5e-5, 0.08), _host_frame, _mishear, _spoil, Cia402NodeRow, CIA402)
