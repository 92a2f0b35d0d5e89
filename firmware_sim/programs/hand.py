"""The program ``python -m firmware_sim``: a simulated hand on its buses, in real time."""

import argparse
import gc
import json
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

from firmware_sim.bus.bus_ports import BusPort, assign_buses, is_local_bus, open_port
from firmware_sim.bus.timed_port import timed_port_factory
from firmware_sim.bus_server import BusServer
from firmware_sim.clock.realtime_priority import RealTimePriority
from firmware_sim.clock.shared_clock import SharedClock
from firmware_sim.command_line import CommandParser, check_time_scale, stop_on_signal
from firmware_sim.description.hand_description import SimulatorError, load_hand
from firmware_sim.faults.fault_injection_socket import FaultInjectionSocket
from firmware_sim.plant.plant_perturbation import PERTURBATION_KEYS, perturbed_hand
from firmware_sim.printing import printable_text
from firmware_sim.scene.scene import load_scene, packaged_scenes
from firmware_sim.serial_numbers import with_serial_numbers
from firmware_sim.simulated_world import SimulatedWorld, make_world
from firmware_sim.socket_paths import clock_path, faults_path, truth_path
from firmware_sim.truth_file import MAX_UNNAMED_FILE_BYTES, TruthWriter
from firmware_sim.wire.wire_options import WIRE_OPTION_KEYS as WIRE_KEYS

_PERTURBATION_KEYS_HELP = "\n".join(f"  {key:16}{text}" for key, text in PERTURBATION_KEYS.items())
_WIRE_KEYS_HELP = "\n".join(f"  {key:16}{text}" for key, text in WIRE_KEYS.items())
_LOG_SUFFIX = ".mcap"
"""Suffix of log files, which the simulator never overwrites."""
_HELP_EPILOG = f"""
factors for --perturb:
{_PERTURBATION_KEYS_HELP}

values for --wire, and what holds without them:
{_WIRE_KEYS_HELP}

examples:
  python -m firmware_sim --hand jamia --bus local:demo --scene cylinder
  python -m firmware_sim --hand jamia --bus socketcan:vcan0 --perturb stiffness=1.2 friction=1.5
  python -m firmware_sim drive mit --ids 1,2 --bus local:lab     drives with free shafts; see "drive --help"
  python -m firmware_sim --hand jamia --bus local:demo --wire queue=10 stuffing=actual
  python -m firmware_sim bus demo        a bus without a hand; a simulator joins it with --bus join:demo
"""


