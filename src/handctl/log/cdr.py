"""CDR, the encoding of ROS 2 messages: a small writer and reader, and templates whose layout never changes.

Source: OMG CORBA 3.0, section 15.3 (alignment relative to the byte after the encapsulation header), as rosbags and
mcap-ros2-support implement it: an empty sequence is its length only, a string's length counts its NUL.
"""

import struct
from dataclasses import dataclass

ENCAPSULATION = b"\x00\x01\x00\x00"
"""Little-endian plain CDR."""

_U32, _I64 = struct.Struct("<I"), struct.Struct("<q")


class CdrWriter:
    """Appends aligned values to ``data``.

    Args:
        start: offset of the first byte within the message body, for a part that is appended to others.
    """

    def __init__(self, start: int = 0) -> None:
        self.data = bytearray()
        self._start = start

    def align(self, size: int) -> None:
        """Pad with zeros to a multiple of size."""
        self.data += bytes(-(self._start + len(self.data)) % size)

    def put(self, code: str, value: float) -> None:
        """One number, as a ``struct`` format character."""
        self.align(struct.calcsize("<" + code))
        self.data += struct.pack("<" + code, value)

    def count(self, number: int) -> None:
        """Length of a sequence."""
        self.put("I", number)

    def text(self, value: str) -> None:
        """A string; a lone surrogate, which no other reader could decode, is escaped."""
        raw = value.encode("utf-8", "backslashreplace")
        self.count(len(raw) + 1)
        self.data += raw + b"\0"

    def texts(self, values: tuple[str, ...]) -> None:
        """A sequence of strings."""
        self.count(len(values))
        for value in values:
            self.text(value)

    def message(self) -> bytes:
        """The whole message with its encapsulation header."""
        return ENCAPSULATION + bytes(self.data)


class CdrReader:
    """Reads aligned values and never beyond the end.

    Raises:
        ValueError: from every method, when the message is shorter than it says.
    """

    def __init__(self, message: bytes) -> None:
        if message[:4] != ENCAPSULATION:
            raise ValueError("not little-endian CDR")
        self._data, self._at = message, 4

    def take(self, size: int) -> bytes:
        """The next size bytes, unaligned."""
        end = self._at + size
        if end > len(self._data):
            raise ValueError(f"message ends {end - len(self._data)} bytes early")
        part, self._at = self._data[self._at : end], end
        return part

    def align(self, size: int) -> None:
        """Skip the padding."""
        self._at += -(self._at - 4) % size

    def count(self) -> int:
        """Length of a sequence."""
        self.align(4)
        return int(_U32.unpack(self.take(4))[0])

    def i64(self) -> int:
        """A signed 64-bit integer."""
        self.align(8)
        return int(_I64.unpack(self.take(8))[0])

    def text(self) -> str:
        """A string."""
        size = self.count()
        return self.take(size)[: max(size - 1, 0)].decode()


@dataclass(frozen=True, slots=True)
class Template:
    """A message of constant layout: only the marked places change.

    Attributes:
        data: the message, all variable places zero.
        stamps: offsets of the 8-byte time stamps.
        places: name -> (offset, numpy format, number of values) of everything else that changes.
    """

    data: bytes
    stamps: tuple[int, ...]
    places: dict[str, tuple[int, str, int]]


class TemplateWriter(CdrWriter):
    """Builds a template."""

    def __init__(self) -> None:
        super().__init__()
        self._stamps: list[int] = []
        self._places: dict[str, tuple[int, str, int]] = {}

    def stamp(self) -> None:
        """Place of a builtin_interfaces/Time."""
        self.align(4)
        self._stamps.append(len(self.data) + 4)
        self.data += bytes(8)

    def header(self, frame_id: str = "") -> None:
        """A std_msgs/Header with constant frame_id."""
        self.stamp()
        self.text(frame_id)

    def place(self, name: str, code: str, number: int = 1) -> None:
        """Place of number values of one numpy format, e.g. "<f8"."""
        size = int(code[-1])
        if number:
            self.align(size)
        self._places[name] = (len(self.data) + 4, code, number)
        self.data += bytes(size * number)

    def floats(self, name: str, number: int) -> None:
        """A float64 sequence of constant length; no place if it is empty."""
        self.count(number)
        if number:
            self.place(name, "<f8", number)

    def template(self) -> Template:
        """The finished template."""
        return Template(self.message(), tuple(self._stamps), dict(self._places))
