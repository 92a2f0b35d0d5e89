"""A DBC of the cyclic frames of a bus, from the tables of signals that the controller reads by, for other tools.

Values are those of the controller: at the spool, with the hand's sign. An identifier has one message in a DBC. So a
command is left out if its identifier is that of the answer, as CubeMars motors have it, and so is what has no values:
remote frames and an empty SYNC. Settings and what a drive says of itself (heartbeats, register and SDO replies) are not
in the tables, and not in the DBC.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from handctl.drives.contract import Drive
from handctl.drives.frame import EXTENDED, REMOTE
from handctl.drives.sensors.node import SensorNode
from handctl.drives.signals import Coding, Message, Quantity, Signal

HOST, SENSORS = "host", "sensor_node"
"""Names of this host and the sensor node in a DBC."""
EXTENDED_BIT = 1 << 31
"""Of an identifier in a DBC, as in SocketCAN."""


class Sent(NamedTuple):
    """A message with who sends and who receives it."""

    message: Message
    sender: str
    receiver: str


def of_bus(
    bus: int, drives: Iterable[Drive], sensors: SensorNode, tendons: Sequence[str], joints: Sequence[str]
) -> str:
    """Write the DBC of a bus of a hand.

    Args:
        bus: its index. drives: all of the hand. sensors: the sensor node. tendons, joints: their names.
    """
    sent = list[Sent]()
    if sensors.bus == bus:
        counter = Signal("counter", Quantity.COUNTER, 0, 8)
        sent.append(Sent(Message("sync", sensors.sync_id, 1, (counter,)), HOST, SENSORS))
        sent += [Sent(_channels(message, tendons, joints), SENSORS, HOST) for message in sensors.messages]
    for drive in drives:
        if drive.bus == bus:
            name = drive.name
            sent += [Sent(_named(message, name), name, HOST) for message in drive.cyclic.feedback]
            sent += [Sent(_named(message, name), HOST, name) for message in drive.cyclic.commands]
    return dbc(sent)


def dbc(sent: Iterable[Sent]) -> str:
    """Write a DBC; the first message of an identifier counts."""
    kept: dict[int, Sent] = {}
    for one in sent:
        if one.message.signals and not one.message.can_id & REMOTE:
            kept.setdefault(one.message.can_id, one)
    nodes = dict.fromkeys(node for one in kept.values() for node in (one.sender, one.receiver))
    lines = ['VERSION ""', "", "NS_ :", "", "BS_:", "", " ".join(["BU_:", *nodes]), ""]
    floats, kinds = list[str](), list[str]()
    for message, sender, receiver in kept.values():
        frame_id = message.can_id & ~EXTENDED | (EXTENDED_BIT if message.can_id & EXTENDED else 0)
        lines.append(f"BO_ {frame_id} {message.name}: {message.length} {sender}")
        lines += [*(_signal(signal, receiver) for signal in message.signals), ""]
        real = [signal.name for signal in message.signals if signal.coding == Coding.FLOAT]
        floats += [f"SIG_VALTYPE_ {frame_id} {name} : 1;" for name in real]
        if message.flags:
            kinds.append(f'BA_ "VFrameFormat" BO_ {frame_id} {FD_EXTENDED if frame_id & EXTENDED_BIT else FD};')
    return "\n".join([*lines, *(_FORMATS if kinds else ()), *kinds, *floats, ""])


FD, FD_EXTENDED = 14, 15
_FORMATS = (
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN",'
    + ",".join(f'"reserved{i}"' for i in range(2, 14))
    + ',"StandardCAN_FD","ExtendedCAN_FD";',
    'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";',
)
"""Declares how a DBC tells FD frames. Source: the attribute as Vector's tools write and cantools reads it."""


def _signal(signal: Signal, receiver: str) -> str:
    order, sign = 0 if signal.big_endian else 1, "+" if signal.coding == Coding.UNSIGNED else "-"
    place = f"{signal.start}|{signal.length}@{order}{sign}"
    return f' SG_ {signal.name} : {place} ({signal.scale!r},{signal.offset!r}) [0|0] "{signal.unit}" {receiver}'


def _named(message: Message, drive: str) -> Message:
    return message._replace(name=f"{drive}_{message.name}")


def _channels(message: Message, tendons: Sequence[str], joints: Sequence[str]) -> Message:
    """Return a frame of the sensor node whose channels have the names of their tendons or joints."""
    names = {Quantity.TENSION: tendons, Quantity.ANGLE: joints}
    signals = [
        signal._replace(name=names[signal.quantity][signal.channel]) if signal.quantity in names else signal
        for signal in message.signals
    ]
    return message._replace(signals=tuple(signals))
