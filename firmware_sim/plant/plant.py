"""The plant: links, object and contacts by the engine, ropes and rotors of our own, in steps of 0.5 ms.

A step is divided where something is sampled within it, so that a sample is of its own instant.
"""

import random
from typing import Any

import numpy as np

from firmware_sim.compiled import addresses, machine_code
from firmware_sim.description import Hand, SimulatorError
from firmware_sim.plant import drivetrain
from firmware_sim.plant.engine import Engine
from firmware_sim.plant.mjcf import STEP_S, model_text, opposed_digits
from firmware_sim.plant.motor import Motor, paced, row_by_row
from firmware_sim.plant.tendon import Routing
from firmware_sim.scene import table as tables
from firmware_sim.scene.scene import Scene, Support
from firmware_sim.scene.stages import Stages
from firmware_sim.scene.table import Table

STEP_NS = round(STEP_S * 1e9)
SLACK_M = (1e-3, 3e-3)
"""Slack of the ropes at power-up [m], drawn between these; the motors were limp."""
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
        sampled: for laws that sample: drivetrain, joint angles [rad] and velocities [rad/s], room for tensions [N].
        steps: how many whole steps were made.
        part_ns: time since the last of them, less than a step [ns].
    """

    def __init__(self, hand: Hand, scene: Scene, seed: int = 0, homed: bool = False, compiled: bool = True) -> None:
        """Build the model.

        Args:
            hand: the hand. scene: object and support. seed: of the ropes' slack. homed: whether the ropes start taut.
            compiled: whether its laws are; no to start in a second less, and to take longer for each step.

        Raises:
            SimulatorError: the engine does not accept the hand, or a tendon names no motor or joint.
        """
        self.hand, self.scene, self.steps = hand, scene, 0
        self.part_ns = 0
        try:
            self.engine = Engine(model_text(hand, scene), len(hand.joints))
        except ValueError as error:
            raise SimulatorError(f"hand {hand.name}: {str(error).splitlines()[0]}") from error
        self._laws: Any = machine_code(drivetrain) if compiled else drivetrain
        rotors: Any
        if compiled:
            self._rotors, rotors = row_by_row(hand.motors, STEP_S)
        else:
            self._rotors = rotors = [Motor(motor, STEP_S) for motor in hand.motors]
        self.motors = {spec.name: motor for spec, motor in zip(hand.motors, self._rotors, strict=True)}
        routing = self._routing(compiled)
        self.ropes = [(rope, self._rotors[rope.motor]) for rope in routing.tendons]
        self._drivetrain = routing.rows, routing.joints, routing.arms, rotors
        engine = self.engine
        self._bodies = (engine.q, engine.dq, engine.applied, engine.rope_damping) if compiled else None
        native = engine.native
        every = (*self._drivetrain, *self._bodies) if self._bodies else ()
        self._addresses = np.array([*addresses(every), *native], np.int64) if every and native else None
        self._tensions = np.zeros(len(self.ropes))
        self.sampled = (*self._drivetrain, engine.q, engine.dq, self._tensions)
        self.table = self._table(scene.support, compiled) if scene.support else None
        self.contact_forces = self.engine.forces_on("contact", [digit.name for digit in hand.digits])
        self.load = scene.load
        self.stages = Stages(scene.stages, hand.gravity) if scene.stages else None
        self.stage = -1
        self.normal_forces = self.engine.normal_forces([digit.name for digit in hand.digits]) if scene.load else list
        if not homed:
            self._slacken(seed)

    def _routing(self, compiled: bool) -> Routing:
        """Return the ropes."""
        hand = self.hand
        motors = [motor.name for motor in hand.motors]
        for spec in hand.tendons:
            unknown = set(spec.arms) - set(hand.joints)
            if spec.motor not in motors or unknown:
                wrong = ", ".join(sorted(unknown)) or spec.motor
                raise SimulatorError(f"hand {hand.name}: {spec.name}: no such motor or joint: {wrong}")
        return Routing(hand.tendons, hand.joints, motors, [motor.spool_radius for motor in hand.motors], compiled)

    def _table(self, support: Support, compiled: bool) -> Table:
        """Return the table, which looks at the contact forces where the engine has them if laws are compiled."""
        opposed = opposed_digits(self.hand)
        if not compiled:
            return Table(support, opposed)
        places = self.engine.force_places("contact", [digit.name for digit in self.hand.digits])
        return Table(support, opposed, places, machine_code(tables))

    def _slacken(self, seed: int) -> None:
        chance = random.Random(f"slack {seed}")
        for rope, motor in self.ropes:
            motor.theta = -chance.uniform(*SLACK_M) / rope.radius

    @property
    def can_sink(self) -> bool:
        """Whether there is a table that sinks once the object is held."""
        support = self.scene.support
        return support is not None and support.drop_when == "grasped"

    @property
    def t_ns(self) -> int:
        """Time since power-up [ns]."""
        return self.steps * STEP_NS + self.part_ns

    def step(self) -> None:
        """Let ropes pull, rotors turn and links move, once; see ``advance``."""
        self.advance(1)

    def advance(self, count: int) -> None:
        """Let ropes pull, rotors turn and links move; a step that was divided is completed first, and counts.

        Args:
            count: how many steps.

        Raises:
            SimulatorError: the plant's parameters are too extreme for the step.
        """
        while count > 0:
            block = 1 if self.part_ns else min(count, self._undisturbed())
            self._move(block)
            count -= block
            if self.table and self.steps % TABLE_STEPS == 0 and self._watches(self.table):
                self._look_after(self.table)
            if self.load:
                pull = self.load.at(self.steps * STEP_S)
                self.engine.push_object([pull * share for share in self.load.direction])

    def advance_part(self, duration_ns: int) -> None:
        """Divide the step that comes next: make a part of it.

        Args:
            duration_ns: of the part [ns]; with the parts before it less than a step.

        Raises:
            SimulatorError: the plant's parameters are too extreme for the step.
        """
        self._move_for(duration_ns)
        self.part_ns += duration_ns

    def _move_for(self, duration_ns: int) -> None:
        """Make one step of another length [ns]."""
        self._pace(duration_ns * 1e-9)
        try:
            self._move_once(self.struck)
        finally:
            self._pace(STEP_S)

    def _pace(self, step_s: float) -> None:
        """Change the length of the next steps [s]."""
        self.engine.set_timestep(step_s)
        rotors = self._drivetrain[-1]
        if self._bodies is None:
            for motor in rotors:
                motor.pace(step_s)
            return
        for name, value in zip(("step", "lag", "velocity_lag"), paced(step_s), strict=True):
            rotors[name] = value

    def _undisturbed(self) -> int:
        """Return how many steps there are until something other than the drivetrain acts."""
        if self.load:
            return 1
        watched = self.table and self._watches(self.table)
        return TABLE_STEPS - self.steps % TABLE_STEPS if watched else 1 << 30

    def _watches(self, table: Table) -> bool:
        """Whether the table, or what happens after it, can still change anything."""
        return bool(self.stages) or not table.settled

    def _move(self, count: int) -> None:
        """Make steps, in one go unless a fault in a motor wants to be asked in each."""
        if self.part_ns:
            self._move_for(STEP_NS - self.part_ns)
            self.part_ns = 0
            self.steps += 1
            return
        if self._addresses is not None:
            done = self._laws.steps(count, self._addresses)
            self.steps += done
            if done == count:
                return
            if not self.struck:
                raise self._diverged()
        struck = self.struck
        for _ in range(count):
            self._move_once(struck)
            self.steps += 1

    @property
    def struck(self) -> list[Motor]:
        """The motors in which there is a fault."""
        return [motor for motor in self._rotors if motor.faulty]

    def _move_once(self, struck: list[Motor]) -> None:
        """Make a step in which some motors turn by themselves."""
        engine = self.engine
        q, dq, torque, damping = self._bodies or self._lists()
        if not abs(sum(engine.dq.tolist())) < drivetrain.DIVERGED_RAD_S:  # not a number is diverged, too
            raise self._diverged()
        if struck:
            for motor in self._rotors:
                motor.waits = motor in struck
        self._laws.drive(*self._drivetrain, q, dq, torque, damping, not struck)
        for motor in struck:
            motor.follow()
        if not self._bodies:
            engine.applied[:], engine.rope_damping[:] = torque, damping
        engine.step()

    def _lists(self) -> tuple[list[float], list[float], list[float], list[float]]:
        """For plain laws: angles and velocities of the joints, room for torques on them and damping of the ropes."""
        q, dq = self.engine.q.tolist(), self.engine.dq.tolist()
        return q, dq, [0.0] * len(q), [0.0] * len(self.ropes)

    def _diverged(self) -> SimulatorError:
        when = self.steps * STEP_S
        return SimulatorError(f"the plant diverged at {when:.4f} s; expected less extreme parameters")

    def _look_after(self, table: Table) -> None:
        """Sink the table when the object is held, and do with it then what the scene says."""
        before = table.depth
        forces = self.engine.sensed if self._bodies else [] if table.dropped_at is not None else self.contact_forces()
        depth = table.update(self.steps * STEP_S, forces)
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

    def cells(self) -> Any:
        """Return the tension of each tendon at its load cell, now [N], shape (tendons,); memory of the plant's own."""
        q, dq, *_ = self._bodies or self._lists()
        self._laws.tensions(*self._drivetrain, q, dq, self._tensions)
        return self._tensions

    def tensions(self) -> list[float]:
        """Return the tension of each tendon at its load cell, now [N]."""
        return [float(tension) for tension in self.cells().tolist()]
