"""The plant of the simulation: links, object, contacts, tendons and rotors, in time steps of 0.5 ms.

The engine computes links, object and contacts. ``drivetrain`` computes tendons and rotors. If a
node samples the plant within a step, the plant divides the step at the exact time of the sample.
"""

import random
from typing import Any

import numpy as np

from firmware_sim.compiled import array_addresses, code_of_kernel, compile_module_kernels
from firmware_sim.description.hand_description import Hand, SimulatorError
from firmware_sim.plant import drivetrain
from firmware_sim.plant.mjcf import STEP_S, model_text, opposed_digits, sink_direction
from firmware_sim.plant.motor import Motor, motor_rows, time_step_factors
from firmware_sim.plant.rigid_body_engine import RigidBodyEngine
from firmware_sim.plant.tendon import TendonRouting
from firmware_sim.scene import support_table as support_kernels
from firmware_sim.scene.scene import Scene, SinkingTable
from firmware_sim.scene.stage_sequence import StageSequence
from firmware_sim.scene.support_table import SupportTable

STEP_NS = round(STEP_S * 1e9)
"""Time step of the plant [ns]."""
INITIAL_SLACK_RANGE_M = (1e-3, 3e-3)
"""Range of the random slack of tendons at power-up [m].

At power-up, tendons are slack because the motors were off before.
"""
LARGEST_OVERLAP_M = 3e-3
"""Largest depth to which an object is allowed to overlap a link or the palm at power-up [m]."""
TABLE_UPDATE_STEPS = 4
"""Number of plant steps from one update of the table to the next."""


