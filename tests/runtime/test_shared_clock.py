"""Test the clock that controller and simulator share.

The tests cover pauses of the shared clock, and the time that the simulator reads from the shared
clock.
"""

import random
import signal
import time
from collections.abc import Callable
from contextlib import closing

import pytest

from firmware_sim.bus.bus_ports import is_local_bus
from firmware_sim.clock import shared_clock as simulated
from handctl.runtime.clocks import shared_clock
from handctl.runtime.clocks.shared_clock import ClockFile, SharedClock
from handctl.runtime.mailbox import StatusWatcher
from tests.runtime.processes import LOCAL_BUS, process_result, start_handctl, wait_for_phase

PERIOD_NS = 2_000_000
TOLERATED_LATENESS_NS = PERIOD_NS // 10
NS_PER_MS = 1_000_000


class SharedClockPair:
    """The clocks of a simulator and of a controller. Both clocks use a simulated CLOCK_MONOTONIC.

    Attributes:
        now: time of the simulated CLOCK_MONOTONIC [ns].
        overshoots: for each of the next sleeps of the clock, the time by which the sleep lasts too
            long [ns]. All later sleeps last 10 us too long.
        simulator: clock of the simulator.
        controller: clock of the controller.
        between: function that the pair of clocks calls at the end of each sleep.
    """

    def __init__(
        self, socket_folder, monkeypatch: pytest.MonkeyPatch, time_scale: float = 1.0
    ) -> None:
        self.now = 5_000_000_000
        self.overshoots: list[int] = []
        self.between: Callable[[], None] = lambda: None
        monkeypatch.setattr(time, "monotonic_ns", lambda: self.now)
        monkeypatch.setattr(time, "sleep", self.sleep)
        self.simulator = simulated.SharedClock(time_scale)
        self.simulator.create_file(socket_folder)
        self.controller = SharedClock(PERIOD_NS, time_scale, file=ClockFile(socket_folder))

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9) + (self.overshoots.pop() if self.overshoots else 10_000)
        self.between()

    def answer(self) -> None:
        """Let the simulator report that it has reached the present time and has replied to all frames."""
        self.simulator.publish_reached_time(self.simulator.now_ns())
        self.simulator.publish_answered_ticks(self.simulator.sent_tick_count())


@pytest.fixture
def clock_pair(tmp_path, monkeypatch):
    pair = SharedClockPair(tmp_path / "t.clock", monkeypatch)
    pair.between = pair.answer
    return pair


def test_both_sides_agree_on_the_file(tmp_path) -> None:
    names = (
        "CLOCK_FILE_VERSION", "GATE_INDEX", "PAUSED_INDEX", "SENT_INDEX", "ANSWERED_INDEX", "REACHED_INDEX",
        "CLOCK_FILE_INTEGER_COUNT", "OPEN_GATE_NS",
    )  # fmt: skip
    assert [getattr(shared_clock, name) for name in names] == [
        getattr(simulated, name) for name in names
    ]
    assert shared_clock.MAX_CONTROLLER_PAUSE_NS < simulated.MAX_GATE_WAIT_NS, (
        "a pause must end before the limit of the simulator"
    )


def test_a_fast_machine_needs_no_pause(clock_pair) -> None:
    clock_pair.controller.start()
    late = [clock_pair.controller.wait(k) for k in range(200)]
    assert max(late) <= 20_000
    assert clock_pair.controller.pause_count == 0
    assert clock_pair.controller.clock_statistics() == {
        "clock_pauses": "0",
        "clock_paused_ms": "0.0",
    }


@pytest.mark.parametrize("late_ms", [1, 3, 99])
def test_the_clock_pauses_for_a_late_controller(clock_pair, late_ms) -> None:
    clock = clock_pair.controller
    clock.start()
    clock.wait(0)
    begin = clock_pair.now
    clock_pair.overshoots = [late_ms * NS_PER_MS]
    assert clock.wait(1) == TOLERATED_LATENESS_NS
    assert clock.pause_count == 1
    assert clock.paused_ns == pytest.approx(late_ms * NS_PER_MS - TOLERATED_LATENESS_NS, abs=20_000)
    assert clock.wait(2) <= 20_000, "the deadlines move with the clock"
    assert clock_pair.now - begin == pytest.approx(2 * PERIOD_NS + clock.paused_ns, abs=50_000)
    assert clock.now_ns() == pytest.approx(2 * PERIOD_NS, abs=50_000)


