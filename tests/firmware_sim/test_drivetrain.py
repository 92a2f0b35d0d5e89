"""The compiled drivetrain: the same motion as motor by motor, as by Python, and as MuJoCo's own ``mj_step``."""

import json
import os
import subprocess
import sys

import pytest

from firmware_sim.description import load_hand
from firmware_sim.engine import Engine
from firmware_sim.plant import Plant
from firmware_sim.rig import Rig
from firmware_sim.scene import load_scene
from firmware_sim.world import World

PLAIN = "import json; from tests.firmware_sim.test_drivetrain import moved; print(json.dumps(moved('jamia', 120)))"


def closing(hand: str, native: bool = True) -> Plant:
    """A hand that closes on a cylinder: slack ropes, then taut; some motors follow a torque, others a position."""
    plant = Plant(load_hand(hand), load_scene("cylinder"), seed=3)
    if not native:
        plant.engine.native = None
    for i, motor in enumerate(plant.motors.values()):
        motor.servo.limit, motor.servo.torque, motor.omega = 0.8, 0.05 + 0.02 * i, 3.0 * (-1) ** i
        if i % 2:
            motor.servo.kp, motor.servo.kd, motor.servo.position = 2.0, 0.05, 1.0 + 0.1 * i
    return plant


def state(plant: Plant) -> list[str]:
    """Every number of the motion, to the last bit."""
    motors = [(m.theta, m.omega, m.torque, m.velocity, m.heat) for m in plant.motors.values()]
    ropes = [(rope.tension, rope.speed, rope.slope) for rope, _ in plant.ropes]
    engine = plant.engine
    numbers = [*sum(motors, ()), *sum(ropes, ()), *engine.q, *engine.dq, *engine.applied, *plant.tensions()]
    return [float(number).hex() for number in numbers]


def moved(hand: str, count: int, native: bool = True) -> list[str]:
    plant = closing(hand, native)
    plant.advance(count)
    return state(plant)


@pytest.mark.parametrize("hand", ["jamia", "jamia11"])
def test_a_block_of_steps_is_the_same_steps(hand: str) -> None:
    block, single, by_motor = closing(hand), closing(hand), closing(hand, native=False)
    block.advance(601)
    for _ in range(601):
        single.step()
        by_motor.step()
    assert block.steps == single.steps == by_motor.steps == 601
    assert max(block.tensions()) > 5.0, "ropes pulled"
    assert state(block) == state(single)
    assert state(block) == state(by_motor)


def test_compiled_and_plain_python_agree_to_the_bit() -> None:
    words = [sys.executable, "-c", PLAIN]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    plain = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(plain.stdout) == moved("jamia", 120)


def test_the_engine_knows_its_own_addresses() -> None:
    native = closing("jamia").engine.native
    assert native is not None
    assert all(native)


def test_the_world_takes_blocks_between_what_is_due() -> None:
    """Truth rows, watchdogs and temperatures come at their time, however far the world is asked to go at once."""
    far, near = (World(load_hand("jamia"), load_scene("cylinder"), seed=1) for _ in range(2))
    far.advance(250_250_000)
    for k in range(1, 251):
        near.advance(k * 1_000_000)
    near.advance(250_250_000)
    assert far.t_ns == near.t_ns == 250_000_000
    assert state(far.plant) == state(near.plant)
    assert [node.wake_ns for bus in far.nodes for node in bus] == [node.wake_ns for bus in near.nodes for node in bus]


def test_a_fault_of_a_motor_is_asked_in_every_step() -> None:
    rig = Rig("jamia", homed=True)
    rig.inject("off node=index_motor")
    seen: list[float] = []
    rig.world.plant.motors["ring_motor"].disobeys = lambda command: seen.append(command) or 0.25
    rig.step(0, [])
    assert len(seen) == 4
    assert rig.world.plant.motors["ring_motor"].torque > 0.2
    assert rig.world.plant.motors["index_motor"].torque == 0.0


def test_without_the_library_the_engine_steps_by_its_bindings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("firmware_sim.engine._native", lambda model, data: None)
    plant = closing("jamia")
    assert isinstance(plant.engine, Engine)
    plant.advance(50)
    assert state(plant) == moved("jamia", 50)
