"""``python -m firmware_sim drive``: drives on a bench, with free shafts and no hand, for anybody's client to try."""

import argparse
import sys
from dataclasses import replace

from firmware_sim.bus.frame import Frame
from firmware_sim.bus.ports import open_port
from firmware_sim.bus.wired import ALONE_BITRATES, maker
from firmware_sim.command import Parser, check_time_scale, until_signal
from firmware_sim.description import MotorSpec, SimulatorError
from firmware_sim.faults.broken import FAULTS, break_node
from firmware_sim.nodes import PROTOCOLS
from firmware_sim.nodes.kind import Node
from firmware_sim.plant.motor import Motor
from firmware_sim.printing import printable
from firmware_sim.programs.drive_types import MIT_TYPES, drive_spec
from firmware_sim.server import ScaledClock, Server

STEP_NS = 1_000_000
EXAMPLES = """
examples:
  python -m firmware_sim drive mit --ids 1,2,3,4 --bus socketcan:vcan0 --motor-type dm4310
  python -m firmware_sim drive odrive --ids 0,1 --bus local:lab
  python -m firmware_sim bus lab; ... drive mit --ids 1 --bus join:lab; ... drive cia402 --ids 32 --bus join:lab
"""


class Bench:
    """Drives on one bus; see ``server.Served``.

    Attributes:
        motors, nodes: in the order of the specs.
    """

    def __init__(self, specs: list[MotorSpec], origin_ns: int = 0, fault: str = "") -> None:
        """Args: the drives; the clock at the start [ns]; what is wrong with all of them, of ``broken.FAULTS``."""
        self.t_ns, self.slip_ns, self.foreign = origin_ns, 0, 0
        specs = [replace(spec, torque_gain=-1.0) if fault == "sign" else spec for spec in specs]
        self._part_ns = 0
        self.motors = [Motor(spec, STEP_NS * 1e-9) for spec in specs]
        pairs = zip(specs, self.motors, strict=True)
        self.nodes: list[Node] = [
            break_node(PROTOCOLS[spec.protocol].node(spec, motor, 0.0), spec.protocol, fault) for spec, motor in pairs
        ]
        self._spoken: list[Frame] = []

    @property
    def malformed(self) -> int:
        """Frames that a node could not read."""
        return sum(node.malformed for node in self.nodes)

    def receive(self, frame: Frame) -> list[Frame]:
        """Hand a frame to every node and return their answers."""
        answers = [node.receive(frame, self.t_ns) for node in self.nodes]
        self.foreign += all(answer is None for answer in answers)
        return [reply._replace(bus=frame.bus, t_ns=self.t_ns) for answer in answers for reply in answer or ()]

    def advance(self, t_ns: int) -> None:
        """Let time pass until t_ns, in whole steps."""
        while self.t_ns - self._part_ns + STEP_NS <= t_ns:
            self._turn(STEP_NS - self._part_ns)
            self._part_ns = 0
            for node in self.nodes:
                if self.t_ns >= node.wake_ns:
                    self._spoken += [frame._replace(t_ns=self.t_ns) for frame in node.wake(self.t_ns) or ()]

    def reach(self, t_ns: int) -> None:
        """Let time pass until exactly t_ns; the next call completes the step that this divides."""
        self.advance(t_ns)
        rest_ns = t_ns - self.t_ns
        if rest_ns > 0:
            self._turn(rest_ns)
            self._part_ns += rest_ns

    def _turn(self, duration_ns: int) -> None:
        """Turn every shaft for a whole step or a part of one [ns]."""
        self.t_ns += duration_ns
        for motor in self.motors:
            if motor.step != duration_ns * 1e-9:
                motor.pace(duration_ns * 1e-9)
            motor.advance(0.0)

    def take_spoken(self) -> list[Frame]:
        """Return what nodes have sent of their own accord since the last call."""
        spoken, self._spoken = self._spoken, []
        return spoken


def _parser() -> Parser:
    parser = Parser(
        prog="python -m firmware_sim drive",
        description="Simulated drives with free shafts, as they come out of the box.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("protocol", choices=sorted(PROTOCOLS), help="what the drives speak")
    add("--ids", required=True, metavar="N,N,..", help="node numbers, decimal or 0x..")
    add("--bus", required=True, metavar="SPEC", help="local:NAME, join:NAME or socketcan:INTERFACE")
    add("--fd", action="store_true", help="MIT motors set to CAN FD (1/5 Mbit/s); they answer as they are asked")
    add("--motor-type", metavar="TYPE", help=f"of MIT motors: {', '.join(MIT_TYPES)} (dm4310); an ak is cubemars")
    add("--firmware", choices=["0.5", "0.6"], help="of ODrives (0.6)")
    add("--inertia", type=float, metavar="KG_M2", help="of each shaft (the motor's own, an assumption)")
    add("--wire", nargs="*", metavar="KEY=VALUE", help="frames take their time (they take none)")
    faults = "; ".join(f"{key}: {text}" for key, text in FAULTS.items())
    add("--broken", choices=sorted(FAULTS), default="", help=f"drives that are broken on purpose. {faults}")
    add("--time-scale", type=float, default=1.0, metavar="X", help="drive time per wall time (1)")
    return parser


def _specs(args: argparse.Namespace) -> list[MotorSpec]:
    """Return the drives that were asked for.

    Raises:
        SimulatorError: an argument that makes no drive.
    """
    if args.protocol != "odrive" and args.firmware:
        raise SimulatorError("--firmware: only drive odrive has it")
    if args.fd and (args.protocol != "mit" or MIT_TYPES.get(args.motor_type) == "cubemars"):
        raise SimulatorError("--fd: only drive mit with Damiao motors has it")
    if args.motor_type and args.protocol not in MIT_TYPES.values():
        raise SimulatorError("--motor-type: only drive mit has it")
    if args.inertia is not None and not 0.0 < args.inertia <= 100.0:
        raise SimulatorError(f"--inertia {args.inertia}: expected more than 0, at most 100")
    check_time_scale(args.time_scale)
    try:
        numbers = [int(word, 0) for word in args.ids.split(",")]
    except ValueError:
        raise SimulatorError(f"--ids {args.ids}: expected numbers with commas, as in 1,2,0x10") from None
    if len(set(numbers)) < len(numbers):
        raise SimulatorError(f"--ids {args.ids}: every number once")
    kind, firmware = args.motor_type or "", args.firmware or "0.6"
    return [drive_spec(args.protocol, n, kind, args.fd, args.inertia, firmware) for n in numbers]


def run(words: list[str]) -> None:
    """Serve drives until SIGTERM or SIGINT.

    Raises:
        SimulatorError: arguments that cannot be served.
    """
    args = _parser().parse_args(words)
    specs = _specs(args)
    clock = ScaledClock(args.time_scale)
    port = open_port(args.bus, 0, maker(args.wire, [ALONE_BITRATES], clock.now_ns))
    try:
        server = Server(Bench(specs, clock.now_ns(), args.broken), [port], clock)

        def stop() -> None:
            server.running = False

        until_signal(stop)
        print(f"firmware_sim: ready drive={args.protocol} ids={args.ids} bus={printable(args.bus)}", flush=True)
        server.run()
        counts = " ".join(f"{key}={value}" for key, value in server.summary().items())
        print(f"firmware_sim: ended {counts}", file=sys.stderr)
    finally:
        port.close()
