"""Read logs with the packages of others, to compare the results."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mcap.reader import make_reader
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore


class Logged(NamedTuple):
    """One message of a log, as the package mcap reads it."""

    topic: str
    kind: str
    schema: str
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


def messages(path: Path) -> list[Logged]:
    """Return all messages of a log in the order of their log times, and check the checksums."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [
            Logged(
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


def by_topic(path: Path) -> dict[str, list[Logged]]:
    """Return the messages of a log by topic, each in the order of the log times."""
    topics: dict[str, list[Logged]] = {}
    for message in messages(path):
        topics.setdefault(message.topic, []).append(message)
    return topics


class Ros2Support:
    """Serialiser of the package mcap-ros2-support for one message type."""

    def __init__(self, kind: str, schema: str) -> None:
        self.decode = generate_dynamic(kind, schema)[kind]
        self.encode = serialize_dynamic(kind, schema)[kind]


class Rosbags:
    """Serialiser of the package rosbags for one message type. It knows only the definition in the log."""

    def __init__(self, kind: str, schema: str) -> None:
        self.store: Typestore = get_typestore(Stores.EMPTY)
        self.store.register(get_types_from_msg(schema, kind))
        self._kind = kind

    def decode(self, data: bytes) -> object:
        return self.store.deserialize_cdr(data, self._kind)

    def encode(self, message: object) -> bytes:
        return bytes(self.store.serialize_cdr(message, self._kind))


def oracles(kind: str, schema: str) -> Iterator[Ros2Support | Rosbags]:
    """Yield the serialisers of both packages for a message type."""
    yield Ros2Support(kind, schema)
    yield Rosbags(kind, schema)
