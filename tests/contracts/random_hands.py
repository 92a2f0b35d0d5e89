"""Run the controller with random hands and generated frames, and compute a hash of each tick.

A random hand can have any number of tendons.
"""

import hashlib
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from handctl.campaign.run_stages import FIRST_NODE_NUMBER, hand_with_drives
from handctl.controller.controller_state import ControllerState
from handctl.controller.run_setup import make_controller
from handctl.controller.tick import Controller
from handctl.core import state_block as s
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import HandMode, TickIn
from handctl.drives import readback
from handctl.drives.cia402 import codec as cia402
from handctl.drives.contract import DrivePhase, DriveState
from handctl.drives.frame import Frame
from handctl.drives.mit import codec as mit
from handctl.drives.moteus import codec as moteus
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from handctl.drives.signals import CyclicMessage, SignalQuantity, SignalTable
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_content, hand_from_content
from handctl.programs.live_session import LiveProgram

RATE_HZ, TICKS_PER_HAND = 200.0, 40
"""Control rate [Hz] and number of ticks of each random hand."""
LAST_TICKS_WITH_FAULTS = 10
"""Number of ticks at the end of a run in which a fault is allowed to end the motion.

In all ticks before the last ``LAST_TICKS_WITH_FAULTS`` ticks, the hand is kept active in spite of
faults.
"""
LOST_FRACTION, DUPLICATE_FRACTION, CORRUPT_FRACTION, SKIPPED_FRACTION = 0.03, 0.02, 0.02, 0.03
"""Fractions of received frames that are lost, duplicate or corrupt, and fraction of ticks that are skipped."""
BUS_NAMES, MOTORS_PER_BUS = ("main", "second"), 12
CARRIED_DIGIT_FRACTION = 0.3
"""Fraction of digits that are mounted on another digit."""
RandomGenerator = np.random.Generator


