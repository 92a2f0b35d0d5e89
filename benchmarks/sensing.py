"""Measure the accuracy of hands without load cells or joint encoders.

The results are errors of the estimated tensions and angles, the delay of contact detection, and
detected faults.

``python benchmarks/sensing.py [--json] [--seeds N] [--page]``. In each run, the simulated hand
grasps a cylinder in lockstep. The phases of the task are: move, close until contact, hold while the
table sinks, release, open. The hand file of the controller lacks load cells or joint encoders, but
the simulated hand is the same in all runs. ``--page`` writes docs/evidence/control-sensing.md.
"""

import argparse
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_content, hand_from_content
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller

PAGE_FILE = Path(__file__).parents[1] / "docs" / "evidence" / "control-sensing.md"
CONTROL_RATES_HZ = {"jamia": 500.0, "n_plus_1": 250.0}
CYLINDER_DIAMETER_M = {"jamia": 0.035, "n_plus_1": 0.042}
PRESHAPE_ANGLES_DEG = {"jamia": (8.0, 0.0), "n_plus_1": (4.0, 0.0)}
"""Angles of fingers and thumb before closing [deg]. At these preshape angles, the digits do not touch the object."""
SENSOR_SETS = {
    "load cells and joint encoders": (True, True),
    "load cells": (True, False),
    "joint encoders": (False, True),
    "neither": (False, False),
}
SENSING_CASES = [
    ("jamia", "load cells"),
    ("jamia", "neither"),
    *(("n_plus_1", sensors) for sensors in SENSOR_SETS),
]
"""Hand and sensors of each case of the benchmark.

The hand jamia has no joint encoders, so it has no cases with joint encoders.
"""
CONTACT_FORCE_N = 0.3
"""A digit is in contact when its true force on the object is above this force [N]."""
MOVING_PHASES = ("home", "preshape", "open")
SETTLING_TIME_S = 1.0
"""Time from the start of a hold until the tensions have settled [s]."""
INJECTED_FAULTS = {
    "a tendon tears": "snap tendon={tendon} at=4s",
    "an encoder is stuck": "stuck encoder={motor} at=1.6s",
    "an encoder slips": "offset encoder={motor} size=0.3 at=4s",
    "a drive is silent": "off node={motor} at=4s",
    "a drive ignores its torque": "disobey node={motor} size=0 at=4s",
    "a drive runs away": "runaway node={motor} at=4s",
    "a drive has a torque ripple": "ripple node={motor} size=0.2 hz=20 at=4s",
    "two drives are exchanged": "swap node={motor} with={other} at=1.6s",
    "a drive keeps its torque after the cut": "hold_on node={motor} at=4s",
}
"""Name and command of each injected fault. Every hand of the benchmark has the parts on which the faults act."""


def hand_with_sensors(hand_name: str, sensor_set: str) -> Hand:
    """Return a packaged hand that has only the given sensors."""
    cells, encoders = SENSOR_SETS[sensor_set]
    content: dict[str, Any] = hand_content(hand_name)
    if not cells and not encoders:
        del content["sensor_node"]
        return hand_from_content(content, hand_name)
    node = content["sensor_node"]
    content["sensor_node"] = (
        node | ({} if cells else {"tendons": []}) | ({} if encoders else {"joints": []})
    )
    return hand_from_content(content, hand_name)


def grasp_task_of(hand: Hand) -> Task:
    """Return the task in which a hand grasps the cylinder."""
    finger, thumb = PRESHAPE_ANGLES_DEG[hand.name]
    preshape = {name: thumb if name == "thumb" else finger for name in hand.digit_names}
    phases = (
        {"kind": "move", "name": "home", "angle_deg": 0.0, "duration_s": 0.4},
        {"kind": "move", "name": "preshape", "angle_deg": preshape, "duration_s": 0.8},
        {
            "kind": "close",
            "name": "close",
            "angle_deg": 80.0,
            "speed_deg_s": 50.0,
            "contact_tension_N": 18.0,
        },
        {
            "kind": "hold",
            "name": "hold",
            "tension_N": 36.0,
            "rate_N_per_s": 40.0,
            "duration_s": 4.0,
        },
        {"kind": "release", "name": "release", "tension_N": 9.0, "rate_N_per_s": 60.0},
        {"kind": "move", "name": "open", "angle_deg": 0.0, "duration_s": 0.8},
    )
    return Task.model_validate(
        {"schema": 1, "name": "grasp", "description": "grasp", "phase": phases}
    )