def _argument_parser() -> argparse.ArgumentParser:
    parser = CommandParser(
        prog="python -m firmware_sim",
        description="Simulate a hand on a CAN bus: drives, load cells, tendons, fingers and an object.",
        epilog=_HELP_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--hand", required=True, metavar="NAME|FILE", help="packaged hand or a .toml file")
    add("--bus", required=True, action="append", metavar="[BUS=]SPEC",
        help="local:NAME, join:NAME or socketcan:INTERFACE; repeat for a hand with several buses")  # fmt: skip
    add(
        "--scene",
        metavar="NAME|FILE",
        help=f"{', '.join(packaged_scenes())}, NAME:MILLIMETRES or a .toml file (free hand)",
    )
    add("--seed", type=int, default=0, help="seed of noise, initial slack and encoder offsets (0)")
    add("--homed", action="store_true", help="start with taut tendons and encoders at zero")
    add("--time-scale", type=float, default=1.0, metavar="X", help="plant time per wall time (1)")
    add("--strict-clock", action="store_true",
        help="do not pause the clock of a controller on this machine if the machine is too slow")  # fmt: skip
    add(
        "--truth",
        type=Path,
        metavar="FILE",
        help="file for the true state of the plant (in the run directory, there at most 1 GiB)",
    )
    add("--json", action="store_true", help="print the line with the word ready as JSON")
    add("--dry-run", action="store_true", help="check all arguments and exit without opening a bus")
    wire = "simulate bit rate and queues of the CAN wire on a local bus (default: off)"
    add("--wire", nargs="*", metavar="KEY=VALUE", help=wire)
    add("--perturb", nargs="+", action="extend", default=[], metavar="KEY=FACTOR",
        help="multiply plant parameters by factors")  # fmt: skip
    text = "serial number of all drives, to which each adds its node number, or of one motor"
    add("--serial", action="append", default=[], metavar="[MOTOR=]NUMBER", help=text)
    return parser


def _perturbation_factors(words: list[str]) -> dict[str, float]:
    """Parse the words KEY=FACTOR after the option ``--perturb``."""
    factors: dict[str, float] = {}
    for word in words:
        key, _, value = word.partition("=")
        if key in factors:
            raise SimulatorError(
                f"--perturb: {key} is given twice; expected one factor for each key"
            )
        try:
            factors[key] = float(value)
        except ValueError:
            raise SimulatorError(
                f"--perturb {word}: expected KEY=FACTOR, as in stiffness=1.2"
            ) from None
    return factors


def run(words: list[str]) -> None:
    """Serve a simulated hand until the process receives SIGTERM or SIGINT.

    Raises:
        SimulatorError: the simulator cannot use the arguments.
    """
    args = _argument_parser().parse_args(words)
    check_time_scale(args.time_scale)
    if args.truth and args.truth.suffix == _LOG_SUFFIX and args.truth.exists():
        raise SimulatorError(f"--truth {args.truth}: is a log; expected another name")
    factors = _perturbation_factors(args.perturb)
    hand = perturbed_hand(load_hand(args.hand), factors)
    scene = load_scene(args.scene)
    hand = with_serial_numbers(hand, args.serial)
    specs = assign_buses(args.bus, hand.buses)
    clock = SharedClock(args.time_scale)
    world = make_world(hand, scene, args.seed, args.homed, clock.now_ns(), compiled=False)
    timed_port = timed_port_factory(args.wire, hand.bitrates, clock.now_ns)
    if args.dry_run:
        return
    ports: list[BusPort] = []
    try:
        for bus, spec in enumerate(specs):
            ports.append(open_port(spec, bus, timed_port))
        if not args.strict_clock and all(map(is_local_bus, specs)):
            clock.create_file(clock_path(specs[0]))
        path = args.truth or truth_path(specs[0])
        with closing(FaultInjectionSocket(faults_path(specs[0]), world.faults)) as faults:
            header = {
                **world.header("monotonic"),
                "perturb": factors,
                "time_scale": args.time_scale,
            }
            ready_message = {
                "hand": world.hand.name,
                "scene": world.plant.scene.name,
                "bus": " ".join(args.bus),
            }
            ready_message["truth"] = str(path)
            pairs = " ".join(
                f"{key}={printable_text(value)}" for key, value in ready_message.items()
            )
            ready_line = (
                json.dumps({"ready": ready_message})
                if args.json
                else f"firmware_sim: ready {pairs}"
            )
            _serve_hand(
                BusServer(world, ports, clock, faults, RealTimePriority()),
                world,
                path,
                header,
                ready_line,
                sys.maxsize if args.truth else MAX_UNNAMED_FILE_BYTES,
            )
    finally:
        clock.close()
        for port in ports:
            port.close()


def _serve_hand(
    server: BusServer, world: SimulatedWorld, path: Path, header: dict[str, Any], ready_line: str,
    max_truth_bytes: int,
) -> None:  # fmt: skip
    """Serve a simulated hand, and write the true values of the hand to a file."""
    try:
        truth = TruthWriter(path, world.plant, header, max_truth_bytes)
    except OSError as error:
        raise SimulatorError(f"truth file {path}: {error.strerror}") from error
    world.record(truth)

    def stop() -> None:
        server.running = False

    stop_on_signal(stop)
    gc.collect()
    gc.freeze()  # from this line on, garbage collection ignores the modules that have been loaded so far
    print(ready_line, flush=True)
    try:
        server.run()
    finally:
        summary = server.summary()
        truth.close(summary)
        counts = " ".join(f"{key}={value}" for key, value in summary.items())
        print(f"firmware_sim: ended {counts}", file=sys.stderr)
