"""Writer and reader for CDR, the encoding of ROS 2 messages, and templates for messages whose layout is constant.

A message begins with four bytes, called the encapsulation: 0x00, 0x01 for little-endian plain CDR,
and two option bytes. After the encapsulation, the fields of the message follow in order. Numbers in
a message are aligned. A number of n bytes begins at a multiple of n bytes, counted from the end of
the encapsulation. A string consists of its length (uint32, including the closing NUL), its bytes,
and the NUL. A sequence consists of its length (uint32) and its elements. An empty sequence consists
only of its length.

Source: OMG CORBA 3.0, section 15.3, as implemented by the packages rosbags and mcap-ros2-support.
"""

import struct
from dataclasses import dataclass

ENCAPSULATION_HEADER = b"\x00\x01\x00\x00"
"""Encapsulation header of little-endian plain CDR."""

_UINT32_STRUCT = struct.Struct("<I")
_INT64_STRUCT = struct.Struct("<q")


class CdrWriter:
    """Writer of the values of a CDR message.

    The writer inserts padding before each value, and appends the value to `data`.
    """

    def __init__(self, start_offset: int = 0) -> None:
        """Start an empty message, or an empty part of a message.

        Args:
            start_offset: offset in the message body at which the part starts [bytes]. If a part follows
                other parts of a message, its offset is above 0.
        """
        self.data = bytearray()
        self._start = start_offset

    def align(self, size: int) -> None:
        """Append zeros until the length after the encapsulation is a multiple of `size` bytes."""
        # In Python, -n % size is the distance from n to the next multiple of size.
        self.data += bytes(-(self._start + len(self.data)) % size)

    def put_number(self, format_code: str, value: float) -> None:
        """Append one number.

        Args:
            format_code: format character of the module `struct`.
            value: number to append.
        """
        self.align(struct.calcsize("<" + format_code))
        self.data += struct.pack("<" + format_code, value)

    def put_length(self, element_count: int) -> None:
        """Append the length of a sequence."""
        self.put_number("I", element_count)

    def put_string(self, value: str) -> None:
        """Append a string.

        Escape sequences replace lone surrogates in the string, because the CDR readers of other
        programs cannot decode a lone surrogate.
        """
        raw_bytes = value.encode("utf-8", "backslashreplace")
        self.put_length(len(raw_bytes) + 1)
        self.data += raw_bytes + b"\0"

    def put_strings(self, values: tuple[str, ...]) -> None:
        """Append a sequence of strings."""
        self.put_length(len(values))
        for value in values:
            self.put_string(value)

    def finished_message(self) -> bytes:
        """Return the whole message, including the four bytes of encapsulation."""
        return ENCAPSULATION_HEADER + bytes(self.data)


class CdrReader:
    """Reader of the values of a CDR message. The reader also skips the padding between the values.

    Raises:
        ValueError: the message ends before the end of the value. Every method of the reader can
            raise this error.
    """

    def __init__(self, message: bytes) -> None:
        """Prepare to read a message from its first field, after the four bytes of encapsulation.

        Raises:
            ValueError: the message is not little-endian plain CDR.
        """
        if message[:4] != ENCAPSULATION_HEADER:
            raise ValueError("not little-endian CDR")
        self._data = message
        self._at = 4

    def read_bytes(self, size: int) -> bytes:
        """Return the next `size` bytes, without skipping padding."""
        end = self._at + size
        if end > len(self._data):
            raise ValueError(f"message ends {end - len(self._data)} bytes early")
        field_bytes = self._data[self._at : end]
        self._at = end
        return field_bytes

    def align(self, size: int) -> None:
        """Skip the padding up to the next multiple of `size` bytes."""
        self._at += -(self._at - 4) % size

    def read_length(self) -> int:
        """Read the length of a sequence."""
        self.align(4)
        return int(_UINT32_STRUCT.unpack(self.read_bytes(4))[0])

    def read_int64(self) -> int:
        """Read a signed 64-bit integer."""
        self.align(8)
        return int(_INT64_STRUCT.unpack(self.read_bytes(8))[0])

    def read_string(self) -> str:
        """Read a string."""
        size = self.read_length()
        # The length counts the NUL at the end of the string. Some writers store an empty string
        # with the length 0 and no NUL.
        return self.read_bytes(size)[: max(size - 1, 0)].decode()


@dataclass(frozen=True, slots=True)
class MessageTemplate:
    """Encoded message whose layout never changes.

    Messages that are made from one template differ only in their variable fields.

    Attributes:
        data: the message with zeros in all variable fields.
        stamp_offsets: offsets of the 8-byte time stamps in the message.
        fields: (offset, numpy format, number of values) of every variable field except the time
            stamps, by name.
    """

    data: bytes
    stamp_offsets: tuple[int, ...]
    fields: dict[str, tuple[int, str, int]]


class TemplateWriter(CdrWriter):
    """Builder of the template of a message.

    The builder is a CdrWriter that can also append variable fields.
    """

    def __init__(self) -> None:
        """Start with an empty message."""
        super().__init__()
        self._stamp_offsets: list[int] = []
        self._fields: dict[str, tuple[int, str, int]] = {}

    def put_time_stamp(self) -> None:
        """Append a time stamp (builtin_interfaces/Time) as a variable field."""
        self.align(4)
        # Offsets are counted from the start of the message. The encapsulation at the start of a
        # message has 4 bytes.
        self._stamp_offsets.append(len(self.data) + 4)
        self.data += bytes(8)

    def put_header(self, frame_id: str = "") -> None:
        """Append a std_msgs/Header, whose stamp is variable and whose frame_id is constant."""
        self.put_time_stamp()
        self.put_string(frame_id)

    def put_field(self, name: str, format_code: str, number: int = 1) -> None:
        """Append a field of one or more numbers, which can differ in each message of the template.

        Args:
            name: name of the field.
            format_code: numpy format, for example "<f8".
            number: number of values.
        """
        size = int(format_code[-1])
        if number:
            self.align(size)
        self._fields[name] = (len(self.data) + 4, format_code, number)
        self.data += bytes(size * number)

    def put_float_sequence(self, name: str, number: int) -> None:
        """Append a float64 sequence with a constant length, whose values differ from message to message.

        An empty sequence adds no variable field.
        """
        self.put_length(number)
        if number:
            self.put_field(name, "<f8", number)

    def finished_template(self) -> MessageTemplate:
        """Return the finished template."""
        return MessageTemplate(
            self.finished_message(), tuple(self._stamp_offsets), dict(self._fields)
        )
