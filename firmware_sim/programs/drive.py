"""Program ``python -m firmware_sim drive``, which simulates drives with free shafts on a test bench."""

import argparse
import sys
from dataclasses import replace

from firmware_sim.bus.bus_ports import open_port
from firmware_sim.bus.frame import Frame
from firmware_sim.bus.timed_port import DEFAULT_BITRATES, timed_port_factory
from firmware_sim.bus_server import BusServer
from firmware_sim.clock.shared_clock import SharedClock
from firmware_sim.command_line import CommandParser, check_time_scale, stop_on_signal
from firmware_sim.description.hand_description import MotorSpec, SimulatorError
from firmware_sim.faults.active_faults import ActiveFaults
from firmware_sim.faults.bench_world import BenchWorld
from firmware_sim.faults.fault_injection_socket import FaultInjectionSocket, is_socket_served
from firmware_sim.faults.faulty_drive import (
    DRIVE_FAULTS,
    check_fault_has_effect,
    motor_specs_with_fault,
    with_fault,
)
from firmware_sim.nodes import PROTOCOL_SPECS
from firmware_sim.nodes.cia402.object_dictionary import EDS_PATH
from firmware_sim.nodes.mit.node import (
    CLEAR_COMMAND_ANSWERS,
    EACH_CLEAR_ANSWERED,
    FED_BY_COMMANDS,
    WATCHDOG_BEHAVIOURS,
)
from firmware_sim.nodes.odrive import bench as odrive_bench
from firmware_sim.nodes.odrive.motion_modes import MOTION_ENDPOINTS
from firmware_sim.nodes.protocol_spec import SimulatedNode
from firmware_sim.plant.motor import Motor
from firmware_sim.printing import printable_text
from firmware_sim.programs.drive_types import (
    MIT_PROTOCOL_BY_MOTOR_TYPE,
    ROBSTRIDE_MOTOR_TYPES,
    drive_spec,
)
from firmware_sim.socket_paths import faults_path

STEP_NS = 1_000_000
"""Time step of the shafts [ns]."""
HELP_EXAMPLES = """
examples:
  python -m firmware_sim drive mit --ids 1,2,3,4 --bus socketcan:vcan0 --motor-type dm4310
  python -m firmware_sim drive odrive --ids 0,1 --bus local:lab
  handctl fault inject "drop node=1 p=0.1" --bus local:lab      into running drives
  python -m firmware_sim drive odrive --ids 0 --uncalibrated --bus socketcan:vcan0
  python -m firmware_sim drive moteus --ids 1,2 --bus socketcan:vcan0
  python -m firmware_sim drive robstride --ids 1,2 --motor-type rs00 --bus local:lab
  python -m firmware_sim bus lab; ... drive mit --ids 1 --bus join:lab; ... drive cia402 --ids 32 --bus join:lab
"""
"""Examples of the help text."""
ENDPOINT_HELP = "\n".join(
    f"  {number}  {key.removeprefix('endpoint_')}"
    for key, number in [
        *odrive_bench.ENDPOINT_NUMBERS.items(),
        *((key, number) for number, (key, _) in MOTION_ENDPOINTS.items()),
    ]
)
"""Table of the ODrive endpoints for the help text."""
HELP_EPILOG = f"""{HELP_EXAMPLES}
endpoints of an ODrive with firmware 0.6, for SDO (real numbers are in its flat_endpoints.json):
{ENDPOINT_HELP}

objects of a CiA 402 drive, for CANopen tools: {EDS_PATH}
"""
"""Text that follows after the options in the help text."""


