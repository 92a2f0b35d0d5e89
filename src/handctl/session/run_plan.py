"""Plan of a run.

A plan contains all settings of a run. The settings are checked before a bus is opened.
"""

import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from handctl.controller.bus_load import BusLoad, bus_loads
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import TickIn, TickOut
from handctl.drives.frame_time import MAX_BUS_LOAD, highest_rate
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.file.error_text import lines_by_text
from handctl.hand.file.section_models import Motor
from handctl.hand.hand_loading import hand_path, load_hand
from handctl.hand.readiness_checks import reasons_not_ready
from handctl.log.attached_meshes import mesh_attachments
from handctl.runtime.buses.bus_opening import check_bus_spec, real_buses
from handctl.runtime.simulator_requests import simulated_time_scale
from handctl.session.buses import refuse_default_hand
from handctl.session.gains import DefaultGainsFunction, gains_with_sources
from handctl.session.notices import NoticeCallback, ProgressFunction, ignore_notice, ignore_progress

MIN_TICKS_PER_WATCHDOG_TIME = 2
"""Smallest allowed number of ticks within the watchdog time of a drive.

With two ticks within the watchdog time, a single lost frame does not disable a drive.
"""


class OperatorDisplay(Protocol):
    """Display that shows the operator the state of a running hand."""

    def show_tick(self, tick_input: TickIn, tick_output: TickOut) -> None:
        """Show the state of the hand after a tick."""
        ...

    def close(self) -> None:
        """Close the display at the end of the run."""
        ...


@dataclass(frozen=True)
class RunPlan:
    """Plan of a run: all settings of the run, after the settings have been checked.

    Attributes:
        hand: description of the hand.
        gains: gains of the controller.
        rate_hz: control rate [Hz].
        bus_loads: load of each bus in the worst case, as a fraction of the capacity of the bus.
        buses: specification of each bus, or an empty mapping in lockstep.
        attachments: files to store in the log.
        time_scale: seconds of the run per second of wall time.
        clear_faults: True to clear the latched errors of the drives, as the operator has requested.
        start_display: function that starts the display of a run, or None for a run without a
            display.
        show_notice: function that shows a notice to the operator.
        show_progress: function that shows the progress of a step before the run.
    """

    hand: Hand
    gains: Gains
    rate_hz: float
    bus_loads: tuple[float, ...]
    buses: tuple[str, ...] = ()
    attachments: dict[str, bytes] = field(default_factory=dict)
    time_scale: float = 1.0
    clear_faults: bool = False
    start_display: "Callable[[RunPlan], OperatorDisplay] | None" = None
    show_notice: NoticeCallback = ignore_notice
    show_progress: ProgressFunction = ignore_progress

    @property
    def period_ns(self) -> int:
        """Return the control period [ns]."""
        return round(1e9 / self.rate_hz)

    @property
    def is_simulated(self) -> bool:
        """Return True if the run uses buses, but no bus to which real motors may be connected."""
        return bool(self.buses) and not real_buses(self.buses)


@dataclass(frozen=True)
class RunOptions:
    """Options that the operator has chosen for a run, before these options are checked.

    Attributes:
        hand: name of a packaged hand, or path of a hand file.
        is_hand_named: True if the operator named the hand.
        bus_arguments: words after ``--bus``: ``SPEC`` for a hand with one bus, or ``NAME=SPEC`` for
            each bus. None in lockstep.
        gains_file: path of the gains file, or None for the packaged gains of the hand.
        gain_arguments: words KEY=VALUE that set single gains. The values in these words override
            the values of every file.
        rate_hz: control rate [Hz]. If ``rate_hz`` is None, the run uses the highest of the usual
            rates that the buses allow.
        time_scale: seconds of the run per second of wall time. If ``time_scale`` is None, the run
            uses the time scale of the simulator that is connected to the bus.
        log_path: log file to write, or None if the command chooses the file later.
        clear_faults: True to clear the latched errors of the drives before the run.
        default_gains: function that returns the gains of a hand without a gains file, or None for
            the packaged gains.
    """

    hand: str | Path
    is_hand_named: bool = False
    bus_arguments: Sequence[str] | None = None
    gains_file: Path | None = None
    gain_arguments: Sequence[str] = ()
    rate_hz: float | None = None
    time_scale: float | None = None
    log_path: Path | None = None
    clear_faults: bool = False
    default_gains: DefaultGainsFunction | None = None


