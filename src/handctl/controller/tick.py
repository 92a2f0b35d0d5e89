"""One tick of the controller, as a pure function.

A tick receives frames and computes the frames to send. A ``TickIn`` contains all inputs of a tick,
so that a tick from a log can be executed again. A tick has four steps. Each step is a method, and
the control loop calls the four methods one by one. The step ``begin_tick`` processes the received
frames. The step ``decide`` applies requests and chooses the goals. The step ``command`` uses
streamed targets and goals to compute the frames that will be sent. The step ``conclude`` completes
the state and the output of the tick. Because of the four steps, the control loop can read requests
and streamed targets as late as possible, and can send the commands as early as possible. The method
``tick`` executes all four steps of a tick.

receive   frames -> values of drives and sensors
estimate  values -> tension, excursion, contact
judge     faults -> action demanded by safety
decide    requests, safety, mode, program -> goals
command   streamed targets, goals -> tension -> motor torque
encode    motor torque -> frames

Compiled functions (``core.tick_stages``) compute the numbers in the state block. Python code makes
the decisions, and calls the compiled functions in order. A tick works on a copy of the controller's
state.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from handctl.compiled import compile_kernels
from handctl.controller import gain_change, hand_modes
from handctl.controller.apply_requests import apply_requests
from handctl.controller.client_lease import enforce_lease
from handctl.controller.controller_state import (
    ControllerDecisions,
    ControllerState,
    layout_of_state,
)
from handctl.controller.monitor.safety_thresholds import compiled_constants, safety_limits
from handctl.controller.monitor.unsolicited_replies import detect_unsolicited_replies
from handctl.controller.relaxation import is_open_loop, present_relax_rate
from handctl.controller.target_streams import apply_target
from handctl.controller.telemetry import TelemetryPlaces
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.block_schema import BlockLayout, TableOffsets
from handctl.core.control_law.goal_writer import sample_trajectories, write_goals
from handctl.core.control_law.required_tensions import evaluate_goals, write_motor_torques
from handctl.core.detectors.bus_faults import EvidenceTable
from handctl.core.detectors.fault_detection import empty_evidence
from handctl.core.estimation.consistency_events import consistency_events
from handctl.core.estimation.filter_prediction import FilterPrediction
from handctl.core.hand_constants import HandConstants
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import (
    HandMode,
    PackedTelemetry,
    TickEvent,
    TickIn,
    TickOut,
    TickRequest,
    Vector,
)
from handctl.core.wire import cyclic_frames
from handctl.core.wire.wire_table_building import build_wire_tables
from handctl.core.wire.wire_tables import WireBlock, WordBlock
from handctl.drives.cia404.amplifier import AmplifierState
from handctl.drives.contract import Drive, DrivePhase, DriveState, DriveTarget
from handctl.drives.frame import Frame, make_tuple
from handctl.drives.frame_records import (
    FIRST_PAYLOAD_WORD,
    NO_FRAMES,
    WORDS_PER_RECORD,
    Frames,
    WordRows,
    concatenate_frames,
    frames_as_records,
)
from handctl.drives.sensors.contract import SensorInterface
from handctl.hand.dynamics import required_torque
from handctl.programs.program import TARE_PHASE, Program, ProgramProgress
from handctl.programs.requests import (
    REFUSAL_EVENT_PREFIX,
    parse_target,
    requests_and_stream_targets,
)
from handctl.safety.safety_action import SafetyAction
from handctl.safety.safety_limits import SafetyLimits
from handctl.safety.tick_verdict import (
    FaultFinding,
    filter_error_frames,
    judge_tick,
    newly_active_faults,
    second_controller_reports,
)

NO_REQUESTS: tuple[hand_modes.OperatorRequests, tuple[TickEvent, ...]] = (
    hand_modes.OperatorRequests(),
    (),
)
ACTIVE = HandMode.ACTIVE
CUT = HandMode.CUT
DONE = HandMode.DONE
RELAX = HandMode.RELAX
SILENT = HandMode.SILENT
_MODES_WITHOUT_COMMANDS = (SILENT, DONE)
"""Modes in which the drives receive no commands."""
_MODES_WITH_GOALS = (ACTIVE, RELAX)
"""Modes in which the goals of the digits determine the motor torques."""
FrameKernelArguments = tuple[TableOffsets, Vector, TableOffsets, WordBlock, TableOffsets]
"""Arguments of a compiled function for frames, see ``DerivedConstants.frame_kernel_args``."""


@dataclass(frozen=True, slots=True)
class DerivedConstants:
    """Constants of a run that follow from the configuration of the controller.

    Attributes:
        limits: thresholds of the safety monitor for the hand.
        layout: layout of the state block.
        constants: constants for the compiled code.
        kernel_args: arguments of a compiled function after the state block: table positions of the
            state block, then block and table positions of ``constants``.
        prediction: prediction of the filter states.
        torque_elements: elements of the commanded torques in the state block.
        wire: signal tables of the drives' cyclic frames.
        frame_kernel_args: arguments of a compiled function for frames, after the state block:
            ``kernel_args``, then ``wire.kernel_args``.
        telemetry_places: places of the telemetry in the state block.
        drive_index_by_id: index of the drive to which an identifier belongs, by bus and identifier.
        amplifier_index_by_id: index of the CiA 404 amplifier, by bus and identifier.
        sends_sync: True if the sensor node needs SYNC frames. On a bus without SYNC frames for the
            sensor node, the host sends SYNC after the command of a CiA 402 drive.
        frame_template: rows for the frames of a tick. Row 0 contains the SYNC frame of the sensor node,
            and all other rows are empty.
        fault_evidence: (faults, instances) memory for the evidence of each fault. Each tick
            overwrites the evidence of the last tick.
    """

    limits: SafetyLimits
    layout: BlockLayout
    constants: HandConstants
    kernel_args: tuple[TableOffsets, Vector, TableOffsets]
    prediction: FilterPrediction
    torque_elements: slice
    wire: WireBlock
    frame_kernel_args: FrameKernelArguments
    telemetry_places: TelemetryPlaces
    drive_index_by_id: dict[tuple[int, int], int]
    amplifier_index_by_id: dict[tuple[int, int], int]
    sends_sync: bool
    frame_template: WordRows
    fault_evidence: EvidenceTable

    def with_gains(
        self, model: HandModel, limits: SafetyLimits, constants: HandConstants
    ) -> "DerivedConstants":
        """Return a copy for new gains: a model, thresholds and constants that replace the present ones."""
        kernel_args = (self.layout.offsets, constants.block, constants.layout.offsets)
        return replace(
            self,
            limits=limits,
            constants=constants,
            kernel_args=kernel_args,
            frame_kernel_args=(*kernel_args, *self.wire.kernel_args),
            prediction=FilterPrediction(model, self.layout),
        )

    @staticmethod
    def from_configuration(
        model: HandModel,
        drives: tuple[Drive, ...],
        sensors: SensorInterface,
        limits: SafetyLimits,
        constants: HandConstants,
    ) -> "DerivedConstants":
        """Compute the constants that follow from a hand, its drives, its sensors and the safety thresholds."""
        layout = layout_of_state(model, len(sensors.ids))
        wire = WireBlock(
            build_wire_tables(
                drives,
                sensors,
                constants.layout.view(constants.block, "servo").astype(bool).tolist(),
                model.torque_gain,
            )
        )
        first_torque = layout.starts["tendon"] + s.COMMANDED_TORQUE * layout.axes["tendon"]
        frame_template = np.zeros((wire.max_frames, WORDS_PER_RECORD), dtype=np.uint64)
        frame_template[0] = frames_as_records([sensors.sync(0)]).rows[0]
        kernel_args = (layout.offsets, constants.block, constants.layout.offsets)
        return DerivedConstants(
            limits=limits,
            layout=layout,
            constants=constants,
            kernel_args=kernel_args,
            prediction=FilterPrediction(model, layout),
            torque_elements=slice(first_torque, first_torque + len(drives)),
            wire=wire,
            frame_kernel_args=(*kernel_args, *wire.kernel_args),
            telemetry_places=TelemetryPlaces(layout),
            drive_index_by_id={
                (drive.bus, can_id): n
                for n, drive in enumerate(drives)
                for can_id in drive.node_ids
            },
            amplifier_index_by_id={
                (amplifier.bus, can_id): i
                for i, amplifier in enumerate(sensors.amplifiers)
                for can_id in (*amplifier.service_ids, *amplifier.tpdo_ids)
            },
            sends_sync=bool(sensors.ids),
            frame_template=frame_template,
            fault_evidence=empty_evidence(layout),
        )


@dataclass(frozen=True, slots=True)
class Controller:
    """Constants of a run. The method ``tick`` uses the constants to compute each new state from the last state.

    ``tick`` is a pure function of the controller, the state, and a ``TickIn``.

    Attributes:
        model: model of the hand, with gains and their designs.
        drives: the motor of each tendon, in the order of the tendons.
        sensors: sensor node of the hand.
        program: program that sets the goals of the digits.
        tare_tensions: (N,) tare of each load cell [N].
        motor_zeros: (N,) zero angle of each motor [rad].
        arm_at_once: True to arm the hand without a request, as soon as every node has replied.
        identities: identities of the drives in the calibration, or an empty tuple if they are
            unknown.
        replacement_limits: thresholds of the safety monitor that replace the thresholds of the
            hand. If the value is None, the thresholds of the hand apply.
        design_cache: cache of the controller designs for gains that are set during a run.
        reusable_constants: constants of a controller that differs from the new controller only in
            its gains. After a change of gains during a run, the new controller uses the tables of
            ``reusable_constants``. If the value is None, all tables are computed.
        derived_constants: constants that are computed from the other attributes of the controller.
    """

    model: HandModel
    drives: tuple[Drive, ...]
    sensors: SensorInterface
    program: Program
    tare_tensions: Vector
    motor_zeros: Vector
    arm_at_once: bool = True
    identities: tuple[str, ...] = ()
    replacement_limits: SafetyLimits | None = None
    design_cache: gain_change.DesignCache = field(
        default_factory=gain_change.DesignCache, compare=False, repr=False
    )
    reusable_constants: DerivedConstants | None = field(default=None, compare=False, repr=False)
    derived_constants: DerivedConstants = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        """Compute ``derived_constants`` from the other attributes of the controller."""
        if self.reusable_constants is None:
            compile_kernels()
        limits = self.replacement_limits or safety_limits(self.model, self.drives, self.sensors)
        constants = compiled_constants(
            self.model, self.drives, self.sensors, limits, self.tare_tensions, self.motor_zeros
        )
        derived_constants = (
            self.reusable_constants.with_gains(self.model, limits, constants)
            if self.reusable_constants
            else DerivedConstants.from_configuration(
                self.model, self.drives, self.sensors, limits, constants
            )
        )
        object.__setattr__(self, "derived_constants", derived_constants)

    def initial_state(self) -> ControllerState:
        """Return the state before the first tick.

        The state before the first tick depends only on the configuration of the controller.
        """
        drives = tuple(drive.initial_state() for drive in self.drives)
        decisions = ControllerDecisions(
            tuple(drive.with_values() for drive in drives),
            self.program.initial_progress(self.model),
            amplifiers=tuple(amplifier.initial_state() for amplifier in self.sensors.amplifiers),
        )
        state = ControllerState(
            self.derived_constants.layout, self.derived_constants.layout.initial.copy(), decisions
        )
        state.is_arming_requested = self.arm_at_once
        state.view("turn_sigma")[...] = self.derived_constants.constants.layout.view(
            self.derived_constants.constants.block, "range_sigma"
        )
        for n, drive_state in enumerate(drives):
            self.store_drive_state(state, n, drive_state)
        self._write_progress(state)
        return state

    def torque_cut_frames(self) -> tuple[Frame, ...]:
        """Return the frames that remove the torque of every motor."""
        return tuple(frame for drive in self.drives for frame in drive.torque_cut_frames())

    def tick(
        self, last_state: ControllerState, tick_input: TickIn
    ) -> tuple[ControllerState, TickOut]:
        """Compute one tick of the controller.

        Args:
            last_state: state after the previous tick.
            tick_input: all inputs of the tick.

        Returns:
            The state after the tick, and the output of the tick.

        Raises:
            ValueError: a command cannot be encoded. The tick sends no commands if a command cannot
                be encoded.
        """
        step = self.begin_tick(last_state, tick_input)
        step.decide(tick_input.requests)
        step.command(())
        return step.conclude()

    def begin_tick(self, last_state: ControllerState, tick_input: TickIn) -> "TickInProgress":
        """Process the received frames, and run the correction and the prediction of the tension filter.

        Args:
            last_state: state after the previous tick.
            tick_input: inputs of the tick. The requests in the input are ignored.
        """
        gains = last_state.decisions.gains
        controller = (
            self
            if gains is None or gains is self.model.gains
            else self.design_cache.controller(self, gains)
        )
        state = last_state.copy()
        second_controller_signs = controller._process_frames(
            last_state, state, tick_input, frames_as_records(tick_input.frames)
        )
        return TickInProgress(controller, last_state, state, tick_input, second_controller_signs)

    def _decide_goals(self, tick_in_progress: "TickInProgress", requests: tuple[str, ...]) -> None:
        """Apply requests, judge faults, and choose mode and goals, see ``TickInProgress.decide``."""
        last_state, state, tick_input = (
            tick_in_progress.last_state,
            tick_in_progress.state,
            tick_in_progress.tick_input,
        )
        operator_requests, request_events = NO_REQUESTS
        if requests:
            operator_requests, request_events = apply_requests(
                self.model, self.program, state, requests
            )
        events = (
            consistency_events(self.model, last_state, state) + request_events
            if state.run_integers[s.CONSISTENCY_CHANGED]
            else request_events
        )
        if request_events or state.decisions.refusals:
            self._count_refusals(state, request_events)
        if state.decisions.lease is not None:
            events += enforce_lease(self.model, state)
        action, findings = self._judge_faults(
            state, tick_input, tick_in_progress.second_controller_signs
        )
        t = tick_input.t_ns / 1e9
        mode_events = hand_modes.next_mode(
            self.model,
            self.drives,
            state,
            action,
            operator_requests,
            tick_in_progress.second_controller_signs,
            t,
            self.identities,
        )
        program_events = self._advance_program(state, action)
        last_progress = last_state.decisions.progress
        if state.decisions.progress is not last_progress:
            self._write_progress(state, last_progress)
        if findings:
            events += tuple(map(_fault_event, findings))
        tick_in_progress.action = action
        tick_in_progress.events = events + mode_events + program_events

    def _command_drives(
        self, tick_in_progress: "TickInProgress", targets: tuple[TickRequest, ...]
    ) -> None:
        """Apply targets, and compute the frames to send, see ``TickInProgress.command``."""
        state, tick_input = tick_in_progress.state, tick_in_progress.tick_input
        for target in targets:
            tick_in_progress.events += apply_target(
                self.model, state, parse_target(target), tick_input.t_ns
            )
        if state.decisions.pending_gains:
            tick_in_progress.state_before_torques = state.copy()
        action = tick_in_progress.action
        ticks = tick_input.k - tick_in_progress.last_state.k
        if state.mode == ACTIVE and self.model.inverse_dynamics is required_torque:
            frame_rows = self._first_frame_rows(state)
            next_drive, count = self._command_active_hand(state, frame_rows, action, ticks)
        else:
            self._compute_torques(state, action, ticks)
            if state.mode in _MODES_WITHOUT_COMMANDS:
                shutdown_frames = hand_modes.shutdown_frames(self.drives, state)
                tick_in_progress.sent_frames = frames_as_records(shutdown_frames)
                return
            frame_rows = self._first_frame_rows(state)
            next_drive, count = self._encode_commands(state, frame_rows, 0, 1)
        tick_in_progress.sent_frames = self._complete_frames(
            state, frame_rows, next_drive, count, tick_input.t_ns
        )

    def _conclude_tick(self, tick_in_progress: "TickInProgress") -> tuple[ControllerState, TickOut]:
        """Return the state after the tick, and the output of the tick. See ``TickInProgress.conclude``.

        If new gains are pending, first design the control loop for the new gains.
        """
        state = tick_in_progress.state
        if tick_in_progress.state_before_torques:
            tick_in_progress.events += self._design_pending_gains(
                tick_in_progress.state_before_torques,
                state,
                tick_in_progress.action,
                tick_in_progress.tick_input.k - tick_in_progress.last_state.k,
            )
        derived_constants = self.derived_constants
        elements = derived_constants.telemetry_places.elements
        telemetry = np.empty(len(elements))
        tick_stages.store_commands(state.block, *derived_constants.kernel_args, elements, telemetry)
        mode = state.mode
        phase = state.progress.phase if mode == ACTIVE else mode.name.lower()
        tick_output = make_tuple(TickOut, (
            tick_in_progress.sent_frames, mode, phase, tick_in_progress.action,
            PackedTelemetry(telemetry, derived_constants.telemetry_places.slices),
            tick_in_progress.events, state.digest(),
        ))  # fmt: skip
        return state, tick_output

    # receive, estimate

    def _process_frames(
        self,
        last_state: ControllerState,
        state: ControllerState,
        tick_input: TickIn,
        frames: Frames,
    ) -> tuple[str, ...]:
        """Process received frames, and run the correction and the prediction of the filter that estimates tensions.

        Return texts that describe signs of a second controller on the bus.
        """
        block = state.block
        derived_constants = self.derived_constants
        kernel_args = derived_constants.kernel_args
        frame_kernel_args = derived_constants.frame_kernel_args
        if state.decisions.amplifiers:
            groups_not_ready = self._groups_not_ready(state.decisions.amplifiers)
            wire = derived_constants.wire.without_groups(groups_not_ready)
            frame_kernel_args = (*kernel_args, *wire.kernel_args)
        missed_ticks = tick_input.k - last_state.k - 1
        min_receive_ns = self.sensors.earliest_answer_time_ns(
            last_state.run_integers[s.TICK_TIME_NS]
        )
        next_row = tick_stages.receive_and_correct(
            block,
            *frame_kernel_args,
            frames.rows,
            tick_input.k,
            tick_input.t_ns,
            tick_input.late_ns,
            missed_ticks,
            min_receive_ns,
        )
        second_controller_signs: tuple[str, ...] = ()
        if next_row < len(frames.rows):
            second_controller_signs = self._receive_remaining_frames(
                state, frame_kernel_args, frames, next_row, min_receive_ns
            )
            tick_stages.observe_tick(block, *kernel_args)
            tick_stages.correct_tension_estimate(block, *kernel_args)
        if state.has_started:
            derived_constants.prediction.predict(block, missed_ticks)
        if tick_stages.conclude_estimate(block, *kernel_args):
            second_controller_signs += detect_unsolicited_replies(
                self.drives, self.sensors, last_state, state, tick_input.frames
            )
        return second_controller_signs

    def _receive_remaining_frames(
        self,
        state: ControllerState,
        frame_kernel_args: FrameKernelArguments,
        frames: Frames,
        next_row: int,
        min_receive_ns: int,
    ) -> tuple[str, ...]:
        """Process the received frames from the first frame on that compiled code has not decoded.

        Args:
            state: state of the tick, modified in place.
            frame_kernel_args: see ``DerivedConstants``, with the tables that decode the frames.
            frames: received frames.
            next_row: index of the first frame that a state machine must handle.
            min_receive_ns: earliest arrival of an answer to the latest SYNC [ns].

        Return the identifiers of received frames that only this host is allowed to send. Each
        identifier occurs once.
        """
        derived_constants = self.derived_constants
        second_controller_signs: list[str] = []
        while next_row < len(frames):
            # Compiled code has already counted the error frames, so the frame at the index is no
            # error frame.
            frame = frames[next_row]
            owner = derived_constants.drive_index_by_id.get((frame.bus, frame.can_id))
            if owner is not None:
                self.store_drive_state(
                    state, owner, self.drives[owner].receive(state.drive(owner), frame)
                )
            elif (frame.bus, frame.can_id) in derived_constants.amplifier_index_by_id:
                self._receive_amplifier_frame(state, frame)
            else:
                second_controller_signs.append(f"{frame.can_id:#05x}")
            next_row = cyclic_frames.receive_frames(
                state.block, *frame_kernel_args, frames.rows, next_row + 1, min_receive_ns
            )
        return tuple(dict.fromkeys(second_controller_signs))

    def _groups_not_ready(self, amplifiers: tuple[AmplifierState, ...]) -> tuple[int, ...]:
        """Return the indices of the load-cell frames whose amplifier is not completely set up.

        The controller does not use the values that an amplifier sends before its set-up is
        complete.
        """
        pairs = zip(amplifiers, self.sensors.amplifier_frame_ranges, strict=True)
        return tuple(
            [
                group
                for amplifier, groups in pairs
                if amplifier.phase != DrivePhase.READY
                for group in groups
            ]
        )

    def _receive_amplifier_frame(self, state: ControllerState, frame: Frame) -> None:
        """Pass a frame to the state machine of the amplifier that sent it."""
        i = self.derived_constants.amplifier_index_by_id[frame.bus, frame.can_id]
        amplifiers_before = state.decisions.amplifiers
        state_after = self.sensors.amplifiers[i].receive(amplifiers_before[i], frame)
        if state_after != amplifiers_before[i]:
            state.decide(
                amplifiers=(*amplifiers_before[:i], state_after, *amplifiers_before[i + 1 :])
            )

    def _advance_amplifiers(self, state: ControllerState, t_ns: int) -> tuple[Frame, ...]:
        """Continue the set-up of the load-cell amplifiers, and return the frames to send."""
        target = hand_modes.drive_target(state.mode)
        states = list[AmplifierState]()
        sent_frames = list[Frame]()
        for amplifier, amplifier_before in zip(
            self.sensors.amplifiers, state.decisions.amplifiers, strict=True
        ):
            amplifier_after, frames = amplifier.advance(amplifier_before, t_ns, target)
            states.append(amplifier_after)
            sent_frames += frames
        if tuple(states) != state.decisions.amplifiers:
            state.decide(amplifiers=tuple(states))
        return tuple(sent_frames)

    def store_drive_state(self, state: ControllerState, n: int, drive_state: DriveState) -> None:
        """Store the state of a drive after a step of its state machine.

        The numbers of the drive are stored in the state block. The values that are not numbers are
        stored in ``state.decisions.drives``.
        """
        drive_state_before = state.decisions.drives[n]
        drive = self.drives[n]
        tick_stages.store_drive_values(
            state.block, self.derived_constants.layout.offsets, n, *drive_state[1:7], *drive_state.recheck,
            int(drive_state.phase), drive_state.error,
            int(drive.fault_cause(drive_state.error)) if drive_state.phase == DrivePhase.FAULT else -1,
            drive.steady_status(drive_state), drive.due_ns(drive_state),
            int(drive_state.misread_frame_count != drive_state_before.misread_frame_count),
        )  # fmt: skip
        # The numbers of the drive are in the state block.
        state_without_numbers = drive_state.with_values()
        if state_without_numbers != drive_state_before:
            drives = state.decisions.drives
            state.decide(drives=(*drives[:n], state_without_numbers, *drives[n + 1 :]))

    # judge, decide

    def _count_refusals(
        self, state: ControllerState, request_events: tuple[TickEvent, ...]
    ) -> None:
        """Count the refused requests of the present tick, and the malformed requests of the last second.

        A client is allowed to send a request to find out whether a value is in range, so a refused
        request does not count as a fault. Only malformed requests show that a client is faulty.
        """
        refused_texts = [event.text for event in request_events if event.level == "warn"]
        malformed_count = sum(not text.startswith(REFUSAL_EVENT_PREFIX) for text in refused_texts)
        k = state.k
        rate = 1.0 / self.model.period
        recent_refusals = tuple(
            refusal_tick
            for refusal_tick in (*state.decisions.refusals, *(k,) * malformed_count)
            if k - refusal_tick < rate
        )
        state.decide(refusals=recent_refusals)
        state.run_integers[s.REFUSED_REQUESTS] = len(recent_refusals)
        state.run_integers[s.REFUSED_REQUESTS_IN_TICK] = len(refused_texts)

    def _judge_faults(
        self,
        state: ControllerState,
        tick_input: TickIn,
        second_controller_signs: tuple[str, ...],
    ) -> tuple[SafetyAction, tuple[FaultFinding, ...]]:
        """Detect the faults of the tick, latch them, and choose the reaction."""
        decisions = state.decisions
        # Before a load cell has been tared, it can read any value.
        state.run_integers[s.ARE_CELLS_TARED] = decisions.progress.phase != TARE_PHASE
        derived_constants = self.derived_constants
        evidence = derived_constants.fault_evidence
        demanded_action = tick_stages.find_faults(
            state.block, *derived_constants.kernel_args, derived_constants.layout.initial, evidence
        )
        new_findings = (
            newly_active_faults(derived_constants.limits, evidence, state.view("fault_ticks"))
            if state.run_integers[s.NEW_FAULT_COUNT]
            else []
        )
        if not (
            new_findings
            or tick_input.io_events
            or second_controller_signs
            or decisions.latched_faults
            or decisions.reported_faults
        ):
            return _ACTION_BY_NUMBER[demanded_action], ()
        reports = [(event.kind, event.where, float(event.number)) for event in tick_input.io_events]
        reports = filter_error_frames(
            reports, self._has_any_node_answered(state)
        ) + second_controller_reports(second_controller_signs)
        verdict = judge_tick(
            decisions.latched_faults,
            decisions.reported_faults,
            new_findings,
            demanded_action,
            reports,
        )
        if (
            verdict.latched_faults != decisions.latched_faults
            or verdict.reported_faults != decisions.reported_faults
        ):
            state.decide(
                latched_faults=verdict.latched_faults, reported_faults=verdict.reported_faults
            )
        return verdict.action, verdict.findings

    def _has_any_node_answered(self, state: ControllerState) -> bool:
        """Return True if at least one node has answered, or if the motors are allowed to make torque."""
        is_node_seen = any(phase != DrivePhase.SILENT for phase in state.drive_phases) or bool(
            state.view("group_frames").any()
        )
        return is_node_seen or HandMode.ARMING <= state.mode <= RELAX

    def _advance_program(
        self, state: ControllerState, action: SafetyAction
    ) -> tuple[TickEvent, ...]:
        """Advance the program while the hand is active.

        While the safety monitor makes the hand hold its position, the program time does not
        increase.
        """
        if state.mode != ACTIVE or action >= SafetyAction.HOLD:
            return ()
        model = self.model
        t = state.goal_time + model.period
        present_progress = state.decisions.progress
        progress, events = self.program.advance(
            model, present_progress, state.estimate, state.measurements, t
        )
        if progress is not present_progress:
            state.decide(progress=progress)
        state.goal_time = t
        return events

    def _write_progress(
        self, state: ControllerState, old_progress: ProgramProgress | None = None
    ) -> None:
        """Update the goals in the state block if the program has changed its goals.

        Args:
            state: state of the tick, modified in place.
            old_progress: progress of the program after the last tick, None before the first tick.
        """
        progress = state.progress
        if old_progress is None or progress.goals is not old_progress.goals:
            write_goals(self.model, self.derived_constants.layout, state.block, progress.goals)
        if old_progress is None or progress.contact is not old_progress.contact:
            state.view("planned_contact")[...] = progress.contact
        if old_progress is None or progress.closing is not old_progress.closing:
            state.view("closing")[...] = progress.closing or 0
        state.run_integers[s.PROGRAM_HOLDS_OBJECT] = progress.grip is not None
        state.run_reals[s.SLIP_DETECTION_START] = progress.grip.ready if progress.grip else 0.0
        if progress.tare:
            state.view("program_tare")[...] = progress.tare

    # command

    def _compute_torques(self, state: ControllerState, action: SafetyAction, ticks: int) -> None:
        """Compute the motor torques of the tick.

        The motor torques are 0 unless the hand is active or relaxing.
        """
        mode = state.mode
        derived_constants = self.derived_constants
        layout = derived_constants.layout
        if mode not in _MODES_WITH_GOALS:
            tick_stages.compute_motor_torques(
                state.block, *derived_constants.kernel_args, 0.0, 0, ticks
            )
            return
        sample_trajectories(self.model, layout, state.block, state.progress.goals, state.goal_time)
        rate, opening_rate = (
            (present_relax_rate(state), is_open_loop(state)) if mode == RELAX else (0.0, False)
        )
        hand_args = self.model, layout, derived_constants.constants, state.block
        unsolved_digits = evaluate_goals(*hand_args, int(action))
        write_motor_torques(*hand_args, unsolved_digits, rate, int(opening_rate), ticks)

    def _command_active_hand(
        self, state: ControllerState, frame_rows: WordRows, action: SafetyAction, ticks: int
    ) -> tuple[int, int]:
        """Compute the motor torques of an active hand, and encode the commands of steady drives.

        Return the results of ``_encode_commands``.
        """
        derived_constants = self.derived_constants
        layout = derived_constants.layout
        sample_trajectories(self.model, layout, state.block, state.progress.goals, state.goal_time)
        unsolved_digits, next_drive, count = tick_stages.command_active_hand(
            state.block,
            *derived_constants.frame_kernel_args,
            frame_rows,
            action,
            ticks,
        )
        if not unsolved_digits:
            return next_drive, count
        write_motor_torques(
            self.model,
            layout,
            derived_constants.constants,
            state.block,
            unsolved_digits,
            ticks=ticks,
        )
        return self._encode_commands(state, frame_rows, 0, 1)

    def _design_pending_gains(
        self,
        state_before_torques: ControllerState,
        state: ControllerState,
        action: SafetyAction,
        ticks: int,
    ) -> tuple[TickEvent, ...]:
        """Design the next control loop for the requested gains.

        A complete design is used from the next tick on.

        Args:
            state_before_torques: state before the motor torques were computed.
            state: state after the motor torques were computed.
            action: reaction that the safety monitor demands.
            ticks: number of control periods since the last tick.
        """
        pending_gains = state.decisions.pending_gains
        assert pending_gains is not None
        if (
            unfinished_design := self.design_cache.design_next_loop(self.model, pending_gains)
        ) is not None:
            state.decide(pending_gains=unfinished_design.pending_gains)
            return unfinished_design.events
        if state.mode in (ACTIVE, RELAX):
            other_controller = self.design_cache.controller(self, pending_gains.gains)
            other_controller._compute_torques(state_before_torques, action, ticks)
            step = (
                state.tendon[s.COMMANDED_TORQUE] - state_before_torques.tendon[s.COMMANDED_TORQUE]
            ) / self.model.tendon_constants.spool_radius
            state.tendon[s.TRIM_FORCE] += step
            state.run_integers[s.TRIM_ACTIVE] = 1
        state.decide(gains=pending_gains.gains, pending_gains=None)
        return gain_change.gain_change_events(self.model.gains, pending_gains.gains)

    # encode

    def _first_frame_rows(self, state: ControllerState) -> WordRows:
        """Return rows for the frames of the tick, with the SYNC frame of the sensor node in row 0."""
        derived_constants = self.derived_constants
        frame_rows = derived_constants.frame_template.copy()
        if derived_constants.sends_sync:
            counter = self.sensors.counter(state.k)
            frame_rows[0, FIRST_PAYLOAD_WORD] = counter
            state.run_integers[s.SYNC_COUNTER] = counter & 0xF
            # Before the set-up of an amplifier is complete, its answers are not used, and missing
            # answers do not count as lost.
            amplifiers = state.decisions.amplifiers
            if not amplifiers or all(
                amplifier.phase == DrivePhase.READY for amplifier in amplifiers
            ):
                state.run_integers[s.SYNC_COUNT] += 1
        return frame_rows

    def _encode_commands(
        self, state: ControllerState, frame_rows: WordRows, first_drive: int, count: int
    ) -> tuple[int, int]:
        """Encode the commands of steady drives, see ``cyclic_frames.encode_commands``.

        If the mode of the hand does not enable the drives, their state machines compute all frames,
        so that the function encodes no commands.
        """
        if hand_modes.drive_target(state.mode) != DriveTarget.ENABLE:
            return first_drive, count
        return cyclic_frames.encode_commands(
            state.block,
            self.derived_constants.layout.offsets,
            *self.derived_constants.wire.kernel_args,
            frame_rows,
            self._drive_torques(state),
            first_drive,
            count,
        )

    def _drive_torques(self, state: ControllerState) -> Vector:
        """Return the torques (N,) that are commanded to the drives [N m]."""
        torque = state.block[self.derived_constants.torque_elements]
        return torque if self.model.torque_gain is None else torque / self.model.torque_gain

    def _complete_frames(
        self, state: ControllerState, frame_rows: WordRows, next_drive: int, count: int, t_ns: int
    ) -> Frames:
        """Return the frames of the tick: SYNC, then the command of each drive.

        In the mode CUT, the frames that cut the torque come first, SYNC follows, and no commands to
        drives are sent.

        Args:
            state: state of the tick, modified in place.
            frame_rows: (frames, WORDS_PER_RECORD) SYNC frame, and the commands of the first drives.
            next_drive: index of the first drive that has no command yet.
            count: number of records in ``frame_rows``, with SYNC.
            t_ns: time of the tick [ns].
        """
        # A hand without sensors needs no SYNC frame, so row 0 is not sent.
        first_sent_row = 0 if self.derived_constants.sends_sync else 1
        if next_drive < len(self.drives):
            sent_frames = self._add_other_commands(
                state, frame_rows, first_sent_row, next_drive, count, t_ns
            )
        else:
            sent_frames = Frames(frame_rows[first_sent_row:count])  # as in most ticks
        if state.decisions.amplifiers and (setup := self._advance_amplifiers(state, t_ns)):
            sent_frames = concatenate_frames([sent_frames, frames_as_records(setup)])
        if state.mode != CUT:
            return sent_frames
        return concatenate_frames(
            [
                frames_as_records(self.torque_cut_frames()),
                Frames(frame_rows[first_sent_row:1]),
            ]
        )

    def _add_other_commands(
        self,
        state: ControllerState,
        frame_rows: WordRows,
        first_sent_row: int,
        next_drive: int,
        count: int,
        t_ns: int,
    ) -> Frames:
        """Return the frames of the tick after the commands of the remaining drives have been added.

        If the state machine of a drive has work to do, such as enabling the drive, the state machine
        computes the frames of this drive. Compiled code encodes the commands of all other drives.

        Args:
            state: state of the tick, modified in place.
            frame_rows: (frames, WORDS_PER_RECORD) SYNC frame, and the commands of the first drives.
            first_sent_row: first row to send: 0 with SYNC, 1 without.
            next_drive: index of the first drive that has no command yet. Its state machine has work
                to do.
            count: number of records in ``frame_rows``, with SYNC.
            t_ns: time of the tick [ns].
        """
        target = hand_modes.drive_target(state.mode)
        torque = self._drive_torques(state)
        # Consecutive frames of state machines become records together, because the conversion of
        # one batch takes as long as the conversion of a single frame.
        frame_batches: list[Frames] = []
        unsent_frames: list[Frame] = []
        first_unsent_row = first_sent_row
        n = next_drive
        while n < len(self.drives):
            frames = self._advance_drive(state, n, target, float(torque[n]), t_ns)
            if frames and count > first_unsent_row:
                frame_batches += [
                    frames_as_records(unsent_frames),
                    Frames(frame_rows[first_unsent_row:count]),
                ]
                unsent_frames = []
                first_unsent_row = count
            unsent_frames += frames
            n, count = self._encode_commands(state, frame_rows, n + 1, count)
        frame_batches += [
            frames_as_records(unsent_frames),
            Frames(frame_rows[first_unsent_row:count]),
        ]
        return concatenate_frames(frame_batches)

    def _advance_drive(
        self, state: ControllerState, n: int, target: DriveTarget, torque: float, t_ns: int
    ) -> Sequence[Frame]:
        """Advance the state machine of a drive, and return the frames that the drive must receive."""
        state_before = state.drive(n)
        drive = self.drives[n]
        if (
            state_before.phase == DrivePhase.FAULT
            and state.is_clearing_errors
            and state.mode == HandMode.INVENTORY
        ):
            drive_state, frames = drive.clear(state_before)
        else:
            drive_state, frames = drive.advance(state_before, t_ns, target, torque)
            servos = self.derived_constants.wire.tables.servos
            if servos[n, 0] < servos[n, 1]:
                send_torque_only(state, n)
        if drive_state is not state_before:
            self.store_drive_state(state, n, drive_state)
        return frames


@dataclass(slots=True)
class TickInProgress:
    """A tick of which only the first steps have been executed.

    Attributes:
        controller: controller with the gains of the tick.
        last_state: state after the previous tick.
        state: state of the tick. Each step modifies this state.
        tick_input: inputs of the tick, without requests.
        second_controller_signs: signs of a second controller.
        targets: targets of streams among the requests, which ``command`` applies.
        sent_frames: frames to send, which ``command`` has computed.
        action: reaction that the safety monitor demands, which ``decide`` has determined.
        events: events of the tick so far.
        state_before_torques: state before the motor torques were computed. The state is kept only
            while the design of other gains is in progress.
    """

    controller: Controller
    last_state: ControllerState
    state: ControllerState
    tick_input: TickIn
    second_controller_signs: tuple[str, ...]
    targets: tuple[TickRequest, ...] = ()
    sent_frames: Frames = NO_FRAMES
    action: SafetyAction = SafetyAction.PASS
    events: tuple[TickEvent, ...] = ()
    state_before_torques: ControllerState | None = None

    def decide(self, requests: tuple[TickRequest, ...]) -> None:
        """Apply requests, judge faults, and choose the mode and the goals of the hand.

        Args:
            requests: requests of operators and programs, in the order of arrival. The step
                ``command`` applies the streamed targets among the requests.
        """
        other_requests, self.targets = (
            requests_and_stream_targets(requests) if requests else ((), ())
        )
        self.controller._decide_goals(self, other_requests)

    def command(self, targets: tuple[TickRequest, ...]) -> Frames:
        """Apply the targets of streams, and return the frames to send.

        Args:
            targets: further targets of streams, in the order of arrival.

        Raises:
            ValueError: a command cannot be encoded. The command is not sent.
        """
        self.controller._command_drives(self, self.targets + targets)
        return self.sent_frames

    def conclude(self) -> tuple[ControllerState, TickOut]:
        """Return the state after the tick, and the output of the tick."""
        return self.controller._conclude_tick(self)


def send_torque_only(state: ControllerState, n: int) -> None:
    """Record that a drive's state machine has sent a torque command instead of a position command."""
    servo = state.layout.table(state.block, "servo")
    servo[[s.SERVO_KP, s.SERVO_KD], n] = 0.0
    servo[s.SERVO_TORQUE, n] = state.tendon[s.COMMANDED_TORQUE, n]


_ACTION_BY_NUMBER = {int(action): action for action in SafetyAction}


def _fault_event(finding: FaultFinding) -> TickEvent:
    """Return the event which reports a fault that has just become active."""
    fault = finding.fault
    level = "error" if fault.action >= SafetyAction.RELAX else "warn"
    text = f"{fault.id} {fault.title}: {finding.part_name} ({finding.value:g}): {fault.action.name}"
    return TickEvent(
        level if fault.action > SafetyAction.PASS else "info", "fault", finding.part_name, text
    )
