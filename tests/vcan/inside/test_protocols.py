"""Test that a hand on real SocketCAN can be armed, can pull its tendons, and can be disarmed.

The tests use each drive protocol, and a hand on two buses.

The simulated hand is a fork of the test process. A new process would need more time for its imports
than the test takes.
"""

import ctypes
import multiprocessing
import os
import select
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import mujoco  # type: ignore[import-untyped,unused-ignore]
import numpy as np
import pytest

from firmware_sim.__main__ import main as firmware_sim
from firmware_sim.truth_file import TruthFile, read_truth
from handctl.compiled import compile_kernels
from handctl.controller.bus_load import bus_loads
from handctl.controller.run_setup import make_drives, make_sensors
from handctl.core.gains.gains import Gains
from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.protocol_registry import PROTOCOL_ENTRIES
from handctl.hand.hand_loading import load_hand
from handctl.programs.live_session import JogProgram
from handctl.programs.requests import HoldTensionRequest
from handctl.runtime.buses.bus_opening import open_bus
from handctl.runtime.clocks.real_clock import RealClock
from handctl.session.exit_codes import ExitCode
from handctl.session.run import RunOutcome, make_controller, run_live
from handctl.session.run_plan import RunPlan
from tests.drives.protocol_bench import hand_file, move_to_second_bus

RATE_HZ = 200.0
PERIOD_NS = 5_000_000
READY_TIMEOUT_S, EXIT_TIMEOUT_S = 30.0, 20.0
SPOOL_TORQUE_N_M, TORQUE_S = 0.05, 0.3
TAUT_TENSION_N, PULLED_N = 5.0, 3.0
"""Smallest tendon tension under motor torque [N], and largest tendon tension after the motor was disabled [N]."""
PULL_N, PULL_S = 20.0, 0.2
DIGIT_NAMES = ("index", "middle", "ring", "thumb")


def run_simulator_in_child(simulator_options: Sequence[str], ready_pipe: int) -> None:
    """Run the simulator in the present child process. The output of the simulator goes into a pipe."""
    mujoco.set_mjcb_time(
        ctypes.cast(ctypes.CDLL(None).drand48, ctypes.CFUNCTYPE(ctypes.c_double))
    )  # conftest.py explains this clock
    sys.stdout = os.fdopen(ready_pipe, "w")
    raise SystemExit(firmware_sim(list(simulator_options)))


@contextmanager
def simulated_hand_process(
    hand_path: Path, bus_texts: Sequence[str], time_scale: float, truth_file: Path
) -> Iterator[None]:
    """Run a simulated hand with taut tendons in another process, and check that the process ends without an error."""
    names = load_hand(str(hand_path)).bus_names
    words = [
        word
        for name, spec in zip(names, bus_texts, strict=True)
        for word in ("--bus", f"{name}={spec}")
    ]
    words += [
        "--hand",
        str(hand_path),
        "--truth",
        str(truth_file),
        "--time-scale",
        str(time_scale),
        "--homed",
    ]
    parent_pipe, child_pipe = os.pipe()
    child = multiprocessing.get_context("fork").Process(
        target=run_simulator_in_child, args=(words, child_pipe)
    )
    child.start()
    os.close(child_pipe)
    try:
        assert select.select([parent_pipe], [], [], READY_TIMEOUT_S)[0], (
            "firmware_sim did not start"
        )
        assert os.read(parent_pipe, 4096).startswith(b"firmware_sim: ready")
        yield
        child.terminate()
        child.join(EXIT_TIMEOUT_S)
        assert child.exitcode == 0
    finally:
        child.kill()
        child.join()
        os.close(parent_pipe)


