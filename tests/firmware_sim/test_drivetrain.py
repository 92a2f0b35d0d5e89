"""Test that compiled code, Python code and MuJoCo's ``mj_step`` give the same simulated motion."""

import resource
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from firmware_sim.bus.frame import Frame
from firmware_sim.description.hand_description import load_hand
from firmware_sim.lockstep_hand import LockstepHand
from firmware_sim.plant.plant import STEP_NS, Plant
from firmware_sim.scene.scene import load_scene
from firmware_sim.simulated_world import SimulatedWorld
from firmware_sim.truth_file import TruthWriter, read_truth, truth_columns


def closing_hand(hand_name: str, uses_mj_step: bool = True, is_compiled: bool = True) -> Plant:
    """Build a simulated hand that closes on a cylinder.

    At the start, the tendons are slack. The tendons become taut while the hand closes. Each motor
    of the hand follows a commanded torque, a commanded position, or a commanded moving position.
    """
    plant = Plant(load_hand(hand_name), load_scene("cylinder"), seed=3, is_compiled=is_compiled)
    if not uses_mj_step:
        plant._addresses = None
    for i, motor in enumerate(plant.motors.values()):
        motor.servo.limit, motor.servo.torque, motor.omega = 0.8, 0.05 + 0.02 * i, 3.0 * (-1) ** i
        if i % 2:
            motor.servo.kp, motor.servo.kd, motor.servo.position = 2.0, 0.05, 1.0 + 0.1 * i
            motor.servo.target_speed = 2.0 if i % 4 == 1 else 0.0
    return plant


def state_as_hex(plant: Plant) -> list[str]:
    """Return all numbers that describe the motion of the simulated hand, as hexadecimal texts without rounding."""
    motors = [(m.theta, m.omega, m.torque, m.velocity, m.heat) for m in plant.motors.values()]
    tendons = [(tendon.tension, tendon.speed, tendon.slope) for tendon, _ in plant.tendons]
    engine = plant.engine
    numbers = [
        *sum(motors, ()),
        *sum(tendons, ()),
        *engine.q,
        *engine.dq,
        *engine.applied,
        *plant.tensions(),
    ]
    return [float(number).hex() for number in numbers]


@pytest.mark.parametrize("hand", ["jamia", "jamia11"])
def test_all_ways_to_step_are_equal_to_the_bit(hand: str) -> None:
    """Four ways to compute simulation steps give results that are equal to the last bit.

    The four ways are a block of simulation steps, single steps, steps by MuJoCo's Python bindings,
    and steps in Python.
    """
    block, single = closing_hand(hand), closing_hand(hand)
    bindings, plain_closing_hand = (
        closing_hand(hand, uses_mj_step=False),
        closing_hand(hand, is_compiled=False),
    )
    block.advance(401)
    for _ in range(401):
        for plant in (single, bindings, plain_closing_hand):
            plant.step()
    assert max(block.tensions()) > 5.0, "tendons were under tension"
    for plant in (single, bindings, plain_closing_hand):
        assert plant.steps == block.steps == 401
        assert state_as_hex(plant) == state_as_hex(block)


def test_compiled_and_python_worlds_send_equal_frames() -> None:
    """Compiled and Python simulation send equal frames, even if a motor, a load cell and an encoder have faults."""
    simulated_worlds = [
        SimulatedWorld(load_hand("jamia"), load_scene("cylinder"), seed=4, compiled=compiled)
        for compiled in (True, False)
    ]
    faults = (
        "runaway node=ring_motor size=0.3 at=20ms",
        "noise cell=index_tendon",
        "noise encoder=thumb_motor",
    )
    answers_and_states = []
    for world in simulated_worlds:
        for fault in faults:
            world.faults.inject(fault)
        answers = []
        for k in range(40):
            world.advance(k * 2_000_000)
            for data in (b"\xff" * 7 + b"\xfc", bytes.fromhex("9fff7ff0ff0337ff")):
                answers += world.receive(Frame(1, data))
            answers += world.receive(Frame(0x080, bytes((k,))))
        answers_and_states.append((answers, state_as_hex(world.plant)))
    assert answers_and_states[0] == answers_and_states[1]


@pytest.mark.parametrize(
    "module_name",
    ["bus_server", "lockstep_hand", "programs.hand", "programs.drive", "programs.bus"],
)
def test_real_time_programs_do_not_import_the_compiler(module_name: str) -> None:
    code = f"import sys, firmware_sim.{module_name}; print('numba' in sys.modules)"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "False"


def test_the_engine_has_native_addresses() -> None:
    native = closing_hand("jamia").engine.native
    assert native is not None
    assert all(native)


def test_the_world_steps_in_blocks_between_events() -> None:
    """One long simulation gives the same motion as many successive short simulations.

    In one long simulation, watchdogs fire at the same times as in many short simulations.
    """
    far_result, near_result = (
        SimulatedWorld(load_hand("jamia"), load_scene("cylinder"), seed=1) for _ in range(2)
    )
    far_result.advance(250_250_000)
    for k in range(1, 251):
        near_result.advance(k * 1_000_000)
    near_result.advance(250_250_000)
    assert far_result.t_ns == near_result.t_ns == 250_000_000
    assert state_as_hex(far_result.plant) == state_as_hex(near_result.plant)
    assert [node.wake_ns for bus in far_result.nodes for node in bus] == [
        node.wake_ns for bus in near_result.nodes for node in bus
    ]