class SimulatedDriveBench:
    """Simulated drives on one bus, without a hand.

    The docstrings of the methods are in the class ``bus_server.BusNodes``.

    Attributes:
        motors: rotors of the drives, in the order of the drive descriptions.
        nodes: simulated nodes of the drives, in the order of the drive descriptions.
        slip_ns: total plant time that was skipped because the plant was behind the clock [ns].
        step_progress_ns: completed part of the present time step [ns].
        faults: faults injected while the bench runs.
    """

    def __init__(self, specs: list[MotorSpec], origin_ns: int = 0, fault: str = "") -> None:
        """Build the drives of the test bench.

        Args:
            specs: descriptions of the drives.
            origin_ns: time of the clock at the start [ns].
            fault: deliberate fault of all drives, as a key of ``faulty_drive.DRIVE_FAULTS``, or an
                empty text for no fault.
        """
        self.t_ns = origin_ns
        self.slip_ns = 0
        self.foreign_frame_count = 0
        specs = motor_specs_with_fault(specs, fault)
        self.step_progress_ns = 0
        self.motors = [Motor(spec, STEP_NS * 1e-9) for spec in specs]
        specs_and_motors = zip(specs, self.motors, strict=True)
        self.nodes: list[SimulatedNode] = [
            with_fault(PROTOCOL_SPECS[spec.protocol].node(spec, motor, 0.0), spec.protocol, fault)
            for spec, motor in specs_and_motors
        ]
        self._unsolicited: list[Frame] = []
        self.faults = ActiveFaults(BenchWorld(self, specs))

    @property
    def malformed_frame_count(self) -> int:
        """Return the number of frames that the nodes could not decode."""
        return sum(node.malformed_frame_count for node in self.nodes)

    def receive(self, frame: Frame) -> list[Frame]:
        """Pass a frame to every drive, and return all answers."""
        if self.faults.wire_faults_of:
            answer_frames = [self.faults.exchange(node, frame, self.t_ns) for node in self.nodes]
        else:
            answer_frames = [node.receive(frame, self.t_ns) for node in self.nodes]
        self.foreign_frame_count += all(answer is None for answer in answer_frames)
        return [
            reply._replace(bus=frame.bus, t_ns=self.t_ns)
            for answer in answer_frames
            for reply in answer or ()
        ]

    def advance(self, t_ns: int) -> None:
        """Advance the drives by whole time steps, but not beyond the time ``t_ns``."""
        while self.t_ns - self.step_progress_ns + STEP_NS <= t_ns:
            self._advance_shafts(STEP_NS - self.step_progress_ns)
            self.step_progress_ns = 0
            for node in self.nodes:
                if self.t_ns >= node.wake_ns:
                    frames = [
                        frame._replace(t_ns=self.t_ns) for frame in node.wake(self.t_ns) or ()
                    ]
                    self.queue_frames(self.faults.frames_after_node_faults(node, frames, self.t_ns))
            if self.faults.on:
                self.queue_frames(self.faults.advance(self.t_ns))

    def queue_frames(self, frames: list[Frame]) -> None:
        """Store frames that the simulator will send without a request from a host."""
        self._unsolicited += frames

    def advance_exactly(self, t_ns: int) -> None:
        """Advance the drives exactly to the time ``t_ns``.

        If the time ``t_ns`` is within a time step, the method simulates only the part of the step
        before ``t_ns``. The next call of ``advance`` or ``advance_exactly`` first simulates the
        remaining part of this time step.
        """
        self.advance(t_ns)
        remaining_ns = t_ns - self.t_ns
        if remaining_ns > 0:
            self._advance_shafts(remaining_ns)
            self.step_progress_ns += remaining_ns

    def _advance_shafts(self, duration_ns: int) -> None:
        """Advance every shaft by a duration [ns], which is a time step or a fraction of a time step."""
        self.t_ns += duration_ns
        for motor in self.motors:
            if motor.step != duration_ns * 1e-9:
                motor.set_step_duration(duration_ns * 1e-9)
            motor.advance(0.0)

    def take_unsolicited_frames(self) -> list[Frame]:
        """Return the unsolicited frames of the drives since the last call."""
        unsolicited_frames = self._unsolicited
        self._unsolicited = []
        return unsolicited_frames


