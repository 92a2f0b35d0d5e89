"""Execution of a run from its plan to its log, in real time or in lockstep."""

import subprocess
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

from handctl.compiled import compile_kernels
from handctl.controller import run_setup
from handctl.controller.controller_state import ControllerState
from handctl.controller.shutdown import shutdown_step
from handctl.controller.state_snapshot import snapshot_parts
from handctl.controller.target_streams import stream_status
from handctl.controller.tick import Controller
from handctl.core.calibration import Calibration
from handctl.core.tick_types import IoEvent, TickIn, TickOut, TickRequest
from handctl.errors import BusError, DriveError, PowerError
from handctl.hand.description import Hand
from handctl.log.header import TRUTH_OFFSET_KEY, RunHeader
from handctl.log.tick_packing import pack_snapshot, pack_tick_record
from handctl.log.topics.snapshot_topic import SNAPSHOT_PERIOD_NS
from handctl.log.write.recorder import Recorder
from handctl.programs.live_session import LiveProgram, import_spline_functions
from handctl.programs.program import Program
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.clocks.lockstep import LockstepBus, LockstepClock
from handctl.runtime.clocks.real_clock import RealClock, TickClock
from handctl.runtime.clocks.realtime_priority import (
    GrantedPriority,
    prepare_priority,
    realtime_priority,
    restore_priority,
)
from handctl.runtime.clocks.rehearsal import rehearsal_for_period
from handctl.runtime.clocks.shared_clock import ClockFile, SharedClock
from handctl.runtime.clocks.suspend_watch import SuspendWatch
from handctl.runtime.hold_timeout import HoldTimeout
from handctl.runtime.loop import ControlLoop, LoopBus, LoopStats, StopSignals
from handctl.runtime.mailbox import CLEAR_REQUEST, Mailbox, bus_lock
from handctl.runtime.observations import ObservationWriter
from handctl.runtime.socket_paths import clock_path, faults_path, is_socket_served
from handctl.runtime.status_line import status_of_tick
from handctl.runtime.target_socket import TargetReceiver
from handctl.safety.faults.table import FAULT_BY_ID
from handctl.session.exit_codes import ExitCode
from handctl.session.run_header import run_header
from handctl.session.run_plan import OperatorDisplay, RunPlan


@dataclass(frozen=True)
class RunOutcome:
    """Outcome of a run.

    Attributes:
        state: last state of the controller in the run.
        loop_stats: statistics of the control loop.
        log_summary: summary of the recorder.
        priority: real-time priority that the operating system granted to the control loop, or None
            in lockstep.
        offset_ns: reading of the simulator's clock at the start of the run [ns].
        pause_count: number of pauses of the clock that the run and the simulator share. If there is
            no shared clock, the value is 0.
        paused_ns: total duration of the pauses of the shared clock in wall time [ns].
    """

    state: ControllerState
    loop_stats: LoopStats
    log_summary: dict[str, object]
    priority: GrantedPriority | None
    offset_ns: int
    pause_count: int = 0
    paused_ns: int = 0

    @property
    def was_too_slow(self) -> bool:
        """Return True if a fault occurred because the host or the simulator was too slow."""
        return any(
            FAULT_BY_ID[latched_fault.id].caused_by_lateness
            for latched_fault in self.state.latched_faults
        )

    @property
    def exit_code(self) -> ExitCode:
        """Return the exit code of a command that executes only this run."""
        if self.state.unconfirmed_motors:
            return ExitCode.REMOVE_POWER
        return ExitCode.FAILED if self.state.failure else ExitCode.DONE

    def raise_if_not_finished(self, location: str, remedy: str = "") -> None:
        """Raise an error if the run did not finish.

        Args:
            location: text for the error message that names the purpose of the run.
            remedy: remedy that the error message suggests, or an empty text if no remedy is known.

        Raises:
            PowerError: a drive did not confirm that it is disabled.
            DriveError: the run ended early for another reason.
        """
        if self.state.unconfirmed_motors:
            raise PowerError(self.state.failure, location)
        if self.state.failure or not self.state.progress.finished:
            raise DriveError(self.state.failure or "stopped before the end", location, remedy)


RunFunction = Callable[["RunPlan", Controller, Path], RunOutcome]
"""Function that executes a run: ``run_live``, or a function for a lockstep run."""