def cylinder_scene_of(hand_name: str) -> str:
    """Return a scene with a cylinder on a table in front of the palm.

    The table sinks when the hand holds the cylinder.
    """
    diameter = CYLINDER_DIAMETER_M[hand_name]
    return (
        f'name = "cylinder"\n[object]\nshape = "cylinder"\ndiameter_m = {diameter}\nlength_m = 0.093\nmass_kg = 0.15\n'
        f"friction = 0.5\nposition_m = [{diameter / 2 + 0.002}, 0.0, 0.0]\n"
        '[support]\ndrop_when = "grasped"\ndrop_hold_s = 0.5\nsink_speed_m_s = 0.2\n'
    )


@dataclass
class SensingRun:
    """Record of a run with one hand and one set of sensors.

    The record has one row for each tick with an active hand. The record also contains the faults
    that the controller reported.
    """

    phase: list[str] = field(default_factory=list)
    error: list[np.ndarray] = field(default_factory=list)
    sigma: list[np.ndarray] = field(default_factory=list)
    angle: list[np.ndarray] = field(default_factory=list)
    first_touch_s: dict[str, float] = field(default_factory=dict)
    contact_report_s: dict[str, float] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    object_motion_mm: float = float("nan")


def run_grasp(
    model: HandModel, scene_name: str, task: Task, seed: int, fault_text: str = ""
) -> SensingRun:
    """Run the grasp task on a simulated hand whose motor zeros are known."""
    record = SensingRun()
    names = model.hand.digit_names
    with SimulatorSettings(model.hand, scene_name, seed, homed=True).begin_run(
        homed_controller(model, TaskProgram(task))
    ) as run:
        run.are_ticks_recorded = False
        plant = run.simulated_hand.world.plant
        if fault_text:
            run.simulated_hand.inject(fault_text)
        start = np.array(plant.engine.object_pose()[:3])
        for entry, tick_output in run.run_ticks(30.0):
            t = entry.k * model.period
            for event in tick_output.events:
                if event.name == "fault":
                    record.faults.append(event.text.split()[0])
                elif event.name == "contact":
                    record.contact_report_s.setdefault(event.where, t)
            forces = np.linalg.norm(np.reshape(plant.contact_forces(), (-1, 3)), axis=1)
            for name, force in zip(names, forces.tolist(), strict=True):
                if force > CONTACT_FORCE_N and tick_output.phase == "close":
                    record.first_touch_s.setdefault(name, t)
            if run.state.mode == HandMode.ACTIVE:
                record.phase.append(tick_output.phase)
                record.error.append(run.state.view("tension") - np.array(plant.tensions()))
                record.sigma.append(run.state.view("sigma").copy())
                record.angle.append(run.state.view("q") - plant.engine.q)
                if tick_output.phase == "hold":
                    record.object_motion_mm = 1e3 * float(
                        np.linalg.norm(np.array(plant.engine.object_pose()[:3]) - start)
                    )
    return record


def rms(values: Any) -> float:
    """Return the root mean square of values, or NaN if there are no values."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def measures_of_case(runs: list[SensingRun], period_s: float) -> dict[str, float]:
    """Compute the results of one case from the records of all its runs."""
    moving = []
    hold_samples = []
    sigma = []
    scaled = []
    angle = []
    delays = []
    for record in runs:
        phase = np.array(record.phase)
        error = np.array(record.error)
        width = np.array(record.sigma)
        is_in_motion = np.isin(phase, MOVING_PHASES)
        hold_ticks = np.flatnonzero(phase == "hold")[round(SETTLING_TIME_S / period_s) :]
        moving.append(error[is_in_motion])
        hold_samples.append(error[hold_ticks])
        sigma.append(width[hold_ticks])
        # A slack tendon has no tension to estimate.
        is_taut = width > 0.0
        is_taut[~(is_in_motion | (phase == "hold"))] = False
        scaled.append(error[is_taut] / width[is_taut])
        angle.append(np.degrees(np.array(record.angle)[is_in_motion]))
        delays += [
            1e3 * (t - record.first_touch_s[name])
            for name, t in record.contact_report_s.items()
            if name in record.first_touch_s
        ]
    return {
        "moving_N": rms(np.concatenate(moving)),
        "holding_N": rms(np.concatenate(hold_samples)),
        "sigma_N": float(np.mean(np.concatenate(sigma))),
        "error_per_sigma": rms(np.concatenate(scaled)),
        "angle_deg": rms(np.concatenate(angle)),
        "delay_ms": float(np.median(delays)),
        "held": float(
            np.mean(
                [
                    np.isfinite(r.object_motion_mm) and r.object_motion_mm < 10.0 and not r.faults
                    for r in runs
                ]
            )
        ),
    }


def measure_sensing(seed_count: int) -> dict[str, Any]:
    """Measure the accuracy in all cases without faults, and then the reactions to injected faults.

    The faults are injected on jamia, with and without load cells.
    """
    result: dict[str, Any] = {"seeds": seed_count, "cases": [], "faults": {}}
    for name, sensors in SENSING_CASES:
        model = HandModel.from_hand(
            hand_with_sensors(name, sensors), Gains(), CONTROL_RATES_HZ[name]
        )
        records = [
            run_grasp(model, cylinder_scene_of(name), grasp_task_of(model.hand), seed)
            for seed in range(seed_count)
        ]
        result["cases"].append(
            {"hand": name, "sensors": sensors, **measures_of_case(records, model.period)}
        )
    names = {"tendon": "index_tendon", "motor": "index_motor", "other": "middle_motor"}
    for sensors in ("load cells", "neither"):
        model = HandModel.from_hand(
            hand_with_sensors("jamia", sensors), Gains(), CONTROL_RATES_HZ["jamia"]
        )
        for title, text in INJECTED_FAULTS.items():
            record = run_grasp(
                model,
                cylinder_scene_of("jamia"),
                grasp_task_of(model.hand),
                0,
                text.format(**names),
            )
            reported_faults = list(dict.fromkeys(record.faults))
            result["faults"].setdefault(title, {})[sensors] = reported_faults
    return result


INTRODUCTION_TEXT = """\
Written by `python benchmarks/sensing.py --page`, from runs in lockstep with the simulated hand. Nothing on this page
was measured on hardware. In each run the hand moves freely, closes on a cylinder, holds it while the table sinks, and
releases it.

