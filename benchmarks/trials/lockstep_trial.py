"""Run trials of a controller and a simulated hand in lockstep.

In a trial, the controller and a simulated hand exchange frames over a simulated bus. The record of
a trial also contains the true values of the simulator.
"""

import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.controller.controller_state import ControllerState
from handctl.controller.run_setup import make_controller
from handctl.controller.tick import Controller
from handctl.core import state_block as s
from handctl.core.estimation.filter_types import FilterDesign
from handctl.core.gains.gains import Gains
from handctl.core.tick_types import TELEMETRY_FIELDS, HandMode, TickIn, TickOut
from handctl.hand.description import Hand
from handctl.programs.program import Program
from handctl.report.truth_record import TruthRecord, read_truth
from handctl.session.lockstep_simulation import SimulatorSettings
from trials.benchmark_hands import FREE_MOTION_SCENE, hand_by_name, hand_file_of, packaged_hand_name

RATES_HZ = {"jamia": 500.0, "jamia_bench": 500.0, "jamia11": 200.0}
"""Default control rate of each hand [Hz]. One classical CAN bus can carry the frames at the default control rates."""
DEFAULT_GAINS = Gains()
FloatArray = NDArray[np.float64]
ControllerChange = Callable[[Controller], Controller]
TickRow = tuple[TickIn, TickOut, FloatArray, ControllerState]
"""Record of a tick: its input and output, the filter inputs (tendons, 2), and the controller state after the tick."""


def unchanged_controller(controller: Controller) -> Controller:
    """Return the given controller without a change."""
    return controller


@dataclass(frozen=True)
class LockstepTrial:
    """Configuration of a trial.

    Attributes:
        hand: name of the hand, an argument of ``benchmark_hands.hand_by_name``.
        program: program that the controller runs.
        seed: seed of the simulated noise, drift and encoder offsets.
        scene: scene of the simulator, or None for a hand without an object.
        plant_factors: factors that multiply parameters of the simulated hand. The controller does not
            know the factors.
        gains: gains of the controller.
        rate_hz: control rate [Hz]. Zero means the default rate of the hand.
        time_limit_s: longest time of the trial [s].
        change_controller: function that changes the controller before the run. The function must be a
            top-level function, or a partial of a top-level function.
    """

    hand: str
    program: Program
    seed: int = 0
    scene: str | None = None
    plant_factors: Mapping[str, float] | None = None
    gains: Gains = DEFAULT_GAINS
    rate_hz: float = 0.0
    time_limit_s: float = 30.0
    change_controller: ControllerChange = unchanged_controller


@dataclass(frozen=True)
class TrialRecord:
    """Record of a trial, with one row for each tick in which the hand is active.

    Attributes:
        hand: description of the hand.
        controller: controller of the run.
        t_ns: (ticks,) time of each tick [ns].
        phase: (ticks,) name of the phase of the program.
        telemetry: dictionary from the name of each telemetry field to an array (ticks, ..).
        force: (ticks, tendons) motor force before each tick, an input of the filter [N].
        filtered_tension: (ticks, tendons) estimated tension at the time of the load-cell readings,
            one period before the tick [N].
        truth_record: true values of the simulator.
        failure: reason why the run ended early.
        events: events as (t [s], name, where, text).
    """

    hand: Hand
    controller: Controller
    t_ns: NDArray[np.int64]
    phase: NDArray[np.str_]
    telemetry: dict[str, FloatArray]
    force: FloatArray
    filtered_tension: FloatArray
    truth_record: TruthRecord
    failure: str
    events: tuple[tuple[float, str, str, str], ...]

    @property
    def times(self) -> FloatArray:
        """Return the time of each tick [s], as an array (ticks,)."""
        return self.t_ns / 1e9

    def true_values(self, names: Iterable[str], delay_ns: int = 0) -> FloatArray:
        """Return the true values of the named quantities at the time ``delay_ns`` [ns] before each tick.

        The result is an array with one row for each tick and one column for each name.
        """
        return self.truth_record.interpolated_columns(list(names), self.t_ns - delay_ns)

    def true_tension(self, delay_ns: int = 0) -> FloatArray:
        """Return the true tension of each tendon [N], as an array (ticks, tendons)."""
        return self.true_values((f"tension/{name}" for name in self.hand.tendon_names), delay_ns)

    def true_joint_angles(self) -> FloatArray:
        """Return the true joint angles [rad], as an array (ticks, joints)."""
        return self.true_values(f"q/{name}" for name in self.hand.joints)

    def contact_force(self) -> FloatArray:
        """Return the true contact force on each digit [N], as an array (ticks, digits)."""
        axes = [
            self.true_values(f"contact_force/{name}/{axis}" for name in self.hand.digit_names)
            for axis in "xyz"
        ]
        return np.sqrt(sum(axis**2 for axis in axes))

    def expand_to_tendons(self, values_by_digit: NDArray[Any]) -> NDArray[Any]:
        """Convert values per digit (ticks, digits) to values per tendon (ticks, tendons)."""
        slices = [self.hand.digit_tendons[name] for name in self.hand.digit_names]
        index = np.repeat(np.arange(len(slices)), [s.stop - s.start for s in slices])
        return values_by_digit[:, index]


