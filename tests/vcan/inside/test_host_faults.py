"""Test the host faults that only the user root can cause.

During a run, the test sets the wall clock of the guest system, or takes one of its CAN interfaces
down.
"""

import fcntl
import os
import shutil
import socket
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from firmware_sim.truth_file import TruthFile, read_truth
from handctl.controller.bus_load import bus_loads
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import HandMode, TickIn, TickOut
from handctl.errors import LogError
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.live_session import JogProgram
from handctl.programs.requests import HoldTensionRequest
from handctl.session.exit_codes import ExitCode
from handctl.session.run import RunOutcome, make_controller, run_live
from handctl.session.run_plan import RunPlan
from tests.drives.protocol_bench import hand_file
from tests.vcan.inside.conftest import STALL_FAULTS
from tests.vcan.inside.test_protocols import DIGIT_NAMES, PULL_N, RATE_HZ, simulated_hand_process

SIOCGIFFLAGS, SIOCSIFFLAGS, IFF_UP = 0x8913, 0x8914, 1
"""Numbers of two ioctl requests of Linux, and the flag of a network interface that is up.

Source: Linux ``sockios.h`` and ``if.h``.
"""
WATCHDOG_MS = 50
HOUR_S = 3600.0
FAULT_AFTER_S, PULL_AFTER_FAULT_S = 0.15, 0.3
"""Time from the start of a tendon pull to the fault [s], and planned duration of the pull after the fault [s]."""
TIME_SCALE = 0.1


