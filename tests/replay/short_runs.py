"""Record short runs in lockstep, and write the golden logs, see `golden_logs`."""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from handctl.controller.controller_state import ControllerState
from handctl.controller.run_setup import make_controller
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import IoEvent, TickIn, TickOut
from handctl.drives.frame import Frame
from handctl.hand.hand_loading import hand_path, load_hand
from handctl.log.tick_packing import pack_tick_record
from handctl.log.write.recorder import Recorder
from handctl.programs.program import Program
from handctl.programs.task import load_task
from handctl.programs.task_program import TaskProgram
from handctl.runtime.clocks.lockstep import (
    LockstepBus,
    LockstepClock,
    LockstepSimulator,
    load_simulator,
)
from handctl.runtime.loop import ControlLoop
from handctl.session.run import snapshot_recorder
from handctl.session.run_header import run_header
from handctl.session.run_plan import RunPlan

SHORT_GRASP_TASK = """schema = 1
name = "short grasp"
description = "Close, hold, let go, as fast as it goes"
[[phase]]
kind = "move"
name = "preshape"
angle_deg = { index = 18.0, middle = 18.0, ring = 18.0, thumb = 3.0 }
duration_s = 0.4
[[phase]]
kind = "close"
angle_deg = 85.0
speed_deg_s = 80.0
contact_tension_N = 14.0
[[phase]]
kind = "hold"
tension_N = 24.0
rate_N_per_s = 80.0
duration_s = 0.8
[[phase]]
kind = "release"
tension_N = 9.0
rate_N_per_s = 120.0
"""

CYLINDER_SCENE = """name = "cylinder"
[object]
shape = "cylinder"
diameter_m = 0.035
length_m = 0.093
mass_kg = 0.15
friction = {friction}
position_m = [0.0195, 0.0, 0.0]
[support]
drop_when = "grasped"
drop_hold_s = 0.1
sink_speed_m_s = 0.2
"""


@dataclass
class PeerWithLostReplies:
    """Wrap a lockstep simulator, and drop some of the simulator's replies.

    From the time ``drop_start_ns`` on, the wrapper drops all replies with the identifier
    ``can_id``.

    Attributes:
        simulator: the wrapped simulator, which sends all replies.
        can_id: CAN identifier of the replies that the wrapper drops.
        drop_start_ns: time from which on replies are dropped [ns].
    """

    simulator: LockstepSimulator
    can_id: int
    drop_start_ns: int

    def step(self, t_ns: int, frames: list[Any]) -> list[Any]:
        """Step the wrapped simulator, and return those of its replies that the wrapper does not drop."""
        replies = self.simulator.step(t_ns, frames)
        return [
            reply
            for reply in replies
            if t_ns < self.drop_start_ns or Frame(*reply).can_id != self.can_id
        ]

    def close(self) -> None:
        """Close the wrapped simulator."""
        self.simulator.close()


def short_task(task_folder: Path) -> TaskProgram:
    """Write the task file of a short grasp into a folder, and return the program of the task."""
    path = task_folder / "task.toml"
    path.write_text(SHORT_GRASP_TASK)
    return TaskProgram(load_task(path))


def record_lockstep_run(
    log_path: Path,
    program: Program,
    *,
    hand_name: str = "jamia",
    rate_hz: float = 250.0,
    friction_factor: float = 0.5,
    seed: int = 0,
    wrap_simulator: Callable[[LockstepSimulator], LockstepSimulator] = lambda peer: peer,
    io_events: dict[int, tuple[IoEvent, ...]] | None = None,
    requests: dict[int, tuple[str, ...]] | None = None,
    truth: Path | None = None,
) -> ControllerState:
    """Run a program in lockstep on a simulated hand that closes on a cylinder, and record a log.

    Args:
        log_path: path of the log. The log contains no data about the machine or the date.
        program: the program to run.
        hand_name, rate_hz, seed: name of the hand, control rate [Hz], and seed of the simulator.
        friction_factor: friction coefficient of the cylinder.
        wrap_simulator: function that wraps the simulator, for example to drop some replies.
        io_events, requests: events of the buses and of the host, and requests to the controller,
            each by the number of the tick in which it arrives.
        truth: path of the truth file. If the path is None, the simulator writes no truth file.
    """
    hand = load_hand(hand_name)
    plan = RunPlan(hand, Gains(), rate_hz, ())
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene.toml"
        scene.write_text(CYLINDER_SCENE.format(friction=friction_factor))
        options: dict[str, object] = {
            "hand_path": str(hand_path(hand_name)),
            "scene": str(scene),
            "seed": seed,
            "homed": True,
        }
        options["truth_path"] = str(truth) if truth else None
        peer = load_simulator(
            "firmware_sim.lockstep_hand:LockstepHand", **options, period_ns=plan.period_ns
        )
    clock = LockstepClock(wrap_simulator(peer), plan.period_ns)
    controller = make_controller(hand, plan.gains, rate_hz, program, None, arm_at_once=True)
    header = run_header(plan, controller, None, lockstep=True)
    attachments = {
        name: data for name, data in header.attachments.items() if name != "pip-freeze.txt"
    }
    recorder = Recorder.start(log_path, replace(header, wall={}, attachments=attachments))

    def record(tick_input: TickIn, tick_output: TickOut) -> None:
        recorder.send_record(pack_tick_record(tick_input, tick_output))

    control_loop = ControlLoop(
        clock,
        plan.period_ns,
        [LockstepBus(clock)],
        controller.begin_tick,
        controller.torque_cut_frames(),
        lambda: (requests or {}).get(clock.k, ()),
        lambda: [*recorder.take_events(), *(io_events or {}).get(clock.k, ())],
        record,
        lambda tick_input, tick_output: None,
        snapshot_recorder(recorder),
    )
    try:
        return control_loop.run(controller.initial_state())
    finally:
        recorder.close("done")
        peer.close()


def drop_index_motor_replies(peer: LockstepSimulator) -> LockstepSimulator:
    """Wrap a simulator so that replies of the index motor are lost.

    From 2.2 s on, the wrapper drops the replies of the index motor. At 2.2 s, the run is in the
    hold phase.
    """
    return PeerWithLostReplies(peer, 0x11, 2_200_000_000)


def write_golden_logs(log_folder: Path) -> None:
    """Write new golden logs into a folder."""
    log_folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        task = short_task(Path(scratch))
    for old_log in log_folder.glob("*.mcap"):
        old_log.unlink()
    record_lockstep_run(log_folder / "jamia-grasp.mcap", task, rate_hz=200.0)
    record_lockstep_run(log_folder / "jamia-lost.mcap", task, rate_hz=200.0, friction_factor=0.02)
    events = {400: (IoEvent("dropped", "main", 3),)}
    record_lockstep_run(
        log_folder / "jamia-fault.mcap",
        task,
        rate_hz=200.0,
        wrap_simulator=drop_index_motor_replies,
        io_events=events,
    )
    record_lockstep_run(log_folder / "jamia11-grasp.mcap", task, hand_name="jamia11", rate_hz=200.0)