def make_controller(
    plan: RunPlan, program: Program, calibration: Calibration | None, arm_at_once: bool
) -> Controller:
    """Construct the controller of a run.

    The function also designs the controller with the gains of the run plan. If numba must first
    compile code, the function shows a progress bar.
    """
    with plan.show_progress("compiling the controller, once") as report_progress:
        compile_kernels(report_progress)
    if isinstance(program, LiveProgram):
        import_spline_functions()
    return run_setup.make_controller(
        plan.hand, plan.gains, plan.rate_hz, program, calibration, arm_at_once
    )


class RunObserver(Protocol):
    """Observer that runs in the process of the controller and receives each tick of the run.

    An observer can send the same requests as an operator can.
    """

    def poll_requests(self) -> tuple[str, ...]:
        """Return the requests that the observer has made since the last call."""
        ...

    def on_tick(self, tick_input: TickIn, tick_output: TickOut) -> None:
        """Receive the input and the output of a finished tick."""
        ...


def run_live(
    plan: RunPlan,
    controller: Controller,
    log: Path,
    live_view: bool = False,
    observer: RunObserver | None = None,
) -> RunOutcome:
    """Execute a run in real time, on real or simulated buses.

    Args:
        plan: checked plan of the run.
        controller: controller that executes the program of the run.
        log: log file to write.
        live_view: True to show the log in Rerun during the run. With ``live_view``, a separate
            process sends the log to the viewer.
        observer: observer of the run, which may send requests. The value is None for a
            run without an observer.

    Raises:
        BusError: a bus cannot be opened, or another controller uses it.
        LogError: the log cannot be written.
    """
    for text in run_setup.caution_lines(controller.drives):
        plan.show_notice(f"handctl: caution: {text}")
    with ExitStack() as stack:
        clock = _real_time_clock(plan, stack)
        mailbox = Mailbox(plan.buses[0])
        stack.callback(mailbox.close)
        targets = TargetReceiver(plan.buses[0], clock.convert_to_run_time)
        stack.callback(targets.close)
        observations = ObservationWriter(
            plan.buses[0], _axis_lengths(plan.hand), _describe_run(plan)
        )
        stack.callback(observations.close)
        for spec in sorted({*plan.buses} - {plan.buses[0]}):
            stack.enter_context(bus_lock(spec))
        buses: list[LoopBus] = []
        for index, (spec, bus) in enumerate(zip(plan.buses, plan.hand.bus, strict=True)):
            opened_bus = open_bus(
                spec, index, bus.bitrate, bus.data_bitrate, clock.convert_to_run_time
            )
            stack.callback(opened_bus.close)
            buses.append(opened_bus)
        priority = prepare_priority()
        stack.callback(restore_priority)
        clock.busy_wait = priority.is_realtime
        with ExitStack() as cleanup_stack:
            recorder, display = _start_recording(
                plan, log, run_header(plan, controller, priority, lockstep=False), cleanup_stack
            )
            if live_view:
                stack.callback(_start_view(log))
            signals = StopSignals()
            stack.enter_context(signals.install_handlers())
            published_state = PublishedState()
            show_tick = _merge_observers(
                observer, _status_callback(display, mailbox, plan.rate_hz, published_state)
            )
            request_source = _merge_requests(observer, _request_source(plan, signals, mailbox))
            loop = _build_loop(plan, controller, clock, buses, recorder, request_source, show_tick)
            if priority.is_realtime:
                clock.rehearsal = rehearsal_for_period(
                    loop.rehearse_tick, int(plan.period_ns / plan.time_scale)
                )
            loop.tick_priority = partial(realtime_priority, clock.processors)
            loop.take_targets = targets.read_targets
            loop.publish_tick = partial(_publish_tick, observations, published_state)
            cleanup_stack.pop_all()
        outcome = _run_to_end(
            loop,
            controller,
            recorder,
            display,
            priority,
            lambda: int(clock.start_ns * clock.time_scale),
        )
        return replace(outcome, pause_count=clock.pause_count, paused_ns=clock.paused_ns)


def run_lockstep(
    plan: RunPlan,
    controller: Controller,
    log: Path,
    clock: LockstepClock,
    observer: RunObserver | None = None,
) -> RunOutcome:
    """Execute a run in virtual time.

    The lockstep clock advances the simulated hand of the run. Several runs can use the same clock,
    one after the other. In virtual time, no operator is present to clear a fault.

    Raises:
        DriveError: a fault made the hand hold its position for longer than allowed.
    """
    clock.restart()
    header = run_header(plan, controller, None, lockstep=True)
    start_offset = {TRUTH_OFFSET_KEY: str(clock.offset_ns)}
    with ExitStack() as cleanup_stack:
        recorder, display = _start_recording(
            plan, log, replace(header, metadata=header.metadata | start_offset), cleanup_stack
        )
        limit = HoldTimeout()
        request_source = _merge_requests(observer, limit.poll_requests)
        show_tick = _merge_observers(
            limit, _merge_observers(observer, display.show_tick if display else _ignore_tick)
        )
        loop = _build_loop(
            plan, controller, clock, [LockstepBus(clock)], recorder, request_source, show_tick
        )
        cleanup_stack.pop_all()
    outcome = _run_to_end(loop, controller, recorder, display, None, lambda: clock.offset_ns)
    limit.raise_if_stopped(f"{plan.hand.name} in lockstep, log {log}")
    return outcome