Without load cells, the controller estimates the tension from the motor torque, the encoder and the friction in the hand
file. The simulated motor has exactly the friction of its hand file. On a real hand, an error of the friction in the
hand file is an additional error of the tension.

- *moving* and *holding*: root mean square error (RMSE) of the estimated tension at present, over all tendons.
- *sigma*: standard deviation of the tension that the filter reports while the hand holds. *error / sigma*: true error
  divided by sigma. A value of 1 is right, and with a smaller value the filter is more cautious than necessary.
- *angle*: RMSE of the joint angles while the hand moves. If one tendon moves several joints, its excursion does not
  determine the angle of each joint.
- *delay*: median time from a true contact force of 0.3 N until the controller detects the contact.
- *held*: fraction of the runs in which the hand held the object without any fault.

For jamia, the table in [Ten minutes to a grasp](../start/ten-minutes.md#what-the-numbers-measure) has a larger tension
error and a smaller angle error than the table on this page. In the run of that table, the bias of the load cells has
drifted since the tare. The angle error of that table compares the mean joint angle of a digit with the setpoint of the
digit.""".splitlines()
FAULT_TEXT = """\
The next table has the faults that the controller reported when a fault was injected into the index finger of jamia
(seed 0). The faults T03b, T04, T05, T06, T09, N02 and N14b need a load cell, and are not detected on a hand without
load cells. The other detectors use the estimated tension, and N16 uses the torque that the drive reports. Without load
cells, the tension limits of T03 are lower by two standard deviations (sigma) of the estimated tension.""".splitlines()


def page_text(result: dict[str, Any]) -> str:
    """Return the text of the page docs/evidence/control-sensing.md for the results of a measurement."""
    rows = [
        f"| {c['hand']}, {c['sensors']} | {c['moving_N']:.2f} | {c['holding_N']:.2f} | {c['sigma_N']:.2f} | "
        f"{c['error_per_sigma']:.2f} | {c['angle_deg']:.2f} | {c['delay_ms']:.0f} | {100 * c['held']:.0f} % |"
        for c in result["cases"]
    ]
    faults = [
        f"| {title} | {', '.join(reported_faults['load cells']) or '-'} | "
        f"{', '.join(reported_faults['neither']) or '-'} |"
        for title, reported_faults in result["faults"].items()
    ]
    return "\n".join(
        [
            "# Without load cells",
            "",
            *INTRODUCTION_TEXT,
            "",
            f"Seeds: {result['seeds']}.",
            "",
            "| hand, sensors | moving [N] | holding [N] | sigma [N] | error / sigma | angle [deg] | delay [ms] |"
            " held |",
            "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
            *rows,
            "",
            *FAULT_TEXT,
            "",
            "| injected fault | reported with load cells | reported without load cells |",
            "| --- | --- | --- |",
            *faults,
            "",
        ]
    )


def main() -> None:
    """Measure the accuracy for all hands and sets of sensors, and print the result or write the page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", 1)[0])
    parser.add_argument(
        "--seeds", type=int, default=20, help="number of runs for each hand (default: 20)"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument(
        "--page", action="store_true", help=f"write the results into docs/evidence/{PAGE_FILE.name}"
    )
    args = parser.parse_args()
    result = measure_sensing(args.seeds)
    if args.page:
        PAGE_FILE.write_text(page_text(result), "utf-8")
    print(json.dumps(result, indent=1) if args.json else page_text(result))


if __name__ == "__main__":
    main()
