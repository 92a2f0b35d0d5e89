"""Test commands, tracking errors, tensions and faults of hands whose drives close the position loops.

The command ``python -m tests.controller.test_position_loop moteus 10`` prints the tracking errors
of ten seeds.
"""

import json
import math
import os
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from firmware_sim.nodes.mit.codec import MitRanges, decode_command
from handctl.campaign.fault_matrix import FREE_MOTION_STAGE, GRASP_STAGE
from handctl.campaign.run_stages import advance_to_stage, hand_with_protocol, homed_run
from handctl.controller.monitor.safety_thresholds import servo_resolutions
from handctl.controller.run_setup import make_controller, make_drives
from handctl.core import state_block as s
from handctl.core.control_law.servo_commands import TORQUE_LIMIT_MARGIN_N
from handctl.core.gains.gains import packaged_gains
from handctl.core.hand_constants import servo_constants
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.core.wire.wire_table_building import build_wire_tables
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.runtime.mailbox import STOP_REQUEST
from handctl.session.lockstep_simulation import SimulatedRun, SimulatorSettings
from tests.faults.test_relaxing import check_relaxing

NIGHTLY = os.environ.get("HANDCTL_NIGHTLY") == "1"
SIMULATOR_SEEDS = range(20) if NIGHTLY else range(2)
MOTEUS_SEEDS = range(20) if NIGHTLY else range(3)
PROTOCOLS_AND_SEEDS = [("mit", seed) for seed in SIMULATOR_SEEDS] + [
    ("moteus", seed) for seed in MOTEUS_SEEDS
]
"""Protocol of the drives and seed of the simulator.

Between two commands, an MIT drive keeps its position target constant. A moteus drive moves its
position target with the commanded velocity.
"""
RATE_HZ = 500.0
STIFF_KP_N_M_PER_RAD = 2.5
"""Stiffness of a tendon of the hand ``jamia``, as torque per angle of the spool [N m/rad].

The stiffness of the tendon is the largest position gain that handctl accepts in the hand file.
"""
TENSION_TRIP_N = 140.0


def with_position_loop(hand: Hand, **drive_options: Any) -> Hand:
    """Return the hand with drives that close the position loops."""
    motors = tuple(
        motor.model_copy(update={"control": "position", **drive_options}) for motor in hand.motor
    )
    return hand.model_copy(update={"motor": motors})


def hand_with_position_loop(
    hand_name: str = "jamia", protocol: str = "mit", kp: float | None = STIFF_KP_N_M_PER_RAD
) -> Hand:
    """Return a packaged hand whose drives close the position loop.

    For moteus drives, the hand file contains the position gain kp and the velocity gain kd.
    """
    hand = with_position_loop(hand_with_protocol(hand_name, protocol), kp_N_m_per_rad=kp)
    if protocol != "moteus":
        return hand
    other_hand = hand_with_position_loop(hand_name, "mit", kp)
    gains = servo_constants(HandModel.from_hand(other_hand, packaged_gains(hand_name), RATE_HZ))
    stiffness, damping = (
        [float(gains[key][0])] * len(hand.motor) for key in ("servo_stiffness", "servo_damping")
    )
    motors = tuple(
        motor.model_copy(update={"kp_N_m_per_rad": stiffness[n], "kd_N_m_s_per_rad": damping[n]})
        for n, motor in enumerate(hand.motor)
    )
    return hand.model_copy(update={"motor": motors})


def back_and_forth_program(hand: Hand, move_count: int, duration_s: float) -> TaskProgram:
    """Return a program that alternately closes and opens all digits of a hand together."""
    ends = [dict.fromkeys(hand.digit_names, angle) for angle in (45.0, 15.0)]
    phases = [{"kind": "move", "name": "ready", "angle_deg": ends[1], "duration_s": 0.6}] + [
        {"kind": "move", "name": f"move {i}", "angle_deg": ends[i % 2], "duration_s": duration_s}
        for i in range(move_count)
    ]
    return TaskProgram(
        Task.model_validate_json(json.dumps({"schema": 1, "name": "to and fro", "phase": phases}))
    )


