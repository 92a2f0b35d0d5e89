"""The whole state of the controller, every second: a re-execution may start behind any of them."""

import struct
from typing import NamedTuple

from handctl.log.cdr import CdrWriter
from handctl.log.container import Run
from handctl.log.topics.streams import Registry, loose, stamps_at

TOPIC = "/controller/snapshot"
PERIOD_NS = 1_000_000_000
_BODY = struct.Struct("<4xII8xqI")
"""Encapsulation, stamp, empty frame_id with padding, tick number, length of the data."""


class Snapshot(NamedTuple):
    """A state.

    Attributes:
        k: tick after which it was the state.
        data: ``controller.snapshot`` reads it.
    """

    k: int
    data: bytes


class SnapshotTopic:
    """The topic of the snapshots."""

    def __init__(self, registry: Registry) -> None:
        self._channel = registry.add(TOPIC, "handctl_msgs/Snapshot")

    def run(self, t_ns: int, snapshot: Snapshot) -> Run:
        """One snapshot; ``t_ns``: time of its tick in the log [ns]."""
        out = CdrWriter()
        out.put("I", t_ns // 10**9)
        out.put("I", t_ns % 10**9)
        out.text("")
        out.put("q", snapshot.k)
        out.count(len(snapshot.data))
        return loose(self._channel, stamps_at(t_ns, snapshot.k), [out.message() + snapshot.data])


def snapshot_of(message: bytes) -> Snapshot:
    """Return the snapshot of a message.

    Raises:
        struct.error: it is too short.
        ValueError: it ends early.
    """
    _, _, k, length = _BODY.unpack_from(message)
    data = message[_BODY.size : _BODY.size + length]
    if len(data) != length:
        raise ValueError("a snapshot that ends early")
    return Snapshot(k, data)