def random_hand(tendons: int, rng: RandomGenerator) -> Hand:
    """Return a random hand with ``tendons`` tendons.

    A digit with n joints has one tendon, n tendons, or n + 1 tendons. Some digits of the random
    hand are mounted on other digits.
    """
    jamia11_content = hand_content("jamia11")
    finger, tendon, motor = (
        jamia11_content["digit"][0],
        jamia11_content["tendon"][0],
        jamia11_content["motor"][0],
    )
    digits, entries, joints = list[dict[str, Any]](), list[dict[str, Any]](), list[str]()
    while len(entries) < tendons:
        name, remaining_tendons, size = (
            f"d{len(digits)}",
            tendons - len(entries),
            int(rng.integers(1, 4)),
        )
        digit_joints = [f"{name}_j{j + 1}" for j in range(size)]
        pulley_radii = rng.uniform(2e-3, 5e-3, size)
        kinds = [
            arms
            for arms in _moment_arm_kinds(digit_joints, pulley_radii)
            if len(arms) <= remaining_tendons
        ]
        arms = kinds[int(rng.integers(len(kinds)))]
        digits.append(_random_digit(finger, name, size, len(arms) == 1 < size, rng))
        if len(digits) > 1 and rng.random() < CARRIED_DIGIT_FRACTION:
            # Tendons of a carried digit pass a joint of its carrier at a distance from the axis.
            carrier = digits[-2]["name"]
            digits[-1]["mount_on"] = carrier
            arms = [arm | {f"{carrier}_j1": float(rng.uniform(1e-3, 5e-3))} for arm in arms]
        joints += digit_joints
        for moment_arm in arms:
            random_tendon_constants = {
                key: tendon[key] * rng.uniform(0.8, 1.2)
                for key in ("stiffness_N_per_m", "friction_coefficient")
            }
            number = len(entries)
            entries.append(
                tendon
                | random_tendon_constants
                | {"name": f"t{number}", "motor": f"m{number}", "moment_arm_m": moment_arm}
            )
    motors = [
        motor
        | {
            "name": f"m{n}",
            "node_id": n % MOTORS_PER_BUS + 1,
            "bus": BUS_NAMES[n // MOTORS_PER_BUS],
        }
        for n in range(tendons)
    ]
    buses = [
        jamia11_content["bus"][0] | {"name": name}
        for name in BUS_NAMES[: -(-tendons // MOTORS_PER_BUS)]
    ]
    read = [joint for joint in joints if rng.random() < 0.6]
    node = jamia11_content["sensor_node"] | {
        "tendons": [entry["name"] for entry in entries],
        "joints": read,
    }
    content = jamia11_content | {
        "name": "random",
        "bus": buses,
        "digit": digits,
        "tendon": entries,
        "motor": motors,
        "sensor_node": node,
    }
    hand = hand_from_content(content, "random.toml")
    hand = hand_with_drives(hand, str(rng.choice(VERIFIABLE_PROTOCOLS)))
    servos = _motors_with_position_loop(hand, rng)
    loop: dict[str, object] = {"control": "position"}
    if hand.motor[0].protocol == "moteus":
        loop |= {"kp_N_m_per_rad": 1.0, "kd_N_m_s_per_rad": 0.02}
    motors = [
        motor_entry.model_copy(
            update={"node_id": FIRST_NODE_NUMBER + n % MOTORS_PER_BUS}
            | (loop if motor_entry.name in servos else {})
        )
        for n, motor_entry in enumerate(hand.motor)
    ]
    return hand.model_copy(update={"motor": tuple(motors)})


def _motors_with_position_loop(hand: Hand, rng: RandomGenerator) -> set[str]:
    """Select motors whose drives will close a position loop, and return the names of these motors.

    The function selects at random about half of the motors in digits without antagonistic tendons.
    """
    if hand.motor[0].protocol not in ("mit", "robstride", "moteus"):
        return set()
    candidate_motors = set[str]()
    for digit in hand.digit:
        tendons = hand.tendon[hand.digit_tendons[digit.name]]
        if len(tendons) <= (len(digit.joints) if digit.coupling is None else 1):
            candidate_motors |= {tendon.motor for tendon in tendons}
    return {name for name in sorted(candidate_motors) if rng.random() < 0.5}


def _moment_arm_kinds(
    joints: list[str], pulley_radii: np.ndarray
) -> Iterator[list[dict[str, float]]]:
    """Yield the moment arms of each kind of digit, as a list with one dictionary for each tendon.

    A dictionary contains the moment arm of the tendon at each joint that the tendon moves. The keys
    are the names of the joints.
    """
    first_radius = float(pulley_radii[0])
    yield [dict.fromkeys(joints, first_radius)]
    closing_arms = [
        dict(zip(joints[: i + 1], pulley_radii[: i + 1].tolist(), strict=True))
        for i in range(len(joints))
    ]
    yield closing_arms
    yield [
        *closing_arms,
        {joint: -float(radius) for joint, radius in zip(joints, pulley_radii, strict=True)},
    ]


def _random_digit(
    finger: dict[str, Any], name: str, size: int, is_coupled: bool, rng: RandomGenerator
) -> dict[str, Any]:
    digit_table = {
        key: value[:size]
        if isinstance(value, list) and key[:5] in ("link_", "joint", "sprin")
        else value
        for key, value in finger.items()
    }
    digit_table |= {"name": name, "mount_position_m": rng.uniform(-0.05, 0.05, 3).tolist()}
    digit_table["spring_preload_rad"] = rng.uniform(0.4, 0.8, size).tolist()
    return digit_table | ({"coupling": [[1.0]] * size} if is_coupled else {})


def _message_payload(
    message: CyclicMessage, given_quantities: dict[SignalQuantity, Any], rng: RandomGenerator
) -> bytes:
    """Encode given values as the payload of a message, and return the payload.

    If the drive status is divided among several signals of the message, the first of these signals
    contains the highest bits.
    """
    values, remaining_bits = (
        [],
        sum(
            status_signal.length
            for status_signal in message.signals
            if status_signal.quantity == SignalQuantity.STATUS
        ),
    )
    for signal in message.signals:
        if signal.quantity == SignalQuantity.UNUSED:
            continue
        value = given_quantities.get(signal.quantity, 0.0)
        if signal.quantity == SignalQuantity.STATUS:
            remaining_bits -= signal.length
            value = float(int(value) >> remaining_bits & (1 << signal.length) - 1)
        elif signal.quantity in (SignalQuantity.TENSION, SignalQuantity.ANGLE):
            value = float(value[signal.channel])
        values.append(value)
    data = SignalTable(message).pack(*values)
    return rng.bytes(len(data)) if rng.random() < CORRUPT_FRACTION else data


class RandomHand:
    """A random hand, and random frames from the nodes of this hand.

    The motors of the random hand make torque. Each random frame is a frame that a node of the
    random hand could send.
    """

    def __init__(self, tendons: int, seed: int) -> None:
        self.random = np.random.default_rng((tendons, seed))
        hand = random_hand(tendons, self.random)
        self.controller: Controller = make_controller(
            hand, Gains(), RATE_HZ, LiveProgram(), None, arm_at_once=True
        )
        self.protocol = hand.motor[0].protocol
        self.state: ControllerState = self.controller.initial_state()
        self.state.decide(progress=replace(self.state.progress, phase="live"))
        self.period_ns = round(1e9 / RATE_HZ)
        for n, drive in enumerate(self.controller.drives):
            self.controller.store_drive_state(
                self.state, n, _enabled_drive_state(drive, self.protocol)
            )
        self.state.mode = HandMode.ACTIVE
        self.position, self.tension = np.zeros(tendons), np.zeros(tendons)
        self.speed = self.random.normal(0.0, 2.0, tendons)
        self.angle = np.zeros(len(hand.joints))
        self.digits = hand.digit_names
        # A drive with a position loop closes this loop only while its tendon is taut.
        self.pull = 20.0 if any(motor.closes_position_loop for motor in hand.motor) else 0.0

    def received_frames(self, t_ns: int) -> tuple[Frame, ...]:
        """Return the random frames that the controller receives in a tick.

        The motor angles and tensions in the frames change from tick to tick. Some of the frames are
        lost, duplicated or corrupted.
        """
        rng, period = self.random, 1.0 / RATE_HZ
        self.speed = 0.9 * self.speed + rng.normal(0.0, 1.0, len(self.speed))
        self.position += self.speed * period
        pull_tensions = self.pull + 400.0 * self.position + rng.normal(0.0, 0.5, len(self.tension))
        self.tension = np.clip(pull_tensions, 0.0, 130.0)
        self.angle += rng.normal(0.01, 0.02, len(self.angle))
        messages = []
        for n, drive in enumerate(self.controller.drives):
            given_quantities: dict[SignalQuantity, Any] = {
                SignalQuantity.POSITION: float(self.position[n]), SignalQuantity.VELOCITY: float(self.speed[n]),
                SignalQuantity.TORQUE: float(rng.normal(0.1, 0.05)),
                SignalQuantity.STATUS: _status_while_enabled(drive, self.protocol),
                SignalQuantity.TEMPERATURE: float(rng.integers(20, 90)),
            }  # fmt: skip
            messages += [
                (feedback_message, drive.bus, given_quantities)
                for feedback_message in drive.cyclic_messages.feedback
            ]
        sensors = self.controller.sensors
        counter = self.state.run_integers[s.SYNC_COUNTER] & 0xF
        for message in sensors.messages:
            is_counter_wrong = rng.random() < CORRUPT_FRACTION
            given_quantities = {
                SignalQuantity.COUNTER: counter ^ is_counter_wrong,
                SignalQuantity.TENSION: self.tension,
                SignalQuantity.ANGLE: self.angle,
            }
            messages += [(message, sensors.bus, given_quantities)]
        out = []
        for message, bus, given_quantities in messages:
            chance = rng.random()
            for _ in range(
                0
                if chance < LOST_FRACTION
                else 2
                if chance < LOST_FRACTION + DUPLICATE_FRACTION
                else 1
            ):
                data = _message_payload(message, given_quantities, rng)
                out.append(
                    Frame(
                        message.can_id,
                        data,
                        message.flags,
                        bus,
                        t_ns - int(rng.integers(1_000_000)),
                    )
                )
        if rng.random() < 0.1:
            out.append(Frame(int(rng.integers(0x800)), rng.bytes(8), 0, 0, t_ns - 1))
        return tuple(out)

    def requests_of_tick(self, i: int) -> tuple[str, ...]:
        """Return the requests that arrive in tick i: one request to move or to tension a digit, or no request."""
        if self.pull and i == 2:
            return (
                json.dumps(
                    {"do": "move", "angle_deg": dict.fromkeys(self.digits, 30.0), "duration_s": 0.2}
                ),
            )
        if i % 8 != 2:
            return ()
        name = str(self.random.choice(self.digits))
        if self.random.random() < 0.5:
            return (
                json.dumps(
                    {
                        "do": "move",
                        "angle_deg": {name: self.random.uniform(0.0, 60.0)},
                        "duration_s": 0.5,
                    }
                ),
            )
        return (json.dumps({"do": "hold", "tension_N": {name: self.random.uniform(5.0, 60.0)}}),)

    def hash_ticks(self) -> Iterator[str]:
        """Run all ticks, and yield a hash after each tick.

        The hash of a tick covers the state, the telemetry, the frames and the events of the tick.
        """
        k = 0
        for i in range(TICKS_PER_HAND):
            if i < TICKS_PER_HAND - LAST_TICKS_WITH_FAULTS:
                self.state.mode = HandMode.ACTIVE
                self.state.decide(latched_faults=())
            k += 1 if self.random.random() > SKIPPED_FRACTION else int(self.random.integers(2, 5))
            t_ns = k * self.period_ns
            entry = TickIn(
                k,
                t_ns,
                int(self.random.integers(1_000_000)),
                self.received_frames(t_ns),
                (),
                self.requests_of_tick(i),
            )
            self.state, out = self.controller.tick(self.state, entry)
            hashed_arrays = [
                out.state_hash,
                out.telemetry.to_bytes(),
                repr(tuple(out.frames)).encode(),
                repr(out.events).encode(),
            ]
            yield hashlib.blake2b(b"".join(hashed_arrays), digest_size=8).hexdigest()


def _status_while_enabled(drive: Any, protocol: str) -> int:
    """Return the status that a drive reports while it is enabled."""
    if protocol == "mit":
        return int(mit.ENABLED << 4 | drive.node_id & 0xF)
    if protocol == "moteus":
        return int(moteus.join_mode_and_fault(moteus.POSITION, 0))
    return int(cia402.ENABLED_STATUS) if protocol == "cia402" else 0


def _enabled_drive_state(drive: Any, protocol: str) -> DriveState:
    """Return the state of a drive that is configured and obeys commands."""
    state: DriveState = drive.initial_state()
    protocol_state: Any = state.protocol_state
    if protocol != "odrive":
        protocol_state = protocol_state._replace(is_enable_sent=True)
    if protocol in ("mit", "moteus", "robstride"):
        protocol_state = protocol_state._replace(is_configured=True)
    if protocol == "cia402":
        cursor = protocol_state.cursor._replace(step=len(drive.setup_steps))
        protocol_state = protocol_state._replace(
            cursor=cursor, power_state=cia402.OPERATION_ENABLED, life_sign_ns=0
        )
    check = readback.first_recheck(drive.node_id, 0)
    return state._replace(phase=DrivePhase.ENABLED, recheck=check, protocol_state=protocol_state)


def tick_hashes(tendons: int, seed: int) -> list[str]:
    """Return the hash of each tick of a random hand."""
    with np.errstate(all="ignore"):
        return list(RandomHand(tendons, seed).hash_ticks())


if __name__ == "__main__":
    print(json.dumps([tick_hashes(*map(int, word.split(":"))) for word in sys.argv[1:]]))
