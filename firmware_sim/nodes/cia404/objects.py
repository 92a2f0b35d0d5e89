"""The object dictionary of the simulated CiA 404 amplifier. Source: docs/facts/cia404.md.

The list below gives the values of the objects in a delivered amplifier. In the list of objects, c
is the number of a load-cell channel, counted from 1.

    1000:0  device type    0x00020194: analogue inputs, profile 404
    1005:0  SYNC           0x080
    1017:0  heartbeat      0 ms, off
    1018:4  serial number
    18xx    TPDO           1 identifier, 2 type 254 (on a change), 3 inhibit time, 5 event timer
    1Axx    mapping        0 entries, 1 to 8
    6131:0  number of channels
    6131:c  unit           0x00FD0000, mV/V: of the maker
    6132:c  decimal digits 2
    6130:c, 7130:c, 9130:c process value as float, 16 bits, 32 bits
    6150:c  status         bit 0 not valid, bit 1 and 2 positive and negative overload
"""

import math
import struct

from firmware_sim.nodes.cia402.object_dictionary import (
    ABORT_NO_OBJECT,
    ABORT_NO_SUBINDEX,
    ABORT_READ_ONLY,
    ABORT_VALUE_OUT_OF_RANGE,
    ABORT_WRONG_STATE,
    ABORT_WRONG_TYPE,
    ObjectKey,
    SdoAbort,
)

PDO_DISABLED_BIT = 1 << 31
"""Bit in the identifier object of a TPDO: the TPDO is off."""
NEWTON_UNIT = 0x0021_0000
"""Number of the unit newton in object 0x6131. Source: CiA 303-2."""
MANUFACTURER_UNIT = 0x00FD_0000
"""Number of the maker's unit, which object 0x6131 has until a host sets another unit."""
TPDO_COUNT = 4
"""Number of TPDOs of an amplifier."""
ABORT_NOT_MAPPABLE = 0x06040041
"""SDO abort code: the object cannot be mapped. Source: CiA 301."""
ABORT_PDO_TOO_LONG = 0x06040042
"""SDO abort code: the mapped objects exceed the length of a PDO. Source: CiA 301."""
NOT_VALID_STATUS = 1
"""Status bit: the reading of the channel is not valid."""
POSITIVE_OVERLOAD_STATUS = 2
"""Status bit: the reading is above the range."""
NEGATIVE_OVERLOAD_STATUS = 4
"""Status bit: the reading is below the range."""
OVERLOAD_RATIO = 1.03125
"""Smallest reading of a load cell that counts as overload, divided by the rated load.

Source: WIKA MH-4-CAN, overload at 3.125 % beyond the range.
"""
FLOAT_PROCESS_VALUE_INDEX = 0x6130
"""Index of the process value as a float."""
INT16_PROCESS_VALUE_INDEX = 0x7130
"""Index of the process value with 16 bits."""
INT32_PROCESS_VALUE_INDEX = 0x9130
"""Index of the process value with 32 bits."""
_OVERLOAD_VALUES = {INT16_PROCESS_VALUE_INDEX: -(1 << 15), INT32_PROCESS_VALUE_INDEX: -(1 << 31)}
"""Integer process values that report an overload.

In an overload, the float process value is NaN. Source: WIKA MH-4-CAN.
"""
_MAPPABLE_SIZES_BYTES = {
    FLOAT_PROCESS_VALUE_INDEX: 4,
    INT16_PROCESS_VALUE_INDEX: 2,
    INT32_PROCESS_VALUE_INDEX: 4,
    0x6150: 1,
}
"""Sizes of the objects that can be mapped into a TPDO [bytes]."""