def make_plan(
    options: RunOptions,
    display: "Callable[[RunPlan], OperatorDisplay] | None" = None,
    show_notice: NoticeCallback = ignore_notice,
) -> RunPlan:
    """Check the hand, gains, buses and control rate, and return the plan of the run.

    Args:
        options: options that the operator has chosen.
        display: function that starts the display of a run, or None for a run without a display.
        show_notice: function that shows a notice to the operator.

    Raises:
        ConfigError: a setting of the operator is wrong. The error message has a single line.
    """
    hand = load_hand(options.hand)
    check_hand_ready(hand, str(options.hand))
    sourced_gains = gains_with_sources(
        hand, options.gains_file, options.gain_arguments, show_notice, options.default_gains
    )
    buses = () if options.bus_arguments is None else bus_specs(hand, options.bus_arguments)
    if not options.is_hand_named:
        refuse_default_hand(buses, "--hand")
    load_of_bus = bus_loads(hand)
    rate = control_rate(options.rate_hz, hand, load_of_bus)
    loads_at_rate = tuple(bus_load.load_at_rate(rate) for bus_load in load_of_bus)
    time_scale = chosen_time_scale(options.time_scale, buses)
    _check_log(options.log_path)
    attachments = {"gains.toml": sourced_gains.file.read_bytes()} if sourced_gains.file else {}
    meshes, omitted_meshes = mesh_attachments(hand, hand_path(options.hand).parent)
    for line in omitted_meshes:
        show_notice(f"handctl: caution: {line}")
    attachments |= meshes
    return RunPlan(
        hand,
        sourced_gains.gains,
        rate,
        loads_at_rate,
        buses,
        attachments,
        time_scale,
        options.clear_faults,
        display,
        show_notice,
    )


def chosen_time_scale(requested_scale: float | None, buses: Sequence[str]) -> float:
    """Return the time scale of a run.

    If the operator has chosen no time scale, the simulator on the bus determines the time scale.
    Without a simulator, the time scale is 1.

    Args:
        requested_scale: ratio of simulated time to wall time that the operator has chosen, or None
            if the operator has chosen no ratio.
        buses: specification of each bus, empty in lockstep.

    Raises:
        ConfigError: the chosen time scale is out of range, is not 1 although a bus is real, or
            differs from the time scale of the simulator.
    """
    if requested_scale is not None and not 0.001 <= requested_scale <= 100:
        raise ConfigError(f"{requested_scale:g}", "--time-scale", "0.001 to 100")
    if hardware_buses := real_buses(buses):
        if requested_scale not in (None, 1.0):
            expected = "1, or a simulated bus: local:NAME, socketcan:vcan0"
            raise ConfigError(
                f"{requested_scale:g}, and {hardware_buses[0]} may have real motors",
                "--time-scale",
                expected,
            )
        return 1.0
    simulator_time_scale = (
        simulated_time_scale(buses[0]) if buses else None
    )  # only the first bus has the simulator's socket for requests
    if requested_scale is not None and simulator_time_scale not in (None, requested_scale):
        raise ConfigError(
            f"{requested_scale:g}",
            "--time-scale",
            f"{simulator_time_scale:g}, as the simulator on {buses[0]} has",
        )
    return next(
        (
            condition
            for condition in (requested_scale, simulator_time_scale)
            if condition is not None
        ),
        1.0,
    )


def check_hand_ready(hand: Hand, location: str) -> None:
    """Raise an error if a hand must not run although its file is valid, see ``reasons_not_ready``.

    Args:
        hand: description of the hand to run.
        location: name or file of the hand, for the error message.

    Raises:
        ConfigError: the hand must not run. The message contains the first reason.
    """
    for mistake in reasons_not_ready(hand):
        raise mistake.error(location)


def control_rate(requested_hz: float | None, hand: Hand, load_of_bus: Sequence[BusLoad]) -> float:
    """Return the requested control rate [Hz].

    If no rate is requested, return the highest of the usual rates that the buses allow.

    Raises:
        ConfigError: at this control rate, a single lost tick would trigger the watchdog of a drive,
            or a bus would be overloaded.
    """
    highest_rate_hz = highest_control_rate(load_of_bus)
    rate = highest_rate_hz if requested_hz is None else requested_hz
    impatient_motor = min(hand.motor, key=lambda motor: motor.watchdog_ms)
    min_rate_hz = MIN_TICKS_PER_WATCHDOG_TIME * 1e3 / impatient_motor.watchdog_ms
    if requested_hz is None and rate < min_rate_hz:
        raise _too_slow_buses_error(impatient_motor, hand, load_of_bus)
    if not min_rate_hz <= rate < math.inf:
        raise ConfigError(
            f"{rate:g}", "--rate", f"at least {min_rate_hz:g}, for the drives' watchdogs"
        )
    for name, load in zip(hand.bus_names, load_of_bus, strict=True):
        if load.load_at_rate(rate) > MAX_BUS_LOAD:
            problem_text = (
                f"bus {name} would be {100 * load.load_at_rate(rate):.0f} % full at {rate:g} Hz"
            )
            raise ConfigError(problem_text, "--rate", f"at most {highest_rate_hz:g}")
    return rate


