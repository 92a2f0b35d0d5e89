"""From the command line's arguments to a checked plan; no bus is opened here."""

import argparse
import datetime
import math
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from handctl.cli.gains_layers import layered_gains
from handctl.controller.bus_load import BusLoad, bus_loads
from handctl.controller.calibration import Calibration, load_calibration
from handctl.controller.gains import Gains
from handctl.controller.pace import check_pace
from handctl.controller.reach import check_reach, check_tip_force
from handctl.controller.task import Task, check_task, load_task, load_trajectory, shapes
from handctl.drives.load import MOST, highest_rate
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.load import load_hand
from handctl.output import check_output
from handctl.runtime.buses.open import check_spec, real_buses

TASKS = Path(__file__).parent.parent / "tasks"
TICKS_IN_WATCHDOG = 2
"""Ticks in a drive's watchdog time, at least: one lost frame is no reason to let go."""
FRESH_S = 24 * 3600.0
"""A calibration older than this is not armed with: load cells drift and ropes creep."""


@dataclass(frozen=True)
class Plan:
    """Everything about a run that is known, and checked, before a bus is opened.

    Attributes:
        hand: description.
        gains: weights and noise assumptions.
        rate_hz: control rate.
        load: worst-case share of each bus, in the hand's order.
        buses: specification of each bus; empty in lockstep.
        attachments: files that go into the log.
        time_scale: run time per wall time.
        quiet: no display.
        clear: a person has ordered that what the drives have latched be cleared.
    """

    hand: Hand
    gains: Gains
    rate_hz: float
    load: tuple[float, ...]
    buses: tuple[str, ...] = ()
    attachments: dict[str, bytes] = field(default_factory=dict)
    time_scale: float = 1.0
    quiet: bool = False
    clear: bool = False

    @property
    def period_ns(self) -> int:
        """Control period [ns]."""
        return round(1e9 / self.rate_hz)

    @property
    def simulated(self) -> bool:
        """Whether it is for buses, and none of them can have real motors."""
        return bool(self.buses) and not real_buses(self.buses)

    def on(self, buses: tuple[str, ...]) -> "Plan":
        """The same plan on other buses."""
        return replace(self, buses=buses)


def make_plan(args: argparse.Namespace, lockstep: bool = False) -> Plan:
    """Check hand, gains, buses and rate.

    Raises:
        ConfigError: anything that is wrong, in one line.
    """
    hand = load_hand(args.hand)
    check_load_cells(hand, str(args.hand))
    layers = layered_gains(args, hand)
    buses = () if lockstep else bus_specs(hand, args.bus)
    _refuse_unnamed(args, hand, buses)
    loads = bus_loads(hand)
    rate = control_rate(args.rate, hand, loads)
    load = tuple(one.at(rate) for one in loads)
    if not 0.001 <= args.time_scale <= 100:
        raise ConfigError(f"{args.time_scale:g}", "--time-scale", "0.001 to 100")
    if args.time_scale != 1 and (real := real_buses(buses)):
        right = "1, or a bus of simulated ones: local:NAME, socketcan:vcan0"
        raise ConfigError(f"{args.time_scale:g}, and {real[0]} may have real motors", "--time-scale", right)
    _check_log(args.log)
    attachments = {"gains.toml": layers.file.read_bytes()} if layers.file else {}
    return Plan(hand, layers.gains, rate, load, buses, attachments, args.time_scale, args.json, args.clear)


def _refuse_unnamed(args: argparse.Namespace, hand: Hand, buses: Sequence[str]) -> None:
    """Refuse the default hand on a real bus: its limits are those of other motors and tendons.

    Raises:
        ConfigError: no hand is named, and the bus may have real motors.
    """
    if not args.hand_named and (real := real_buses(buses)):
        right = f"--hand, the file of the hand that is there; the default {hand.name!r} is for simulated buses alone"
        raise ConfigError(f"no hand is named, and {real[0]} may have real motors", "--hand", right)


def check_load_cells(hand: Hand, where: str) -> None:
    """Refuse a hand with a tendon that has no load cell: no controller arms it.

    Args:
        hand: to be armed.
        where: its name or file, for the message.

    Raises:
        ConfigError: ``sensor_node.tendons`` leaves a tendon out.
    """
    if bare := [name for name in hand.tendon_names if name not in hand.sensor_node.tendons]:
        what = f"no load cell of {', '.join(bare)}"
        raise ConfigError(what, f"{where}: sensor_node.tendons", "every tendon: without its load cell no hand is armed")


def control_rate(asked: float | None, hand: Hand, loads: Sequence[BusLoad]) -> float:
    """The rate that was asked for [Hz], or the highest usual one.

    Raises:
        ConfigError: the drives' watchdogs do not allow a lost tick at it, or a bus cannot carry it.
    """
    best = fastest(loads)
    rate = best if asked is None else asked
    lowest = TICKS_IN_WATCHDOG * 1e3 / min(motor.watchdog_ms for motor in hand.motor)
    if not lowest <= rate < math.inf:
        what = f"{rate:g}" if asked is not None else f"the buses carry {rate:g}"
        raise ConfigError(what, "--rate", f"at least {lowest:g}, for the drives' watchdogs")
    for name, load in zip(hand.bus_names, loads, strict=True):
        if load.at(rate) > MOST:
            what = f"bus {name} would be {100 * load.at(rate):.0f} % full at {rate:g} Hz"
            raise ConfigError(what, "--rate", f"at most {best:g}")
    return rate