def _argument_parser() -> CommandParser:
    parser = CommandParser(
        prog="python -m firmware_sim drive",
        description="Simulate drives with free shafts, as delivered.",
        epilog=HELP_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("protocol", choices=sorted(PROTOCOL_SPECS), help="protocol of the drives")
    add("--ids", required=True, metavar="N,N,..", help="node numbers, decimal or 0x..")
    add("--bus", required=True, metavar="SPEC", help="local:NAME, join:NAME or socketcan:INTERFACE")
    add("--fd", action="store_true",
        help="MIT motors set to CAN FD (1/5 Mbit/s); they answer in the format of the request")  # fmt: skip
    add("--motor-type", metavar="TYPE",
        help=f"type of MIT motors: {', '.join(MIT_PROTOCOL_BY_MOTOR_TYPE)} (dm4310); an ak is cubemars; "
        f"of RobStride motors: {', '.join(ROBSTRIDE_MOTOR_TYPES)} (rs05)")  # fmt: skip
    add("--firmware", choices=["0.5", "0.6"], help="firmware of ODrives (0.6)")
    add("--uncalibrated", action="store_true",
        help="ODrives that refuse closed loop until they were calibrated")  # fmt: skip
    texts = "; ".join(f"{key}: {text}" for key, text in WATCHDOG_BEHAVIOURS.items())
    add("--watchdog", choices=list(WATCHDOG_BEHAVIOURS), default=FED_BY_COMMANDS,
        help=f"watchdog of MIT motors. {texts} ({FED_BY_COMMANDS})")  # fmt: skip
    texts = "; ".join(f"{key}: {text}" for key, text in CLEAR_COMMAND_ANSWERS.items())
    add("--clear-answers", choices=list(CLEAR_COMMAND_ANSWERS), default=EACH_CLEAR_ANSWERED,
        help=f"answers of MIT motors to the clear command. {texts} ({EACH_CLEAR_ANSWERED})")  # fmt: skip
    add(
        "--inertia",
        type=float,
        metavar="KG_M2",
        help="inertia of each shaft [kg m2] (assumed for the motor type)",
    )
    add("--wire", nargs="*", metavar="KEY=VALUE", help="simulate the wire with its timing (off)")
    faults = "; ".join(f"{key}: {text}" for key, text in DRIVE_FAULTS.items())
    add(
        "--broken",
        choices=sorted(DRIVE_FAULTS),
        default="",
        help=f"deliberate fault of all drives. {faults}",
    )
    add("--time-scale", type=float, default=1.0, metavar="X", help="drive time per wall time (1)")
    return parser


def _behaviour_options(args: argparse.Namespace) -> dict[str, object]:
    """Return the command-line options that change how the drives behave.

    Raises:
        SimulatorError: an option belongs to another protocol.
    """
    behaviour_by_option = {
        "--firmware": ("odrive", "", bool(args.firmware)),
        "--uncalibrated": ("odrive", True, args.uncalibrated),
        "--watchdog": ("mit", args.watchdog, args.watchdog != FED_BY_COMMANDS),
        "--clear-answers": ("mit", args.clear_answers, args.clear_answers != EACH_CLEAR_ANSWERED),
    }
    wrong_options = [
        name
        for name, (protocol, _, on) in behaviour_by_option.items()
        if on and args.protocol != protocol
    ]
    if wrong_options:
        raise SimulatorError(
            f"{wrong_options[0]}: only for drive {behaviour_by_option[wrong_options[0]][0]}"
        )
    value_by_option = {
        name: value
        for name, (_, value, on) in behaviour_by_option.items()
        if on and name != "--firmware"
    }
    return {
        name.removeprefix("--").replace("-", "_"): value for name, value in value_by_option.items()
    }


def _drive_specs(args: argparse.Namespace) -> list[MotorSpec]:
    """Build the descriptions of the requested drives.

    Raises:
        SimulatorError: an argument is not valid for a drive.
    """
    options = _behaviour_options(args)
    if args.fd and (
        args.protocol != "mit" or MIT_PROTOCOL_BY_MOTOR_TYPE.get(args.motor_type) == "cubemars"
    ):
        raise SimulatorError("--fd: only for drive mit with Damiao motors")
    if args.motor_type and args.protocol not in (*MIT_PROTOCOL_BY_MOTOR_TYPE.values(), "robstride"):
        raise SimulatorError("--motor-type: only for drive mit and drive robstride")
    if args.inertia is not None and not 0.0 < args.inertia <= 100.0:
        raise SimulatorError(f"--inertia {args.inertia}: expected more than 0, at most 100")
    check_time_scale(args.time_scale)
    check_fault_has_effect(args.protocol, args.broken)
    try:
        numbers = [int(word, 0) for word in args.ids.split(",")]
    except ValueError:
        raise SimulatorError(
            f"--ids {args.ids}: expected numbers with commas, as in 1,2,0x10"
        ) from None
    if len(set(numbers)) < len(numbers):
        raise SimulatorError(f"--ids {args.ids}: expected each number once")
    kind = args.motor_type or ""
    firmware_version = args.firmware or "0.6"
    specs = [
        drive_spec(args.protocol, n, kind, args.fd, args.inertia, firmware_version) for n in numbers
    ]
    return [replace(spec, options={**spec.options, **options}) for spec in specs]


def run(words: list[str]) -> None:
    """Serve simulated drives until the process receives SIGTERM or SIGINT.

    Raises:
        SimulatorError: the simulator cannot use the arguments.
    """
    args = _argument_parser().parse_args(words)
    specs = _drive_specs(args)
    clock = SharedClock(args.time_scale)
    bench = SimulatedDriveBench(specs, clock.now_ns(), args.broken)
    port = open_port(args.bus, 0, timed_port_factory(args.wire, [DEFAULT_BITRATES], clock.now_ns))
    faults = open_fault_socket(args.bus, bench)
    try:
        server = BusServer(bench, [port], clock, faults)

        def stop() -> None:
            server.running = False

        stop_on_signal(stop)
        print(
            f"firmware_sim: ready drive={args.protocol} ids={args.ids} bus={printable_text(args.bus)}",
            flush=True,
        )
        server.run()
        counts = " ".join(f"{key}={value}" for key, value in server.summary().items())
        print(f"firmware_sim: ended {counts}", file=sys.stderr)
    finally:
        port.close()
        if faults:
            faults.close()


def open_fault_socket(bus: str, bench: SimulatedDriveBench) -> FaultInjectionSocket | None:
    """Open the socket for ``handctl fault inject``.

    Return None if another simulator on this bus already has a fault socket.

    Args:
        bus: specification of the bus.
        bench: drives on the bus.
    """
    path = faults_path(bus)
    if is_socket_served(path):
        print(
            f"firmware_sim: another simulator on {printable_text(bus)} takes the faults",
            file=sys.stderr,
        )
        return None
    return FaultInjectionSocket(path, bench.faults)