class AmplifierObjects:
    """The object dictionary of one amplifier: the values of all objects.

    Attributes:
        readings: present reading of each channel [N].
    """

    def __init__(self, node_id: int, channels: int, measurement_range: float, serial: int) -> None:
        """Set all objects to the values with which the maker delivers the amplifier.

        Args:
            node_id: node number of the amplifier.
            channels: number of channels of the amplifier.
            measurement_range: rated load of the connected load cells [N].
            serial: serial number of the amplifier.
        """
        self.readings = [0.0] * channels
        self._range = measurement_range
        self._sizes: dict[ObjectKey, int] = {}
        self._values: dict[ObjectKey, int] = {}
        self._fixed: set[ObjectKey] = set()
        self._add_object((0x1000, 0), 4, 0x0002_0194, is_fixed=True)
        self._add_object((0x1005, 0), 4, 0x080)
        self._add_object((0x1017, 0), 2, 0)
        self._add_object((0x1018, 4), 4, serial, is_fixed=True)
        for i in range(TPDO_COUNT):
            mapped_objects = [
                INT32_PROCESS_VALUE_INDEX << 16 | c << 8 | 32
                for c in (2 * i + 1, 2 * i + 2)
                if c <= channels
            ]
            can_id = 0x180 + 0x100 * i + node_id | (0 if mapped_objects else PDO_DISABLED_BIT)
            for sub, size, value in ((1, 4, can_id), (2, 1, 254), (3, 2, 0), (5, 2, 0)):
                self._add_object((0x1800 + i, sub), size, value)
            self._add_object((0x1A00 + i, 0), 1, len(mapped_objects))
            for sub in range(1, 9):
                self._add_object(
                    (0x1A00 + i, sub),
                    4,
                    mapped_objects[sub - 1] if sub <= len(mapped_objects) else 0,
                )
        self._add_object((0x6131, 0), 1, channels, is_fixed=True)
        for channel in range(1, channels + 1):
            self._add_object((0x6131, channel), 4, MANUFACTURER_UNIT)
            self._add_object((0x6132, channel), 1, 2)

    def _add_object(
        self, key: ObjectKey, byte_count: int, value: int, is_fixed: bool = False
    ) -> None:
        """Add an object to the object dictionary. A fixed object is read-only for hosts."""
        self._sizes[key] = byte_count
        self._values[key] = value
        if is_fixed:
            self._fixed.add(key)

    def __getitem__(self, key: ObjectKey) -> int:
        """Return the stored value of an object."""
        return self._values[key]

    def __setitem__(self, key: ObjectKey, value: int) -> None:
        """Set the value of an object from inside the amplifier."""
        self._values[key] = value

    def read(self, key: ObjectKey) -> bytes:
        """Return the value of an object as bytes.

        Raises:
            SdoAbort: the object does not exist.
        """
        if key[0] in _MAPPABLE_SIZES_BYTES:
            if not 1 <= key[1] <= len(self.readings):
                raise SdoAbort(ABORT_NO_SUBINDEX)
            return self._measured_bytes(*key)
        if key not in self._sizes:
            raise SdoAbort(
                ABORT_NO_SUBINDEX
                if any(index == key[0] for index, _ in self._sizes)
                else ABORT_NO_OBJECT
            )
        return self._values[key].to_bytes(self._sizes[key], "little")

    def write(self, key: ObjectKey, value_bytes: bytes) -> None:
        """Write the bytes of a value, as received in a frame, to an object.

        Raises:
            SdoAbort: the object does not exist, is read-only or has another length, or the mapping
                is not possible.
        """
        self.read(key)
        if key[0] in _MAPPABLE_SIZES_BYTES or key in self._fixed:
            raise SdoAbort(ABORT_READ_ONLY)
        if len(value_bytes) != self._sizes[key]:
            raise SdoAbort(ABORT_WRONG_TYPE)
        value = int.from_bytes(value_bytes, "little")
        if 0x1A00 <= key[0] < 0x1A00 + TPDO_COUNT:
            self._check_mapping(key, value)
        self._values[key] = value

    def _check_mapping(self, key: ObjectKey, value: int) -> None:
        """Check that a new value of a mapping object is possible, and that the TPDO of the mapping is off."""
        index, sub = key
        if not self[index - 0x200, 1] & PDO_DISABLED_BIT:
            raise SdoAbort(ABORT_WRONG_STATE)
        if sub and self[index, 0]:
            raise SdoAbort(ABORT_WRONG_STATE)
        if sub and (
            value >> 16 not in _MAPPABLE_SIZES_BYTES
            or not 1 <= value >> 8 & 0xFF <= len(self.readings)
        ):
            raise SdoAbort(ABORT_NOT_MAPPABLE)
        if not sub and value > 8:
            raise SdoAbort(ABORT_VALUE_OUT_OF_RANGE)
        if not sub and sum(self[index, i + 1] & 0xFF for i in range(value)) > 64:
            raise SdoAbort(ABORT_PDO_TOO_LONG)

    def payload(self, tpdo_number: int) -> bytes:
        """Return the payload of a TPDO with the present readings."""
        entries = [self[0x1A00 + tpdo_number, i + 1] for i in range(self[0x1A00 + tpdo_number, 0])]
        return b"".join(self._measured_bytes(entry >> 16, entry >> 8 & 0xFF) for entry in entries)

    def _channel_status(self, channel: int) -> int:
        """Return the status of a channel."""
        reading = self.readings[channel - 1]
        if abs(reading) < OVERLOAD_RATIO * self._range:
            return 0
        return NOT_VALID_STATUS | (
            POSITIVE_OVERLOAD_STATUS if reading > 0 else NEGATIVE_OVERLOAD_STATUS
        )

    def _measured_bytes(self, index: int, channel: int) -> bytes:
        """Return the process value or the status of a channel as bytes."""
        status = self._channel_status(channel)
        if index == 0x6150:
            return bytes((status,))
        # The unit in which the amplifier is delivered is assumed to be 1/100 N. Therefore a host
        # that does not set the unit reads wrong tensions.
        unit = 1.0 if self[0x6131, channel] == NEWTON_UNIT else 100.0
        value = math.nan if status else self.readings[channel - 1] * unit
        if index == FLOAT_PROCESS_VALUE_INDEX:
            return struct.pack("<f", value)
        size = _MAPPABLE_SIZES_BYTES[index]
        count = _OVERLOAD_VALUES[index] if status else round(value * 10 ** self[0x6132, channel])
        max_value = (1 << 8 * size - 1) - 1
        return min(max_value, max(-max_value - 1, count)).to_bytes(size, "little", signed=True)