class HandDrives:
    """The drives of a hand on real CAN sockets, without a controller.

    In each tick, an object of this class sends a SYNC frame and the commands of all drives. If
    ``time_scale`` is less than 1, the ticks are slower than in real time.
    """

    def __init__(self, hand_path: Path, bus_texts: Sequence[str], time_scale: float) -> None:
        self.clock = RealClock(PERIOD_NS, time_scale)
        hand = load_hand(str(hand_path))
        self.buses = [
            open_bus(spec, i, bus.bitrate, bus.data_bitrate, self.clock.convert_to_run_time)
            for i, (spec, bus) in enumerate(zip(bus_texts, hand.bus, strict=True))
        ]
        self.drives, self.sensors = make_drives(hand), make_sensors(hand)
        self.states = [drive.initial_state() for drive in self.drives]
        self.k = 0
        compile_kernels()  # compile the kernels in advance, so that no watchdog fires during the compilation
        self.clock.start()

    def tick(self, target: DriveTarget, torque: float = 0.0) -> None:
        self.clock.wait(self.k)
        for frame in [frame for bus in self.buses for frame in bus.drain()]:
            self.states = [
                d.receive(s, frame) for d, s in zip(self.drives, self.states, strict=True)
            ]
        self.buses[self.sensors.bus].send([self.sensors.sync(self.k)])
        for i, drive in enumerate(self.drives):
            self.states[i], frames = drive.advance(
                self.states[i], self.k * PERIOD_NS, target, torque
            )
            assert self.buses[drive.bus].send(frames) == len(frames)
        self.k += 1

    def run_until_phase(self, target: DriveTarget, phase: DrivePhase, max_ticks: int = 600) -> None:
        for _ in range(max_ticks):
            self.tick(target)
            if all(state.phase == phase for state in self.states):
                return
        pytest.fail(
            f"{[(state.phase.name, state.error_text) for state in self.states]}, expected {phase.name}"
        )

    def close(self) -> None:
        for bus in self.buses:
            assert bus.take_events() == []
            bus.close()


@pytest.mark.parametrize("protocol", sorted(PROTOCOL_ENTRIES))
def test_a_hand_is_armed_pulls_and_is_disarmed(protocol: str, tmp_path: Path) -> None:
    path, truth_path, time_scale = hand_file(tmp_path, [protocol]), tmp_path / "truth", 0.2
    path.write_text(path.read_text().replace("watchdog_ms = 50", "watchdog_ms = 500"))
    with simulated_hand_process(path, ["socketcan:vcan0"], time_scale, truth_path):
        hand = HandDrives(path, ["socketcan:vcan0"], time_scale)
        hand.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
        hand.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
        for _ in range(int(TORQUE_S * RATE_HZ)):
            hand.tick(DriveTarget.ENABLE, SPOOL_TORQUE_N_M)
        assert [state.phase for state in hand.states] == [DrivePhase.ENABLED] * len(DIGIT_NAMES)
        hand.run_until_phase(DriveTarget.DISABLE, DrivePhase.READY)
        for _ in range(int(TORQUE_S * RATE_HZ)):
            hand.tick(DriveTarget.POLL)
        hand.close()
    truth = read_truth(truth_path)
    assert truth.header["lost_frames"] == 0
    for digit in DIGIT_NAMES:
        tension = truth.column(f"tension/{digit}_tendon")
        assert tension.max() > TAUT_TENSION_N, digit
        assert np.median(tension[-10:]) < PULLED_N, digit


def test_one_hand_over_two_buses_with_two_protocols(tmp_path: Path) -> None:
    """Run the whole controller and its recorder with a hand on two buses.

    The drives of the hand use the protocols CiA 402 and ODrive. The module ``test_run`` tests
    neither CiA 402 nor ODrive.
    """
    path = move_to_second_bus(hand_file(tmp_path, ["cia402", "cia402", "odrive"]))
    outcome, truth = run_tendon_pull(path, ["socketcan:vcan0", "socketcan:vcan1"], tmp_path)
    assert outcome.state.failure == ""
    assert outcome.state.unconfirmed_motors == ()
    assert outcome.exit_code == ExitCode.DONE
    assert outcome.loop_stats.refused_frames == truth.header["lost_frames"] == 0
    for digit in DIGIT_NAMES:
        assert truth.column(f"tension/{digit}_tendon").max() > 0.25 * PULL_N, (
            digit
        )  # the limit of the tension is low, because the clocks of the guest system jump


def run_tendon_pull(
    hand_path: Path, bus_options: Sequence[str], work_folder: Path
) -> tuple[RunOutcome, TruthFile]:
    """Arm a hand, pull every tendon for a moment, relax the tendons, and disarm the hand.

    Return the outcome of the run, and the true values from the simulator.
    """
    hand, time_scale = load_hand(str(hand_path)), 0.1
    load = tuple(bus_load.load_at_rate(RATE_HZ) for bus_load in bus_loads(hand))
    plan = RunPlan(hand, Gains(), RATE_HZ, load, tuple(bus_options), time_scale=time_scale)
    program = JogProgram(
        HoldTensionRequest(do="hold", tension_N=dict.fromkeys(DIGIT_NAMES, PULL_N)), PULL_S
    )
    with simulated_hand_process(hand_path, bus_options, time_scale, work_folder / "truth"):
        outcome = run_live(
            plan, make_controller(plan, program, None, arm_at_once=True), work_folder / "run.mcap"
        )
    return outcome, read_truth(work_folder / "truth")
