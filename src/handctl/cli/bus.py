"""``handctl bus plan``: how full each bus of a hand is in the worst case, and how to split it if it does not fit.

``handctl bus doctor`` is in ``bus_doctor``.
"""

import argparse
from typing import Any

from handctl.cli.exit_codes import Exit
from handctl.cli.options import bus_option, json_option, print_json
from handctl.cli.plan import tick_times_s
from handctl.controller.setup import make_drives, make_sensors
from handctl.drives.load import MOST, bus_time_s, highest_rate
from handctl.errors import ConfigError
from handctl.hand.description import Hand, load_hand

EXAMPLE = "handctl bus plan --hand jamia11 --rate 200"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    told = "plan: worst-case load of each bus of a hand, stuff bits included; doctor: look at buses, and what to type"
    parser.add_argument("what", choices=["plan", "doctor"], help=told)
    about = "packaged hand or file (plan: jamia; doctor: none)"
    parser.add_argument("--hand", metavar="NAME|FILE", help=about)
    bus_option(parser, required=False)
    json_option(parser)
    parser.add_argument("--bitrate", type=int, default=1_000_000, metavar="BIT/S", help="without a hand (1000000)")
    parser.add_argument("--data-bitrate", type=int, metavar="BIT/S", help="without a hand: of CAN FD's data phase")
    parser.add_argument("--rate", type=float, metavar="HZ", help="control rate (default: the highest that fits)")


def run(args: argparse.Namespace) -> int:
    """Compute and print; 1 if the hand does not fit at the rate, or something is to be mended."""
    if args.what == "doctor":
        from handctl.cli.bus_doctor import doctor

        return doctor(args, load_hand(args.hand) if args.hand else None)
    hand = load_hand(args.hand or "jamia")
    times = tick_times_s(hand)
    rate = highest_rate(times) if args.rate is None else args.rate
    if not 0 < rate <= 10_000:
        raise ConfigError(f"{rate:g}", "--rate", "more than 0, at most 10000 Hz")
    result = plan(hand, times, rate)
    if args.json:
        print_json(result)
    else:
        _print(result)
    return Exit.DONE if result["fits"] else Exit.FAILED


def plan(hand: Hand, times: tuple[float, ...], rate: float) -> dict[str, Any]:
    """Load of each bus, and what would fit.

    Args:
        hand: with its buses.
        times: of one tick's frames on each bus [s].
        rate: control rate [Hz].
    """
    buses = [
        {
            "name": bus.name,
            "motors": sum(motor.bus == bus.name for motor in hand.motor),
            "tick_us": busy * 1e6,
            "load": busy * rate,
            "max_hz": MOST / busy if busy else None,
        }
        for bus, busy in zip(hand.bus, times, strict=True)
    ]
    fits = all(busy * rate <= MOST for busy in times)
    return {"hand": hand.name, "rate_hz": rate, "most": MOST, "fits": fits, "buses": buses,
            "split": [] if fits else split(hand, rate)}  # fmt: skip


def split(hand: Hand, rate: float) -> list[list[str]]:
    """Motors on as few buses as hold them at the rate, all with the bit rates of the hand's first bus.

    The load cells stay on the first bus and take their share of it.

    Returns:
        names of the motors of each bus; empty if a single motor is too much.
    """
    first, sensors = hand.bus[0], make_sensors(hand)
    room = MOST / rate
    cells = [(size, False, number) for size, number in sensors.exchange]
    left, buses = room - bus_time_s(cells, first.bitrate, first.data_bitrate), list[list[str]]([[]])
    for drive in make_drives(hand):
        busy = bus_time_s([(size, fd, 1.0) for size, fd in drive.exchange], first.bitrate, first.data_bitrate)
        if busy > room:
            return []
        if busy > left:
            left = room
            buses.append([])
        buses[-1].append(drive.name)
        left -= busy
    return buses


def _print(result: dict[str, Any]) -> None:
    print(f"{result['hand']} at {result['rate_hz']:g} Hz, at most {result['most']:.0%} of a bus:")
    for bus in result["buses"]:
        most = f"{bus['max_hz']:.0f} Hz at most" if bus["max_hz"] else "nothing on it"
        print(
            f"  {bus['name']:<12}{bus['motors']:>3} motors {bus['tick_us']:>7.0f} us a tick {bus['load']:>7.1%}  {most}"
        )
    if result["fits"]:
        return
    if not result["split"]:
        print("does not fit, and no split would: one motor alone is too much at this rate")
        return
    print(f"does not fit; {len(result['split'])} buses of this kind would hold it:")
    for i, names in enumerate(result["split"]):
        print(f"  bus {i + 1}: {', '.join(names)}" + (" and the sensor node" if i == 0 else ""))
