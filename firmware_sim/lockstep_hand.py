"""The simulator in lockstep. The clock of the simulator advances only when the caller executes a tick."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from firmware_sim.bus.frame import Frame
from firmware_sim.bus.frame_records import frames_to_records, records_to_frames
from firmware_sim.bus.lockstep_buses import LockstepBuses
from firmware_sim.description.hand_description import load_hand
from firmware_sim.plant.plant_perturbation import perturbed_hand
from firmware_sim.scene.scene import load_scene
from firmware_sim.serial_numbers import with_serial_numbers
from firmware_sim.simulated_world import make_world
from firmware_sim.truth_file import PERIOD_NS, TruthWriter
from firmware_sim.wire.wire_options import parse_wire_options


class LockstepHand:
    """A simulated hand that runs in lockstep with a caller.

    If two runs have equal seeds and equal frames of the host, their answers and truth files are
    equal in every byte.

    Attributes:
        world: plant and nodes of the hand, for tests that need the true state.
        wired: simulated wires of the buses, or None if frames take no time.
    """

    def __init__(  # noqa: PLR0913 - a keyword for each thing that a test varies
        self,
        hand_path: str,
        *,
        scene: str | None = None,
        seed: int = 0,
        truth_path: str | None = None,
        truth_period_ns: int = PERIOD_NS,
        perturb: dict[str, float] | None = None,
        period_ns: int = 2_000_000,
        homed: bool = False,
        wire: Sequence[str] | None = None,
        serials: Sequence[str] = (),
    ) -> None:
        """Build the simulated hand.

        Args:
            hand_path: path of a hand file, or name of a packaged hand.
            scene: scene as a packaged name, as a file, or in a short form such as ``cylinder:35``.
                None for a hand without an object.
            seed: seed of all random numbers: noise, initial slack and encoder offsets.
            truth_path: path of the truth file. If None, no truth file is written.
            truth_period_ns: time from one row of the truth file to the next row [ns].
            perturb: factors that multiply plant parameters, see ``plant_perturbation.PERTURBATION_KEYS``.
            period_ns: length of a tick [ns].
            homed: True to start with taut tendons and with the encoders at ``zero_rad`` of the hand
                file.
            wire: KEY=VALUE words of a simulated wire, see ``wire.wire_options``. If None, the
                answers to all frames arrive within the tick of the frames.
            serials: serial numbers of the drives, see ``serial_numbers.with_serial_numbers``.

        Raises:
            SimulatorError: the hand, the scene, a factor, or a word of the argument ``wire`` is
                wrong.
        """
        hand = with_serial_numbers(perturbed_hand(load_hand(hand_path), perturb or {}), serials)
        self.world = make_world(hand, load_scene(scene), seed, homed)
        assert self.world.compiled_nodes
        self._compiled_nodes = self.world.compiled_nodes
        self._period_ns = period_ns
        self.wired = None if wire is None else LockstepBuses(self.world, parse_wire_options(wire))
        self._compiled_nodes.sends_unsolicited = self.wired is None
        self._truth: TruthWriter | None = None
        if truth_path is not None:
            header = {**self.world.header("virtual"), "perturb": perturb or {}}
            self._truth = TruthWriter(
                Path(truth_path), self.world.plant, header, period_ns=truth_period_ns
            )
            self.world.record(self._truth)

    def exchange(self, t_ns: int, frames: Any) -> Any:
        """Answer the host's frames of one tick, and advance the simulation to the next tick.

        Args:
            t_ns: start of the tick [ns], which must not be earlier than the previous tick.
            frames: frames of the host as a contiguous array of ``frame_records.FRAME_DTYPE``. The
                function ignores the times in the frames of the host.

        Returns:
            The answers as an array of ``frame_records.FRAME_DTYPE``. The answers have the times of
            frames that are sent one after the other on each bus within the tick. With simulated
            wires, the result contains the frames that have arrived by the end of the tick, and
            error frames of the host's CAN controllers.
        """
        end_ns = t_ns + self._period_ns
        if self.wired:
            return frames_to_records(self.wired.step(t_ns, records_to_frames(frames), end_ns))
        world = self.world
        world.advance_exactly(t_ns)
        answer_frames, is_in_order = self._compiled_nodes.answer(frames, t_ns, self._period_ns - 1)
        world.advance(end_ns, self._compiled_nodes.wake_ns)
        unsolicited_records = world.take_unsolicited_records()
        return (
            answer_frames
            if is_in_order and not len(unsolicited_records)
            else self._compiled_nodes.merge_frames(answer_frames, unsolicited_records)
        )

    def step(self, t_ns: int, frames: Iterable[tuple[Any, ...]]) -> list[Frame]:
        """Answer the host's frames of one tick, and return the answers as objects.

        The docstring of ``exchange`` tells which times the answers have.

        Args:
            t_ns: start of the tick [ns], not before the previous tick.
            frames: frames of the host as tuples of can_id, data, flags, bus and t_ns.
        """
        return records_to_frames(self.exchange(t_ns, frames_to_records(frames)))

    def inject(self, fault_line: str) -> None:
        """Start a fault, now or at a later time.

        Args:
            fault_line: fault as text, see ``faults.fault_text``.

        Raises:
            SimulatorError: the hand of this simulation cannot have the fault.
        """
        self.world.faults.inject(fault_line)

    def fault_states(self) -> list[dict[str, object]]:
        """List each fault that was injected so far, with its state and the number of its effects."""
        return self.world.faults.fault_states()

    def truth(self) -> dict[str, list[float]]:
        """Return the present true tensions [N] and the commanded motor torques [N m], for tests."""
        motors = self.world.plant.motors.values()
        return {
            "tension": self.world.plant.tensions(),
            "torque": [motor.servo.torque for motor in motors],
        }

    def close(self) -> None:
        """Complete and close the truth file, if one exists."""
        if self._truth is not None:
            counts = {
                "foreign_frames": self.world.foreign_frame_count,
                "malformed_frames": self.world.malformed_frame_count,
            }
            self._truth.close(counts | ({"wire_load": self._wire_loads()} if self.wired else {}))
            self._truth = None

    def _wire_loads(self) -> list[float]:
        """Return the load of each simulated CAN wire.

        The load is the fraction of the simulated time in which frames occupied the wire.
        """
        assert self.wired
        return [round(wire.load(0, max(1, self.world.t_ns)), 4) for wire in self.wired.wires]
