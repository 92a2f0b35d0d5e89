"""Export of the cyclic frames of a bus as a DBC file.

The DBC file is written from the signal tables of the controller. The values in the DBC file are the
values at the spool, and positive values wind the tendon. A DBC file can have only one message per
identifier. The export omits a command if the answer to the command has the same identifier
(CubeMars), or if the identifier of the command contains a value (RobStride). The export also omits
frames without values: remote frames, and a SYNC without payload. Settings, heartbeats, register
replies and SDO replies are not in the signal tables, and so not in the DBC file.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from handctl.drives.contract import Drive
from handctl.drives.frame import EXTENDED_FLAG, REMOTE_FLAG
from handctl.drives.sensors.contract import SensorInterface
from handctl.drives.signals import CyclicMessage, Signal, SignalCoding, SignalQuantity

# Names of the host and of the sensor node in a DBC file.
HOST_NODE_NAME = "host"
SENSOR_NODE_NAME = "sensor_node"
EXTENDED_BIT = 1 << 31
"""Flag bit of a 29-bit identifier in a DBC file, as in SocketCAN."""


class SentMessage(NamedTuple):
    """Cyclic frame with the names of its sender and its receiver."""

    message: CyclicMessage
    sender: str
    receiver: str


def export_bus_dbc(
    bus: int,
    drives: Iterable[Drive],
    sensors: SensorInterface,
    tendons: Sequence[str],
    joints: Sequence[str],
) -> str:
    """Return the content of a DBC file for one bus of a hand.

    Args:
        bus: index of the bus.
        drives: all drives of the hand.
        sensors: sensors of the hand.
        tendons: names of all tendons of the hand, in order.
        joints: names of all joints of the hand, in order.
    """
    sent_messages = list[SentMessage]()
    if sensors.bus == bus and sensors.ids:
        sent_messages.append(SentMessage(sensors.sync_message, HOST_NODE_NAME, SENSOR_NODE_NAME))
        sent_messages += [
            SentMessage(
                _with_channel_names(message, tendons, joints), SENSOR_NODE_NAME, HOST_NODE_NAME
            )
            for message in sensors.messages
        ]
    for drive in drives:
        if drive.bus == bus:
            name = drive.name
            sent_messages += [
                SentMessage(_with_drive_name(message, name), name, HOST_NODE_NAME)
                for message in drive.cyclic_messages.feedback
            ]
            sent_messages += [
                SentMessage(_with_drive_name(message, name), HOST_NODE_NAME, name)
                for message in drive.cyclic_messages.commands
            ]
    return dbc_text(sent_messages)


def dbc_text(sent_messages: Iterable[SentMessage]) -> str:
    """Return the content of a DBC file.

    If several messages have the same identifier, the DBC file contains only the first of these
    messages.
    """
    by_identifier: dict[int, SentMessage] = {}
    for sent_message in sent_messages:
        are_signals_in_payload = all(signal.start >= 0 for signal in sent_message.message.signals)
        if (
            sent_message.message.signals
            and are_signals_in_payload
            and not sent_message.message.can_id & REMOTE_FLAG
        ):
            by_identifier.setdefault(sent_message.message.can_id, sent_message)
    nodes = dict.fromkeys(
        node
        for sent_message in by_identifier.values()
        for node in (sent_message.sender, sent_message.receiver)
    )
    lines = ['VERSION ""', "", "NS_ :", "", "BS_:", "", " ".join(["BU_:", *nodes]), ""]
    float_type_lines = list[str]()
    format_lines = list[str]()
    for message, sender, receiver in by_identifier.values():
        frame_id = message.can_id & ~EXTENDED_FLAG | (
            EXTENDED_BIT if message.can_id & EXTENDED_FLAG else 0
        )
        lines.append(f"BO_ {frame_id} {message.name}: {message.length} {sender}")
        lines += [*(_signal_line(signal, receiver) for signal in message.signals), ""]
        float_signals = [
            signal.name for signal in message.signals if signal.coding == SignalCoding.FLOAT
        ]
        # SIG_VALTYPE_ 1 marks a signal as an IEEE 754 float32.
        float_type_lines += [f"SIG_VALTYPE_ {frame_id} {name} : 1;" for name in float_signals]
        if message.flags:
            frame_format = FD_EXTENDED_FRAME_FORMAT if frame_id & EXTENDED_BIT else FD_FRAME_FORMAT
            format_lines.append(f'BA_ "VFrameFormat" BO_ {frame_id} {frame_format};')
    return "\n".join(
        [
            *lines,
            *(_FRAME_FORMAT_LINES if format_lines else ()),
            *format_lines,
            *float_type_lines,
            "",
        ]
    )


# Values of the attribute VFrameFormat for CAN FD frames, with 11-bit and 29-bit identifiers.
FD_FRAME_FORMAT = 14
FD_EXTENDED_FRAME_FORMAT = 15
_FRAME_FORMAT_LINES = (
    'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN",'
    + ",".join(f'"reserved{i}"' for i in range(2, 14))
    + ',"StandardCAN_FD","ExtendedCAN_FD";',
    'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";',
)
"""Lines of a DBC file that declare the attribute VFrameFormat, which marks CAN FD frames.

Source: the form in which Vector's tools write the attribute VFrameFormat and cantools reads it.
"""


def _signal_line(signal: Signal, receiver_name: str) -> str:
    """Return the line of a DBC file that describes a signal."""
    # In a DBC, @0 is big-endian and @1 little-endian. + is unsigned, - is signed or float.
    byte_order = 0 if signal.is_big_endian else 1
    sign = "+" if signal.coding == SignalCoding.UNSIGNED else "-"
    layout = f"{signal.start}|{signal.length}@{byte_order}{sign}"
    return f' SG_ {signal.name} : {layout} ({signal.scale!r},{signal.offset!r}) [0|0] "{signal.unit}" {receiver_name}'


def _with_drive_name(message: CyclicMessage, drive_name: str) -> CyclicMessage:
    """Return the message with a new name that begins with the name of the drive."""
    return message._replace(name=f"{drive_name}_{message.name}")


def _with_channel_names(
    message: CyclicMessage, tendons: Sequence[str], joints: Sequence[str]
) -> CyclicMessage:
    """Return a message of the sensor node, in which the signals have the names of tendons or joints."""
    names = {SignalQuantity.TENSION: tendons, SignalQuantity.ANGLE: joints}
    signals = [
        signal._replace(name=names[signal.quantity][signal.channel])
        if signal.quantity in names
        else signal
        for signal in message.signals
    ]
    return message._replace(signals=tuple(signals))
