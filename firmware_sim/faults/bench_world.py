"""A test bench of drives into which a user can inject faults.

The bench is described as a hand without digits, in which each drive is a motor.
"""

from collections.abc import Sequence
from typing import Any, Protocol

from firmware_sim.bus.frame import Frame
from firmware_sim.description.hand_description import Hand, MotorSpec
from firmware_sim.faults.faulty_drive import FaultyDrive
from firmware_sim.nodes import PROTOCOL_SPECS
from firmware_sim.plant.motor import Motor

BENCH_BUS = "bench"
"""Name of the only bus of a bench."""


class BenchInterface(Protocol):
    """Interface of a test bench of drives, with the attributes and methods that injected faults use.

    Attributes:
        motors: rotors of the drives, in the order of the drive descriptions.
        nodes: simulated nodes of the drives, in the order of the drive descriptions.
        slip_ns: total plant time that was skipped because the plant was behind the clock [ns].
        step_progress_ns: completed part of the present plant step [ns].
    """

    motors: list[Motor]
    nodes: list[Any]
    slip_ns: int
    step_progress_ns: int

    @property
    def t_ns(self) -> int:
        """Return the present time on the clock of the drives [ns]."""
        ...

    def queue_frames(self, frames: list[Frame]) -> None:
        """Queue frames on the bus of the bench, as if a device outside of the bench had sent them."""
        ...


class BenchPlant:
    """The rotors of a test bench, and the clock of the bench.

    Attributes:
        motors: mapping from the name of each drive to its rotor.
        tendons: empty sequence, because a bench has no tendons.
    """

    tendons: Sequence[Any] = ()

    def __init__(self, bench: BenchInterface, specs: Sequence[MotorSpec]) -> None:
        """Give each rotor of the bench the name of its drive."""
        self._bench = bench
        self.motors = {spec.name: motor for spec, motor in zip(specs, bench.motors, strict=True)}

    @property
    def t_ns(self) -> int:
        """Return the present time on the clock of the rotors [ns]."""
        return self._bench.t_ns

    @property
    def step_progress_ns(self) -> int:
        """Return the completed part of the present plant step [ns]."""
        return self._bench.step_progress_ns


class BenchWorld:
    """Adapter that gives a test bench of drives the interface of a simulated world.

    ``active_faults.ActiveFaults`` needs the interface of a simulated world.

    Attributes:
        hand: description of a hand whose motors are the drives of the bench.
        plant: rotors of the drives.
        nodes: list with one entry, the list of the nodes on the only bus of the bench.
        sensor_node: None, because a bench has no sensor node.
    """

    sensor_node = None

    def __init__(self, bench: BenchInterface, specs: Sequence[MotorSpec]) -> None:
        """Build the description of a hand that has the drives of the bench as its motors."""
        self._bench = bench
        motors = list(specs)
        self.hand = Hand("bench", (0.0, 0.0, 0.0), [BENCH_BUS], [(0, 0)], [], [], motors, None)
        self.plant = BenchPlant(bench, specs)
        self.nodes = [bench.nodes]
        self._nodes = {spec.name: node for spec, node in zip(specs, bench.nodes, strict=True)}

    @property
    def t_ns(self) -> int:
        """Return the present time on the clock of the drives [ns]."""
        return self._bench.t_ns

    @property
    def slip_ns(self) -> int:
        """Return the total plant time that was skipped to keep up with the clock [ns]."""
        return self._bench.slip_ns

    def node_of(self, name: str) -> Any:
        """Return the simulated node of a drive.

        If the node is wrapped by a ``FaultyDrive``, return the node without the wrapper.
        """
        node = self._nodes[name]
        return node.node if isinstance(node, FaultyDrive) else node

    def motor_spec(self, name: str) -> MotorSpec:
        """Return the description of the drive with a given name."""
        return next(motor for motor in self.hand.motors if motor.name == name)

    def host_frame(self, name: str) -> Frame:
        """Return a frame that only the host of the named drive would send. The frame has no effect on the drive."""
        spec = self.motor_spec(name)
        can_id, data = PROTOCOL_SPECS[spec.protocol].host_frame(spec.node_id)
        return Frame(can_id, data, 0, 0, self.t_ns)

    def queue_frames(self, frames: list[Frame]) -> None:
        """Queue frames on the bus of the bench, as if a device outside of the bench had sent them."""
        self._bench.queue_frames(frames)

    def refresh_identifiers(self) -> None:
        """Do nothing: a bench needs no identifiers, because it passes every frame to every node."""
