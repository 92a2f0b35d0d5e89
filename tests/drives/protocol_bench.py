"""Make hand files with any drive protocol, and connect the drives to the simulated firmware tick by tick."""

import json
import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from firmware_sim.lockstep_hand import LockstepHand
from handctl.controller.run_setup import make_drives
from handctl.drives.contract import Drive, DrivePhase, DriveState, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.drives.sensors.sensor_node import SensorNode
from handctl.hand.file.section_models import Motor
from handctl.hand.hand_loading import load_hand

PERIOD_NS = 2_000_000
FIRST_NODE_ID = 0x10
OPTIONS_TEXT_BY_PROTOCOL = {
    name: "[motor.options]\n"
    + "".join(f"{key} = {json.dumps(value)}\n" for key, value in traits.options.items())
    if traits.options
    else ""
    for name, traits in PROTOCOL_TRAITS.items()
}
"""For each drive protocol, the necessary options of a motor, as text of a section of the hand file."""


def hand_file(hand_folder: Path, protocols: Sequence[str], added_text: str = "") -> Path:
    """Write a copy of a packaged hand file with other drive protocols.

    Return the path of the new hand file.

    Args:
        hand_folder: folder of the new file.
        protocols: drive protocol of each motor, in the order of the motors. If there are more
            motors than protocols, the remaining motors get the last protocol.
        added_text: text with further options of every motor.
    """
    text_before_motors, *motor_texts = load_hand("jamia").to_toml().split("[[motor]]")
    for i, text in enumerate(motor_texts):
        protocol = protocols[min(i, len(protocols) - 1)]
        text = text.replace('"mit"', f'"{protocol}"')
        text = re.sub(r"node_id = \d+", f"node_id = {FIRST_NODE_ID + i}", text)
        options = OPTIONS_TEXT_BY_PROTOCOL[protocol] + added_text
        if PROTOCOL_TRAITS[protocol].can_fd and "data_bitrate" not in text_before_motors:
            text_before_motors = text_before_motors.replace(
                "bitrate = 1000000\n", "bitrate = 1000000\ndata_bitrate = 5000000\n"
            )
        motor_texts[i] = text.rstrip() + "\n" + options + "\n" if options else text
    path = hand_folder / "hand.toml"
    path.write_text("[[motor]]".join([text_before_motors, *motor_texts]))
    return path


SECOND_BUS_SECTION = '[[bus]]\nname = "second"\nbitrate = 1000000\n\n[sensor_node]'


def move_to_second_bus(hand_path: Path, motor_indices: Sequence[int] = (2, 3)) -> Path:
    """Move some motors of a hand file to a second bus, and return the path of the file.

    The second bus has no load cells.
    """
    head, *sections = (
        hand_path.read_text().replace("[sensor_node]", SECOND_BUS_SECTION).split("[[motor]]")
    )
    for i in motor_indices:
        sections[i] = sections[i].replace('bus = "main"', 'bus = "second"')
    hand_path.write_text("[[motor]]".join([head, *sections]))
    return hand_path


class ProtocolBench:
    """Bench that connects handctl's code for the drives and the sensor node of a hand to the simulated firmware."""

    def __init__(
        self, hand_path: Path, wire_words: Sequence[str] | None = None, period_ns: int = PERIOD_NS
    ) -> None:
        """Start the simulator and create the drives for the hand that a file describes."""
        self.hand = load_hand(str(hand_path))
        self.period_ns = period_ns
        self.simulated_hand = LockstepHand(
            str(hand_path), seed=3, period_ns=period_ns, wire=wire_words
        )
        buses = self.hand.bus_names
        self.drives: list[Drive] = list(make_drives(self.hand))
        self.states: list[DriveState] = [drive.initial_state() for drive in self.drives]
        node = self.hand.sensor_node
        self.sensor_node = SensorNode.from_description(
            node, buses.index(node.bus), self.hand.tendon_names, self.hand.joints
        )
        self.received_frames: list[Frame] = []
        self.sent_frames: list[Frame] = []
        self.k = 0

    def tick(
        self, target: DriveTarget, torque: float = 0.0, extra_frames: Sequence[Frame] = ()
    ) -> None:
        """Receive the frames of the last tick, advance all drives by a tick, and let the simulator reply."""
        for frame in self.received_frames:
            self.states = [
                d.receive(s, frame) for d, s in zip(self.drives, self.states, strict=True)
            ]
        host_frames = [self.sensor_node.sync(self.k), *extra_frames]
        for i, drive in enumerate(self.drives):
            self.states[i], frames = drive.advance(
                self.states[i], self.k * self.period_ns, target, torque
            )
            host_frames += frames
        self.sent_frames = host_frames
        self.received_frames = [
            Frame(*reply)
            for reply in self.simulated_hand.step(self.k * self.period_ns, list(host_frames))
        ]
        self.k += 1

    def run_until_phase(self, target: DriveTarget, phase: DrivePhase, max_ticks: int = 400) -> None:
        """Run ticks until all drives are in a given drive phase.

        If the drives do not all reach the given drive phase, the test fails.
        """
        for _ in range(max_ticks):
            self.tick(target)
            if all(state.phase == phase for state in self.states):
                return
        pytest.fail(
            f"{[(state.phase.name, state.error_text) for state in self.states]}, expected {phase.name}"
        )

    def clear_errors(self) -> None:
        """Clear the errors of all drives, as the controller does when the operator requests a clear."""
        frames: list[Frame] = []
        for i, drive in enumerate(self.drives):
            self.states[i], clear_frames = drive.clear(self.states[i])
            frames += clear_frames
        self.tick(DriveTarget.POLL, extra_frames=frames)


def motor_on_bench(
    protocol: str,
    node_id: int,
    torque_max_N_m: float,
    drive_options: dict[str, object],
    **section_changes: object,
) -> Motor:
    """Return the hand-file section of a motor that is alone on a bus.

    The position, velocity and torque ranges in the section are those of a Damiao motor.
    """
    return Motor.model_validate(
        {
            "name": "m", "protocol": protocol, "bus": "bench", "node_id": node_id, "spool_radius_m": 0.005,
            "inertia_kg_m2": 1e-4, "viscous_N_m_s_per_rad": 1e-3, "coulomb_N_m": 0.0,
            "torque_constant_N_m_per_A": 0.26, "torque_max_N_m": torque_max_N_m, "torque_peak_N_m": torque_max_N_m,
            "position_range_rad": 12.5, "velocity_range_rad_s": 30.0, "direction": 1, "zero_rad": 0.0,
            "watchdog_ms": 50, "options": drive_options, **section_changes,
        }
    )  # fmt: skip


def servo_torques(bench: ProtocolBench) -> list[float]:
    """Return the torque commands that the simulated drives execute."""
    return [motor.servo.torque for motor in bench.simulated_hand.world.plant.motors.values()]
