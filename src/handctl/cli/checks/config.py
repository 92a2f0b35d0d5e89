"""``handctl config``: show a hand with everything that follows from it, check files, or export it for other tools."""

import argparse
from pathlib import Path
from typing import Any

from handctl.cli.console.options import print_json, say
from handctl.cli.console.plan import find_calibration, layered_gains
from handctl.controller.bus_load import bus_loads
from handctl.controller.setup import caveats, make_drives, make_sensors
from handctl.core.gains.bounds import flat
from handctl.core.identified import UNITS
from handctl.drives.dbc import of_bus
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.load import hand_path, load_hand, packaged_hands
from handctl.hand.strength import strength_warnings
from handctl.output import named_after, write_whole
from handctl.session.gains import LayeredGains
from handctl.session.plan import check_design, check_load_cells, fastest
from handctl.session.tasks import TASKS, find_task


def run(args: argparse.Namespace) -> int:
    """Show, check, list or export."""
    if args.what == "list":
        return _list(args.json)
    hand = load_hand(args.hand)
    if args.what == "export":
        return _export(args, hand)
    return _show(args, hand)


def _show(args: argparse.Namespace, hand: Hand) -> int:
    """Show or check a hand with its files."""
    layers = layered_gains(args, hand)
    if args.task:
        find_task(args.task, hand)
    if args.calibration and not args.calibration.exists():
        raise ConfigError("no such file", str(args.calibration), "a calibration to check")
    calibration = _calibration(args, hand)
    loads = bus_loads(hand)
    rate = fastest(loads)
    load = {one.name: one.at(rate) for one in loads}
    if args.what == "check":
        check_load_cells(hand, str(args.hand))
        check_design(hand, layers.gains, rate)
    source = str(hand_path(args.hand).name)
    if args.json:
        print_json(
            {
                "file": source,
                "identity": hand.identity,
                "rate_hz": rate,
                "bus_load": load,
                "caveats": list(caveats(make_drives(hand))),
                "warnings": list(strength_warnings(hand)),
                "hand": hand.content,
                "gains": layers.gains.model_dump(by_alias=True),
                "gains_file": str(layers.file) if layers.file else "packaged",
                "gains_origins": layers.origins,
                "calibration": calibration,
            }
        )
        return 0
    if args.what == "show":
        print(f"# from {source}, identity {hand.identity[:16]}")
        print(hand.to_toml(), end="")
        print("\n".join(_gains_with_sources(layers)))
        print("\n".join(f"# {line}" for line in _calibration_lines(calibration)))
    for text in caveats(make_drives(hand)):
        print(f"# caution: {text}")
    for text in strength_warnings(hand):
        print(f"# warning: {text}")
    bus_loads_text = ", ".join(f"bus {name} {100 * fraction:.0f} %" for name, fraction in load.items())
    print(f"# default rate {rate:g} Hz: {bus_loads_text}; gains: {layers.file or 'packaged'}; all files are good")
    return 0


def _gains_with_sources(layers: LayeredGains) -> list[str]:
    """Every gain with where it came from, as comments: they are a file of their own."""
    values = flat(layers.gains)
    return ["", "# gains", *(f"# {key} = {value}  ({layers.origins[key]})" for key, value in values.items())]


def _calibration(args: argparse.Namespace, hand: Hand) -> dict[str, Any]:
    """Which calibration a run would use, or why none, and what of it takes the place of the hand file."""
    path, calibration, reason = find_calibration(args, hand)
    if calibration is None:
        return {"file": str(path), "problem": reason, "made": None, "identified": {}}
    identified = {
        tendon: {
            name: {"value": value, "half_width": width, "unit": UNITS[name], "made": parameters.made}
            for name, value, width in zip(parameters.names, parameters.values, parameters.half_widths, strict=True)
        }
        for tendon, parameters in calibration.identified.items()
    }
    return {"file": str(path), "problem": "", "made": calibration.made, "identified": identified}


def _calibration_lines(calibration: dict[str, Any]) -> list[str]:
    """The same for a person."""
    if calibration["problem"]:
        return [f"calibration: {calibration['problem']}"]
    return [f"calibration: {calibration['file']}, made {calibration['made']}"] + [
        f"{tendon}.{name} = {one['value']:.5g} +- {one['half_width']:.2g} {one['unit']}"
        f"  ({calibration['file']}, identified {one['made']})"
        for tendon, values in calibration["identified"].items()
        for name, one in values.items()
    ]


def _export(args: argparse.Namespace, hand: Hand) -> int:
    """Write a DBC of each bus; of several, a file with the name of the bus in it."""
    if not args.dbc:
        raise ConfigError("no format", "export", "--dbc")
    output = args.output or Path(f"{hand.name}.dbc")
    drives = make_drives(hand)
    sensors = make_sensors(hand)
    buses = hand.bus_names
    written = []
    for bus, name in enumerate(buses):
        path = output if len(buses) == 1 else named_after(output, f".{name}{output.suffix}")
        write_whole(path, of_bus(bus, drives, sensors, hand.tendon_names, hand.joints), new=True)
        written.append({"bus": name, "output": str(path)})
    if args.json:
        print_json({"hand": hand.name, "files": written})
    else:
        for one in written:
            say(f"{one['output']}: bus {one['bus']}")
    return 0


def _list(as_json: bool) -> int:
    """Packaged hands and tasks."""
    tasks = sorted(path.name for path in TASKS.glob("*.toml"))
    if as_json:
        print_json({"hands": list(packaged_hands()), "tasks": tasks})
    else:
        print("hands: " + ", ".join(packaged_hands()))
        print("tasks: " + ", ".join(tasks))
    return 0
