"""Simulate one drive on a bus in virtual time, together with a host that commands the drive."""

from dataclasses import replace

from firmware_sim.bus.frame import Frame as SimFrame
from firmware_sim.nodes.odrive.bench import ENDPOINT_NUMBERS
from firmware_sim.programs.drive import SimulatedDriveBench
from firmware_sim.programs.drive_types import drive_spec
from handctl.drives.frame import Frame
from handctl.drives.protocol_registry import make_drive
from handctl.runtime.diagnostics.drive_rig import PERIOD_NS, DriveRig
from tests.drives.protocol_bench import motor_on_bench

DRIVE_NODE_ID = 0x21
OPTIONS_BY_PROTOCOL = {
    "mit": {},
    "odrive": {**ENDPOINT_NUMBERS, "torque_feedback": True},
    "moteus": {},
    "robstride": {"motor_type": "rs05"},
    "robstride_mit": {"motor_type": "rs05", "host_id": 0},
    "cubemars": {"motor_type": "ak80-9"},
    "cia402": {"rated_torque_N_m": 1.0, "counts_per_turn": 65536, "sync": True},
}


class VirtualBench:
    """Bench with a simulated drive. The host uses the bench both as its bus and as its clock.

    When the host waits for a tick, the virtual time of the drive advances.
    """

    name = "bench"

    def __init__(
        self, protocol, drive_fault="", shaft_inertia=None, delay_ticks=0, **drive_options
    ):
        """Put a simulated drive on the bench.

        The drive can have a fault. The frames of the drive arrive ``delay_ticks`` ticks late.
        """
        spec = drive_spec(protocol, DRIVE_NODE_ID, inertia=shaft_inertia)
        self.bench = SimulatedDriveBench(
            [replace(spec, options=drive_options or spec.options)], fault=drive_fault
        )
        self.frames_on_bus, self.largest_torque, self.origin_ns = [], 0.0, 0
        self.delayed_frames = [
            [] for _ in range(delay_ticks)
        ]  # frames of the drive that have not arrived yet, one list for each tick

    def start(self):
        """Begin a run. The present virtual time becomes the time of tick 0."""
        self.origin_ns = self.bench.t_ns

    def wait(self, k):
        """Advance the virtual time to tick ``k``, and return how late the host is [ns].

        The host is late only if ``advance_time`` has already moved the virtual time beyond tick
        ``k``.
        """
        self.bench.advance(self.origin_ns + k * PERIOD_NS)
        self.largest_torque = max(self.largest_torque, abs(self.bench.motors[0].servo.torque))
        return max(0, self.now_ns() - k * PERIOD_NS)

    def now_ns(self):
        """Return the virtual time [ns]."""
        return self.bench.t_ns - self.origin_ns

    def send(self, frames):
        """Deliver frames of the host to the drive without a delay."""
        for frame in frames:
            self.frames_on_bus += self.bench.receive(SimFrame(*frame))
        return len(frames)

    def drain(self):
        """Return the frames that the drive sent ``delay_ticks`` ticks ago."""
        self.delayed_frames.append(self.frames_on_bus + self.bench.take_unsolicited_frames())
        self.frames_on_bus = []
        return [
            Frame(*frame)._replace(t_ns=frame.t_ns - self.origin_ns)
            for frame in self.delayed_frames.pop(0)
        ]

    def advance_time(self, duration_s):
        """Advance the time of the drive by ``duration_s`` seconds, without a host."""
        self.bench.advance(self.bench.t_ns + round(duration_s * 1e9))

    def take_events(self):
        """Return an empty list of bus events, because a bench has no bus events."""
        return []


def make_drive_rig(virtual_bench, protocol, torque_limit, drive_options=None):
    """Return a host that commands the drive of a bench with a torque of at most ``torque_limit`` [N m]."""
    motor = motor_on_bench(
        protocol,
        DRIVE_NODE_ID,
        torque_limit,
        OPTIONS_BY_PROTOCOL[protocol] if drive_options is None else drive_options,
    )
    return DriveRig(make_drive(motor, 0), virtual_bench, virtual_bench)
