"""A short run on a bus without nodes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from handctl.core.gains.gains import Gains
from handctl.hand.hand_loading import load_hand
from handctl.programs.task import load_task
from handctl.programs.task_program import TaskProgram
from handctl.session import run
from handctl.session.run_plan import RunPlan, default_control_rate
from tests.drives.protocol_bench import hand_file
from tests.runtime.processes import MOVE_PHASE, TASK_HEAD


class EmptyBus:
    """A bus without nodes. It accepts all frames for sending, but delivers no frames."""

    def __init__(self):
        self.closed = False

    def drain(self):
        return []

    def send(self, frames):
        return len(frames)

    def take_events(self):
        return []

    def close(self):
        self.closed = True


def plan_and_controller(tmp_path: Path, start_display: Callable[..., Any] | None = None):
    """Return the path of a hand file, the plan of a short run of the hand, and the controller of the run."""
    path = hand_file(tmp_path, ["mit"])
    task = tmp_path / "short.toml"
    task.write_text(TASK_HEAD + MOVE_PHASE.format(name="bend", angle=10.0, duration=0.1))
    hand = load_hand(path)
    plan = RunPlan(hand, Gains(), default_control_rate(hand), (0.5,), start_display=start_display)
    return path, plan, run.make_controller(plan, TaskProgram(load_task(task)), None, True)
