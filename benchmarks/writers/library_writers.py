"""Log writers that use libraries other than handctl.

Each log writer writes the same decoded messages into a file, and reads the file back.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple


class LogMessage(NamedTuple):
    """One message for a log: topic, type, definition of the type, time [ns], and content as plain values."""

    topic: str
    type_name: str
    type_definition: str
    t_ns: int
    content: dict[str, Any]


class LibraryWriter(NamedTuple):
    """A log writer, as three functions: write one message, close the file, and read all messages."""

    write: Callable[[LogMessage], None]
    close: Callable[[], None]
    read: Callable[[], Iterator[Any]]


def mcap_ros2_writer(path: Path) -> LibraryWriter:
    """Return a log writer that uses mcap-ros2-support with its default settings."""
    from mcap_ros2.reader import read_ros2_messages
    from mcap_ros2.writer import Writer as Ros2Writer

    file = path.open("wb")
    writer = Ros2Writer(file)
    schemas = {}

    def write(log_message: LogMessage) -> None:
        if log_message.type_name not in schemas:
            schemas[log_message.type_name] = writer.register_msgdef(
                log_message.type_name, log_message.type_definition
            )
        writer.write_message(
            log_message.topic,
            schemas[log_message.type_name],
            log_message.content,
            log_message.t_ns,
            log_message.t_ns,
        )

    def close() -> None:
        writer.finish()
        file.close()

    return LibraryWriter(
        write, close, lambda: (message.ros_msg for message in read_ros2_messages(str(path)))
    )


def rosbags_writer(path: Path) -> LibraryWriter:
    """Return a log writer that uses rosbags.

    The library rosbags writes a folder that contains an MCAP file. A message must be an object of its message
    type.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag2 import StoragePlugin
    from rosbags.rosbag2 import Writer as BagWriter
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    type_store = get_typestore(Stores.EMPTY)
    connections = {}
    bag = BagWriter(path, version=9, storage_plugin=StoragePlugin.MCAP)
    bag.open()

    def write(log_message: LogMessage) -> None:
        if log_message.topic not in connections:
            types = get_types_from_msg(log_message.type_definition, log_message.type_name)
            type_store.register(
                {name: kind for name, kind in types.items() if name not in type_store.fielddefs}
            )
            connections[log_message.topic] = bag.add_connection(
                log_message.topic, log_message.type_name, typestore=type_store
            )
        data = type_store.serialize_cdr(
            _typed_object(type_store, log_message.type_name, log_message.content),
            log_message.type_name,
        )
        bag.write(connections[log_message.topic], log_message.t_ns, bytes(data))

    def read() -> Iterator[Any]:
        with AnyReader([path]) as reader:
            for connection, _, raw_bytes in reader.messages():
                yield reader.deserialize(raw_bytes, connection.msgtype)

    return LibraryWriter(write, bag.close, read)


def _typed_object(type_store: Any, type_name: str, content: dict[str, Any]) -> Any:
    """Convert plain values to an object of the message type ``type_name``.

    ``type_store`` contains the definition of the message type.
    """
    import numpy as np

    fields = {}
    for name, (node, inner_definition) in type_store.fielddefs[type_name][1]:
        value = content[name]
        if node.name == "NAME":
            fields[name] = _typed_object(type_store, inner_definition, value)
        elif node.name == "BASE":
            fields[name] = value
        elif inner_definition[0][0].name == "NAME":
            fields[name] = [
                _typed_object(type_store, inner_definition[0][1], element) for element in value
            ]
        else:
            element_type = inner_definition[0][1][0]
            fields[name] = (
                list(value)
                if element_type == "string"
                else np.array(value, element_type.replace("byte", "uint8"))
            )
    return type_store.types[type_name](**fields)


def json_mcap_writer(path: Path) -> LibraryWriter:
    """Return a log writer that writes JSON messages into an MCAP log with json.dumps and the package mcap."""
    from mcap.reader import make_reader
    from mcap.writer import Writer as McapWriter

    file = path.open("wb")
    writer = McapWriter(file)
    channels = {}
    writer.start("", "benchmark")

    def write(log_message: LogMessage) -> None:
        if log_message.topic not in channels:
            schema = writer.register_schema(
                log_message.type_name, "jsonschema", b'{"type": "object"}'
            )
            channels[log_message.topic] = writer.register_channel(log_message.topic, "json", schema)
        writer.add_message(
            channels[log_message.topic],
            log_message.t_ns,
            json.dumps(log_message.content).encode(),
            log_message.t_ns,
        )

    def close() -> None:
        writer.finish()
        file.close()

    def read() -> Iterator[Any]:
        with path.open("rb") as log_file:
            for _, _, log_message in make_reader(log_file).iter_messages(log_time_order=False):
                yield json.loads(log_message.data)

    return LibraryWriter(write, close, read)


def foxglove_writer(path: Path) -> LibraryWriter:
    """Return a log writer that uses the Foxglove SDK.

    The log writer uses the channels of the Foxglove SDK that write dictionaries as JSON.
    """
    import foxglove_writer as sdk
    from mcap.reader import make_reader

    context = sdk.Context()
    channels = {}
    file = sdk.open_mcap(path, context=context)

    def write(log_message: LogMessage) -> None:
        if log_message.topic not in channels:
            channels[log_message.topic] = sdk.Channel(
                log_message.topic, schema={"type": "object"}, context=context
            )
        channels[log_message.topic].log(log_message.content, log_time=log_message.t_ns)

    def read() -> Iterator[Any]:
        with path.open("rb") as log_file:
            for _, _, log_message in make_reader(log_file).iter_messages(log_time_order=False):
                yield json.loads(log_message.data)

    return LibraryWriter(write, file.close, read)


WRITER_BY_LIBRARY = {
    "mcap-ros2-support": mcap_ros2_writer,
    "rosbags": rosbags_writer,
    "JSON": json_mcap_writer,
    "foxglove-sdk": foxglove_writer,
}
