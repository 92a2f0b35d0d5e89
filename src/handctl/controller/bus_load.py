"""Load of each bus of a hand, computed for frames of the longest possible duration."""

from dataclasses import dataclass, replace

from handctl.controller.run_setup import make_drives, make_sensors
from handctl.drives.canopen.codec import SYNC
from handctl.drives.cia402.drive import Cia402Drive
from handctl.drives.contract import Drive
from handctl.drives.frame_time import MAX_BUS_LOAD, frame_time_s
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.section_models import Bus

USUAL_BITRATES_BIT_S = (
    *(10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000),
    *(2_000_000, 4_000_000, 5_000_000, 8_000_000),
)
"""Bit rates of CAN buses [bit/s].

Sources: CiA 301 for the bit rates up to 1 Mbit/s, CiA 601-1 for the data bit rates of CAN FD.
"""


@dataclass(frozen=True, slots=True)
class BusLoadRow:
    """Row of the bus-load table: all frames of one kind on a bus.

    Attributes:
        sender: name of the motor, or of the part of the sensor node, that sends the frames.
        size: payload of each frame [bytes].
        fd: True for CAN FD frames.
        frames_per_tick: number of frames of the kind in every tick.
        frames_per_second: number of frames of the kind per second, for frames whose rate does not
            depend on the control rate.
        frame_s: longest duration of one frame [s].
    """

    sender: str
    size: int
    fd: bool
    frames_per_tick: float
    frames_per_second: float
    frame_s: float


@dataclass(frozen=True, slots=True)
class BusLoad:
    """Load of one bus of a hand.

    Attributes:
        name: name of the bus.
        motors: number of motors on the bus.
        rows: kinds of frames on the bus.
    """

    name: str
    motors: int
    rows: tuple[BusLoadRow, ...]

    @property
    def frame_time_per_tick_s(self) -> float:
        """Return the time that all frames of one tick take on the bus [s]."""
        return sum(row.frames_per_tick * row.frame_s for row in self.rows)

    @property
    def periodic_load_fraction(self) -> float:
        """Return the part of the bus load that does not depend on the control rate, as a fraction.

        Frames with a rate of their own, such as heartbeats, cause a bus load that does not depend
        on the control rate.
        """
        return sum(row.frames_per_second * row.frame_s for row in self.rows)

    def load_at_rate(self, rate_hz: float) -> float:
        """Return the bus load at a control rate [Hz], as a fraction."""
        return rate_hz * self.frame_time_per_tick_s + self.periodic_load_fraction

    def highest_rate_hz(self, load_limit: float) -> float:
        """Return the control rate [Hz] at which the bus load reaches ``load_limit``.

        If the bus has no frames that are sent once per tick, return infinity.
        """
        return (
            max(0.0, load_limit - self.periodic_load_fraction) / self.frame_time_per_tick_s
            if self.frame_time_per_tick_s
            else float("inf")
        )


def bus_loads(hand: Hand) -> tuple[BusLoad, ...]:
    """Return the load of each bus of a hand.

    Raises:
        ConfigError: a motor is set to CAN FD, although its bus has no data bit rate.
    """
    drives = make_drives(hand)
    return tuple(_load_of_bus(hand, index, bus, drives) for index, bus in enumerate(hand.bus))


def bus_warnings(hand: Hand) -> tuple[str, ...]:
    """Return one line for each bus whose section in the hand file is probably wrong.

    Raises:
        ConfigError: a motor is set to CAN FD, although its bus has no data bit rate.
    """
    lines = []
    for bus, load in zip(hand.bus, bus_loads(hand), strict=True):
        location = f"bus[{bus.name}]"
        if not load.rows:
            lines.append(f"{location}: no motor and no sensor uses this bus")
        if bus.data_bitrate is not None and not any(row.fd for row in load.rows):
            lines.append(f"{location}.data_bitrate: no motor on this bus sends CAN FD frames")
        for key, value in (("bitrate", bus.bitrate), ("data_bitrate", bus.data_bitrate)):
            if value is not None and value not in USUAL_BITRATES_BIT_S:
                usual_bitrates_text = ", ".join(str(bitrate) for bitrate in USUAL_BITRATES_BIT_S)
                lines.append(
                    f"{location}.{key}: {value} is not usual; usual are {usual_bitrates_text}"
                )
    return tuple(lines)


