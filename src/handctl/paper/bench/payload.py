"""Measurement of the payload of a hand in the simulator.

The hand grips a cylinder with 6 N per finger. After the grip, a force pulls the cylinder along one
axis. The force grows until the cylinder slips.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from handctl.hand.digit import Array
from handctl.paper import paper_data as src
from handctl.paper.bench.bench_run import BenchRecording, run_bench_task
from handctl.paper.errata_item import ErrataItem
from handctl.paper.verdicts import verdict_of_lower_bound
from handctl.programs.task import Task
from handctl.report.truth_record import TruthRecord, read_truth

HAND_NAME = "jamia"
"""Name of the packaged hand whose payload is measured."""
DIAMETERS_MM = (30.0, 35.0, 40.0)
"""Diameters of the cylinders [mm]."""
LOAD_DIRECTIONS: dict[str, tuple[int, int, int]] = {
    "x": (1, 0, 0),
    "y": (0, -1, 0),
    "z": (0, 0, -1),
}
"""Direction of the load for each axis, in the palm frame."""
AXIS_NAMES = {"x": "out of the palm", "y": "towards the thumb", "z": "down, along the cylinder"}
"""Direction of the load for each axis, in words."""
CYLINDER_MASS_KG = 0.05
"""Mass of the cylinder [kg]."""
TENSION_STEPS_N = (20.0, 26.0, 32.0, 38.0, 44.0)
"""Tensions at which the search measures the normal forces [N].

The tension at which a finger presses with 6 N is interpolated between the measured tensions.
"""
TENSION_STEP_S = 0.5
"""Time for which the search holds each tension [s]."""
GRIP_SETTLING_S = 0.8
"""Time from the start of the grip to the start of the load [s]."""
LOAD_RATE_N_PER_S = 4.0
"""Rate at which the load increases [N/s]."""
LOAD_DURATION_S = 5.5
"""Time for which the load increases [s]."""
SLIP_SPEED_M_PER_S = 1e-3
"""Largest speed at which the object does not count as slipping [m/s]."""
SLIP_DISTANCE_M = 2e-3
"""Largest displacement at which the object does not count as slipping [m]."""
SPEED_WINDOW_S = 0.1
"""Length of the window over which the speed of the object is measured [s]."""
AVERAGED_SAMPLE_COUNT = 100
"""Number of rows of the ground truth over which normal forces are averaged.