@contextmanager
def start_back_and_forth_run(
    hand: Hand, seed: int = 0, rate_hz: float = RATE_HZ, move_count: int = 6
) -> Iterator[SimulatedRun]:
    """Yield the run of a simulated hand that moves to and fro.

    The yielded run has just reached the first tick of its first move.
    """
    controller = make_controller(
        hand,
        packaged_gains(hand.name),
        rate_hz,
        back_and_forth_program(hand, move_count, 0.6),
        None,
        arm_at_once=True,
    )
    with SimulatorSettings(hand, None, seed, homed=True).begin_run(controller) as run:
        assert run.run_until(lambda out: out.phase == "move 0", 5.0)
        yield run


def sent_stiffness(run: SimulatedRun) -> np.ndarray:
    return run.state.view("servo_kp")


def mean_errors(hand: Hand, seed: int) -> tuple[np.ndarray, float]:
    """Return the RMS angle error along each tendon [deg], and the largest true tension [N].

    The RMS error and the largest tension are measured while the hand moves. The error along a
    tendon is the error of the mean angle of the joints that the tendon passes. In the hand
    ``jamia``, the springs determine how the single joints of a digit share the error along a
    tendon.
    """
    errors, peak = list[np.ndarray](), 0.0
    with start_back_and_forth_run(hand, seed, move_count=2) as run:
        arms = run.controller.model.hand.moment_arms_of_own_digit
        plant: Any = run.simulated_hand.world.plant  # type: ignore[attr-defined]
        for _, out in run.run_ticks(8.0):
            if not out.phase.startswith("move"):
                break
            q = np.array(plant.engine.q[: len(out.telemetry.q)])
            errors.append(np.degrees(arms @ (q - out.telemetry.q_goal) / np.abs(arms).sum(axis=1)))
            peak = max(peak, *run.simulated_hand.truth()["tension"])
        assert run.state.latched_faults == ()
    return np.sqrt((np.array(errors) ** 2).mean(axis=0)), peak


def moteus_command(payload: bytes) -> tuple[float, ...]:
    """Return the values in the payload of a moteus command.

    A moteus command contains position [rad], velocity [rad/s], torque [N m], the fractions of kp
    and kd, and the torque limit [N m].
    """
    assert len(payload) == 48
    assert (payload[:5], payload[17:19], payload[31:36]) == (
        b"\1\0\x0a\x0f\x20",
        b"\x0f\x23",
        b"\1\x2b\0\x0d\x27",
    )
    position, velocity, torque = struct.unpack_from("<fff", payload, 5)
    return (
        math.tau * position,
        math.tau * velocity,
        torque,
        *struct.unpack_from("<fff", payload, 19),
    )


@pytest.mark.parametrize("motor_direction", [1, -1])
def test_a_moteus_command_makes_the_predicted_torque(motor_direction: int) -> None:
    """A moteus drive moves its position target with the commanded velocity.

    The mean position target in a control period leads the commanded position by the commanded
    velocity times half a control period.
    """
    hand = hand_with_position_loop(protocol="moteus")
    motors = tuple(
        motor.model_copy(update={"direction": motor_direction, "zero_rad": 0.7})
        for motor in hand.motor
    )
    hand = hand.model_copy(update={"motor": motors})
    with start_back_and_forth_run(hand) as run:
        model, sent = run.controller.model, 0
        for _ in range(400):
            out = run.run_tick()
            commands = {
                frame.can_id & 0xFF: frame.data for frame in out.frames if len(frame.data) == 48
            }
            for n, motor in enumerate(hand.motor):
                if sent_stiffness(run)[n] == 0.0:
                    continue
                position, velocity, added_torque, kp, kd, limit = moteus_command(
                    commands[motor.node_id]
                )
                assert 0.0 < kp <= 1.0
                assert 0.0 < kd <= 1.0
                p, v = (
                    run.state.view(name)[n] / model.tendon_constants.spool_radius[n]
                    for name in ("travel", "speed")
                )
                target = (
                    motor_direction * (position - motor.zero_rad)
                    + 0.5 * model.period * motor_direction * velocity
                )
                predicted_position = p + run.controller.motor_zeros[n] + 0.5 * model.period * v
                torque = (
                    STIFF_KP_N_M_PER_RAD * kp * (target - predicted_position)
                    + motor_direction * added_torque
                )
                torque += motor.kd_N_m_s_per_rad * kd * (motor_direction * velocity - v)
                torque_of_law = run.state.view("torque")[n]
                # The position gains are rounded to six digits, and the position is a float32.
                assert torque == pytest.approx(torque_of_law, abs=2e-5)
                margin = TORQUE_LIMIT_MARGIN_N * model.tendon_constants.spool_radius[n]
                assert limit == pytest.approx(
                    min(abs(torque_of_law) + margin, motor.torque_max_N_m), rel=1e-6
                )
                sent += 1
        assert sent > 1500, "nearly all commands carry a position"


