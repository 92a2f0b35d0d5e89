"""Run simulated hands to get the data of the figures.

All runs are in lockstep, which makes them reproducible.
"""

import contextlib
import io
import json
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.campaign.run_stages import advance_to_stage, homed_run
from handctl.cli.main import main
from handctl.controller.run_setup import make_controller
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.programs.program import Program
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.replay.motion_replay import active_interval, playback_program
from handctl.report.truth_record import TruthRecord, read_truth
from handctl.session.lockstep_simulation import SimulatedRun, SimulatorSettings
from tools.figures.style import PLOT_SETTINGS

Array = NDArray[np.float64]
DEMO_COMMAND = ("demo", "--lockstep", "--json")
"""Arguments of the command whose results are in the README."""
RATE_HZ = 500.0
SNAP_S = 0.25
"""Time after the snap of the tendon until the end of the figure [s]."""
TIP_HAND, TIP_RATE_HZ = "jamia11", 200.0
TIP_COMMANDS_N = (2.0, 4.0, 6.0)
GRIP_COMMANDS_N = (1.0, 1.5, 2.0)
FINGER_NAMES = ("index", "middle", "ring")
WALL_SCENE = """name = "wall"
[object]
shape = "box"
size_m = [0.04, 0.02, 0.093]
mass_kg = 50.0
friction = 0.5
position_m = [0.045, -0.001, 0.0]
[support]
drop_when = "never"
"""
"""Scene with a heavy block. Only the last link of each digit can reach the block."""


@dataclass
class RunRecording:
    """Recorded values of a run, one row for each tick.

    Attributes:
        t: (ticks,) time of each tick [s].
        values: arrays by name: telemetry fields, ``true_tension``, ``true_torque``, ``true_contact``.
        phase: name of the program phase in each tick.
        mode: mode of the hand in each tick.
        events: time and text of each event.
    """

    t: Array
    values: dict[str, Array]
    phase: list[str]
    mode: list[HandMode]
    events: list[tuple[float, str]] = field(default_factory=list)


RECORDED_FIELDS = ("q", "tension", "motor_torque_goal", "tip_force")
"""Telemetry fields that a recording contains."""


def record_run(run: SimulatedRun, seconds: float, end_phase: str = "") -> RunRecording:
    """Continue a simulated run and record it.

    The recording stops when the phase ``end_phase`` begins, when the run is done, or after
    ``seconds``.

    Args:
        run: simulation to continue, in any phase of its program.
        seconds: longest duration of the recording [s].
        end_phase: name of the program phase whose start ends the recording.
    """
    rows: dict[str, list[Array]] = {
        name: [] for name in (*RECORDED_FIELDS, "true_tension", "true_torque", "true_contact")
    }
    recording = RunRecording(np.zeros(0), {}, [], [])
    times = []
    run.are_ticks_recorded = False
    for _ in range(round(seconds * 1e9 / run.period_ns)):
        t = run.k * run.period_ns * 1e-9
        truth = run.simulated_hand.truth()
        contact = np.linalg.norm(
            np.reshape(run.simulated_hand.world.plant.contact_forces(), (-1, 3)), axis=1
        )
        tick_output = run.run_tick()
        times.append(t)
        for name in RECORDED_FIELDS:
            rows[name].append(np.array(getattr(tick_output.telemetry, name)))
        rows["true_tension"].append(np.array(truth["tension"]))
        rows["true_torque"].append(np.array(truth["torque"]))
        rows["true_contact"].append(contact)
        recording.phase.append(tick_output.phase)
        recording.mode.append(tick_output.mode)
        recording.events += [(t, event.text) for event in tick_output.events]
        if tick_output.mode == HandMode.DONE or (end_phase and tick_output.phase == end_phase):
            break
    recording.t = np.array(times)
    recording.values = {name: np.array(values) for name, values in rows.items()}
    return recording


def grasp_run(folder: Path) -> tuple[RunLog, TruthRecord, dict[str, Any]]:
    """Return the log, the true values and the printed result of `handctl demo`.

    If the files of an earlier execution of `handctl demo` exist, the function does not execute the
    command again.
    """
    log = folder / "grasp.mcap"
    printed = folder / "grasp.json"
    if not printed.exists():
        printed_text = io.StringIO()
        with contextlib.redirect_stdout(printed_text):
            code = main([*DEMO_COMMAND, "--log", str(log)])
        if code:
            raise RuntimeError(f"handctl {' '.join(DEMO_COMMAND)} returned {code}")
        printed.write_text(printed_text.getvalue(), encoding="utf-8")
    return (
        RunLog(log),
        read_truth(log.with_suffix(".truth")),
        json.loads(printed.read_text(encoding="utf-8")),
    )


def run_picture(folder: Path) -> Path:
    """Return the path of the picture that `handctl demo` has drawn."""
    grasp_run(folder)
    return folder / "grasp.png"