The ground truth has a row for each millisecond.
"""
SCENE_TOML_TEMPLATE = """name = "payload"
[object]
shape = "cylinder"
diameter_m = {diameter}
length_m = 0.093
mass_kg = {mass}
friction = {friction}
position_m = [{x}, 0.0, 0.0]
[support]
drop_when = "grasped"
drop_hold_s = 0.3
[load]
direction = {direction}
start_s = {start}
rate_N_per_s = {rate}
"""
"""Template of the scene file."""


def search_grip_tension(folder: Path, diameter_mm: float) -> dict[str, Any]:
    """Return the tension of each digit for a grip with 6 N per finger, and the start time of the grip.

    The search increases the tension in steps. The returned tension is interpolated between the
    tension steps. Because of friction, the normal force also depends on the earlier tension steps.
    To avoid the influence of earlier steps, the hand then grips the cylinder a second time,
    directly with the interpolated tension. From the normal forces in the second grip, the function
    computes one correction of the tension. The thumb must balance the fingers. Therefore the
    tension of the thumb is the mean tension of the fingers. In all runs with the same diameter, the
    grip begins at the same time.
    """
    names = src.paper_hand().digit_names
    phases = [
        _hold_phase(f"stair {tension:g}", dict.fromkeys(names, tension), TENSION_STEP_S)
        for tension in TENSION_STEPS_N
    ]
    recording, truth = _grip_cylinder(folder, diameter_mm, "z", 1e3, phases)
    normal_forces = np.array(
        [_mean_normal_forces(truth, _phase_end_ns(recording, phase["name"])) for phase in phases]
    )
    # The interpolation needs normal forces that strictly increase. The code adds k times 1e-6 N to
    # the forces of phase k, so that equal forces become different.
    normal_forces = np.maximum.accumulate(normal_forces + 1e-6 * np.arange(len(phases))[:, None])
    start_s = recording.t_ns[recording.phase.index(phases[0]["name"])] / 1e9
    target_normal_forces = np.full(len(names), float(src.FINGER_GRIP_FORCE_N))
    tension = _tension_for_normal_forces(normal_forces, target_normal_forces)
    recording, truth = _grip_cylinder(
        folder, diameter_mm, "z", 1e3, [_hold_phase("try", tension, GRIP_SETTLING_S)]
    )
    missing_force = target_normal_forces - _mean_normal_forces(
        truth, _phase_end_ns(recording, "try")
    )
    return {
        "tension_N": _tension_for_normal_forces(
            normal_forces, target_normal_forces + missing_force
        ),
        "began_s": start_s,
    }


def _tension_for_normal_forces(
    normal_forces_by_step: Array, target_normal_forces: Array
) -> dict[str, float]:
    """Return the tension [N] of each digit at which the fingers press with the given normal forces [N].

    The tensions are interpolated between the tension steps of the search. The measured forces have
    the shape (steps, digits).
    """
    names = src.paper_hand().digit_names
    tension = {
        name: float(
            np.interp(target_normal_forces[i], normal_forces_by_step[:, i], TENSION_STEPS_N)
        )
        for i, name in enumerate(names)
    }
    tension["thumb"] = float(np.mean([tension[name] for name in names if name != "thumb"]))
    return tension


def load_until_slip(
    folder: Path, diameter_mm: float, load_axis: str, grip_result: Mapping[str, Any]
) -> dict[str, Any]:
    """Grip a cylinder, pull the cylinder with a growing force until it slips, and return the result as plain values."""
    tension = grip_result["tension_N"]
    hold_phase = _hold_phase("load", tension, GRIP_SETTLING_S + LOAD_DURATION_S)
    load_start_s = grip_result["began_s"] + GRIP_SETTLING_S
    recording, truth = _grip_cylinder(folder, diameter_mm, load_axis, load_start_s, [hold_phase])
    first_row = int(np.searchsorted(truth.t_ns, round(load_start_s * 1e9)))
    end = int(np.searchsorted(truth.t_ns, _phase_end_ns(recording, "load")))
    normal_forces = _mean_normal_forces(truth, int(truth.t_ns[first_row]))
    slip, end_reason = _find_slip(truth, first_row, end)
    # For the load case z, the weight of the object acts in the same direction as the load.
    weight = CYLINDER_MASS_KG * float(src.GRAVITY_M_PER_S2) if load_axis == "z" else 0.0
    load = float(truth.interpolated_column("load", truth.t_ns[slip : slip + 1])[0]) + weight
    # The axis x points out of the palm. So the palm carries the sum of the contact forces of the
    # digits along x.
    palm = sum(
        float(
            truth.interpolated_column(
                f"contact_force/{name}/x", truth.t_ns[first_row : first_row + 1]
            )[0]
        )
        for name in tension
    )
    times = truth.t_ns[first_row:end:10]
    object_motion = np.linalg.norm(
        _object_positions(truth, times) - _object_positions(truth, times)[0], axis=1
    )
    return {
        "diameter_mm": diameter_mm, "axis": load_axis, "tension_N": dict(tension),
        "normal_N": dict(zip(tension, normal_forces, strict=True)), "palm_N": max(0.0, palm), "load_N": load,
        "ended": end_reason,
        "payload_kg": load / float(src.GRAVITY_M_PER_S2),
        "trace_N": (truth.interpolated_column("load", times) + weight).tolist(),
        "trace_mm": (1000.0 * object_motion).tolist(),
    }  # fmt: skip


def _hold_phase(name: str, tension: Mapping[str, float], duration_s: float) -> dict[str, Any]:
    """Return a task phase in which the digits hold given tensions."""
    return {
        "kind": "hold",
        "name": name,
        "tension_N": dict(tension),
        "rate_N_per_s": 60.0,
        "duration_s": duration_s,
    }


def _grip_cylinder(
    folder: Path,
    diameter_mm: float,
    load_axis: str,
    load_start_s: float,
    hold_phases: Sequence[Mapping[str, Any]],
) -> tuple[BenchRecording, TruthRecord]:
    """Close the hand on a cylinder, and hold the cylinder."""
    scene = folder / "payload.toml"
    truth = folder / "payload.truth"
    diameter = diameter_mm / 1000.0
    text = SCENE_TOML_TEMPLATE.format(
        diameter=diameter, mass=CYLINDER_MASS_KG, friction=float(src.FRICTION_COEFFICIENT), x=diameter / 2 + 0.002,
        direction=list(LOAD_DIRECTIONS[load_axis]), start=load_start_s, rate=LOAD_RATE_N_PER_S)  # fmt: skip
    scene.write_text(text, encoding="utf-8")
    open_hand = {"index": 20.0, "middle": 20.0, "ring": 20.0, "thumb": 4.0}
    phases = (
        {"kind": "move", "name": "preshape", "angle_deg": open_hand, "duration_s": 0.6},
        {
            "kind": "close",
            "name": "close",
            "angle_deg": 85.0,
            "speed_deg_s": 60.0,
            "contact_tension_N": 14.0,
        },
        *hold_phases,
    )
    task = Task.model_validate({"schema": 1, "name": "payload", "phase": phases})
    return run_bench_task(HAND_NAME, str(scene), task, truth), read_truth(truth)


def _phase_end_ns(recording: BenchRecording, phase_name: str) -> int:
    """Return the time [ns] of the last tick of a phase."""
    return recording.t_ns[int(np.flatnonzero(recording.mask_of_phase(phase_name))[-1])]


def _mean_normal_forces(truth: TruthRecord, until_ns: int) -> list[float]:
    """Return the normal force [N] of each digit, averaged over the ground-truth samples before a given time."""
    end = int(np.searchsorted(truth.t_ns, until_ns))
    times = truth.t_ns[end - AVERAGED_SAMPLE_COUNT : end]
    return [
        float(truth.interpolated_column(f"normal/{name}", times).mean())
        for name in src.paper_hand().digit_names
    ]


def _object_positions(truth: TruthRecord, t_ns: Any) -> Array:
    """Return the positions (times, 3) [m] of the object at given times."""
    return truth.interpolated_columns([f"object/{axis}" for axis in "xyz"], t_ns)


def _find_slip(truth: TruthRecord, first_row: int, end_row: int) -> tuple[int, str]:
    """Return the index of the ground-truth sample at which the object slips, and the name of the slip criterion."""
    positions = _object_positions(truth, truth.t_ns[first_row:end_row])
    window = round(SPEED_WINDOW_S * 1000)
    object_motion = np.linalg.norm(positions - positions[0], axis=1)
    speed = np.linalg.norm(positions[window:] - positions[:-window], axis=1) / SPEED_WINDOW_S
    crossings = {
        "moved": np.flatnonzero(object_motion > SLIP_DISTANCE_M),
        "creep": np.flatnonzero(speed > SLIP_SPEED_M_PER_S) + window,
    }
    # A speed of the object is assigned to the end of the time window in which the speed is
    # measured.
    slip_starts = [
        (int(rows[0]), end_reason) for end_reason, rows in crossings.items() if len(rows)
    ]
    row, ended = min(slip_starts, default=(len(object_motion) - 1, "held"))
    return first_row + row, ended


def friction_bound_kg(payload_result: Mapping[str, Any]) -> float:
    """Return the largest mass [kg] that the hand can hold according to Coulomb friction.

    The mass is computed from the measured normal forces of the digits and the palm on the object.
    """
    normal = sum(payload_result["normal_N"].values()) + payload_result["palm_N"]
    return float(src.FRICTION_COEFFICIENT) * float(normal) / float(src.GRAVITY_M_PER_S2)


def payload_errata(payload_results: Sequence[Mapping[str, Any]]) -> list[ErrataItem]:
    """Return one errata item for each load case.

    A load case is a combination of a cylinder diameter and a load axis.
    """
    rows = []
    for result in payload_results:
        axis = result["axis"]
        payload = float(result["payload_kg"])
        fingers = [force for name, force in result["normal_N"].items() if name != "thumb"]
        reason = (
            f"Cylinder of {result['diameter_mm']:g} mm, load {AXIS_NAMES[axis]}; fingers press with "
            f"{', '.join(f'{force:.1f}' for force in fingers)} N, the thumb with {result['normal_N']['thumb']:.1f} N; "
            f"{TEXT_BY_CRITERION[result['ended']]}. Coulomb's bound by all normal forces is "
            f"{friction_bound_kg(result):.2f} kg."
        )
        rows.append(
            ErrataItem(
                f"payload.{axis}.d{result['diameter_mm']:g}", "Sec. 5", f"we can lift {src.PAYLOAD_KG} kg",
                payload,
                "kg or more" if result["ended"] == "held" else "kg",
                verdict_of_lower_bound(src.PAYLOAD_KG, payload),
                reason, ("simulator",),
            )
        )  # fmt: skip
    return rows


def payload_table(payload_results: Sequence[Mapping[str, Any]]) -> tuple[tuple[str, ...], ...]:
    """Return a table that compares measured with calculated payloads.

    The calculated payloads come from the formula of the paper and from Coulomb friction.

    The first row contains the titles of the columns.
    """
    formula = float(src.payload_kg(src.FINGER_COUNT * src.FINGER_GRIP_FORCE_N))
    column_titles = (
        "cylinder",
        "load",
        "fingers",
        "thumb",
        "palm",
        "measured",
        "3 μF/g",
        "both sides",
        "Coulomb's bound",
    )
    rows = []
    for result in payload_results:
        normal = result["normal_N"]
        fingers = sum(force for name, force in normal.items() if name != "thumb")
        lower_bound_sign = "≥ " if result["ended"] == "held" else ""
        rows.append((
            f"⌀ {result['diameter_mm']:g} mm", f"{result['axis']}: {AXIS_NAMES[result['axis']]}", f"{fingers:.1f} N",
            f"{normal['thumb']:.1f} N", f"{result['palm_N']:.1f} N", f"{lower_bound_sign}{result['payload_kg']:.2f} kg",
            f"{formula:.3f} kg", f"{2 * formula:.3f} kg", f"{friction_bound_kg(result):.2f} kg",
        ))  # fmt: skip
    return (column_titles, *rows)


TEXT_BY_CRITERION = {
    "moved": "it had moved by 2 mm",
    "creep": "it crept faster than 1 mm/s",
    "held": "it still held at the end",
}
"""Text for each criterion that can end a measurement of the payload."""