def test_a_position_command_makes_the_predicted_torque() -> None:
    hand = with_position_loop(load_hand("jamia"), kp_N_m_per_rad=STIFF_KP_N_M_PER_RAD)
    with start_back_and_forth_run(hand) as run:
        model, ranges = run.controller.model, MitRanges(12.5, 50.0, 0.8)
        sent = 0
        for _ in range(400):
            out = run.run_tick()
            commands = {frame.can_id: frame.data for frame in out.frames if 0 < frame.can_id < 5}
            for n in range(4):
                decoded_command = decode_command(commands[n + 1], ranges)
                p, v = (
                    run.state.view(name)[n] / model.tendon_constants.spool_radius[n]
                    for name in ("travel", "speed")
                )
                predicted_position = p + run.controller.motor_zeros[n] + 0.5 * model.period * v
                torque = (
                    decoded_command.kp * (decoded_command.position - predicted_position)
                    + decoded_command.kd * (decoded_command.velocity - v)
                    + decoded_command.torque
                )
                # The permitted torque difference is the sum of three torques. The three torques
                # correspond to the resolutions of position, velocity and torque in the command.
                assert torque == pytest.approx(run.state.view("torque")[n], abs=2.0e-3)
                sent += decoded_command.kp > 0.0
                assert decoded_command.kp == pytest.approx(run.state.view("servo_kp")[n], abs=1e-9)
        assert sent > 1500, "nearly all commands carry a position"


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
def test_a_stiff_drive_follows_twice_as_well(seed: int) -> None:
    hand = load_hand("jamia")
    torque, _ = mean_errors(hand, seed)
    position, peak = mean_errors(
        with_position_loop(hand, kp_N_m_per_rad=STIFF_KP_N_M_PER_RAD), seed
    )
    assert position.mean() < 0.7 * torque.mean(), f"{position} against {torque} deg"
    assert (position < torque).all(), f"{position} against {torque} deg"
    assert peak < 40.0
    as_before, _ = mean_errors(with_position_loop(hand), seed)
    assert as_before.mean() < 1.1 * torque.mean(), f"{as_before} against {torque} deg"


LARGEST_ERROR_RATIO = {"jamia": 0.75, "jamia11": 0.85, "t42": 1.01}
"""Largest permitted tracking error with position loops, divided by the tracking error with torque commands.

The springs of the hand ``t42`` determine its tracking error in both cases.
"""


@pytest.mark.parametrize("seed", MOTEUS_SEEDS)
@pytest.mark.parametrize("hand_name", LARGEST_ERROR_RATIO)
def test_a_stiff_moteus_follows_better(hand_name: str, seed: int) -> None:
    torque, _ = mean_errors(hand_with_protocol(hand_name, "moteus"), seed)
    position, peak = mean_errors(hand_with_position_loop(hand_name, "moteus"), seed)
    assert position.mean() < LARGEST_ERROR_RATIO[hand_name] * torque.mean(), (
        f"{position} against {torque} deg"
    )
    assert peak < 40.0


