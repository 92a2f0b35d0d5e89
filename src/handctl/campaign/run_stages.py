"""Simulated hands for each drive protocol, and simulated runs up to each stage.

Each scenario runs in a child process. The child process starts as a copy of a run that has reached
the stage of the scenario.
"""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from typing import Any, Protocol, TypeVar, cast

from handctl.campaign.fault_matrix import ARMING_STAGE, FREE_MOTION_STAGE, GRASP_STAGE, MIT
from handctl.campaign.scenario_run import ScenarioResult
from handctl.controller.bus_load import with_more_buses
from handctl.controller.run_setup import make_controller
from handctl.core.gains.gains import packaged_gains
from handctl.core.tick_types import HandMode
from handctl.document import validate_content
from handctl.drives.motor_description import PROTOCOL_TRAITS, options_with_motor_type
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import load_hand
from handctl.processes import run_in_forked_copy
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatedRun, SimulatorSettings
from handctl.session.run_plan import default_control_rate

FIRST_NODE_NUMBER = 0x10
"""Node id of the first motor, if the drives of a packaged hand have been replaced."""
DATA_BITRATE = 5_000_000
"""Bit rate of the data phase on the buses of a hand whose drives need CAN FD [bit/s]."""
MIN_CONTROL_RATE_HZ = 200.0
"""Lowest control rate at which the controller reacts to every fault within the fault's time limit [Hz]."""
SPLIT_BUS_RATE_HZ = 250.0
"""Control rate that the buses must allow after the motors have been distributed over more buses [Hz]."""
CAMPAIGN_TASK: dict[str, Any] = {
    "schema": 1,
    "name": "campaign",
    "phase": [
        {"kind": "move", "name": "free", "angle_deg": {"*": 25.0}, "duration_s": 1.2},
        {"kind": "close", "angle_deg": 85.0, "speed_deg_s": 80.0, "contact_tension_N": 14.0},
        {"kind": "hold", "tension_N": 24.0, "rate_N_per_s": 30.0, "duration_s": 60.0},
    ],
}
"""Task that the hand executes in all runs: a free motion, then a grasp that is held for the rest of the run."""
RUN_STAGES = (ARMING_STAGE, FREE_MOTION_STAGE, GRASP_STAGE)
"""Stages of a run in the order of time."""
FREE_MOTION_STAGE_DELAY_S = 0.2
"""Time from the start of the free motion to the stage at which faults are injected into the free motion [s]."""
STAGE_TIMEOUT_S = 12.0
"""Longest simulated time until a run reaches the next stage [s]."""


def hand_with_protocol(name: str, protocol: str, motor_type: str | None = None) -> Hand:
    """Return a packaged hand in which all drives use the given protocol.

    Args:
        name: name or file of the hand.
        protocol: name of the protocol.
        motor_type: motor type of all drives, None for the default of the protocol.

    Raises:
        ConfigError: the protocol has no motor type with this name.
    """
    hand = load_hand(name)
    options = options_with_motor_type(protocol, motor_type)
    if protocol == MIT and all(motor.protocol == MIT for motor in hand.motor):
        return hand
    return hand_with_drives(hand, protocol, options)


def hand_with_drives(
    hand: Hand, protocol: str, motor_options: Mapping[str, Any] | None = None
) -> Hand:
    """Return a copy of a hand in which all drives are replaced by drives with the given protocol.

    The buses use CAN FD if the protocol needs CAN FD.

    If a single bus allows only a control rate below ``MIN_CONTROL_RATE_HZ`` with drives of the
    given protocol, the motors are distributed over more buses.

    Args:
        hand: description of the hand.
        protocol: name of the protocol.
        motor_options: options of every drive, or None for the default options of the protocol.
    """
    protocol_traits = PROTOCOL_TRAITS[protocol]
    options = dict(protocol_traits.options if motor_options is None else motor_options)
    if protocol_traits.torque_option and not hand.has_cell.all():
        options.setdefault(protocol_traits.torque_option, True)
    motors = tuple(
        motor.model_copy(
            update={
                "protocol": protocol,
                "node_id": FIRST_NODE_NUMBER + i,
                "options": dict(options),
            }
        )
        for i, motor in enumerate(hand.motor)
    )
    buses = tuple(
        bus.model_copy(update={"data_bitrate": DATA_BITRATE})
        if protocol_traits.can_fd and bus.data_bitrate is None
        else bus
        for bus in hand.bus
    )
    hand_copy = hand.model_copy(update={"motor": motors, "bus": buses})
    is_too_slow = len(buses) == 1 and default_control_rate(hand_copy) < MIN_CONTROL_RATE_HZ
    return with_more_buses(hand_copy, SPLIT_BUS_RATE_HZ) if is_too_slow else hand_copy


@contextmanager
def homed_run(
    hand: Hand,
    rate_hz: float,
    seed: int,
    perturb: dict[str, float] | None = None,
    task: dict[str, Any] = CAMPAIGN_TASK,
) -> Iterator[SimulatedRun]:
    """Yield a simulated run that has not executed any tick yet.

    The hand is homed, and the scene contains a cylinder.

    Args:
        hand: hand to simulate.
        rate_hz: control rate [Hz].
        seed: seed of the simulator's noise.
        perturb: factors by which parameters of the simulated plant are multiplied, by name.
        task: task to execute, whose first phase must be a move.
    """
    angles = dict.fromkeys(hand.digit_names, 25.0)
    phases = [dict(phase) for phase in cast(list[dict[str, Any]], task["phase"])]
    phases[0]["angle_deg"] = angles
    program = TaskProgram(
        validate_content({**task, "phase": phases}, Task, "the task of the campaign")
    )
    controller = make_controller(
        hand, packaged_gains(hand.name), rate_hz, program, None, arm_at_once=True
    )
    with SimulatorSettings(hand, "cylinder", seed, perturb, homed=True).begin_run(
        controller
    ) as run:
        yield run


