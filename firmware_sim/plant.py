"""The plant: links, object and contacts by the engine, ropes and rotors of our own, in steps of 0.5 ms."""

import random

from firmware_sim.description import Hand, SimulatorError
from firmware_sim.engine import Engine
from firmware_sim.mjcf import STEP_S, model_text, opposed_digits
from firmware_sim.motor import Motor
from firmware_sim.scene import Scene
from firmware_sim.stages import Stages
from firmware_sim.table import Table
from firmware_sim.tendon import Tendon

STEP_NS = round(STEP_S * 1e9)
SLACK_M = (1e-3, 3e-3)
"""Slack of the ropes at power-up [m], drawn between these; the motors were limp."""
DIVERGED_RAD_S = 1e5
"""Sum of joint speeds that no hand has [rad/s]."""
TABLE_STEPS = 4
"""The table is looked after at every so many steps."""


class Plant:
    """A hand with its object.

    Attributes:
        hand: its description.
        scene: object and support.
        engine: rigid bodies and contact.
        motors: the rotors by name.
        ropes: each with the rotor that winds it.
        table: what the object stands on; None without support.
        load: what pulls at the object; None in most scenes.
        stages: what is done to the object once it is held; None in most scenes.
        stage: which stage of the scene it is; -1 before the first.
        steps: how many steps were made.
    """

    def __init__(self, hand: Hand, scene: Scene, seed: int = 0, homed: bool = False) -> None:
        """Build the model.

        Args:
            hand: the hand. scene: object and support. seed: of the ropes' slack. homed: whether the ropes start taut.

        Raises:
            SimulatorError: the engine does not accept the hand, or a tendon names no motor or joint.
        """
        self.hand, self.scene, self.steps = hand, scene, 0
        try:
            self.engine = Engine(model_text(hand, scene), len(hand.joints))
        except ValueError as error:
            raise SimulatorError(f"hand {hand.name}: {str(error).splitlines()[0]}") from error
        self.motors = {motor.name: Motor(motor, STEP_S) for motor in hand.motors}
        self.ropes = self._routing()
        self.table = Table(scene.support, opposed_digits(hand)) if scene.support else None
        self.contact_forces = self.engine.forces_on("contact", [digit.name for digit in hand.digits])
        self.load = scene.load
        self.stages = Stages(scene.stages, hand.gravity) if scene.stages else None
        self.stage = -1
        self.normal_forces = self.engine.normal_forces([digit.name for digit in hand.digits]) if scene.load else list
        if not homed:
            self._slacken(seed)

    def _routing(self) -> list[tuple[Tendon, Motor]]:
        """Return each rope with the rotor that winds it."""
        radii = {motor.name: motor.spool_radius for motor in self.hand.motors}
        ropes = []
        for spec in self.hand.tendons:
            unknown = set(spec.arms) - set(self.hand.joints)
            if spec.motor not in radii or unknown:
                wrong = ", ".join(sorted(unknown)) or spec.motor
                raise SimulatorError(f"hand {self.hand.name}: {spec.name}: no such motor or joint: {wrong}")
            ropes.append((Tendon(spec, self.hand.joints, radii[spec.motor]), self.motors[spec.motor]))
        return ropes

    def _slacken(self, seed: int) -> None:
        chance = random.Random(f"slack {seed}")
        for rope, motor in self.ropes:
            motor.theta = -chance.uniform(*SLACK_M) / rope.radius

    @property
    def t_ns(self) -> int:
        """Time since power-up [ns]."""
        return self.steps * STEP_NS

    def step(self) -> None:
        """Let ropes pull, rotors turn and links move.

        Rope damping and Coulomb-like capstan friction are far too steep for an explicit step of the light links: the
        engine takes their slope as a damping of the tendon, implicitly, and what that damping takes now is given back.

        Raises:
            SimulatorError: the plant's parameters are too extreme for the step.
        """
        engine = self.engine
        q, dq = engine.q.tolist(), engine.dq.tolist()
        if not abs(sum(dq)) < DIVERGED_RAD_S:  # not a number is diverged, too
            raise SimulatorError(f"the plant diverged at {self.steps * STEP_S:.4f} s; expected less extreme parameters")
        torque = [0.0] * len(q)
        slopes = []
        for rope, motor in self.ropes:
            motor.advance(rope.radius * rope.pull(q, dq, motor.theta, motor.omega, torque))
            slope = rope.slope
            slopes.append(slope)
            if slope:
                push = slope * rope.speed
                for joint, arm in rope.path:
                    torque[joint] += arm * push
        engine.rope_damping[:] = slopes
        engine.applied[:] = torque
        engine.step()
        self.steps += 1
        if self.table and self.steps % TABLE_STEPS == 0:
            self._look_after(self.table)
        if self.load:
            pull = self.load.at(self.steps * STEP_S)
            engine.push_object([pull * share for share in self.load.direction])

    def _look_after(self, table: Table) -> None:
        """Sink the table when the object is held, and do with it then what the scene says."""
        before = table.depth
        depth = table.update(self.steps * STEP_S, [] if table.dropped_at is not None else self.contact_forces())
        if depth != before:
            self.engine.lower_table(depth - before)
        if self.stages and table.dropped_at is not None:
            now = self.stages.at(self.steps * STEP_S - table.dropped_at)
            self.stage = now.stage
            self.engine.set_gravity(now.gravity)
            self.engine.push_object(list(now.push))
            if now.friction is not None:
                self.engine.set_friction(now.friction)

    def measured_grip(self) -> list[float]:
        """Return the load and the sum of normal forces of each digit [N]; nothing in a scene without load."""
        return [self.load.at(self.steps * STEP_S), *self.normal_forces()] if self.load else []

    def tensions(self) -> list[float]:
        """Return the tension of each tendon at its load cell, now [N]."""
        q, dq = self.engine.q.tolist(), self.engine.dq.tolist()
        return [rope.tension_at(q, dq, motor.theta, motor.omega) for rope, motor in self.ropes]
