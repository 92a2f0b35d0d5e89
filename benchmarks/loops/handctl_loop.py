"""Run the complete control loop of handctl: bus, filter, control law, safety, encoding, log.

In a run without deadlines, ``ReplyDrivenClock`` replaces the clock of the control loop.
"""

import select
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

from handctl.core.gains.gains import Gains
from handctl.core.tick_types import HandMode
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import load_hand
from handctl.log.header import RunHeader
from handctl.log.tick_packing import pack_tick_record
from handctl.log.write.recorder import Recorder
from handctl.programs.program import ProgramProgress, goal_to_move_to_angle
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.clocks.awake_processors import AwakeProcessors
from handctl.runtime.clocks.real_clock import RealClock
from handctl.runtime.clocks.realtime_priority import request_priority
from handctl.runtime.clocks.rehearsal import rehearsal_for_period
from handctl.runtime.loop import ControlLoop
from handctl.runtime.mailbox import STOP_REQUEST
from handctl.session.run import make_controller, snapshot_recorder
from handctl.session.run_plan import RunPlan

DESIGN_RATE_HZ = 1000.0


class HoldPositionProgram:
    """Program that holds every digit at its present position."""

    def initial_progress(self, model):
        return ProgramProgress.initial(len(model.digits), "start")

    def advance(self, model, progress, estimate, measurements, t):
        if progress.phase == "start":
            goals = tuple(
                goal_to_move_to_angle(digit, estimate, 0.0, 1.0, t) for digit in model.digits
            )
            progress = replace(progress, phase="stay", goals=goals)
        return progress, ()


@dataclass
class ReplyDrivenClock:
    """Clock without deadlines.

    The next tick begins when the first reply to the commands of the preceding tick has arrived. If
    no reply arrives, the next tick begins after 2 ms.
    """

    fd: int
    processors: AwakeProcessors = field(default_factory=AwakeProcessors)

    def start(self):
        return

    def wait(self, k):
        select.select([self.fd], [], [], 0.002)
        return 0

    def now_ns(self):
        return 0

    def clock_statistics(self):
        return {}


def run_loop(
    hand_name: str, bus_name: str, duration_s: float, rate_hz: float | None, log_path: Path
):
    """Run the controller until the hand has been active for a given time.

    Args:
        hand_name: name of a packaged hand.
        bus_name: name of the local bus.
        duration_s: time for which the hand is active [s].
        rate_hz: control rate [Hz]. None means that ticks have no deadlines.
        log_path: path of a new file for the log.

    Returns:
        ticks per second while active, fraction of missed deadlines, lateness of every active tick [ns], wall time
        of each tick in the controller [ns], and CPU time of the control process per second.

    Raises:
        RuntimeError: the hand was not active for the whole time.
    """
    hand = load_hand(hand_name)
    rate = rate_hz or DESIGN_RATE_HZ
    plan = RunPlan(hand, Gains(), rate, (0.0,), (f"local:{bus_name}",))
    controller = make_controller(plan, HoldPositionProgram(), None, arm_at_once=True)
    bus = open_bus(plan.buses[0], 0, 1_000_000)
    clock = RealClock(plan.period_ns) if rate_hz else ReplyDrivenClock(bus.fileno())
    priority = request_priority()
    if rate_hz:
        clock.busy_wait = priority.is_realtime
    attachments = {"hand.toml": hand.to_toml().encode(), "hand.urdf": urdf_text(hand).encode()}
    recorder = Recorder.start(
        log_path, RunHeader.from_hand(hand.to_toml(), plan.period_ns, attachments=attachments)
    )
    tick_times_ns: list[int] = []
    counter = ActiveTickCounter(duration_s, tick_times_ns)
    cut_frames = controller.torque_cut_frames()

    def record(entry, tick_output):
        recorder.send_record(pack_tick_record(entry, tick_output))

    # To measure the wall time of a tick takes a few microseconds. A measurement of the rate without
    # deadlines must not include the time that the readings of the clock take.
    begin_tick = (
        (lambda state, entry: TimedTick(controller, state, entry, tick_times_ns))
        if rate_hz
        else controller.begin_tick
    )
    # Without deadlines, the time of the run passes many times as fast as real time. Two snapshots for
    # each second of the run would be many times more than in a run with deadlines.
    record_snapshot = snapshot_recorder(recorder) if rate_hz else lambda entry, state: None
    loop = ControlLoop(
        clock, plan.period_ns, [bus], begin_tick, cut_frames, counter.requests,
        lambda: list(recorder.take_events()), record, counter, tick_priority=clock.processors.keep_awake,
        record_snapshot=record_snapshot,
    )  # fmt: skip
    if rate_hz and priority.is_realtime:
        clock.rehearsal = rehearsal_for_period(loop.rehearse_tick, plan.period_ns)
    state = loop.run(controller.initial_state())
    recorder.close("done")
    bus.close()
    log_path.unlink()
    if not counter.stopped:
        seconds = (counter.last_ns - counter.first_ns) / 1e9
        raise RuntimeError(f"active for only {seconds:.1f} s: {state.failure}")
    run_time_s = (counter.last_ns - counter.first_ns) / 1e9
    missed_fraction = (counter.last_k - counter.first_k - counter.ticks) / counter.ticks
    return (
        counter.ticks / run_time_s,
        missed_fraction,
        counter.late,
        counter.tick_times_ns,
        counter.cpu_s / run_time_s,
    )