def _too_slow_buses_error(motor: Motor, hand: Hand, load_of_bus: Sequence[BusLoad]) -> ConfigError:
    """Return the error for a hand whose slowest bus is too slow for the watchdog of a motor."""
    bus, load = min(
        zip(hand.bus, load_of_bus, strict=True),
        key=lambda bus_and_load: bus_and_load[1].highest_rate_hz(MAX_BUS_LOAD),
    )
    rate = highest_control_rate(load_of_bus)
    min_watchdog_ms = MIN_TICKS_PER_WATCHDOG_TIME * 1e3 / rate if rate > 0.0 else math.inf
    return ConfigError(
        f"{motor.watchdog_ms} ms, and bus {bus.name} with {bus.bitrate} bit/s and {load.motors} motors "
        f"allows a control rate of only {rate:g} Hz",
        f"motor[{motor.name}].watchdog_ms",
        f"at least {min_watchdog_ms:g} ms, or a faster bus",
    )


def _check_log(log: Path | None) -> None:
    """Raise an error if the log file of a run exists, has a wrong suffix, or is in a missing folder."""
    if log is None:
        return
    if log.suffix != ".mcap":
        raise ConfigError(f"{log} has another ending", "--log", "a new file ending in .mcap")
    if not log.parent.is_dir():
        raise ConfigError(
            f"the folder {log.parent} does not exist", "--log", "a file in a folder that exists"
        )
    if os.path.lexists(log):
        raise ConfigError(f"{log} exists already", "--log", "a new file ending in .mcap")


def highest_control_rate(load_of_bus: Sequence[BusLoad]) -> float:
    """Return the highest of the usual control rates at which no bus is overloaded [Hz]."""
    return highest_rate(
        (load.frame_time_per_tick_s for load in load_of_bus),
        (load.periodic_load_fraction for load in load_of_bus),
    )


def default_control_rate(hand: Hand) -> float:
    """Return the default control rate of a hand [Hz].

    The default is the highest of the usual rates that the buses of the hand allow.
    """
    return highest_control_rate(bus_loads(hand))


def protocol_hint_lines(hand: Hand) -> tuple[str, ...]:
    """Return one line for each drive protocol that has a hint for the operator.

    Each line contains the names of the motors that use the protocol.
    """
    hints = ((motor.name, PROTOCOL_TRAITS[motor.protocol].hint) for motor in hand.motor)
    return lines_by_text((name, hint) for name, hint in hints if hint)


def check_gain_margins(hand: Hand, gains: Gains, rate_hz: float | None = None) -> None:
    """Raise an error if no valid controller or filter can be designed with the gains.

    The design of a controller can be impossible although every gain is within its bounds.

    Args:
        hand: description of the hand.
        gains: all gains of the run.
        rate_hz: control rate [Hz]. The default is the highest usual rate that the buses of the hand
            allow.

    Raises:
        ConfigError: no valid controller or filter can be designed with the gains.
    """
    from handctl.core.hand_model import HandModel

    HandModel.from_hand(hand, gains, rate_hz or default_control_rate(hand))


def bus_specs(hand: Hand, bus_arguments: Sequence[str]) -> tuple[str, ...]:
    """Return the specification of each bus of a hand.

    The bus specifications come from the words after ``--bus``.

    Raises:
        ConfigError: a bus is missing, given twice, or not part of the hand, or a specification is
            invalid.
    """
    specs = _specs_by_name(hand.bus_names, bus_arguments)
    for spec in specs:
        check_bus_spec(spec)
    return specs


def _specs_by_name(names: tuple[str, ...], bus_arguments: Sequence[str]) -> tuple[str, ...]:
    """Return the specifications that the arguments give for the named buses, in the order of the names."""
    if (
        len(names) == 1
        and len(bus_arguments) == 1
        and "=" not in bus_arguments[0].partition(":")[0]
    ):
        return (bus_arguments[0],)
    specs: dict[str, str] = {}
    for text in bus_arguments:
        name, _, spec = text.partition("=")
        if name not in names or not spec or name in specs:
            raise ConfigError(repr(text), "--bus", " ".join(f"--bus {name}=SPEC" for name in names))
        specs[name] = spec
    for name in names:
        if name not in specs:
            raise ConfigError("missing", f"--bus {name}=SPEC", f"all of {', '.join(names)}")
    return tuple(specs[name] for name in names)


def commissioning_log_path(log: Path) -> Path:
    """Return an unused path next to the log of a run, for the log of the commissioning before the run.

    If a fault ends the commissioning, there is a log of the commissioning, but no log of the run.
    When the operator repeats the command, the next commissioning gets a log with another name.
    """
    number = 1
    path = log.with_suffix(".commission.mcap")
    while os.path.lexists(path):
        number += 1
        path = log.with_suffix(f".commission-{number}.mcap")
    return path


def default_log_path(hand: Hand, name_suffix: str = "") -> Path:
    """Return an unused path of the form logs/DATE-HAND.mcap, and create the folder of this path."""
    folder = Path("logs")
    folder.mkdir(exist_ok=True)
    stem = (
        time.strftime("%Y%m%d-%H%M%S")
        + f"-{hand.name}"
        + (f"-{name_suffix}" if name_suffix else "")
    )
    number = 1
    path = folder / f"{stem}.mcap"
    while path.exists():
        path = folder / f"{stem}-{number}.mcap"
        number += 1
    return path