@pytest.mark.parametrize(
    ("hand_name", "protocol"),
    [
        ("jamia", "mit"),
        ("jamia", "robstride"),
        ("jamia", "moteus"),
        ("jamia11", "moteus"),
        ("t42", "moteus"),
    ],
)
def test_a_grasp_with_position_loops_has_no_position_commands_in_contact(
    hand_name: str, protocol: str
) -> None:
    hand = hand_with_position_loop(hand_name, protocol, None)
    with homed_run(hand, RATE_HZ, 0) as run:
        advance_to_stage(run, FREE_MOTION_STAGE)
        assert (sent_stiffness(run) > 0.0).all()
        advance_to_stage(run, GRASP_STAGE)
        run.run_tick()
        assert not sent_stiffness(run).any()
        np.testing.assert_allclose(run.state.view("servo_torque"), run.state.view("torque"))
        for _ in range(round(RATE_HZ)):
            assert run.run_tick().mode == HandMode.ACTIVE
            assert not sent_stiffness(run).any()
        run.run_tick(requests=(STOP_REQUEST,))
        while run.state.mode != HandMode.DONE:
            run.run_tick()
            assert not sent_stiffness(run).any()
        assert run.state.latched_faults == ()


@pytest.mark.parametrize("kp", [None, STIFF_KP_N_M_PER_RAD])
@pytest.mark.parametrize(("protocol", "seed"), PROTOCOLS_AND_SEEDS)
def test_an_obstacle_bounds_the_tension(kp: float | None, protocol: str, seed: int) -> None:
    with start_back_and_forth_run(hand_with_position_loop("jamia", protocol, kp), seed) as run:
        for _ in range(round((0.15 + 0.01 * seed) * RATE_HZ)):
            run.run_tick()
        run.simulated_hand.inject("block digit=index")
        peak, blocked = 0.0, False
        for _ in range(round(1.5 * RATE_HZ)):
            run.run_tick()
            peak = max(peak, *run.simulated_hand.truth()["tension"])
            if run.state.view("blocked")[0]:
                blocked = True
                assert sent_stiffness(run)[0] == 0.0
        assert blocked
        # A blocked digit presses with a tension of up to 30 N more than its motion requires, see
        # touch.MAX_BLOCKED_EXTRA_TENSION_N.
        assert peak < 60.0, f"{peak} N"


@pytest.mark.parametrize("time_until_loss_ms", [0, 10, 20])
@pytest.mark.parametrize("seed", MOTEUS_SEEDS)
def test_a_dead_host_at_an_obstacle_is_bounded_by_the_limit_in_the_command(
    time_until_loss_ms: int, seed: int
) -> None:
    """When the host dies, a moteus drive continues to move its position target until its watchdog fires after 50 ms.

    Without the torque limit in the last command of the host, the moteus drive would pull with 70 N
    in this test.
    """
    with start_back_and_forth_run(hand_with_position_loop(protocol="moteus"), seed) as run:
        for _ in range(round((0.1 + 0.06 * seed) * RATE_HZ)):
            run.run_tick()
        run.simulated_hand.inject("block digit=index")
        for _ in range(round(1e-3 * time_until_loss_ms * RATE_HZ)):
            run.run_tick()
        motors: Any = run.simulated_hand.world.plant.motors  # type: ignore[attr-defined]
        has_position_loop = sent_stiffness(run) > 0.0
        forces = (
            np.abs(run.state.view("torque")) / run.controller.model.tendon_constants.spool_radius
        )
        limit = forces + TORQUE_LIMIT_MARGIN_N * has_position_loop
        sent = run.state.view("servo_limit") / run.controller.model.tendon_constants.spool_radius
        np.testing.assert_allclose(sent[has_position_loop], limit[has_position_loop])
        assert has_position_loop.sum() >= 3, "only the blocked digit has a torque command"
        tension_at_loss = np.array(run.simulated_hand.truth()["tension"])
        peak = np.zeros(4)
        for _ in range(round(0.1 * RATE_HZ)):
            run._advance_simulated_hand()
            peak = np.maximum(peak, run.simulated_hand.truth()["tension"])
        assert [motor.servo.kp for motor in motors.values()] == [0.0] * 4, (
            "the watchdogs have fired"
        )
        # The kinetic energy of the moving rotor can raise the tension above the limit.
        assert (peak < np.maximum(tension_at_loss, limit) + 10.0).all(), (
            f"{peak} N, limits {limit} N"
        )
        assert peak.max() < 55.0


