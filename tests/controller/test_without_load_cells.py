"""Test hands in which some or all tendons have no load cells.

The controller estimates the tensions of tendons without load cells from motor force, encoder and
friction. The tests compare the estimated tensions with the true tensions in the simulator.
"""

import os
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import pytest

from handctl.campaign.run_stages import hand_with_drives
from handctl.controller.run_setup import make_controller, make_drives
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import MARGIN_SIGMAS_WITHOUT_CELL, HandModel
from handctl.core.tick_types import HandMode, TickEvent
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_content, hand_from_content
from handctl.programs.commission import CommissionProgram, calibration_of_result
from handctl.programs.program import Program
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatedRun, SimulatorSettings, homed_controller

RATE_HZ = 500.0
SIMULATOR_SEEDS = range(20 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 2)


@cache
def hand_without_cells(*tendon_names: str) -> Hand:
    """Return the hand jamia without the load cells of the named tendons.

    If no tendon is named, the returned hand has no load cell and no sensor node.
    """
    content: dict[str, Any] = hand_content("jamia")
    if not tendon_names:
        del content["sensor_node"]
    else:
        node = content["sensor_node"]
        content["sensor_node"] = node | {
            "tendons": [name for name in node["tendons"] if name not in tendon_names]
        }
    return hand_from_content(content, "without cells")


@cache
def model_of(*tendon_names: str) -> HandModel:
    """Return the model of the hand that ``hand_without_cells(*tendons)`` returns."""
    return HandModel.from_hand(hand_without_cells(*tendon_names), Gains(), RATE_HZ)


CYLINDER_TASK = Task.model_validate(
    {
        "schema": 1,
        "name": "close",
        "description": "close on a cylinder, hold, let go",
        "phase": (
            {"kind": "move", "name": "home", "angle_deg": 0.0, "duration_s": 0.4},
            {
                "kind": "move",
                "name": "preshape",
                "angle_deg": {"index": 20.0, "middle": 20.0, "ring": 20.0, "thumb": 4.0},
                "duration_s": 0.8,
            },
            {
                "kind": "close",
                "name": "close",
                "angle_deg": 85.0,
                "speed_deg_s": 50.0,
                "contact_tension_N": 18.0,
            },
            {
                "kind": "hold",
                "name": "hold",
                "tension_N": 32.0,
                "rate_N_per_s": 40.0,
                "duration_s": 3.0,
            },
            {"kind": "release", "name": "release", "tension_N": 9.0, "rate_N_per_s": 60.0},
            {"kind": "move", "name": "open", "angle_deg": 0.0, "duration_s": 0.8},
        ),
    }
)


@dataclass
class RunWithoutCells:
    """Record of a run without load cells: the values of each tick, and all events.

    For each tick, the record contains the phase of the task. The record also contains three arrays
    (tendons,) [N] for each tick: the estimated tension of each tendon, the standard deviation of
    this estimate, and the true tension. The attribute ``object_height`` is the height of the object
    [m] at the end of the phase ``hold``.
    """

    phase_name: list[str] = field(default_factory=list)
    tension: list[np.ndarray] = field(default_factory=list)
    sigma: list[np.ndarray] = field(default_factory=list)
    true_tension: list[np.ndarray] = field(default_factory=list)
    events: list[TickEvent] = field(default_factory=list)
    object_height: float = 0.0

    def normalized_errors(self, *phase_names: str) -> np.ndarray:
        """Return the tension errors in the phases ``phase_names``.

        Each error is divided by the standard deviation that the filter has estimated.
        """
        rows = np.isin(self.phase_name, phase_names)
        return (np.array(self.tension)[rows] - np.array(self.true_tension)[rows]) / np.array(
            self.sigma
        )[rows]