def set_interface_up(can_interface: str, is_up: bool) -> None:
    """Set a CAN interface up or down, like ``ip link set INTERFACE up``, but without starting a process."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        name = can_interface.encode().ljust(16, b"\0")
        (flags,) = struct.unpack_from(
            "=h", fcntl.ioctl(any_socket, SIOCGIFFLAGS, name + bytes(24)), 16
        )
        flags = flags | IFF_UP if is_up else flags & ~IFF_UP
        fcntl.ioctl(any_socket, SIOCSIFFLAGS, name + struct.pack("=h", flags) + bytes(22))


class FaultObserver:
    """Observer that injects faults into the controller run that it observes.

    While the hand pulls its tendons, the observer calls the given functions in their order. Each
    function causes a fault.

    See ``session.run.RunObserver``.
    """

    def __init__(self, *fault_action: Callable[[], None]) -> None:
        self.fault_actions = fault_action
        self.reset()

    def reset(self) -> None:
        """Prepare the observer for a new run.

        After the reset, the observer has caused no fault, and has recorded no mode of the hand.
        """
        self.done_ns, self.modes, self.pulled, self.left = (
            0,
            list[HandMode](),
            0,
            list(self.fault_actions),
        )

    def poll_requests(self) -> tuple[str, ...]:
        return ()

    def on_tick(self, tick_input: TickIn, out: TickOut) -> None:
        self.modes.append(out.mode)
        self.pulled += out.mode == HandMode.ACTIVE
        if (
            self.left
            and self.pulled
            >= (len(self.fault_actions) - len(self.left) + 1) * FAULT_AFTER_S * RATE_HZ
        ):
            self.left.pop(0)()
            self.done_ns = round(time.monotonic_ns() * TIME_SCALE)


def run_tendon_pull(work_folder: Path, observer: FaultObserver) -> tuple[RunOutcome, TruthFile]:
    """Arm a hand, pull every tendon, relax the tendons, and disarm the hand.

    While the hand pulls its tendons, ``observer`` injects its faults.
    """
    path = hand_file(work_folder, ["mit"])
    hand = load_hand(str(path))
    load = tuple(bus_load.load_at_rate(RATE_HZ) for bus_load in bus_loads(hand))
    plan = RunPlan(hand, Gains(), RATE_HZ, load, ("socketcan:vcan0",), time_scale=TIME_SCALE)
    program = JogProgram(
        HoldTensionRequest(do="hold", tension_N=dict.fromkeys(DIGIT_NAMES, PULL_N)),
        FAULT_AFTER_S + PULL_AFTER_FAULT_S,
    )
    with simulated_hand_process(path, plan.buses, TIME_SCALE, work_folder / "truth"):
        controller = make_controller(plan, program, None, arm_at_once=True)
        outcome = run_live(plan, controller, work_folder / "run.mcap", observer=observer)
    return outcome, read_truth(work_folder / "truth")


def run_until_done(
    work_folder: Path, observer: FaultObserver, expected_end: str
) -> tuple[RunOutcome, TruthFile]:
    """Execute runs until one ends as expected, and return the outcome and the true values of this run.

    If a run ends because the only core of the guest system was busy, the test repeats the run. A
    defect of handctl can end a run with the same error as a busy core. If none of five runs ends as
    expected, the function assumes a defect, and the test fails.
    """
    failure_text = ""
    for number in range(5):
        run_folder = work_folder / str(number)
        run_folder.mkdir()
        observer.reset()
        set_interface_up("vcan0", True)
        try:
            outcome, truth = run_tendon_pull(run_folder, observer)
        except LogError as error:  # the run failed because the recorder did not start in time
            failure_text = str(error)
            continue
        failure_text = outcome.state.failure
        if not observer.left and (
            expected_end in failure_text if expected_end else not failure_text
        ):
            (run_folder / "run.mcap").rename(work_folder / "run.mcap")
            return outcome, truth
        assert any(row in failure_text for row in STALL_FAULTS), failure_text
    pytest.fail(f"none of five runs came through: {failure_text}")


@pytest.fixture
def can_interface() -> Iterator[str]:
    """Yield the name of a CAN interface, and set the interface up again after the test."""
    assert shutil.which("ip")
    yield "vcan0"
    set_interface_up("vcan0", True)


@pytest.fixture
def restore_wall_clock() -> Iterator[None]:
    """Restore the wall clock of the guest after a test."""
    wall, mono = time.time(), time.monotonic()
    yield
    time.clock_settime(time.CLOCK_REALTIME, wall + time.monotonic() - mono)


@pytest.mark.nightly
@pytest.mark.timeout(600)
@pytest.mark.usefixtures("restore_wall_clock")
def test_steps_of_the_wall_clock_have_no_effect(tmp_path: Path) -> None:
    """In this test, the wall clock is set one hour forward, and after that two hours back.

    A step of the wall clock is the fault H11 of the fault catalogue.
    """
    offsets = [time.time() - time.monotonic()]

    def step_clock(seconds: float) -> None:
        time.clock_settime(time.CLOCK_REALTIME, time.time() + seconds)
        offsets.append(time.time() - time.monotonic())

    outcome, truth = run_until_done(
        tmp_path, FaultObserver(lambda: step_clock(HOUR_S), lambda: step_clock(-2.0 * HOUR_S)), ""
    )
    moved = np.diff(offsets[-3:])
    assert moved == pytest.approx([HOUR_S, -2.0 * HOUR_S], abs=5.0), "the wall clock moved"
    assert (outcome.state.failure, outcome.exit_code) == ("", ExitCode.DONE)
    for digit in DIGIT_NAMES:
        assert truth.column(f"tension/{digit}_tendon").max() > 0.25 * PULL_N, digit
    with RunLog(tmp_path / "run.mcap") as log:
        assert not log.warning
        assert (np.diff(log.t_ns) > 0).all()
        assert not [event.event.text for event in log.events if event.event.level == "error"]


@pytest.mark.timeout(600)
def test_an_interface_taken_down_cuts_the_run_and_the_drives_drop_torque(
    can_interface: str, tmp_path: Path
) -> None:
    """A CAN interface that is taken down is the fault B14 of the fault catalogue."""
    observer = FaultObserver(lambda: set_interface_up(can_interface, False))
    outcome, truth = run_until_done(tmp_path, observer, "B14")
    assert "B14" in outcome.state.failure, outcome.state.failure
    assert outcome.exit_code == ExitCode.REMOVE_POWER, "no drive confirmed the end of torque"
    modes_after = observer.modes[observer.modes.index(HandMode.ACTIVE) :]
    fault_tick = round(FAULT_AFTER_S * RATE_HZ)
    assert modes_after[: fault_tick + 3].count(HandMode.ACTIVE) <= fault_tick + 1, (
        "the next tick removes torque"
    )
    torque = np.array([truth.column(f"torque/{digit}_motor") for digit in DIGIT_NAMES])
    driven = truth.t_ns[np.abs(torque).max(axis=0) > 1e-3]
    late_ms = (int(driven[-1]) - observer.done_ns) * 1e-6
    assert truth.column("tension/index_tendon").max() > 0.25 * PULL_N, "the tendon was taut before"
    assert late_ms <= WATCHDOG_MS + 20.0, f"{late_ms:.0f} ms, the guest's clocks slip"
    with RunLog(tmp_path / "run.mcap") as log:
        assert not log.warning
    assert os.path.getsize(tmp_path / "run.mcap") > 0
