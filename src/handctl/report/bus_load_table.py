"""Table of the bus load of each drive protocol.

The table gives the time that the frames of one tick need, for hands with 4 and with 11 motors. The
time includes the frames with commands, the frames with feedback and the frames with load-cell
readings. If the drive protocol needs SYNC frames, the time also includes the SYNC frames. With
classical CAN, a load-cell frame contains 8 bytes with the readings of four tendons. With CAN FD, a
single frame contains the readings of all tendons. The bus load of one particular hand file is
computed by ``controller.bus_load``.
"""

from typing import Any, NamedTuple

from handctl.drives.frame_time import MAX_BUS_LOAD, bus_time_s

# Bit rates for which the table is computed [bit/s]: the nominal rate, and the rate in the data
# phase of CAN FD.
BITRATE_BIT_PER_S = 1_000_000
DATA_BITRATE_BIT_PER_S = 5_000_000
BUS_LOAD_RATES_HZ = (250.0, 500.0, 1000.0)
"""Control rates for which the table gives the bus load [Hz]."""


class BusLoadTableRow(NamedTuple):
    """Row of the table of bus loads.

    Attributes:
        protocol: name and variant of the drive protocol.
        fd: True for CAN FD at 1/5 Mbit/s, and False for classical CAN at 1 Mbit/s.
        motors: number of motors on the bus.
        per_motor: payload [bytes] of each frame that is sent once per tick for every motor.
        shared: payload [bytes] of each frame that is sent once per tick for all motors together,
            such as SYNC frames.
    """

    protocol: str
    fd: bool
    motors: int
    per_motor: tuple[int, ...]
    shared: tuple[int, ...]

    @property
    def frame_time_per_tick_s(self) -> float:
        """Return the time that the frames of one tick take on the bus [s]."""
        sizes = [*self.per_motor * self.motors, *self.shared]
        return bus_time_s(
            [(size, self.fd, 1.0) for size in sizes], BITRATE_BIT_PER_S, DATA_BITRATE_BIT_PER_S
        )

    def as_json(self) -> dict[str, Any]:
        """Return the row as a mapping for JSON output."""
        loads = {f"{rate:g}": rate * self.frame_time_per_tick_s for rate in BUS_LOAD_RATES_HZ}
        return self._asdict() | {
            "tick_us": self.frame_time_per_tick_s * 1e6,
            "load": loads,
            "max_hz": MAX_BUS_LOAD / self.frame_time_per_tick_s,
        }


BUS_LOAD_ROWS = (
    BusLoadTableRow("MIT", False, 4, (8, 8), (8,)),
    BusLoadTableRow("MIT", False, 11, (8, 8), (8, 8, 8)),
    BusLoadTableRow("MIT", True, 4, (8, 8), (12,)),
    BusLoadTableRow("MIT", True, 11, (8, 8), (32,)),
    BusLoadTableRow("CiA 402", False, 4, (4, 8), (0, 8)),
    BusLoadTableRow("CiA 402", False, 11, (4, 8), (0, 8, 8, 8)),
    BusLoadTableRow("CiA 402, four torques in one RPDO", False, 4, (8,), (0, 8, 8)),
    BusLoadTableRow("ODrive, torque and encoder", False, 4, (4, 8), (8,)),
    BusLoadTableRow("ODrive, with torque feedback", False, 4, (8, 8, 8), (8,)),
)
"""Rows of the table: (protocol, CAN FD, motors, payloads of each motor, shared payloads)."""