def run_without_sensors(
    program: Program,
    scene: str | None,
    seed: int,
    *fault_commands: str,
    max_duration_s: float = 30.0,
) -> RunWithoutCells:
    """Run a program on a hand that has neither load cells nor joint encoders.

    The controller knows the motor zeros. Each text in ``fault_commands`` describes an injected
    fault and contains the time of the fault.
    """
    rows = RunWithoutCells()
    with SimulatorSettings(hand_without_cells(), scene, seed, homed=True).begin_run(
        homed_controller(model_of(), program)
    ) as run:
        run.are_ticks_recorded = False
        for fault in fault_commands:
            run.simulated_hand.inject(fault)
        for _, out in run.run_ticks(max_duration_s):
            rows.phase_name.append(out.phase)
            rows.tension.append(run.state.view("tension").copy())
            rows.sigma.append(run.state.view("sigma").copy())
            rows.true_tension.append(np.array(run.simulated_hand.world.plant.tensions()))
            rows.events += out.events
            if run.state.progress.phase == "hold":
                rows.object_height = run.simulated_hand.world.plant.engine.object_pose()[2]
    return rows


def assert_no_check_of_a_missing_cell(hand: Hand, events: list[TickEvent]) -> None:
    """Assert that the commissioning reports a load-cell check only for tendons with a load cell.

    Earlier defect: for a hand without load cells, the commissioning program printed "answers 2.99
    N, others 0.00 N".
    """
    texts = {event.where: event.text for event in events if event.name == "commission"}
    assert set(texts) == set(hand.tendon_names)
    for name, has_cell in zip(hand.tendon_names, hand.has_cell, strict=True):
        assert texts[name].startswith("answers " if has_cell else "taut at "), texts[name]
        assert ("by its motor" in texts[name]) == (not has_cell)
        assert ("swapped tendons are not checked" in texts[name]) == (not hand.has_cell.any())
        assert (", other load cells 0." in texts[name]) == hand.has_cell.any()
    assert any("no load cells to tare" in event.text for event in events) != hand.has_cell.any()


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
@pytest.mark.parametrize("tendons_without_cells", [(), ("index_tendon", "thumb_tendon")])
def test_hand_commissions_with_the_tares_of_its_load_cells(
    tendons_without_cells: tuple[str, ...], seed: int
) -> None:
    hand = hand_without_cells(*tendons_without_cells)
    with SimulatorSettings(hand, None, seed).simulated_hand(round(1e9 / RATE_HZ)) as peer:
        run = SimulatedRun.start_run(
            make_controller(hand, Gains(), RATE_HZ, CommissionProgram(), None, True), peer
        )
        events: list[TickEvent] = []
        for _, out in run.run_ticks(30.0):
            events += out.events
        assert not [event for event in events if event.level == "error"]
        assert_no_check_of_a_missing_cell(hand, events)
        calibration = calibration_of_result(
            model_of(*tendons_without_cells), run.state.progress, "2026-01-01T00:00:00+00:00"
        )
        assert not calibration.tare_tensions(hand)[~hand.has_cell].any()
        offset = [peer.world.encoder_offset[name] for name in hand.motor_names]
        travel_errors = (calibration.motor_zeros(hand) - offset) * model_of(
            *tendons_without_cells
        ).tendon_constants.spool_radius
        np.testing.assert_allclose(travel_errors, 0.0, atol=5e-5)


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
def test_it_grasps_holds_and_lets_go_and_the_error_is_within_its_sigma(seed: int) -> None:
    rows = run_without_sensors(TaskProgram(CYLINDER_TASK), "cylinder", seed)
    assert not [event.text for event in rows.events if event.level == "error"]
    assert {event.where for event in rows.events if event.name == "contact"} == {
        "index",
        "middle",
        "ring",
        "thumb",
    }
    assert rows.object_height == pytest.approx(0.0, abs=3e-3)
    error = rows.normalized_errors("home", "preshape", "close", "hold")
    assert np.sqrt(np.mean(error**2)) < 1.0, "the standard deviation is not too small"
    assert np.quantile(np.abs(error), 0.99) < 4.0, "an impact is seen late"


