"""Identity of a CANopen drive (vendor, product, name, ...).

The library ``canopen`` reads the objects of the drive one by one.

No program uses this module while a controller runs. The library ``canopen`` opens the bus with
python-can, and starts threads. After ``identify_nodes`` has returned, the bus is closed and the
threads have ended.
"""

import logging
from collections.abc import Sequence
from typing import NamedTuple

import canopen
from canopen.sdo.exceptions import SdoError

from handctl.runtime.buses.pythoncan import open_python_can

NUMERIC_IDENTITY_OBJECTS = {
    "vendor": (0x1018, 1),
    "product": (0x1018, 2),
    "revision": (0x1018, 3),
    "serial": (0x1018, 4),
    "status": (0x6041, 0),
    "error": (0x603F, 0),
    "modes": (0x6502, 0),
    "rated_torque": (0x6076, 0),
    "counts": (0x608F, 1),
}
"""Index and subindex of the objects with numbers, by name. Source: CiA 301, CiA 402-2."""
TEXT_IDENTITY_OBJECTS = {"name": (0x1008, 0), "software": (0x100A, 0)}
"""Index and subindex of the objects with texts, by name. Source: CiA 301."""
ANSWER_TIMEOUT_S = 0.3
"""Longest wait for the answer of a drive [s]."""


class CanopenIdentity(NamedTuple):
    """Numbers and texts reported by a node, named as in ``NUMERIC_IDENTITY_OBJECTS`` and ``TEXT_IDENTITY_OBJECTS``.

    An object that the node does not have is left out.
    """

    numbers: dict[str, int]
    texts: dict[str, str]


def identify_nodes(spec: str, bitrate: int, nodes: Sequence[int]) -> dict[int, CanopenIdentity]:
    """Read the identity of each node by SDO uploads.

    Args:
        spec: ``INTERFACE:CHANNEL`` of the bus. The bus must be closed in this process.
        bitrate: nominal bit rate of the bus [bit/s].
        nodes: numbers of the nodes to read.

    Raises:
        BusError: the bus cannot be opened.
    """
    interface, _, channel = spec.partition(":")
    network = canopen.Network(open_python_can(interface, channel, bitrate))
    logger = logging.getLogger("canopen")
    level_before = logger.level
    logger.setLevel(
        logging.CRITICAL
    )  # without this filter, the library would log an error for each object that a drive does not have
    try:
        network.connect()
        return {number: _read_identity(network, number) for number in nodes}
    finally:
        network.disconnect()
        logger.setLevel(level_before)


def _read_identity(network: canopen.Network, node_id: int) -> CanopenIdentity:
    """Read the identity of one node."""
    node = network.add_node(node_id, canopen.ObjectDictionary())  # type: ignore[no-untyped-call]
    node.sdo.RESPONSE_TIMEOUT = ANSWER_TIMEOUT_S
    numbers: dict[str, int] = {}
    texts: dict[str, str] = {}
    for name, (index, sub) in NUMERIC_IDENTITY_OBJECTS.items():
        if raw_bytes := _upload_object(node, index, sub):
            numbers[name] = int.from_bytes(raw_bytes, "little")
    for name, (index, sub) in TEXT_IDENTITY_OBJECTS.items():
        if raw_bytes := _upload_object(node, index, sub):
            texts[name] = raw_bytes.rstrip(b"\0").decode("ascii", "replace")
    return CanopenIdentity(numbers, texts)


def _upload_object(node: canopen.RemoteNode, index: int, subindex: int) -> bytes:
    """Read an object of the drive by SDO, and return the content.

    If the drive refuses the request or does not answer, the content is empty.
    """
    try:
        return bytes(node.sdo.upload(index, subindex))
    except SdoError:
        return b""