def test_ticks_of_a_controller_that_was_stopped_are_missed(clock_pair) -> None:
    """Stop the controller process for many ticks, as a user can do.

    The clock that controller and simulator share continues during the stop, so the watchdogs of the
    drives fire.
    """
    clock = clock_pair.controller
    clock.start()
    clock.wait(0)
    clock_pair.overshoots = [110 * NS_PER_MS]
    assert clock.wait(1) == pytest.approx(110 * NS_PER_MS, abs=20_000)
    assert clock.pause_count == 0


def test_the_clock_waits_for_the_simulator(clock_pair) -> None:
    clock = clock_pair.controller
    clock.start()
    clock.wait(0)
    simulator_stop_end_ns = clock_pair.now + 30 * NS_PER_MS
    read: list[int] = []

    def stopped() -> None:
        read.append(clock_pair.simulator.now_ns())
        if clock_pair.now >= simulator_stop_end_ns:
            clock_pair.answer()

    clock_pair.between = stopped
    assert clock.wait(1) <= TOLERATED_LATENESS_NS
    assert clock_pair.now >= simulator_stop_end_ns
    assert clock.pause_count == 1
    assert clock.paused_ns == pytest.approx(30 * NS_PER_MS - PERIOD_NS, abs=200_000)
    assert max(read) <= clock.start_ns + PERIOD_NS + TOLERATED_LATENESS_NS
    assert read == sorted(read)


def test_a_simulator_that_stopped_is_not_waited_for_again(clock_pair) -> None:
    """The controller waits once for a simulator that has stopped, and then continues without it.

    The missing frames of the simulator cause the same faults as missing frames on a real bus.
    """
    clock = clock_pair.controller
    clock.start()
    clock.wait(0)
    clock_pair.between = lambda: None
    begin = clock_pair.now
    clock.wait(1)
    assert clock_pair.now - begin == pytest.approx(shared_clock.MAX_SIMULATOR_WAIT_NS, rel=0.02)
    begin = clock_pair.now
    for k in range(2, 50):
        clock.wait(k)
    assert clock_pair.now - begin == pytest.approx(48 * PERIOD_NS, abs=NS_PER_MS)
    clock_pair.between = clock_pair.answer
    clock.wait(50)
    clock_pair.between = lambda: None
    begin = clock_pair.now
    clock.wait(51)
    assert clock_pair.now - begin > shared_clock.MAX_SIMULATOR_WAIT_NS, (
        "after an answer the controller waits for the simulator again"
    )


def test_a_simulator_behind_its_time_is_waited_for(clock_pair) -> None:
    """In this test, the simulator has replied to all frames, but its time is behind the present time.

    The controller still waits, because simulated sensors can send further frames up to the present
    time.
    """
    clock = clock_pair.controller
    clock.start()
    clock.wait(0)
    reached_ns = clock_pair.simulator.now_ns()
    until = clock_pair.now + 10 * NS_PER_MS

    def behind() -> None:
        clock_pair.simulator.publish_answered_ticks(clock_pair.simulator.sent_tick_count())
        clock_pair.simulator.publish_reached_time(
            reached_ns if clock_pair.now < until else clock_pair.simulator.now_ns()
        )

    clock_pair.between = behind
    clock.wait(1)
    assert clock_pair.now >= until


def test_the_simulator_leaves_a_controller_that_stays_away(clock_pair) -> None:
    clock = clock_pair.controller
    clock.start()
    clock.wait(0)
    gate_ns = clock.start_ns + PERIOD_NS + TOLERATED_LATENESS_NS
    clock_pair.now = gate_ns + simulated.MAX_GATE_WAIT_NS
    assert clock_pair.simulator.now_ns() == gate_ns
    clock_pair.now += 1
    assert clock_pair.simulator.now_ns() == clock_pair.now


