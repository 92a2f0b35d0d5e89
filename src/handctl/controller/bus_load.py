"""How full each bus of a hand is: what is on it, frame by frame, in the worst case."""

from dataclasses import dataclass

from handctl.controller.setup import make_drives, make_sensors
from handctl.drives.contract import Drive
from handctl.drives.load import MOST, frame_time_s
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.sections import Bus


@dataclass(frozen=True, slots=True)
class Row:
    """Frames of one kind.

    Attributes:
        what: motor, or part of the sensor node.
        size: payload [bytes]. fd: whether CAN FD.
        per_tick, per_second: how many with every tick, and how many by time.
        frame_s: longest time of one [s].
    """

    what: str
    size: int
    fd: bool
    per_tick: float
    per_second: float
    frame_s: float


@dataclass(frozen=True, slots=True)
class BusLoad:
    """One bus.

    Attributes:
        name: of the bus. motors: how many are on it. rows: what is on it.
    """

    name: str
    motors: int
    rows: tuple[Row, ...]

    @property
    def tick_s(self) -> float:
        """Time of one tick's frames [s]."""
        return sum(row.per_tick * row.frame_s for row in self.rows)

    @property
    def share(self) -> float:
        """Share of the bus that frames take which come by time."""
        return sum(row.per_second * row.frame_s for row in self.rows)

    def at(self, rate_hz: float) -> float:
        """Share of the bus at a control rate [Hz]."""
        return rate_hz * self.tick_s + self.share

    def highest(self, most: float) -> float:
        """Control rate at which it is as full as ``most`` [Hz]; infinity if nothing comes with a tick."""
        return max(0.0, most - self.share) / self.tick_s if self.tick_s else float("inf")


def bus_loads(hand: Hand) -> tuple[BusLoad, ...]:
    """Load of each bus.

    Raises:
        ConfigError: a motor is set to CAN FD and its bus has no data bit rate.
    """
    drives = make_drives(hand)
    return tuple(_load(hand, index, bus, drives) for index, bus in enumerate(hand.bus))


def drive_rows(drive: Drive, bus: Bus) -> tuple[Row, ...]:
    """What one motor puts on a bus.

    Raises:
        ConfigError: it speaks CAN FD and the bus does not.
    """
    kinds = [(size, fd, 1.0, 0.0) for size, fd in drive.exchange]
    kinds += [(size, fd, 0.0, number) for size, fd, number in drive.background]
    if bus.data_bitrate is None and any(fd for _, fd, _, _ in kinds):
        raise ConfigError("missing, and a motor on it is set to CAN FD", f"bus[{bus.name}].data_bitrate", "bit/s")
    return tuple(
        Row(drive.name, size, fd, tick, second, frame_time_s(size, fd, bus.bitrate, bus.data_bitrate))
        for size, fd, tick, second in kinds
    )


def sensor_rows(hand: Hand, bus: Bus) -> tuple[Row, ...]:
    """What the sensor node and its SYNC put on a bus."""
    node = make_sensors(hand)
    names = ["SYNC"] + ["tensions"] * node.tension_frames + ["joint angles"] * (len(node.ids) - node.tension_frames)
    return tuple(
        Row(name, size, False, number, 0.0, frame_time_s(size, False, bus.bitrate))
        for name, (size, number) in zip(names, node.exchange, strict=True)
    )


def _load(hand: Hand, index: int, bus: Bus, drives: tuple[Drive, ...]) -> BusLoad:
    mine = [drive for drive in drives if drive.bus == index]
    rows = [row for drive in mine for row in drive_rows(drive, bus)]
    if hand.sensor_node.bus == bus.name:
        rows += sensor_rows(hand, bus)
    return BusLoad(bus.name, len(mine), tuple(rows))


def split(hand: Hand, rate_hz: float) -> list[list[str]]:
    """Motors on as few buses as hold them at a rate [Hz], all with the bit rates of the hand's first bus.

    The load cells stay on the first bus and take their share of it.

    Returns:
        names of the motors of each bus; empty if a single motor is too much.
    """
    first = hand.bus[0]
    left, buses = MOST - BusLoad("", 0, sensor_rows(hand, first)).at(rate_hz), list[list[str]]([[]])
    for drive in make_drives(hand):
        share = BusLoad("", 1, drive_rows(drive, first)).at(rate_hz)
        if share > MOST:
            return []
        if share > left:
            left = MOST
            buses.append([])
        buses[-1].append(drive.name)
        left -= share
    return buses
