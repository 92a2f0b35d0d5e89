"""What other people's readers make of a log."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from mcap.reader import make_reader
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore


class Logged(NamedTuple):
    """One message of a log as the mcap package sees it."""

    topic: str
    kind: str
    schema: str
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


def messages(path: Path) -> list[Logged]:
    """All messages in the order of their log times; checksums are compared."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [
            Logged(
                channel.topic, schema.name, schema.data.decode(), one.sequence, one.log_time, one.publish_time, one.data
            )
            for schema, channel, one in reader.iter_messages()
            if schema is not None
        ]


def by_topic(path: Path) -> dict[str, list[Logged]]:
    """Messages of each topic in the order of the file's index."""
    found: dict[str, list[Logged]] = {}
    for one in messages(path):
        found.setdefault(one.topic, []).append(one)
    return found


class Ros2Support:
    """mcap-ros2-support for one type."""

    def __init__(self, kind: str, schema: str) -> None:
        self.decode = generate_dynamic(kind, schema)[kind]
        self.encode = serialize_dynamic(kind, schema)[kind]


class Rosbags:
    """rosbags for one type, from the definition in the log alone."""

    def __init__(self, kind: str, schema: str) -> None:
        self.store: Typestore = get_typestore(Stores.EMPTY)
        self.store.register(get_types_from_msg(schema, kind))
        self._kind = kind

    def decode(self, data: bytes) -> object:
        return self.store.deserialize_cdr(data, self._kind)

    def encode(self, message: object) -> bytes:
        return bytes(self.store.serialize_cdr(message, self._kind))


def oracles(kind: str, schema: str) -> Iterator[Ros2Support | Rosbags]:
    """Both."""
    yield Ros2Support(kind, schema)
    yield Rosbags(kind, schema)
