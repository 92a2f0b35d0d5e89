"""Read handctl logs by means of Python packages of other projects.

Tests compare the messages from other packages with the messages from handctl's own reader.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mcap.reader import make_reader
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore


class LoggedMessage(NamedTuple):
    """One message of a log, as the package mcap reads it."""

    topic: str
    kind: str
    schema: str
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


def read_messages(log_path: Path) -> list[LoggedMessage]:
    """Return all messages of a log in the order of their log times, and check all checksums of the file."""
    with log_path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [
            LoggedMessage(
                channel.topic,
                schema.name,
                schema.data.decode(),
                message.sequence,
                message.log_time,
                message.publish_time,
                message.data,
            )
            for schema, channel, message in reader.iter_messages()
            if schema is not None
        ]


def messages_by_topic(log_path: Path) -> dict[str, list[LoggedMessage]]:
    """Return the messages of each topic of a log, in the order of the log times."""
    topics: dict[str, list[LoggedMessage]] = {}
    for message in read_messages(log_path):
        topics.setdefault(message.topic, []).append(message)
    return topics


class Ros2SupportSerialiser:
    """Serialiser of the package mcap-ros2-support for one message type."""

    def __init__(self, type_name: str, type_definition: str) -> None:
        self.decode = generate_dynamic(type_name, type_definition)[type_name]
        self.encode = serialize_dynamic(type_name, type_definition)[type_name]


class RosbagsSerialiser:
    """Serialiser of the package rosbags for one message type.

    The serialiser gets the definition of the message type from the log.
    """

    def __init__(self, type_name: str, type_definition: str) -> None:
        self.store: Typestore = get_typestore(Stores.EMPTY)
        self.store.register(get_types_from_msg(type_definition, type_name))
        self._kind = type_name

    def decode(self, data: bytes) -> object:
        return self.store.deserialize_cdr(data, self._kind)

    def encode(self, message: object) -> bytes:
        return bytes(self.store.serialize_cdr(message, self._kind))


def other_serialisers(
    type_name: str, type_definition: str
) -> Iterator[Ros2SupportSerialiser | RosbagsSerialiser]:
    """Yield the serialisers of both packages for a message type."""
    yield Ros2SupportSerialiser(type_name, type_definition)
    yield RosbagsSerialiser(type_name, type_definition)
