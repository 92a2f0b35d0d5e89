"""Frames as bytes: records of 80 bytes in a numpy array, which compiled code reads and writes without objects."""

import struct
from collections.abc import Iterable
from typing import Any

import numpy as np

from firmware_sim.bus.frame import Frame

RECORD = np.dtype(
    [("t_ns", "<i8"), ("can_id", "<u4"), ("flags", "<u2"), ("bus", "u1"), ("length", "u1"), ("data", "u1", (64,))]
)
"""Fields of ``Frame``, the payload padded with zeros to 64 bytes; ``length`` counts the bytes without the padding."""
_STRUCT = struct.Struct("<qIHBB64s")


def to_records(frames: Iterable[tuple[Any, ...]]) -> Any:
    """Return frames as an array of ``RECORD``, shape (frames,).

    Args:
        frames: can_id, data, flags, bus, t_ns of each.
    """
    pack = _STRUCT.pack
    packed = [pack(t_ns, can_id, flags, bus, len(data), data) for can_id, data, flags, bus, t_ns in frames]
    return np.frombuffer(bytearray(b"".join(packed)), RECORD)


def to_frames(records: Any) -> list[Frame]:
    """Return the frames of an array of ``RECORD``."""
    unpacked = _STRUCT.iter_unpack(records.tobytes())
    return [Frame(can_id, data[:length], flags, bus, t_ns) for t_ns, can_id, flags, bus, length, data in unpacked]