def test_a_divided_step_ends_where_the_whole_step_ends() -> None:
    """The simulator can divide a simulation step into two steps to read a sensor at an exact time.

    The division of a simulation step changes the simulated motion only slightly.
    """
    undivided, divided = (Plant(load_hand("jamia"), load_scene(None), homed=True) for _ in range(2))
    for plant in (undivided, divided):
        for motor in plant.motors.values():
            motor.servo.limit, motor.servo.torque = 0.8, 0.06
    for k in range(400):
        undivided.step()
        for part_ns in (100_000, 250_000):
            divided.advance_within_step(part_ns)
        assert divided.t_ns == k * STEP_NS + 350_000
        divided.step()
    assert divided.t_ns == undivided.t_ns == 400 * STEP_NS
    assert divided.steps == undivided.steps
    assert min(undivided.tensions()) > 5.0, "tendons were under tension"
    assert divided.tensions() == pytest.approx(undivided.tensions(), abs=0.2)
    assert divided.engine.q == pytest.approx(undivided.engine.q, abs=0.01)
    set_step = [(motor.step, motor.lag, motor.velocity_lag) for motor in undivided.motors.values()]
    assert [
        (motor.step, motor.lag, motor.velocity_lag) for motor in divided.motors.values()
    ] == set_step


@pytest.mark.parametrize("hand", ["jamia", "jamia11"])
def test_a_spool_at_constant_speed_is_sampled_without_jitter_at_any_rate(hand: str) -> None:
    """The simulated encoder readings have no jitter, even if the control period is no multiple of the simulation step.

    In this test, the spool speed is 3 rad/s. If the simulator read the encoder only at the end of
    whole simulation steps, a reading would be wrong by 5 counts.
    """
    for rate_hz in (300.0, 333.0, 450.0, 640.0):
        world = SimulatedWorld(load_hand(hand), load_scene(None), seed=2)
        motor = next(iter(world.plant.motors.values()))
        motor.omega, motor.viscous, motor.coulomb = (
            -3.0,
            0.0,
            0.0,
        )  # with a negative speed, the spool unwinds a slack tendon
        period_ns, angles = round(1e9 / rate_hz), []
        for k in range(40):
            world.advance_exactly(k * period_ns)
            assert world.t_ns == k * period_ns
            angles.append(motor.theta)
        steps = [angle_after - angle_before for angle_before, angle_after in pairwise(angles)]
        assert steps == pytest.approx([-3.0 / rate_hz] * 39, rel=1e-6)


def test_samples_between_steps_do_not_move_the_rows_of_the_truth_file(tmp_path: Path) -> None:
    """The truth file has a row for every millisecond, even if a fault is injected within a step."""
    path = tmp_path / "truth"
    simulated_hand = LockstepHand("jamia", truth_path=str(path), period_ns=3_333_333)
    for k in range(30):
        if k == 4:
            simulated_hand.inject("flood bus=main size=1")
        simulated_hand.step(k * 3_333_333, [])
    simulated_hand.close()
    t_ns = read_truth(path).t_ns
    assert t_ns.tolist() == [k * 1_000_000 for k in range(len(t_ns))]
    assert len(t_ns) >= 99
    (fault,) = simulated_hand.fault_states()
    assert fault["felt"] == pytest.approx(87, abs=2)


def test_a_motor_fault_acts_in_every_step() -> None:
    simulated_hand = LockstepHand("jamia", homed=True)
    simulated_hand.inject("off node=index_motor")
    commands: list[float] = []
    simulated_hand.world.plant.motors["ring_motor"].power_stage_fault = lambda command: (
        commands.append(command) or 0.25
    )
    simulated_hand.step(0, [])
    assert len(commands) == 4
    assert simulated_hand.world.plant.motors["ring_motor"].torque > 0.2
    assert simulated_hand.world.plant.motors["index_motor"].torque == 0.0


@pytest.mark.parametrize("stop_reason", ["size", "disk"])
def test_a_full_truth_file_ends_and_the_simulation_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stop_reason: str
) -> None:
    simulated_hand = LockstepHand("jamia")
    plant = simulated_hand.world.plant
    path = tmp_path / "truth"
    limit = 8192 + 1000 * 8 * (1 + len(truth_columns(plant)))
    writer = TruthWriter(path, plant, {}, limit if stop_reason == "size" else sys.maxsize)
    for t_ms in range(3000):
        if stop_reason == "disk" and t_ms == 1000:
            monkeypatch.setattr("firmware_sim.truth_file.MIN_FREE_DISK_BYTES", 1 << 62)
        writer.write(t_ms * 1_000_000, plant)
    writer.close({"frames": 7})
    truth = read_truth(path)
    assert truth.t_ns.tolist() == [t_ms * 1_000_000 for t_ms in range(768)]
    assert path.stat().st_size <= limit
    assert (truth.header["truncated"], truth.header["frames"]) == (True, 7)


def test_a_truth_file_ends_after_a_part_of_the_rows_was_written(tmp_path: Path) -> None:
    """Reproduce a defect: the simulator wrote only half of a row to the truth file, and continued with the next row.

    After the incomplete row, a reader assigned each number to a wrong column.
    """
    plant = LockstepHand("jamia").world.plant
    row_bytes = 8 * (1 + len(truth_columns(plant)))
    writer = TruthWriter(tmp_path / "truth", plant, {})
    present_limit, largest = resource.getrlimit(resource.RLIMIT_FSIZE)
    for t_ms in range(2000):
        if t_ms == 700:
            limit = 8192 + 600 * row_bytes + row_bytes // 2
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, largest))
        if t_ms == 800:
            resource.setrlimit(resource.RLIMIT_FSIZE, (present_limit, largest))
        writer.write(t_ms * 1_000_000, plant)
    writer.close({})
    truth = read_truth(tmp_path / "truth")
    assert truth.t_ns.tolist() == [t_ms * 1_000_000 for t_ms in range(600)]
    assert truth.header["truncated"]