def _start_recording(
    plan: RunPlan, log: Path, header: RunHeader, cleanup_stack: ExitStack
) -> tuple[Recorder, OperatorDisplay | None]:
    """Start the recorder of a run. If the plan of the run contains an operator display, also start the display.

    Args:
        plan: plan of the run.
        log: log file to write.
        header: header of the run.
        cleanup_stack: stack that closes the recorder and the display if an error occurs before the
            loop starts. After the start of the loop, ``_run_to_end`` closes the recorder and the
            display.

    Raises:
        LogError: the log cannot be written.
    """
    recorder = Recorder.start(log, header)
    cleanup_stack.callback(recorder.close, "error before the first tick")
    display = plan.start_display(plan) if plan.start_display else None
    if display:
        cleanup_stack.callback(display.close)
    return recorder, display


def _real_time_clock(plan: RunPlan, stack: ExitStack) -> RealClock:
    """Return the clock of a run in real time.

    If the simulator on the bus offers a shared clock, the result is the shared clock. If there is
    no shared clock, the result is the clock CLOCK_MONOTONIC.

    Raises:
        BusError: the file of the shared clock cannot be read, or has the format of another version.
    """
    spec = plan.buses[0]
    if not is_socket_served(faults_path(spec)):
        return RealClock(plan.period_ns, plan.time_scale)
    try:
        file = ClockFile(clock_path(spec))
    except FileNotFoundError:
        return RealClock(plan.period_ns, plan.time_scale)
    except (OSError, ValueError) as error:
        raise BusError(
            f"cannot share the clock of the simulator: {error}", spec, "sim --strict-clock"
        ) from None
    stack.callback(file.close)
    return SharedClock(plan.period_ns, plan.time_scale, file=file)


def refuse_view_without_screen(view_requested: bool) -> None:
    """Raise an error if the user gives ``--view`` in a desktop session without a screen.

    Commands call this function before they open a bus.

    Raises:
        ConfigError: the desktop session has no screen.
    """
    if view_requested:
        from handctl.view.viewer import check_screen_exists

        check_screen_exists()


def _start_view(log: Path) -> Callable[[], None]:
    """Start the live view of a log.

    Another process sends the log to the viewer. The result is a function that stops the process of
    the live view. The viewer itself stays open.
    """
    from handctl.view.live_view import start_live_view

    child: subprocess.Popen[bytes] = start_live_view(log)
    return child.terminate


def snapshot_recorder(recorder: Recorder) -> Callable[[TickIn, ControllerState], None]:
    """Return a function that records a snapshot of the controller's state twice per second.

    The caller must call the returned function after each tick.
    """
    due_ns = SNAPSHOT_PERIOD_NS

    def record_snapshot(tick_input: TickIn, state: ControllerState) -> None:
        nonlocal due_ns
        if tick_input.t_ns >= due_ns:
            due_ns = tick_input.t_ns + SNAPSHOT_PERIOD_NS
            recorder.send_record(pack_snapshot(tick_input, *snapshot_parts(state)))

    return record_snapshot


def _build_loop(
    plan: RunPlan,
    controller: Controller,
    clock: TickClock,
    buses: Sequence[LoopBus],
    recorder: Recorder,
    receive_requests: Callable[[], tuple[TickRequest, ...]],
    show_tick: Callable[[TickIn, TickOut], None],
) -> ControlLoop[ControllerState]:
    def record_tick(tick_input: TickIn, tick_output: TickOut) -> None:
        recorder.send_record(pack_tick_record(tick_input, tick_output))

    take_suspend_events = (
        SuspendWatch().take_events if isinstance(clock, RealClock) else list[IoEvent]
    )
    return ControlLoop(
        clock=clock,
        period_ns=plan.period_ns,
        buses=buses,
        begin_tick=controller.begin_tick,
        torque_cut_frames=controller.torque_cut_frames(),
        take_requests=receive_requests,
        take_host_events=lambda: [*recorder.take_events(), *take_suspend_events()],
        record_tick=record_tick,
        show_tick=show_tick,
        record_snapshot=snapshot_recorder(recorder),
        disable_drives=partial(shutdown_step, controller),
    )