def _check_log(log: Path | None) -> None:
    """Refuse a log that could not be created, before anything is opened."""
    if log is not None and (log.suffix != ".mcap" or os.path.lexists(log) or not log.parent.is_dir()):
        raise ConfigError(str(log), "--log", "a new file ending in .mcap in a folder that exists")


def bus_specs(hand: Hand, given: Sequence[str]) -> tuple[str, ...]:
    """Specification of each bus of a hand, from ``--bus``.

    Raises:
        ConfigError: a bus is missing, given twice, not the hand's, or none.
    """
    specs = _specs(hand.bus_names, given)
    for spec in specs:
        check_spec(spec)
    return specs


def _specs(names: tuple[str, ...], given: Sequence[str]) -> tuple[str, ...]:
    """What was given for each name."""
    if len(names) == 1 and len(given) == 1 and "=" not in given[0].partition(":")[0]:
        return (given[0],)
    found: dict[str, str] = {}
    for text in given:
        name, _, spec = text.partition("=")
        if name not in names or not spec or name in found:
            raise ConfigError(repr(text), "--bus", " ".join(f"--bus {name}=SPEC" for name in names))
        found[name] = spec
    for name in names:
        if name not in found:
            raise ConfigError("missing", f"--bus {name}=SPEC", f"all of {', '.join(names)}")
    return tuple(found[name] for name in names)


def fastest(loads: Sequence[BusLoad]) -> float:
    """The highest usual control rate that all buses can carry [Hz]."""
    return highest_rate((load.tick_s for load in loads), (load.share for load in loads))


def check_design(hand: Hand, gains: Gains, rate_hz: float | None = None) -> None:
    """Refuse gains from which nothing can be designed, though each is within its bounds.

    Args:
        hand: that they are for.
        gains: all of them.
        rate_hz: at which they are used; that of the hand, if it is not given [Hz].

    Raises:
        ConfigError: no controller or no filter follows from them.
    """
    from handctl.controller.model import HandModel

    HandModel.of(hand, gains, rate_hz or fastest(bus_loads(hand)))


def find_task(name: Path, hand: Hand) -> tuple[Task, bytes]:
    """A task file, from the path or from those that come with handctl, checked against the hand.

    Raises:
        ConfigError: there is none, or something in it is wrong.
    """
    path = name if name.exists() else TASKS / name.with_suffix(".toml").name
    if not path.exists():
        packaged = ", ".join(sorted(path.name for path in TASKS.glob("*.toml")))
        raise ConfigError("no such task", str(name), f"a task file, or one of {packaged}")
    task = load_task(path)
    check_suits(task, hand, str(name))
    return task, path.read_bytes()


def find_trajectory(path: Path, hand: Hand) -> Task:
    """A trajectory file as a task, checked against the hand.

    Raises:
        ConfigError: there is none, or something in it is wrong.
    """
    task = load_trajectory(path)
    check_suits(task, hand, str(path))
    return task


def check_suits(task: Task, hand: Hand, where: str) -> None:
    """Refuse a task that does not suit the hand.

    Raises:
        ConfigError: a digit, a number of angles, a tension or an angle that the hand does not have; a move too fast; a
            tip force of an underactuated digit.
    """
    check_task(task, hand.digit_names, min(tendon.tension_max_N for tendon in hand.tendon), where, shapes(hand))
    check_tip_force(task, hand, where)
    check_reach(task, hand, where)
    check_pace(task, hand.digit_names, where)


def calibration_path(args: argparse.Namespace, hand: Hand) -> Path:
    """Where the hand's calibration is or shall be.

    Raises:
        ConfigError: none could be written there: that is known before a hand moves for it.
    """
    path: Path = args.calibration or Path(f"{hand.name}.calibration.toml")
    check_output(path, "--calibration", Path(args.hand), getattr(args, "gains", None), getattr(args, "task", None))
    return path


def find_calibration(args: argparse.Namespace, hand: Hand) -> tuple[Path, Calibration | None, str]:
    """The hand's calibration file, if it is good enough to arm with.

    Returns:
        where it is or shall be, the calibration or None, and why it is None.

    Raises:
        ConfigError: the file named on the command line is there and cannot be used, or none could be written there.
    """
    path = calibration_path(args, hand)
    if not path.exists():
        return path, None, f"there is no {path}"
    try:
        calibration = load_calibration(path, hand)
    except ConfigError as error:
        if args.calibration:
            raise
        return path, None, str(error)
    made = datetime.datetime.fromisoformat(calibration.made).timestamp()
    if time.time() - made > FRESH_S:
        return path, None, f"{path} is older than a day"
    return path, calibration, ""


def commission_log(log: Path) -> Path:
    """Return a new name beside a run's log for the commissioning before it.

    A run that a fault ended in its commissioning leaves that log and no other; the same command then goes on beside it.
    """
    number, path = 1, log.with_suffix(".commission.mcap")
    while os.path.lexists(path):
        number, path = number + 1, log.with_suffix(f".commission-{number + 1}.mcap")
    return path


def default_log(hand: Hand, kind: str = "") -> Path:
    """logs/DATE-HAND.mcap, made unique."""
    folder = Path("logs")
    folder.mkdir(exist_ok=True)
    stem = time.strftime("%Y%m%d-%H%M%S") + f"-{hand.name}" + (f"-{kind}" if kind else "")
    number, path = 1, folder / f"{stem}.mcap"
    while path.exists():
        number, path = number + 1, folder / f"{stem}-{number}.mcap"
    return path