@pytest.mark.parametrize("seed", MOTEUS_SEEDS)
def test_missed_ticks_are_no_fault_of_a_drive_that_moves_its_target(seed: int) -> None:
    rng = np.random.default_rng(seed)
    with start_back_and_forth_run(hand_with_position_loop(protocol="moteus"), seed) as run:
        apart = []
        for _ in range(1200):
            run.run_tick(skipped_ticks=int(rng.integers(0, 4)) if rng.random() < 0.1 else 0)
            apart.append(run.state.view("servo_report") - run.state.view("measured_force"))
        assert run.state.latched_faults == ()
        assert run.state.mode == HandMode.ACTIVE
        assert np.nanmax(np.abs(apart)) < 2.0


@pytest.mark.parametrize(("protocol", "seed"), PROTOCOLS_AND_SEEDS)
@pytest.mark.parametrize(
    "fault_command",
    ["", "swap node=index_motor with=thumb_motor", "disobey node=ring_motor size=1.6"],
)
def test_relaxing_from_a_position_loop_raises_no_command(
    fault_command: str, protocol: str, seed: int
) -> None:
    with start_back_and_forth_run(hand_with_position_loop("jamia", protocol), seed) as run:
        for _ in range(round((0.1 + 0.03 * seed) * RATE_HZ)):
            run.run_tick()
        assert (sent_stiffness(run) > 0.0).any()
        if fault_command:
            run.simulated_hand.inject(fault_command)
        check_relaxing(run, run.k + 40, round(0.06 * RATE_HZ), fault_command)


def ignore_drive_gains(run: SimulatedRun, motor_name: str) -> None:
    """Make a drive ignore the gains kp and kd, so that it produces only the torque in its commands."""
    motor: Any = run.simulated_hand.world.plant.motors[motor_name]  # type: ignore[attr-defined]
    motor.power_stage_fault = lambda _: float(
        np.clip(motor.servo.torque, -motor.servo.limit, motor.servo.limit)
    )


EXPECTED_FAULTS = {
    "stuck encoder=index_motor": {"N04"},
    "swap node=index_motor with=thumb_motor": {"N05b", "N14", "N17", "T04b"},
    "cross node=index_motor with=thumb_motor": {"N14", "N17", "N04", "T04b", "N05b"},
    # With the fault "replay", a moteus drive sends its old replies again, in addition to its
    # present replies.
    "replay node=index_motor size=16": {"N05b", "N14", "N17", "N04", "B06", "N13"},
    "disobey node=index_motor size=0.4": {"N14", "N17"},
    "offset encoder=index_motor size=-0.5": {"N05b", "T02a", "T03", "N14"},
}


@pytest.mark.parametrize(("protocol", "seed"), PROTOCOLS_AND_SEEDS)
@pytest.mark.parametrize("fault_command", EXPECTED_FAULTS)
def test_faults_are_found_with_a_position_loop(
    fault_command: str, protocol: str, seed: int
) -> None:
    with start_back_and_forth_run(hand_with_position_loop("jamia", protocol), seed) as run:
        for _ in range(round((0.1 + 0.02 * seed) * RATE_HZ)):
            run.run_tick()
        run.simulated_hand.inject(fault_command)
        peak = 0.0
        while run.run_tick().mode < HandMode.DISARM and run.k < 5.0 * RATE_HZ:
            peak = max(peak, *run.simulated_hand.truth()["tension"])
        assert {mark.id for mark in run.state.latched_faults} & EXPECTED_FAULTS[fault_command], (
            run.state.latched_faults
        )
        assert peak < TENSION_TRIP_N


