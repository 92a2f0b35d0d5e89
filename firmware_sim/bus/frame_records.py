"""Frames as records of 80 bytes in a numpy array, for compiled code.

Compiled code reads and writes the array without Python objects.

Record (little-endian):

    byte  0..7   t_ns
    byte  8..11  can_id with flag bits
    byte 12..13  flags: BRS, ESI, FDF
    byte 14      index of the bus
    byte 15      payload length
    byte 16..79  payload, padded with zeros
"""

import struct
from collections.abc import Iterable
from typing import Any

import numpy as np

from firmware_sim.bus.frame import Frame

FRAME_DTYPE = np.dtype(
    [
        ("t_ns", "<i8"),
        ("can_id", "<u4"),
        ("flags", "<u2"),
        ("bus", "u1"),
        ("length", "u1"),
        ("data", "u1", (64,)),
    ]
)
"""Dtype with the fields of ``Frame``.

The payload is padded with zeros to 64 bytes. ``length`` excludes the padding.
"""
_FRAME_STRUCT = struct.Struct("<qIHBB64s")


def frames_to_records(frames: Iterable[tuple[Any, ...]]) -> Any:
    """Convert frames to an array of ``FRAME_DTYPE``.

    Args:
        frames: tuples of can_id, data, flags, bus, t_ns.

    Returns:
        Array of shape (frames,).
    """
    pack_fields = _FRAME_STRUCT.pack
    packed_records = [
        pack_fields(t_ns, can_id, flags, bus, len(data), data)
        for can_id, data, flags, bus, t_ns in frames
    ]
    # The buffer is a bytearray, because kernels write into the resulting array. An array made from
    # a ``bytes`` object would be read-only.
    return np.frombuffer(bytearray(b"".join(packed_records)), FRAME_DTYPE)


def records_to_frames(records: Any) -> list[Frame]:
    """Convert an array of ``FRAME_DTYPE`` to frames."""
    unpacked_fields = _FRAME_STRUCT.iter_unpack(records.tobytes())
    return [
        Frame(can_id, data[:length], flags, bus, t_ns)
        for t_ns, can_id, flags, bus, length, data in unpacked_fields
    ]