def run_trial(trial: LockstepTrial) -> TrialRecord:
    """Run a trial and return its record. Equal trials give bit-identical records.

    Raises:
        RuntimeError: a digit touched something in a trial of free motion.
    """
    hand = hand_by_name(trial.hand)
    rate = trial.rate_hz or RATES_HZ[packaged_hand_name(trial.hand)]
    controller = trial.change_controller(
        make_controller(hand, trial.gains, rate, trial.program, None, arm_at_once=True)
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "truth"
        file = hand_file_of(trial.hand, Path(folder))
        simulator_settings = SimulatorSettings(
            file, trial.scene, trial.seed, dict(trial.plant_factors or {}), homed=True, truth=path
        )
        rows: list[TickRow] = []
        with simulator_settings.begin_run(controller) as run:
            inputs = run.state.tendon[[s.FILTER_INPUT_FORCE, s.PLANNED_TENSION_RATE]].T
            for entry, tick_output in run.run_ticks(trial.time_limit_s):
                rows.append((entry, tick_output, inputs, run.state))
                inputs = run.state.tendon[[s.FILTER_INPUT_FORCE, s.PLANNED_TENSION_RATE]].T
        record = _trial_record(hand, controller, rows, read_truth(path), run.state)
    # If a digit hits something, all errors of the motion become larger. No other check detects the
    # collision.
    if trial.scene == FREE_MOTION_SCENE and record.contact_force().any():
        raise RuntimeError(f"{trial.hand}: a digit touched something during free motion")
    return record


def _filtered_tension(
    filter_design: FilterDesign, filter_inputs: FloatArray, controller_state: ControllerState
) -> list[float]:
    """Return the estimated tension [N] of each tendon at the time of the load-cell readings.

    The filter predicts the tension from the time of the readings to the present. The function
    undoes this prediction.

    Args:
        filter_design: design of the filter.
        filter_inputs: (tendons, 2) inputs of the filter in the tick.
        controller_state: state of the controller after the tick.
    """
    result = []
    states = controller_state.tendon[s.SPOOL_TRAVEL : s.STRETCH_OFFSET + 1].T
    for i, (kind, x) in enumerate(
        zip(controller_state.tendon_int[s.FILTER_KIND], states, strict=True)
    ):
        block = filter_design.blocks[i][kind]
        result.append(
            max(
                float(block.tension_row @ np.linalg.solve(block.F, x - block.B @ filter_inputs[i])),
                0.0,
            )
        )
    return result


def _trial_record(
    hand: Hand,
    controller: Controller,
    rows: list[TickRow],
    truth_record: TruthRecord,
    state: ControllerState,
) -> TrialRecord:
    active = [row for row in rows if row[1].mode == HandMode.ACTIVE]
    fields = TELEMETRY_FIELDS
    events = [
        (entry.t_ns / 1e9, *event[1:])
        for entry, tick_output, *_ in rows
        for event in tick_output.events
    ]
    design = controller.model.filter_design
    return TrialRecord(
        hand,
        controller,
        np.array([entry.t_ns for entry, *_ in active]),
        np.array([out.phase for _, out, *_ in active]),
        {
            name: np.array([getattr(out.telemetry, name) for _, out, *_ in active])
            for name in fields
        },
        np.array([inputs[:, 0] for *_, inputs, _ in active]),
        np.array(
            [_filtered_tension(design, inputs, state_after) for *_, inputs, state_after in active]
        ),
        truth_record,
        state.failure,
        tuple(events),
    )
