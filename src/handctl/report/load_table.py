"""Table of the bus load of each protocol: time per tick for 4 or 11 motors at the usual bit rates.

The time includes command, feedback, and load cell frames (four tendons in 8 bytes, or all in one
CAN FD frame), and SYNC where a protocol needs it. ``controller.bus_load`` computes the load for a
hand file.
"""

from typing import Any, NamedTuple

from handctl.drives.frame_time import MAX_BUS_LOAD, bus_time_s

# Bit rates of the table: nominal, and data phase of CAN FD [bit/s].
BITRATE = 1_000_000
DATA_BITRATE = 5_000_000
TABLE_RATES_HZ = (250.0, 500.0, 1000.0)
"""Control rates of the table [Hz]."""


class TableRow(NamedTuple):
    """Row of the table.

    Attributes:
        protocol: name and variant.
        fd: CAN FD at 1/5 Mbit/s if True, else classical CAN at 1 Mbit/s.
        motors: number of motors.
        per_motor: payload of each frame of one motor in a tick [bytes].
        shared: payload of each frame for all motors, such as tensions and SYNC [bytes].
    """

    protocol: str
    fd: bool
    motors: int
    per_motor: tuple[int, ...]
    shared: tuple[int, ...]

    @property
    def tick_s(self) -> float:
        """Return the time of one tick's frames [s]."""
        sizes = [*self.per_motor * self.motors, *self.shared]
        return bus_time_s([(size, self.fd, 1.0) for size in sizes], BITRATE, DATA_BITRATE)

    def numbers(self) -> dict[str, Any]:
        """Return the row as a mapping for JSON output."""
        loads = {f"{rate:g}": rate * self.tick_s for rate in TABLE_RATES_HZ}
        return self._asdict() | {"tick_us": self.tick_s * 1e6, "load": loads, "max_hz": MAX_BUS_LOAD / self.tick_s}


TABLE = (
    TableRow("MIT", False, 4, (8, 8), (8,)),
    TableRow("MIT", False, 11, (8, 8), (8, 8, 8)),
    TableRow("MIT", True, 4, (8, 8), (12,)),
    TableRow("MIT", True, 11, (8, 8), (32,)),
    TableRow("CiA 402", False, 4, (4, 8), (0, 8)),
    TableRow("CiA 402", False, 11, (4, 8), (0, 8, 8, 8)),
    TableRow("CiA 402, four torques in one RPDO", False, 4, (8,), (0, 8, 8)),
    TableRow("ODrive, torque and encoder", False, 4, (4, 8), (8,)),
    TableRow("ODrive, with torque feedback", False, 4, (8, 8, 8), (8,)),
)
"""Rows: (protocol, CAN FD, motors, payloads per motor, shared payloads)."""
