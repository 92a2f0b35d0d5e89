"""``handctl bus plan``: compute the worst-case load of each bus of a hand.

If a bus is overloaded, the command proposes a distribution of the motors over more buses.
"""

import argparse
import math
from typing import Any

from handctl.cli.console.options import print_json
from handctl.cli.console.verbosity import is_verbose
from handctl.controller.bus_load import BusLoad, BusLoadRow, bus_loads, split_motors_over_buses
from handctl.drives.frame_time import MAX_BUS_LOAD
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from handctl.report.bus_load_table import BUS_LOAD_RATES_HZ, BUS_LOAD_ROWS
from handctl.session.exit_codes import ExitCode
from handctl.session.run_plan import bus_specs, highest_control_rate


def run(args: argparse.Namespace) -> int:
    """Compute and print the load of each bus of a hand.

    Return 1 if a bus is overloaded, or if a CAN interface has a wrong bit rate.
    """
    if args.table:
        _print_table() if not args.json else print_json(
            {"rows": [row.as_json() for row in BUS_LOAD_ROWS]}
        )
        return ExitCode.DONE
    hand = load_hand("jamia" if args.hand is None else args.hand)
    loads = bus_loads(hand)
    rate = highest_control_rate(loads) if args.rate is None else args.rate
    if not 1 <= rate <= 10_000:
        raise ConfigError(f"{rate:g}", "--rate", "1 to 10000 Hz")
    wrong_bit_rates = bit_rate_errors(hand, bus_specs(hand, args.bus)) if args.bus else []
    result = bus_plan_report(hand, loads, rate) | {"wrong_bit_rates": wrong_bit_rates}
    if args.json:
        print_json(result)
    else:
        _print_loads(result, is_verbose())
    return ExitCode.DONE if result["fits"] and not wrong_bit_rates else ExitCode.FAILED


def bus_plan_report(hand: Hand, loads: tuple[BusLoad, ...], rate_hz: float) -> dict[str, Any]:
    """Return the load of each bus for the report.

    If a bus is overloaded, the report also contains a distribution of the motors over more buses.

    Args:
        hand: description of the hand.
        loads: worst-case load of each bus, in the order of the hand file.
        rate_hz: control rate [Hz].
    """
    is_within_load = all(load.load_at_rate(rate_hz) <= MAX_BUS_LOAD for load in loads)
    buses = [_bus_fields(load, rate_hz) for load in loads]
    return {"hand": hand.name, "rate_hz": rate_hz, "most": MAX_BUS_LOAD, "fits": is_within_load, "buses": buses,
            "split": [] if is_within_load else split_motors_over_buses(hand, rate_hz)}  # fmt: skip


def bit_rate_errors(hand: Hand, specs: tuple[str, ...]) -> list[str]:
    """Return one line for each CAN interface with a bit rate that differs from the hand file.

    Each line contains the command that corrects the bit rate.
    """
    from handctl.runtime.buses.interface_setup import wrong_bit_rate_text

    lines = [
        wrong_bit_rate_text(spec.removeprefix("socketcan:"), bus.bitrate, bus.data_bitrate)
        for spec, bus in zip(specs, hand.bus, strict=True)
        if spec.startswith("socketcan:")
    ]
    return [line for line in lines if line]


def _bus_fields(bus_load: BusLoad, rate_hz: float) -> dict[str, Any]:
    max_rate = bus_load.highest_rate_hz(MAX_BUS_LOAD)
    return {
        "name": bus_load.name,
        "motors": bus_load.motors,
        "tick_us": bus_load.frame_time_per_tick_s * 1e6,
        "by_time": bus_load.periodic_load_fraction,
        "load": bus_load.load_at_rate(rate_hz),
        "max_hz": max_rate if math.isfinite(max_rate) else None,
        "frames": [_row_fields(row) for row in bus_load.rows],
    }


def _row_fields(row: BusLoadRow) -> dict[str, Any]:
    return {"what": row.sender, "bytes": row.size, "fd": row.fd, "per_tick": row.frames_per_tick,
            "per_second": row.frames_per_second, "frame_us": row.frame_s * 1e6}  # fmt: skip


def _print_loads(bus_plan: dict[str, Any], with_details: bool) -> None:
    print(
        f"{bus_plan['hand']} at {bus_plan['rate_hz']:g} Hz, at most {bus_plan['most']:.0%} of a bus:"
    )
    for bus in bus_plan["buses"]:
        limit = "nothing on it" if bus["max_hz"] is None else f"{bus['max_hz']:.0f} Hz at most"
        time = f"{bus['tick_us']:>7.0f} us a tick + {bus['by_time']:4.1%}"
        print(f"  {bus['name']:<12}{bus['motors']:>3} motors {time} {bus['load']:>7.1%}  {limit}")
        for row in bus["frames"] if with_details else ():
            rate = (
                f"{row['per_tick']:g} a tick"
                if row["per_tick"]
                else f"{row['per_second']:.3g} a second"
            )
            kind = "FD" if row["fd"] else "classical"
            print(
                f"      {row['what']:<16}{kind:<10}{row['bytes']:>2} bytes {row['frame_us']:>6.1f} us  {rate}"
            )
    for line in bus_plan["wrong_bit_rates"]:
        print(line)
    if not bus_plan["fits"]:
        _print_bus_split(bus_plan["split"])


def _print_bus_split(buses: list[list[str]]) -> None:
    if not buses:
        print("does not fit, even with one motor per bus")
        return
    print(f"does not fit; {len(buses)} buses of this kind are enough:")
    for i, names in enumerate(buses):
        print(f"  bus {i + 1}: {', '.join(names)}" + (" and the sensor node" if i == 0 else ""))


def _print_table() -> None:
    rates = " / ".join(f"{rate:g}" for rate in BUS_LOAD_RATES_HZ)
    print(
        "worst case with stuff bits, frames of the tensions included, SYNC only where the protocol needs it"
    )
    print(
        f"{'protocol':<34}{'bus':<11}motors  us a tick   % at {rates} Hz   Hz at {MAX_BUS_LOAD:.0%}"
    )
    for row in BUS_LOAD_ROWS:
        loads = " / ".join(
            f"{100 * rate * row.frame_time_per_tick_s:.0f}" for rate in BUS_LOAD_RATES_HZ
        )
        kind = "FD 1/5" if row.fd else "classical"
        print(f"{row.protocol:<34}{kind:<11}{row.motors:>6}{row.frame_time_per_tick_s * 1e6:>11.0f}   {loads:<22}"
              f"{MAX_BUS_LOAD / row.frame_time_per_tick_s:>6.0f}")  # fmt: skip