def test_limits_are_stricter_by_the_sigma_of_the_estimate() -> None:
    file = hand_without_cells()
    bare_model = model_of("index_tendon")
    margin = bare_model.margin_without_cell
    assert margin[0] > 2.0
    assert not margin[1:].any()
    assert bare_model.ceiling[0] == file.tendon[0].tension_max_N - margin[0]
    controller = homed_controller(bare_model, TaskProgram(CYLINDER_TASK))
    assert (
        controller.derived_constants.limits.tension_trip[0]
        == file.tendon[0].tension_trip_N - margin[0]
    )
    assert controller.derived_constants.limits.tension_trip[1] == file.tendon[1].tension_trip_N
    assert margin[0] == MARGIN_SIGMAS_WITHOUT_CELL * bare_model.filter_design.held_tension_sigma[0]


def test_a_hand_without_sensors_sends_no_sync() -> None:
    hand = hand_without_cells()
    controller = homed_controller(model_of(), TaskProgram(CYLINDER_TASK))
    with SimulatorSettings(hand, None, 0, homed=True).begin_run(controller) as run:
        sync = (controller.sensors.bus, hand.sensor_node.sync_id)
        for _, out in run.run_ticks(1.0):
            assert sync not in {(frame.bus, frame.can_id) for frame in out.frames}
        assert run.state.mode == HandMode.ACTIVE


@pytest.mark.parametrize(
    ("tendons_without_cells", "options", "is_valid"),
    [
        ((), {}, False),
        (("index_tendon",), {}, False),
        (("index_tendon",), {"torque_feedback": False}, False),
        (("index_tendon",), {"torque_feedback": True}, True),
        ((), {"torque_feedback": True}, True),
    ],
)
def test_a_tendon_without_a_load_cell_needs_a_torque_report(
    tendons_without_cells: tuple[str, ...], options: dict[str, Any], is_valid: bool
) -> None:
    """Without a load cell and without torque reports of the drive, nothing shows that the drive pulls too hard."""
    hand = hand_with_drives(hand_without_cells(*tendons_without_cells), "odrive")
    motors = tuple(motor.model_copy(update={"options": options}) for motor in hand.motor)
    hand = hand.model_copy(update={"motor": motors})
    if is_valid:
        assert len(make_drives(hand)) == len(motors)
        return
    with pytest.raises(ConfigError, match="torque_feedback: false; expected true") as caught:
        make_drives(hand)
    assert "index_tendon" in str(caught.value)


def test_replaced_drives_report_their_torque() -> None:
    hand = hand_with_drives(hand_without_cells("index_tendon"), "odrive")
    assert len(make_drives(hand)) == len(hand.motor)


def test_cia402_drives_have_their_sync_without_sensors() -> None:
    content: dict[str, Any] = hand_content("jamia")
    del content["sensor_node"]
    content["motor"] = [
        motor | {"protocol": "cia402", "options": PROTOCOL_TRAITS["cia402"].options}
        for motor in content["motor"]
    ]
    hand = hand_from_content(content, "cia402")
    model = HandModel.from_hand(hand, Gains(), 250.0)
    with SimulatorSettings(hand, None, 0, homed=True).begin_run(
        homed_controller(model, TaskProgram(CYLINDER_TASK))
    ) as run:
        assert run.run_until(lambda out: out.mode == HandMode.ACTIVE, 10.0)


@pytest.mark.parametrize(
    ("fault_command", "expected_faults"),
    [
        ("snap tendon=index_tendon at=2.4s", ("T01", "T02a", "T02b")),
        ("stuck encoder=middle_motor at=1.5s", ("N04",)),
        ("drop node=ring_motor at=2.4s", ("B02", "B17")),
    ],
)
def test_faults_that_need_no_load_cell_are_found(
    fault_command: str, expected_faults: tuple[str, ...]
) -> None:
    rows = run_without_sensors(TaskProgram(CYLINDER_TASK), "cylinder", 0, fault_command)
    detected_faults = {event.text.split()[0] for event in rows.events if event.name == "fault"}
    assert detected_faults & set(expected_faults), rows.events[-5:]