@pytest.mark.parametrize(("protocol", "seed"), PROTOCOLS_AND_SEEDS)
def test_a_drive_that_ignores_kp_is_found(protocol: str, seed: int) -> None:
    with start_back_and_forth_run(hand_with_position_loop("jamia", protocol), seed) as run:
        ignore_drive_gains(run, "index_motor")
        peak = 0.0
        while run.run_tick().mode == HandMode.ACTIVE and run.k < 6.0 * RATE_HZ:
            peak = max(peak, *run.simulated_hand.truth()["tension"])
        assert {mark.id for mark in run.state.latched_faults} & {"N14", "N17"}
        assert peak < TENSION_TRIP_N


@pytest.mark.parametrize(
    ("protocol", "force_sigma_N"), [("mit", 0.3), ("robstride", 0.3), ("moteus", 0.12)]
)
def test_a_healthy_drive_reports_what_is_predicted(protocol: str, force_sigma_N: float) -> None:
    """The force that a drive reports agrees with the force that the controller has predicted.

    Detectors compare the reported force with the predicted force to find drives that do not obey.
    """
    with start_back_and_forth_run(hand_with_position_loop("jamia", protocol)) as run:
        apart = []
        for _ in range(600):
            run.run_tick()
            apart.append(run.state.view("servo_report") - run.state.view("measured_force"))
        assert np.nanstd(apart) < force_sigma_N
        assert np.nanmax(np.abs(apart)) < 10.0 * force_sigma_N


@pytest.mark.parametrize("force_sign", [1, -1])
def test_a_report_is_predicted_within_the_limit_of_its_command(force_sign: int) -> None:
    with start_back_and_forth_run(hand_with_position_loop(protocol="moteus")) as run:
        for _ in range(20):
            run.run_tick()
        limit = (
            float(run.state.view("servo_limit")[1])
            / run.controller.model.tendon_constants.spool_radius[1]
        )
        run.state.view("servo_position")[1] += 2.0 * force_sign
        run.run_tick()
        # The torque report that arrives in tick k is the drive's reply to the command of tick k -
        # 2.
        run.run_tick()
        assert run.state.view("servo_report")[1] == pytest.approx(force_sign * limit)
        assert (
            limit
            < 0.5
            * run.controller.model.torque_limit[1]
            / run.controller.model.tendon_constants.spool_radius[1]
        )


@pytest.mark.parametrize(
    ("protocol", "expected_reason"),
    [("odrive", "Set_Input_Pos of an ODrive contains no gains"), ("cia402", "no gains")],
)
def test_a_protocol_without_position_commands_is_refused(
    protocol: str, expected_reason: str
) -> None:
    hand = with_position_loop(hand_with_protocol("jamia", protocol))
    expected_message = rf'motor\[index_motor\].protocol: "{protocol}"; expected mit, moteus with .*{expected_reason}'
    with pytest.raises(ConfigError, match=expected_message):
        make_drives(hand)


@pytest.mark.parametrize("gain_key", ["kp_N_m_per_rad", "kd_N_m_s_per_rad"])
def test_a_moteus_without_gains_is_refused(gain_key: str) -> None:
    hand = hand_with_position_loop(protocol="moteus")
    with pytest.raises(
        ConfigError,
        match=rf"motor\[index_motor\].{gain_key}: missing; expected a number, because control",
    ):
        make_drives(with_position_loop(hand, **{gain_key: None}))