class TimedTick:
    """Tick of the controller with a measurement of the wall time that the tick takes.

    The wall time of a tick [ns] is the sum of the wall times of four methods: begin, decide,
    command and conclude.
    """

    def __init__(self, controller, state, entry, tick_times_ns) -> None:
        start_time_ns = _now_ns()
        self.step = controller.begin_tick(state, entry)
        self.tick_times_ns = tick_times_ns
        self.spent_ns = _now_ns() - start_time_ns

    def decide(self, requests):
        start_time_ns = _now_ns()
        self.step.decide(requests)
        self.spent_ns += _now_ns() - start_time_ns

    def command(self, targets):
        start_time_ns = _now_ns()
        frames = self.step.command(targets)
        self.spent_ns += _now_ns() - start_time_ns
        return frames

    @property
    def state(self):
        return self.step.state

    def conclude(self):
        start_time_ns = _now_ns()
        result = self.step.conclude()
        self.tick_times_ns.append(self.spent_ns + _now_ns() - start_time_ns)
        return result


class ActiveTickCounter:
    """Observer that counts the ticks with an active hand and ends the run after the requested time.

    The observer does not count ticks before and after the requested time, because these ticks also
    run the state machines of the drives.
    """

    def __init__(self, duration_s: float, all_times_ns: list[int]) -> None:
        """Create the observer.

        Args:
            duration_s: time for which the hand is active [s].
            all_times_ns: wall times of all ticks so far [ns], empty if ticks are not timed.
        """
        self.seconds = duration_s
        self.all_times_ns = all_times_ns
        self.tick_times_ns: list[int] = []
        self.ticks = 0
        self.late = []
        self.first_ns = self.last_ns = self.first_k = self.last_k = 0
        self.cpu_s = self.first_cpu_s = 0.0
        self.stopped = False

    def __call__(self, entry, tick_output) -> None:
        if tick_output.mode != HandMode.ACTIVE or self.stopped:
            return
        if not self.first_ns:
            self.first_cpu_s = time.process_time()
            self.first_ns = self.last_ns = _now_ns()
            self.first_k = self.last_k = entry.k
            return
        self.ticks += 1
        self.last_k = entry.k
        self.late.append(entry.late_ns)
        self.tick_times_ns += self.all_times_ns[-1:]

    def requests(self) -> tuple[str, ...]:
        if not self.first_ns or self.stopped:
            return ()
        self.last_ns = _now_ns()
        if self.last_ns - self.first_ns < self.seconds * 1e9:
            return ()
        self.cpu_s = time.process_time() - self.first_cpu_s
        self.stopped = True
        return (STOP_REQUEST,)


def _now_ns() -> int:
    return time.monotonic_ns()