def test_a_closed_clock_opens_the_gate(clock_pair, tmp_path) -> None:
    clock_pair.controller.start()
    clock_pair.controller.wait(0)
    clock_pair.controller.file.close()
    clock_pair.now += 20 * NS_PER_MS
    assert clock_pair.simulator.now_ns() == clock_pair.now
    clock_pair.simulator.close()
    assert not (tmp_path / "t.clock").exists()


def test_a_time_stamp_before_the_last_pause_is_converted(clock_pair) -> None:
    """A client stamps its targets with CLOCK_MONOTONIC, which never pauses.

    The controller converts the time stamp of a target to the time of the run, in which pauses do
    not count.
    """
    clock = clock_pair.controller
    clock.start()
    clock.wait(0)
    stamp, run_ns = clock_pair.now, clock.now_ns()
    clock_pair.overshoots = [20 * NS_PER_MS]
    clock.wait(1)
    assert clock.convert_to_run_time(stamp) == pytest.approx(run_ns, abs=1)
    assert clock.convert_to_run_time(clock_pair.now) == clock.now_ns()


@pytest.mark.parametrize("seed", range(20))
def test_the_time_of_the_simulator_never_runs_backwards(tmp_path, monkeypatch, seed) -> None:
    """In this test, a simulated machine stops the processes of controller and simulator at random times."""
    rng = random.Random(seed)
    clock_pair = SharedClockPair(
        tmp_path / "t.clock", monkeypatch, scale := rng.choice([0.1, 1.0, 1.0, 4.0])
    )
    clock_pair.controller.busy_wait = rng.random() < 0.5
    read = [0]

    def advance() -> None:
        read.append(clock_pair.simulator.now_ns())
        if rng.random() < 0.7:
            clock_pair.answer()

    clock_pair.between = advance
    if clock_pair.controller.busy_wait:
        monkeypatch.setattr(
            time,
            "monotonic_ns",
            lambda: setattr(clock_pair, "now", clock_pair.now + 500) or clock_pair.now,
        )
    clock_pair.controller.start()
    k = 0
    for _ in range(300):
        if rng.random() < 0.1:
            clock_pair.overshoots = [rng.randrange(30 * NS_PER_MS)]
        late = clock_pair.controller.wait(k)
        assert late <= max(TOLERATED_LATENESS_NS, 60_000 * scale), "no tick is missed"
        advance()
        clock_pair.now += rng.randrange(2 * NS_PER_MS) if rng.random() < 0.1 else 50_000
        k += 1 + late // PERIOD_NS
    assert read == sorted(read)
    assert clock_pair.controller.pause_count > 0


def test_only_buses_of_this_machine_share_a_clock() -> None:
    assert is_local_bus("local:demo")
    assert not is_local_bus("join:demo")
    assert is_local_bus("socketcan:lo"), "an interface without hardware"
    assert not is_local_bus("socketcan:can0")


@pytest.mark.realtime
@pytest.mark.parametrize("stopped_process", ["simulator", "controller"])
def test_a_short_stop_of_a_process_is_no_fault(
    hand_truth_file, calibration_options, started_processes, stopped_process
) -> None:
    """The test repeatedly stops a process for 20 ms, as a busy machine can do.

    Without the shared clock, ten ticks would be late after each stop of the process.
    """
    started_processes.append(
        start_handctl(
            "run", *calibration_options, "--task", "short.toml", "--log", "run.mcap", "--json"
        )
    )
    simulator, controller = started_processes[-2:]
    with closing(StatusWatcher(LOCAL_BUS)) as watcher:
        wait_for_phase("bend", watcher, controller)
    process = simulator if stopped_process == "simulator" else controller
    for _ in range(5):
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.02)
        process.send_signal(signal.SIGCONT)
        time.sleep(0.05)
    code, result, err = process_result(started_processes.pop())
    assert code == 0, err
    assert (result["missed"], result["frames_late"], result["frames_lost"]) == (0, 0, 0)
    assert result["clock_paused_s"] > 0.05