def _axis_lengths(hand: Hand) -> dict[str, int]:
    """Return the numbers of a hand's joints, tendons, motors and digits, with the keys "joint", "tendon", and so on."""
    return {
        "joint": len(hand.joints),
        "tendon": len(hand.tendon),
        "motor": len(hand.motor),
        "digit": len(hand.digit),
    }


def _describe_run(plan: RunPlan) -> dict[str, object]:
    """Return constants of a run, by name: the hand file, the control rate and the time scale.

    Programs need the constants to interpret the observations of the run.
    """
    return {
        "hand_toml": plan.hand.to_toml(),
        "rate_Hz": plan.rate_hz,
        "time_scale": plan.time_scale,
    }


def _request_source(
    plan: RunPlan, signals: StopSignals, mailbox: Mailbox
) -> Callable[[], tuple[TickRequest, ...]]:
    """Return a function that collects the requests for a tick.

    Streamed targets are not included. If the plan has ``clear_faults``, the first request clears
    the latched errors of the drives.
    """
    pending_requests = [CLEAR_REQUEST] if plan.clear_faults else []

    def take_requests() -> tuple[TickRequest, ...]:
        clear_request = (pending_requests.pop(),) if pending_requests else ()
        return clear_request + signals.take_request() + mailbox.read_requests()

    return take_requests


RequestSource = Callable[[], tuple[TickRequest, ...]]
TickCallback = Callable[[TickIn, TickOut], None]


def _merge_requests(observer: RunObserver | None, other_source: RequestSource) -> RequestSource:
    if observer is None:
        return other_source
    return lambda: other_source() + observer.poll_requests()


def _merge_observers(observer: RunObserver | None, other_callback: TickCallback) -> TickCallback:
    if observer is None:
        return other_callback

    def show_tick(tick_input: TickIn, tick_output: TickOut) -> None:
        observer.on_tick(tick_input, tick_output)
        other_callback(tick_input, tick_output)

    return show_tick


STATUS_RATE_HZ = 50.0
"""Rate at which programs that observe a run get status lines [Hz]."""


@dataclass(slots=True)
class PublishedState:
    """Values that the status lines show, copied from the latest state of the controller.

    Attributes:
        commander: client that commands the hand, or None if every client is allowed to start to
            command the hand.
    """

    commander: str | None = None


def _publish_tick(
    observations: ObservationWriter,
    published_state: PublishedState,
    tick_input: TickIn,
    tick_output: TickOut,
    state: ControllerState,
    sent_ns: int,
) -> None:
    """Write the observation of a tick, and store the values that status lines show."""
    observations.write_record(tick_input, tick_output, stream_status(state), sent_ns)
    published_state.commander = state.decisions.commanding_client


def _status_callback(
    display: OperatorDisplay | None,
    mailbox: Mailbox,
    rate_hz: float,
    published_state: PublishedState,
) -> TickCallback:
    """Return a function that updates the display and sends status lines.

    The control loop must call the returned function after each tick. The programs that observe the
    run receive the status lines.
    """
    ticks_per_status = max(1, round(rate_hz / STATUS_RATE_HZ))

    def show_tick(tick_input: TickIn, tick_output: TickOut) -> None:
        if display:
            display.show_tick(tick_input, tick_output)
        if (
            mailbox.watchers and (tick_input.k % ticks_per_status == 0 or tick_output.events)
        ) or mailbox.askers:
            mailbox.publish_status(
                status_of_tick(tick_input, tick_output, published_state.commander)
            )

    return show_tick


def _ignore_tick(tick_input: TickIn, tick_output: TickOut) -> None:
    return


def _run_to_end(
    loop: ControlLoop[ControllerState],
    controller: Controller,
    recorder: Recorder,
    display: OperatorDisplay | None,
    priority: GrantedPriority | None,
    offset_ns: Callable[[], int],
) -> RunOutcome:
    """Run the control loop to its end.

    After the end of the loop, close the display and the recorder, even if the loop raised an error.
    """
    reason = "controller error"
    try:
        state = loop.run(controller.initial_state())
        reason = state.failure or "done"
    except KeyboardInterrupt:
        reason = "interrupted"
        raise
    finally:
        try:
            if display:
                display.close()
        finally:
            summary = recorder.close(reason, loop.clock.clock_statistics())
    return RunOutcome(state, loop.stats, summary, priority, offset_ns())