def drive_rows(drive: Drive, bus: Bus) -> tuple[BusLoadRow, ...]:
    """Return the rows of the bus-load table for the frames of a motor.

    Raises:
        ConfigError: the motor uses CAN FD, although its bus does not use CAN FD.
    """
    kinds = [(size, fd, 1.0, 0.0) for size, fd in drive.frames_per_tick]
    kinds += [(size, fd, 0.0, number) for size, fd, number in drive.background_frames]
    if bus.data_bitrate is None and any(fd for _, fd, _, _ in kinds):
        raise ConfigError(
            "missing, and a motor on it is set to CAN FD", f"bus[{bus.name}].data_bitrate", "bit/s"
        )
    return tuple(
        BusLoadRow(
            drive.name,
            size,
            fd,
            frames_per_tick,
            frames_per_second,
            frame_time_s(size, fd, bus.bitrate, bus.data_bitrate, drive.has_extended_ids),
        )
        for size, fd, frames_per_tick, frames_per_second in kinds
    )


def sensor_rows(hand: Hand, bus: Bus) -> tuple[BusLoadRow, ...]:
    """Return the rows of the bus-load table for the sensor node.

    The rows contain the frames of the node and the SYNC frames.
    """
    node = make_sensors(hand)
    if not node.ids:
        return ()
    names = (
        ["SYNC"]
        + ["tensions"] * node.tension_frames
        + ["joint angles"] * (len(node.ids) - node.tension_frames)
    )
    kinds = [
        (name, size, number, 0.0)
        for name, (size, number) in zip(names, node.frames_per_tick, strict=True)
    ]
    kinds += [("heartbeats", size, 0.0, number) for size, number in node.background_frames]
    return tuple(
        BusLoadRow(
            name,
            size,
            False,
            frames_per_tick,
            frames_per_second,
            frame_time_s(size, False, bus.bitrate),
        )
        for name, size, frames_per_tick, frames_per_second in kinds
    )


def _load_of_bus(hand: Hand, bus_index: int, bus: Bus, drives: tuple[Drive, ...]) -> BusLoad:
    bus_drives = [drive for drive in drives if drive.bus == bus_index]
    rows = [row for drive in bus_drives for row in drive_rows(drive, bus)]
    if hand.sensor_node.bus == bus.name and make_sensors(hand).ids:
        rows += sensor_rows(hand, bus)
    return BusLoad(bus.name, len(bus_drives), tuple(rows))


def split_motors_over_buses(hand: Hand, rate_hz: float) -> list[list[str]]:
    """Distribute the motors over the smallest number of buses that allows the given control rate [Hz].

    All buses have the bit rates of the first bus in the hand file. The load cells stay on the first
    bus of the hand.

    Returns:
        The names of the motors on each bus. If a single motor already overloads a bus, the list is
        empty.
    """
    first_bus = hand.bus[0]
    # The first bus also carries the SYNC frame and the load-cell frames, so it has less capacity
    # for motors.
    free_bus_load = MAX_BUS_LOAD - BusLoad("", 0, sensor_rows(hand, first_bus)).load_at_rate(
        rate_hz
    )
    # A CiA 402 drive sends its reply after a SYNC frame, so each bus without the sensor node's SYNC
    # frame needs a SYNC frame of its own.
    uses_sync = SYNC in make_sensors(hand).host_ids
    sync_load = rate_hz * frame_time_s(0, False, first_bus.bitrate)
    buses = list[list[str]]([[]])
    for drive in make_drives(hand):
        listens_to_sync = isinstance(drive, Cia402Drive)
        # Any drive can become the drive after whose command the host sends its heartbeat.
        # ``sync_load`` contains the load of the SYNC frame.
        if isinstance(drive, Cia402Drive):
            drive = replace(drive, sync=False, sends_heartbeat=True)
        load = BusLoad("", 1, drive_rows(drive, first_bus)).load_at_rate(rate_hz)
        load_with_sync = load + sync_load * listens_to_sync
        if load_with_sync > MAX_BUS_LOAD:
            return []
        if (load if uses_sync else load_with_sync) > free_bus_load:
            free_bus_load = MAX_BUS_LOAD
            buses.append([])
            uses_sync = False
        free_bus_load -= load if uses_sync else load_with_sync
        uses_sync |= listens_to_sync
        buses[-1].append(drive.name)
    return buses


def with_more_buses(hand: Hand, rate_hz: float) -> Hand:
    """Return a copy of a hand, in which the number of buses is the smallest that allows the given control rate [Hz].

    In the copy, the motors are distributed over all buses. The load cells stay on the first bus of
    the hand. All buses have the bit rates of the first bus. If a single motor already overloads a
    bus, the hand is returned unchanged.
    """
    groups = split_motors_over_buses(hand, rate_hz)
    if not groups:
        return hand
    first_bus = hand.bus[0]
    names = [first_bus.name, *(f"bus_{number}" for number in range(1, len(groups)))]
    bus_by_motor = {
        motor: name for name, motors in zip(names, groups, strict=True) for motor in motors
    }
    return hand.model_copy(
        update={
            "bus": tuple(first_bus.model_copy(update={"name": name}) for name in names),
            "motor": tuple(
                motor.model_copy(update={"bus": bus_by_motor[motor.name]}) for motor in hand.motor
            ),
        }
    )