class Plant:
    """The simulated mechanics of a hand and an object.

    Attributes:
        hand: description of the hand.
        scene: description of object, support and later events.
        engine: rigid bodies and contacts.
        motors: rotors by the names of the motors.
        tendons: each tendon with the rotor that winds it, in the order of ``Hand.all_tendons``.
        table: table under the object, or None in a scene without a support. load: growing force on
        the object, or None in a scene without a load. stages: stages of the scene after the grasp,
        or None in a scene without stages.
        stage: index of the present stage, or -1 before the first stage.
        sampled: arguments for the kernels by which nodes read the plant: arrays of the drivetrain,
            joint angles [rad], joint velocities [rad/s], and an array into which tensions are
            written [N].
        steps: number of completed steps.
        step_progress_ns: completed part of the present time step [ns].
    """

    def __init__(
        self, hand: Hand, scene: Scene, seed: int = 0, homed: bool = False, is_compiled: bool = True
    ) -> None:
        """Build the plant in its state at power-up.

        Args:
            hand: description of the hand.
            scene: description of object, support and later events.
            seed: seed for the random slack of the tendons.
            homed: True to start with taut tendons.
            is_compiled: True to use compiled kernels. If False, the start of the plant is one
                second faster, but each step is slower.

        Raises:
            SimulatorError: MuJoCo does not accept the hand, a tendon names an unknown motor or
                joint, or the object is inside the hand.
        """
        self.hand = hand
        self.scene = scene
        self.steps = 0
        self.step_progress_ns = 0
        try:
            self.engine = RigidBodyEngine(model_text(hand, scene), len(hand.joints))
        except ValueError as error:
            raise SimulatorError(f"hand {hand.name}: {str(error).splitlines()[0]}") from error
        self._check_overlaps()
        self._kernels: Any = compile_module_kernels(drivetrain) if is_compiled else drivetrain
        rotors: Any
        if is_compiled:
            self._rotors, rotors = motor_rows(hand.motors, STEP_S)
        else:
            self._rotors = rotors = [Motor(motor, STEP_S) for motor in hand.motors]
        # In the dict below, a key is the index of the first tendon of a spool pair, and the value
        # is the index of the second tendon.
        first_tendons_of_pairs = [i for i, spec in enumerate(hand.tendons) if spec.pretension]
        self._antagonist = {
            i: len(hand.tendons) + pair_index for pair_index, i in enumerate(first_tendons_of_pairs)
        }
        self._tendons_of_pairs = np.array(list(self._antagonist.items()), np.int64).ravel()
        self.motors = {
            spec.name: motor for spec, motor in zip(hand.motors, self._rotors, strict=True)
        }
        routing = self._build_routing(is_compiled)
        self.tendons = [(tendon, self._rotors[tendon.motor]) for tendon in routing.tendons]
        self._drivetrain = routing.rows, routing.joints, routing.arms, rotors
        engine = self.engine
        self._bodies = (
            (engine.q, engine.dq, engine.applied, engine.tendon_damping) if is_compiled else None
        )
        native_engine = engine.native
        arrays = (*self._drivetrain, *self._bodies) if self._bodies else ()
        # The kernel gets a single array of addresses, because each argument would cost 0.2 us in
        # every tick.
        self._addresses = (
            np.array([*array_addresses(arrays), *native_engine], np.int64)
            if arrays and native_engine
            else None
        )
        self._run_compiled_steps = code_of_kernel(self._kernels.steps) if is_compiled else None
        self._tensions = np.zeros(len(self.tendons))
        self.sampled = (*self._drivetrain, engine.q, engine.dq, self._tensions)
        self._sink_direction = sink_direction(hand.gravity)
        self.table = self._build_table(scene.support, is_compiled) if scene.support else None
        self.contact_forces = self.engine.make_force_reader(
            "contact", [digit.name for digit in hand.digits]
        )
        self._contact_sensors = self.engine.force_components(
            "contact", [digit.name for digit in hand.digits]
        )
        self.load = scene.load
        self.stages = StageSequence(scene.stages, hand.gravity) if scene.stages else None
        self.stage = -1
        self.normal_forces = (
            self.engine.normal_forces([digit.name for digit in hand.digits]) if scene.load else list
        )
        if not homed:
            self._unwind_spools(seed)

    def _check_overlaps(self) -> None:
        """Raise an error if the object overlaps the open hand.

        If the object overlapped the hand, contact forces would throw the hand and the object apart.
        """
        overlaps = {
            name: depth
            for name, depth in self.engine.overlaps().items()
            if depth > LARGEST_OVERLAP_M
        }
        if overlaps:
            name = max(overlaps, key=lambda name: overlaps[name])
            depth = f"{1e3 * overlaps[name]:.0f} mm"
            raise SimulatorError(
                f"scene {self.scene.name}: the object is {depth} inside {name} of the open hand {self.hand.name}; "
                "expected a smaller object, or another position_m"
            )

    def _build_routing(self, is_compiled: bool) -> TendonRouting:
        """Build the tendons of the hand and their pulleys.

        If the description of a tendon names an unknown motor or joint, raise an error.
        """
        hand = self.hand
        motors = [motor.name for motor in hand.motors]
        for spec in hand.tendons:
            unknown_joints = set(spec.arms) - set(hand.joints)
            if spec.motor not in motors or unknown_joints:
                unknown_text = ", ".join(sorted(unknown_joints)) or spec.motor
                raise SimulatorError(
                    f"hand {hand.name}: {spec.name}: no such motor or joint: {unknown_text}"
                )
        return TendonRouting(
            hand.all_tendons,
            hand.joints,
            motors,
            [motor.spool_radius for motor in hand.motors],
            is_compiled,
        )

    def _build_table(self, support: SinkingTable, is_compiled: bool) -> SupportTable:
        """Build the table under the object.

        With compiled kernels, the returned ``SupportTable`` reads the contact forces directly from
        MuJoCo's memory.
        """
        hand = self.hand
        closing_digit_indices = [
            i for i, digit in enumerate(hand.digits) if digit in hand.closing_digits
        ]
        is_opposed = [opposed_digits(hand)[i] for i in closing_digit_indices]
        if not is_compiled:
            return SupportTable(support, is_opposed, [3 * i for i in closing_digit_indices])
        indices = self.engine.force_indices(
            "contact", [hand.digits[i].name for i in closing_digit_indices]
        )
        return SupportTable(support, is_opposed, indices, compile_module_kernels(support_kernels))

    def _unwind_spools(self, seed: int) -> None:
        """Unwind a random length of tendon from each spool, so that each tendon is slack."""
        rng = random.Random(f"slack {seed}")
        for i, (spec, (tendon, motor)) in enumerate(
            zip(self.hand.tendons, self.tendons, strict=False)
        ):
            # A negative wound length means that the tendon is unwound from the spool.
            wound_length = -rng.uniform(*INITIAL_SLACK_RANGE_M)
            motor.theta = wound_length / tendon.radius
            if spec.pretension:
                # The tendons of a spool pair stay taut, because the pair was mounted while the
                # spool was at its present angle.
                tendon.extra_length += wound_length
                self.tendons[self._antagonist[i]][0].extra_length -= wound_length

    @property
    def has_sinking_table(self) -> bool:
        """Return True if the scene has a table that sinks after the object has been grasped."""
        support = self.scene.support
        return support is not None and support.drop_when == "grasped"

    @property
    def t_ns(self) -> int:
        """Return the time since power-up [ns]."""
        return self.steps * STEP_NS + self.step_progress_ns

    def step(self) -> None:
        """Advance the plant by one time step, see ``advance``."""
        self.advance(1)

    def advance(self, count: int) -> None:
        """Advance the plant by a number of time steps.

        If an earlier call has divided a time step, the method first completes the divided step. A
        divided step counts as one step.

        Args:
            count: number of time steps.

        Raises:
            SimulatorError: the plant has diverged, because its parameters are too extreme for the
                time step.
        """
        while count > 0:
            step_count = (
                1 if self.step_progress_ns else min(count, self._steps_until_table_update())
            )
            self._run_steps(step_count)
            count -= step_count
            # The table and the load of the scene change only between two time steps, never within a
            # time step.
            if (
                self.table
                and self.steps % TABLE_UPDATE_STEPS == 0
                and self._is_table_active(self.table)
            ):
                self._update_table(self.table)
            if self.load:
                force = self.load.force_at(self.steps * STEP_S)
                self.engine.push_object([force * component for component in self.load.direction])

    def advance_within_step(self, duration_ns: int) -> None:
        """Advance the plant by a fraction of the next time step.

        Args:
            duration_ns: duration of the advance [ns]. The sum of all durations within a step must
                be less than the step.

        Raises:
            SimulatorError: the plant has diverged, because its parameters are too extreme for the
                time step.
        """
        self._run_step_of_duration(duration_ns)
        self.step_progress_ns += duration_ns

    def _run_step_of_duration(self, duration_ns: int) -> None:
        """Run one step of the given duration [ns] instead of a step of ``STEP_NS``."""
        self._set_step_duration(duration_ns * 1e-9)
        try:
            self._run_single_step(self.faulty_motors)
        finally:
            self._set_step_duration(STEP_S)

    def _set_step_duration(self, step_s: float) -> None:
        """Set the time step of MuJoCo and the rotors for the following steps [s]."""
        self.engine.set_timestep(step_s)
        rotors = self._drivetrain[-1]
        if self._bodies is None:
            for motor in rotors:
                motor.set_step_duration(step_s)
            return
        for name, value in zip(
            ("step", "lag", "velocity_lag"), time_step_factors(step_s), strict=True
        ):
            rotors[name] = value

    def _steps_until_table_update(self) -> int:
        """Return the number of steps until the scene next acts on the plant.

        A scene acts on the plant by its table, its load on the object, and its stages (events after
        the grasp).
        """
        if self.load:
            return 1
        is_table_active = self.table and self._is_table_active(self.table)
        return TABLE_UPDATE_STEPS - self.steps % TABLE_UPDATE_STEPS if is_table_active else 1 << 30

    def _is_table_active(self, table: SupportTable) -> bool:
        """Return True if the table still moves, or if the scene has stages (events after the grasp)."""
        return bool(self.stages) or not table.is_settled

    def _run_steps(self, count: int) -> None:
        """Run a number of time steps of the plant.

        If no motor has a fault, a single call of a compiled kernel runs all ``count`` time steps.
        """
        if self.step_progress_ns:
            # The code first completes the rest of a divided time step, so that later steps start at
            # multiples of STEP_NS.
            self._run_step_of_duration(STEP_NS - self.step_progress_ns)
            self.step_progress_ns = 0
            self.steps += 1
            return
        if self._run_compiled_steps and self._addresses is not None:
            finished_steps = self._run_compiled_steps(count, self._addresses)
            self.steps += finished_steps
            if finished_steps == count:
                return
            if not self.faulty_motors:
                raise self._divergence_error()
        faulty_motors = self.faulty_motors
        for _ in range(count):
            self._run_single_step(faulty_motors)
            self.steps += 1

    @property
    def faulty_motors(self) -> list[Motor]:
        """List the motors whose encoder or power stage has a fault."""
        return [motor for motor in self._rotors if motor.faulty]

    def _run_single_step(self, faulty_motors: list[Motor]) -> None:
        """Run one time step of the plant.

        Interpreted Python code integrates the motors in ``faulty_motors``. A compiled kernel
        integrates all other motors.
        """
        engine = self.engine
        q, dq, torque, damping = self._bodies or self._joint_lists()
        if (
            not abs(sum(engine.dq.tolist())) < drivetrain.DIVERGENCE_SPEED_RAD_S
        ):  # the condition is written in this form so that it is true if the sum of the speeds is NaN
            raise self._divergence_error()
        if faulty_motors:
            for motor in self._rotors:
                motor.steps_alone = motor in faulty_motors
        self._kernels.step_drivetrain(*self._drivetrain, q, dq, torque, damping, not faulty_motors)
        for motor in faulty_motors:
            motor.step_without_plant()
        if not self._bodies:
            engine.applied[:] = torque
            engine.tendon_damping[: len(damping)] = damping
        engine.step()

    def _joint_lists(self) -> tuple[list[float], list[float], list[float], list[float]]:
        """Return the four lists that the kernels need when they run as interpreted Python.

        The lists contain the joint angles, the joint velocities, the joint torques, and the damping
        coefficients of the tendons. The torques and damping coefficients in the returned lists are
        zero, and the kernels replace these zeros.
        """
        q = self.engine.q.tolist()
        dq = self.engine.dq.tolist()
        return q, dq, [0.0] * len(q), [0.0] * len(self.tendons)

    def _divergence_error(self) -> SimulatorError:
        """Build the error that reports a diverged plant."""
        time_s = self.steps * STEP_S
        return SimulatorError(
            f"the plant diverged at {time_s:.4f} s; expected less extreme parameters"
        )

    def _update_table(self, table: SupportTable) -> None:
        """Lower the table after the hand has grasped the object, and then apply the stages of the scene."""
        depth_before = table.depth
        forces = (
            self.engine.sensed
            if self._bodies
            else []
            if table.dropped_at is not None
            else self.contact_forces()
        )
        depth = table.update(self.steps * STEP_S, forces)
        if depth != depth_before:
            self.engine.lower_table(depth - depth_before, self._sink_direction)
        if self.stages and table.dropped_at is not None:
            scene_state = self.stages.state_at(self.steps * STEP_S - table.dropped_at)
            self.stage = scene_state.stage
            self.engine.set_gravity(scene_state.gravity)
            self.engine.push_object(list(scene_state.push))
            if scene_state.friction is not None:
                self.engine.set_friction(scene_state.friction)

    def measured_grip_forces(self) -> list[float]:
        """Return the load on the object, then the normal force of each digit on the object [N].

        If the scene has no load, the returned list is empty.
        """
        return [self.load.force_at(self.steps * STEP_S), *self.normal_forces()] if self.load else []

    def cells(self) -> Any:
        """Compute the present tension of each tendon at the load cell of the tendon.

        Returns:
            Tensions, shape (tendons,) [N]. The array belongs to the plant, and the next call of the
            method overwrites the array.
        """
        q, dq, *_ = self._bodies or self._joint_lists()
        self._kernels.tensions(*self._drivetrain, q, dq, self._tensions)
        return self._tensions

    def tensions(self) -> list[float]:
        """Return the present tension of each tendon at the load cell of the tendon [N].

        For a spool pair, the result contains a single value, the difference between the tensions of
        its two tendons.
        """
        tensions: list[float] = self._net_tensions(self.cells()).tolist()
        return tensions

    def _net_tensions(self, cell_tensions: Any) -> Any:
        """Return the tension of each tendon or spool pair of the hand [N], given the tensions at all load cells."""
        net_tensions = cell_tensions[: len(self.hand.tendons)]
        if self._antagonist:
            net_tensions = net_tensions.copy()
            net_tensions[self._tendons_of_pairs[::2]] -= cell_tensions[len(net_tensions) :]
        return net_tensions

    def true_state(self) -> list[Any]:
        """Return arrays with the values of a row of the truth file, in the order of its columns.

        The function ``truth_file.truth_columns`` describes the columns.
        """
        engine = self.engine
        cell_tensions = self.cells()
        arrays = [
            self._net_tensions(cell_tensions),
            engine.q,
            engine.dq,
            *self._rotor_state(),
            -engine.sensed[self._contact_sensors],
            engine.object_pose_array,
            (engine.object_speed(),),
        ]
        if self.has_sinking_table and self.table:
            arrays.append((self.table.depth,))
        if self.load:
            arrays.append(self.measured_grip_forces())
        if self._antagonist:
            arrays.append(cell_tensions[self._tendons_of_pairs])
        return arrays

    def _rotor_state(self) -> tuple[Any, Any]:
        """Return the spool angle [rad] and the torque [N m] of each motor."""
        rotors = self._drivetrain[-1]
        if self._bodies:
            return rotors["theta"], rotors["torque"]
        return [motor.theta for motor in rotors], [motor.torque for motor in rotors]

    def tensions_in_pairs(self) -> list[float]:
        """Return the tensions of the first and the second tendon of each spool pair [N], pair by pair."""
        if not self._antagonist:
            return []
        pair_tensions: list[float] = self.cells()[self._tendons_of_pairs].tolist()
        return pair_tensions
