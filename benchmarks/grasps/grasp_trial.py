"""Run a task on a simulated hand in lockstep, and record the true values of the simulator."""

from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from firmware_sim.plant.mjcf import STEP_S
from firmware_sim.plant.plant import Plant
from handctl.core import state_block as s
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, TickEvent
from handctl.hand.hand_loading import load_hand
from handctl.programs.program import Program
from handctl.programs.task import HoldPhase
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller
from handctl.session.run_plan import default_control_rate
from handctl.session.task_loading import load_task_for_hand

TIMEOUT_S = 120.0
LOST_DISTANCE_M = 0.3
DEFAULT_GAINS = Gains()


@cache
def hand_model(hand_name: str, gains: Gains = DEFAULT_GAINS) -> tuple[HandModel, float]:
    """Return the controller's model of a hand, and the default control rate of the hand [Hz].

    Each process computes the model of a hand only once.
    """
    hand = load_hand(hand_name)
    rate = default_control_rate(hand)
    return HandModel.from_hand(hand, gains, rate), rate


@dataclass
class GraspRun:
    """Record of one run of a task on a simulated hand. The arrays have one row per tick.

    Attributes:
        t: (ticks,) time of each tick [s].
        phase: (ticks,) name of the phase of the task.
        stage: (ticks,) number of the stage of the scene.
        object_position: (ticks, 3) position of the object [m].
        true_force: (ticks, digits) true contact force on each digit [N].
        contact: (ticks, digits) True if the controller reports contact of the digit.
        tension: (ticks, tendons) tension that the controller estimates [N].
        external_tension: (ticks, tendons) external tension that the controller estimates [N].
        excursion: (ticks, tendons) tendon excursion that the controller reports [m].
        filter_states: (ticks, values) for each tendon, the values of the tension filter from
            ``SPOOL_TRAVEL`` to ``STRETCH_OFFSET`` in the state block of the controller.
        estimated_tip_force: (ticks, digits) contact force on the tip that the controller estimates [N].
        q: (ticks, joints) true joint angles [rad].
        contact_normal: (ticks, digits) sum of the normal forces on each digit [N]. The array
            ``contact_normal`` exists only in scenes with a load.
        object_rotation: (ticks, 4) orientation of the object as a quaternion (qw, qx, qy, qz).
        events: every event of the controller, with the index of its tick.
        failure: reason why the controller ended the run.
        table_sink_start_s: time at which the table begins to sink [s], or None.
    """

    t: np.ndarray
    phase: list[str]
    stage: np.ndarray
    object_position: np.ndarray
    true_force: np.ndarray
    contact: np.ndarray
    tension: np.ndarray
    external_tension: np.ndarray
    excursion: np.ndarray
    filter_states: np.ndarray
    estimated_tip_force: np.ndarray
    q: np.ndarray
    contact_normal: np.ndarray
    object_rotation: np.ndarray
    events: list[tuple[int, TickEvent]] = field(default_factory=list)
    failure: str = ""
    table_sink_start_s: float | None = None


def task_program(task_name: str, hand_name: str, hold_s: float | None = None) -> TaskProgram:
    """Return the controller program for a hand and a task.

    The task is a packaged task or a task file.

    ``hold_s`` replaces the duration of each hold phase [s].
    """
    packaged_task, _ = load_task_for_hand(Path(task_name), load_hand(hand_name))
    phases = [
        phase.model_copy(update={"duration_s": hold_s})
        if hold_s is not None and isinstance(phase, HoldPhase)
        else phase
        for phase in packaged_task.phase
    ]
    return TaskProgram(packaged_task.model_copy(update={"phase": tuple(phases)}))


def simulate_grasp(
    hand_name: str,
    program: Program,
    scene: str | None,
    *,
    seed: int = 0,
    plant_factors: dict[str, float] | None = None,
    last_phase: str = "",
    gains: Gains = DEFAULT_GAINS,
    timeout_s: float = TIMEOUT_S,
    retry_timeout_s: float = TIMEOUT_S,
) -> GraspRun:
    """Run a controller program on a simulated hand. The motor zeros of the hand are known.

    Args:
        hand_name: name of a packaged hand.
        program: program of the controller.
        scene: text of a scene file, name of a packaged scene, or None.
        seed: seed of the simulator.
        plant_factors: factors that multiply parameters of the simulated hand.
        last_phase: the run ends when this phase begins.
        timeout_s: the run ends at this time [s].
        retry_timeout_s: the run ends after this time if the table has not begun to sink [s].
    """
    model, rate = hand_model(hand_name, gains)
    controller = homed_controller(model, program)
    rows = []
    phases = []
    events = []
    stages = []
    with SimulatorSettings(hand_name, scene, seed, plant_factors, homed=True).begin_run(
        controller
    ) as simulation:
        plant = simulation.simulated_hand.world.plant
        simulation.are_ticks_recorded = False
        for entry, tick_output in simulation.run_ticks(timeout_s):
            k = entry.k
            state = simulation.state
            filter_states = state.tendon[s.SPOOL_TRAVEL : s.STRETCH_OFFSET + 1].T.ravel()
            true_force = np.linalg.norm(np.reshape(plant.contact_forces(), (-1, 3)), axis=1)
            pose = plant.engine.object_pose()
            telemetry = tick_output.telemetry
            rows.append(
                (k / rate, pose, true_force, telemetry.contact, telemetry.tension, telemetry.external_tension,
                 telemetry.excursion, filter_states, telemetry.tip_force, plant.engine.q.copy(), plant.normal_forces())
            )  # fmt: skip
            phases.append(tick_output.phase)
            stages.append(plant.stage)
            events += [(k, event) for event in tick_output.events]
            if state.mode == HandMode.RELAX or (last_phase and tick_output.phase == last_phase):
                break
            if (
                _has_program_finished(plant)
                or _is_lost(plant)
                or (k / rate > retry_timeout_s and plant.table and plant.table.dropped_at is None)
            ):
                break
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return GraspRun(
        columns[0], phases, np.array(stages), columns[1][:, :3], *columns[2:11], columns[1][:, 3:],
        events, state.failure or state.progress.failure, plant.table.dropped_at if plant.table else None,
    )  # fmt: skip


def _has_program_finished(plant: Plant) -> bool:
    """Return True if all stages of the scene are over."""
    table_sink_start_s = plant.table.dropped_at if plant.table else None
    return (
        bool(plant.stages)
        and table_sink_start_s is not None
        and plant.steps * STEP_S - table_sink_start_s > plant.stages.duration
    )


def _is_lost(plant: Plant) -> bool:
    """Return True if the object has left the hand."""
    return (
        plant.scene.grasp_object is not None
        and np.linalg.norm(plant.engine.object_pose()[:3]) > LOST_DISTANCE_M
    )


def stage_motions(run: GraspRun) -> list[float]:
    """Return the largest motion [m] of the object in each stage.

    The motion is measured from the position that the object has at the start of the stage.
    """
    motions = []
    for stage in range(int(run.stage.max(initial=-1)) + 1):
        path = run.object_position[run.stage == stage]
        motions.append(float(np.linalg.norm(path - path[0], axis=1).max()))
    return motions
