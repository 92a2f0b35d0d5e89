"""The compiled drivetrain: the same motion as motor by motor, as by Python, and as MuJoCo's own ``mj_step``."""

import subprocess
import sys

import pytest

from firmware_sim.description import load_hand
from firmware_sim.frame import Frame
from firmware_sim.plant import Plant
from firmware_sim.rig import Rig
from firmware_sim.scene import load_scene
from firmware_sim.world import World


def closing(hand: str, native: bool = True, compiled: bool = True) -> Plant:
    """A hand that closes on a cylinder: slack ropes, then taut; some motors follow a torque, others a position."""
    plant = Plant(load_hand(hand), load_scene("cylinder"), seed=3, compiled=compiled)
    if not native:
        plant._native = None
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


@pytest.mark.parametrize("hand", ["jamia", "jamia11"])
def test_however_steps_are_made_they_are_the_same(hand: str) -> None:
    """In a block, one by one, with the engine stepped by its bindings, and by plain Python: equal to the last bit."""
    block, single = closing(hand), closing(hand)
    bindings, plain = closing(hand, native=False), closing(hand, compiled=False)
    block.advance(401)
    for _ in range(401):
        for plant in (single, bindings, plain):
            plant.step()
    assert max(block.tensions()) > 5.0, "ropes pulled"
    for plant in (single, bindings, plain):
        assert plant.steps == block.steps == 401
        assert state(plant) == state(block)


def test_a_whole_hand_says_the_same_compiled_and_plain() -> None:
    """Also with a fault in a motor, in a load cell, and on the wire."""
    worlds = [
        World(load_hand("jamia"), load_scene("cylinder"), seed=4, compiled=compiled) for compiled in (True, False)
    ]
    faults = "runaway node=ring_motor size=0.3 at=20ms", "noise cell=index_tendon", "noise encoder=thumb_motor"
    said = []
    for world in worlds:
        for fault in faults:
            world.faults.inject(fault)
        answers = []
        for k in range(40):
            world.advance(k * 2_000_000)
            for data in (b"\xff" * 7 + b"\xfc", bytes.fromhex("9fff7ff0ff0337ff")):
                answers += world.receive(Frame(1, data))
            answers += world.receive(Frame(0x080, bytes((k,))))
        said.append((answers, state(world.plant)))
    assert said[0] == said[1]


@pytest.mark.parametrize("module", ["server", "rig", "simulate", "bench", "alone"])
def test_who_does_not_step_in_lockstep_waits_for_no_compiler(module: str) -> None:
    code = f"import sys, firmware_sim.{module}; print('numba' in sys.modules)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "False"


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