@pytest.mark.parametrize("rate_hz", [100.0, 500.0])
@pytest.mark.parametrize("gain_value", [0.9, 1.2])
def test_fractions_of_the_gains_of_a_moteus_are_at_most_1(
    gain_value: float, rate_hz: float
) -> None:
    """A moteus command contains fractions of the drive's gains kp and kd. Both fractions are limited to 1.

    Without the limit of 1, the controller would send fractions above 1 to a moteus drive that makes
    less torque than commanded.
    """
    hand = hand_with_position_loop(protocol="moteus")
    model = HandModel.from_hand(hand, packaged_gains("jamia"), rate_hz, np.full(4, gain_value))
    controller = make_controller(
        hand, packaged_gains("jamia"), rate_hz, back_and_forth_program(hand, 1, 1.0), None, True
    )
    drives = make_drives(hand)
    steps, loop = servo_resolutions(model, drives), servo_constants(model)
    wire = build_wire_tables(drives, controller.sensors, [True] * 4, model.torque_gain)
    for n in range(4):
        rows = wire.servo_signal_scalings[wire.servos[n, 0] : wire.servos[n, 1]]
        for name, key, row in (("stiffness", "kp", 2), ("damping", "kd", 3)):
            value = min(loop[f"servo_{name}"][n], steps[f"servo_{key}_max"][n])
            step = steps[f"servo_{key}_step"][n]
            rounded_gain = step * math.floor(value / step + 0.5)
            assert 0.0 < rounded_gain <= rows[row, 3], "the law's rounded gain can be encoded"
            assert np.float32(rounded_gain / rows[row, 0]) <= 1.0
            assert (value < loop[f"servo_{name}"][n]) == (
                gain_value < 1.0 and (name == "damping" or rate_hz > 100.0)
            )


def test_position_loops_of_antagonists_are_refused() -> None:
    content = hand_content("n_plus_1")
    content["motor"][0]["control"] = "position"
    with pytest.raises(
        ConfigError, match=r'control: "position"; expected "torque": position loops of antagonistic'
    ):
        hand_from_content(content, "antagonists.toml")


def test_a_stiffness_below_one_count_is_refused() -> None:
    hand = with_position_loop(load_hand("jamia"), kp_N_m_per_rad=0.05)
    with pytest.raises(
        ConfigError,
        match=r"motor\[index_motor\].kp_N_m_per_rad: 0.05; expected 0.122 to 500 N m/rad",
    ):
        make_drives(hand)


def test_a_low_rate_lowers_the_stiffness() -> None:
    hand = with_position_loop(load_hand("jamia"), kp_N_m_per_rad=STIFF_KP_N_M_PER_RAD)
    with start_back_and_forth_run(hand, rate_hz=100.0) as run:
        for _ in range(20):
            run.run_tick()
        assert sent_stiffness(run).max() == pytest.approx(500.0 / 4095.0)


def test_a_hand_without_position_loops_has_no_servo_table_and_keeps_its_identity() -> None:
    hand = load_hand("jamia")
    loop = with_position_loop(hand, kp_N_m_per_rad=1.0)
    assert loop.identity == hand.identity
    assert "control" not in hand.to_toml()
    layouts = [
        make_controller(
            hand_variant,
            packaged_gains("jamia"),
            RATE_HZ,
            back_and_forth_program(hand_variant, 1, 1.0),
            None,
            True,
        ).derived_constants.layout
        for hand_variant in (hand, loop)
    ]
    assert [layout.axes["servo"] for layout in layouts] == [0, 4]
    assert layouts[1].size - layouts[0].size == 4 * s.STATE_SCHEMA.rows("servo")


def print_tracking_errors(protocol: str, seed_count: int) -> None:
    """Print a line for each hand and each control mode of the drives.

    Each printed line contains the mean tracking error, the smallest and the largest tracking error
    of all seeds, and the largest tension.
    """
    for name in LARGEST_ERROR_RATIO:
        hands = {
            "torque commands": hand_with_protocol(name, protocol),
            "kp and kd of the gains": hand_with_position_loop(name, protocol, None),
            f"kp = {STIFF_KP_N_M_PER_RAD} N m/rad": hand_with_position_loop(name, protocol),
        }
        for mode, hand in hands.items():
            runs = [mean_errors(hand, seed) for seed in range(seed_count)]
            errors = [error.mean() for error, _ in runs]
            mean, low, high = np.mean(errors), min(errors), max(errors)
            peak = max(peak for _, peak in runs)
            print(
                f"{name:8}{mode:24}{mean:8.3f} deg ({low:.3f} to {high:.3f}){peak:7.1f} N",
                flush=True,
            )


if __name__ == "__main__":
    print_tracking_errors(sys.argv[1], int(sys.argv[2]))