def advance_to_stage(simulation: SimulatedRun, stage: str) -> None:
    """Simulate a run up to a given stage.

    Raises:
        ConfigError: the run does not reach the stage, so the hand cannot be tested.
    """
    free_motion_ticks = 0

    def is_stage_reached(tick_output: Any) -> bool:
        nonlocal free_motion_ticks
        if stage == ARMING_STAGE:
            return bool(tick_output.mode == HandMode.ARMING)
        # A run has reached the grasp stage if at least one digit touches an object and a tendon has
        # at least 16 N.
        free_motion_ticks += tick_output.phase == "free"
        is_free_stage = free_motion_ticks * simulation.period_ns > FREE_MOTION_STAGE_DELAY_S * 1e9
        is_holding = (
            tick_output.phase == "hold"
            and min(tick_output.telemetry.contact.max(), tick_output.telemetry.tension.max() / 16.0)
            >= 1.0
        )
        return bool(is_free_stage if stage == FREE_MOTION_STAGE else is_holding)

    if not simulation.run_until(is_stage_reached, STAGE_TIMEOUT_S):
        failure = simulation.state.failure or simulation.state.mode.name
        raise ConfigError(
            f"the simulated hand does not reach stage {stage}: {failure}",
            "--hand",
            "a hand that grasps",
        )


class StagedRun(Protocol):
    """Experiment that starts at a given stage of a run: a fault scenario, or a sequence of random faults."""

    @property
    def name(self) -> str:
        """Return the text that describes the experiment in reports."""
        ...

    @property
    def id(self) -> str:
        """Return the id that reports show for the experiment.

        The id of a scenario is the id of a row of the fault matrix.
        """
        ...

    @property
    def stage(self) -> str:
        """Return the stage at which the experiment begins."""
        ...


T = TypeVar("T", bound=StagedRun)


def run_experiments(
    hand: Hand,
    rate_hz: float,
    experiments: Sequence[T],
    jobs: int,
    run_experiment: Callable[[SimulatedRun, T], ScenarioResult],
    on_result: Callable[[ScenarioResult], None],
    on_failure: Callable[[SimulatedRun, ScenarioResult], None],
    seed: int = 0,
) -> None:
    """Simulate a run up to each stage, and run the experiments of this stage in copies of the simulation.

    See `run_in_forked_processes` for the arguments.
    """
    with homed_run(hand, rate_hz, seed) as simulation:
        for stage in RUN_STAGES:
            experiments_at_stage = [
                experiment for experiment in experiments if experiment.stage == stage
            ]
            if experiments_at_stage:
                advance_to_stage(simulation, stage)
                run_in_forked_processes(
                    simulation, experiments_at_stage, jobs, run_experiment, on_result, on_failure
                )


def run_in_forked_processes(
    simulation: SimulatedRun,
    experiments: Sequence[T],
    jobs: int,
    run_experiment: Callable[[SimulatedRun, T], ScenarioResult],
    on_result: Callable[[ScenarioResult], None],
    on_failure: Callable[[SimulatedRun, ScenarioResult], None],
) -> None:
    """Run experiments, each in a forked copy of this process.

    Each copy begins with the present state of the simulation. Therefore the part of the run before
    the stage is simulated only once for all experiments.

    Args:
        simulation: simulation at the stage of the experiments. The simulation stays unchanged.
        experiments: experiments to run.
        jobs: number of forked copies that run at the same time.
        run_experiment: function that runs an experiment in a copy and returns the result.
        on_result: function called in this process with each result.
        on_failure: function called in the copy of a failed experiment, with the simulation and the
            result.
    """
    experiment_by_child: dict[int, tuple[int, T]] = {}
    waiting_experiments = list(experiments)
    while waiting_experiments or experiment_by_child:
        while waiting_experiments and len(experiment_by_child) < jobs:
            experiment = waiting_experiments.pop(0)
            child_pid, read_end = run_in_forked_copy(
                partial(
                    _run_to_json,
                    partial(run_experiment, simulation, experiment),
                    partial(on_failure, simulation),
                )
            )
            experiment_by_child[child_pid] = (read_end, experiment)
        child_pid, wait_status = os.wait()
        if child_pid in experiment_by_child:
            read_end, experiment = experiment_by_child.pop(child_pid)
            on_result(_read_result(read_end, experiment, wait_status))


def _run_to_json(
    run_experiment: Callable[[], ScenarioResult], on_failure: Callable[[ScenarioResult], None]
) -> str:
    """Run an experiment, call `on_failure` if the experiment has failed, and return the result as JSON."""
    result = run_experiment()
    if not result.ok:
        on_failure(result)
    return json.dumps(asdict(result))


def _read_result(read_end: int, experiment: StagedRun, wait_status: int) -> ScenarioResult:
    """Read the result of an experiment from the pipe of a child process that has ended with `wait_status`."""
    with os.fdopen(read_end) as pipe:
        text = pipe.read()
    if wait_status or not text:
        return ScenarioResult(
            experiment.name,
            experiment.id,
            experiment.stage,
            problem=f"its process ended with status {wait_status}",
        )
    return ScenarioResult(**json.loads(text))