def view_picture(folder: Path) -> Path:
    """Draw the log of `handctl demo` in the viewer Rerun, at a time when the hand holds the object.

    The viewer needs a Vulkan driver.
    """
    log, _, _ = grasp_run(folder)
    at_s = next(change.t_ns for change in log.phases if change.name == "hold") * 1e-9 + 2.5
    path = folder / "view.png"
    if code := main(
        ["view", str(folder / "grasp.mcap"), "--picture", str(path), "--at", f"{at_s:.1f}"]
    ):
        raise RuntimeError(f"handctl view returned {code}")
    return path


def replay_run(folder: Path) -> RunRecording:
    """Replay the log of `handctl demo` on a simulated hand with other sensor noise, and record the replay."""
    log, _, _ = grasp_run(folder)
    program: Program = playback_program(log, 1.0 / RATE_HZ, False)
    hand = load_hand("jamia")
    controller = make_controller(hand, Gains(), RATE_HZ, program, None, arm_at_once=True)
    with SimulatorSettings(hand, "cylinder", 5, homed=True).begin_run(controller) as run:
        return record_run(run, 30.0)


def recording_interval(log: RunLog) -> tuple[float, float]:
    """Return the start time and the end time of the part of a log that a replay repeats [s]."""
    return active_interval(log)


def snap_run() -> RunRecording:
    """Record a grasp in which the tendon of the index finger snaps."""
    with homed_run(load_hand("jamia"), RATE_HZ, 0) as run:
        advance_to_stage(run, "grasp")
        record_run(run, 0.5)
        recording_before = record_run(run, 0.05)
        run.simulated_hand.inject("snap tendon=index_tendon")
        recording_after = record_run(run, SNAP_S)
    t = np.concatenate([recording_before.t, recording_after.t]) - recording_after.t[0]
    values = {
        name: np.concatenate([recording_before.values[name], recording_after.values[name]])
        for name in recording_before.values
    }
    events = [(when - recording_after.t[0], text) for when, text in recording_after.events]
    return RunRecording(
        t,
        values,
        recording_before.phase + recording_after.phase,
        recording_before.mode + recording_after.mode,
        events,
    )


def tip_on_wall() -> RunRecording:
    """Record a hand that presses on a wall with three commanded tip forces.

    The recorded hand has one tendon per joint.
    """
    opened = {"index": 6.0, "middle": 6.0, "ring": 6.0, "thumb": 0.0}
    return _record_press(
        WALL_SCENE, opened, 60.0, [{"tip_force_N": force} for force in TIP_COMMANDS_N]
    )


def tip_in_grasp() -> RunRecording:
    """Record a simulated hand that holds a cylinder.

    Each finger gets three commanded tip forces, one after another.

    The commanded force of the thumb is the sum of the forces of the fingers.
    """
    opened = {**dict.fromkeys(FINGER_NAMES, 15.0), "thumb": 8.0}
    closed = {**dict.fromkeys(FINGER_NAMES, 60.0), "thumb": 45.0}
    forces = [
        {**dict.fromkeys(FINGER_NAMES, force), "thumb": len(FINGER_NAMES) * force}
        for force in GRIP_COMMANDS_N
    ]
    return _record_press(
        "cylinder:35", opened, closed, [{"tip_force_N": force} for force in forces]
    )


def _record_press(
    scene: str, opened_angles: Any, closed_angles: Any, hold_phases: list[dict[str, Any]]
) -> RunRecording:
    """Close the hand ``TIP_HAND`` on the object of a scene, hold the object, and record the run.

    The hold phases are named 0, 1 and so on.
    """
    hand = load_hand(TIP_HAND)
    phases: list[dict[str, Any]] = [
        {"kind": "move", "angle_deg": opened_angles, "duration_s": 0.8},
        {"kind": "close", "angle_deg": closed_angles, "speed_deg_s": 50.0},
        *(
            {"kind": "hold", "name": str(i), **hold, "duration_s": 1.5}
            for i, hold in enumerate(hold_phases)
        ),
    ]
    task = Task.model_validate_json(json.dumps({"schema": 1, "name": "tip", "phase": phases}))
    controller = make_controller(
        hand, Gains(), TIP_RATE_HZ, TaskProgram(task), None, arm_at_once=True
    )
    with SimulatorSettings(hand, scene, 0, homed=True).begin_run(controller) as run:
        return record_run(run, 14.0)


def training_picture(folder: Path) -> Path:
    """Run ``examples/train_policy.py``, and return the path of its picture."""
    program = Path(__file__).parents[2] / "examples" / "train_policy.py"
    # matplotlib reads its settings from the file matplotlibrc in the working folder of the process.
    style = "".join(f"{key}: {value}\n" for key, value in PLOT_SETTINGS.items())
    (folder / "matplotlibrc").write_text(style, encoding="utf-8")
    subprocess.run(
        [sys.executable, str(program)], cwd=folder, check=True, stdout=subprocess.DEVNULL
    )
    return folder / "training.png"
