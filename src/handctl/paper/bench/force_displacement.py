"""Measurement for Figure 5 of the paper: force over displacement of a tendon that pulls a blocked finger.

The encoder of the motor measures the displacement, and the load cell measures the force.
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import curve_fit

from handctl.hand.description import Hand
from handctl.hand.digit import Array
from handctl.hand.hand_loading import hand_from_content, load_hand
from handctl.hand.tendons import TendonElasticity
from handctl.paper import paper_data as src
from handctl.paper.bench.bench_run import run_bench_task
from handctl.paper.errata_item import ErrataItem
from handctl.paper.verdicts import verdict_of_contradiction
from handctl.programs.task import Task

HAND_NAME = "jamia_bench"
"""Name of the packaged hand of the test bench."""
BLOCKED_JOINT_RANGE_DEG = 0.01
"""Range of motion that remains in a clamped joint [deg].

The remaining motion of three clamped joints moves the tendon by 1.6 um.
"""
MAX_PULL_N = 238.0
"""Tension to which the tendons are pulled [N].

Even with its overshoot, the tension stays below 244 N. At 244 N, the load cells count as saturated.
"""
PULL_RATE_N_PER_S = 60.0
"""Rate at which the tension of the pulled tendons increases [N/s]."""
LINEAR_TENSION_RANGE_N = (30.0, 150.0)
"""Range of tension in which the curves of all tendons are linear [N].

A straight line through the linear range of a curve gives the origin of the curve.
"""
MAX_RESIDUAL_TO_NOISE_RATIO = 1.2
"""Largest residual at which a curve counts as linear [standard deviations of the load-cell noise]."""


@dataclass(frozen=True, slots=True)
class TendonCurve:
    """Measured force-displacement curve of a tendon.

    Attributes:
        nominal_knee_N: tension at the knee of the curve, above which the simulated tendon is softer
            [N].
        displacement: (samples,) displacement of the tendon at the spool [mm]. The displacement is
            zero where the extrapolated linear section of the curve reaches the force 0.
        force: (samples,) reading of the load cell [N].
        stiffness: stiffness of the tendon in the linear section of the curve [N/m].
        knee: tension at the measured knee [N], or None if the whole curve is linear.
        knee_sigma: standard deviation of the measured knee [N].
    """

    nominal_knee_N: float
    displacement: Array
    force: Array
    stiffness: float
    knee: float | None
    knee_sigma: float


def blocked_hand(knee_tensions: tuple[float, ...]) -> Hand:
    """Return the hand of the test bench, with all joints clamped.

    The force-displacement curve of each tendon has a knee. ``knee_tensions`` contains the tension
    at the knee [N] of the first tendon, the second tendon, and so on. Tendons without a tension in
    ``knee_tensions`` keep the knee that the hand file gives.
    """
    content = copy.deepcopy(load_hand(HAND_NAME).content)
    for digit in content["digit"]:
        digit["joint_max_deg"] = [low + BLOCKED_JOINT_RANGE_DEG for low in digit["joint_min_deg"]]
    for tendon, knee in zip(content["tendon"], knee_tensions, strict=False):
        tendon["knee_N"] = knee
    return hand_from_content(content, f"{HAND_NAME}, blocked")


def measure_tendons(folder: Path) -> dict[str, Any]:
    """Pull the tendons of index finger and middle finger, and return the measurements as plain values.

    Args:
        folder: folder for the files of the experiment.
    """
    knees = tuple(map(float, src.KNEE_TENSIONS_N))
    hand = blocked_hand(knees)
    path = folder / "blocked.toml"
    path.write_text(hand.to_toml(), encoding="utf-8")
    tension_by_digit = dict.fromkeys(hand.digit_names[: len(knees)], MAX_PULL_N)
    recording = run_bench_task(str(path), None, _pull_task(tension_by_digit))
    rows = recording.mask_of_phase("pull")
    force = np.array(recording.tension)[rows]
    travel = np.array(recording.travel)[rows]
    spool_radii = [hand.motor_of_tendon(name).spool_radius_m for name in hand.tendon_names]
    return {
        "ropes": [
            {
                "knee_N": knee,
                "travel_m": (travel[:, i] * spool_radii[i]).tolist(),
                "force_N": force[:, i].tolist(),
            }
            for i, knee in enumerate(knees)
        ]
    }


def _pull_task(tension: dict[str, float]) -> Task:
    """Return the task that pulls the tendons of the named digits to given tensions [N]."""
    phases = (
        {
            "kind": "close",
            "name": "touch",
            "angle_deg": 30.0,
            "speed_deg_s": 20.0,
            "contact_tension_N": 12.0,
        },
        {
            "kind": "hold",
            "name": "pull",
            "tension_N": tension,
            "rate_N_per_s": PULL_RATE_N_PER_S,
            "duration_s": MAX_PULL_N / PULL_RATE_N_PER_S + 0.3,
        },
    )
    return Task.model_validate({"schema": 1, "name": "force and displacement", "phase": phases})


def curve_of_tendon(measured_curve: Mapping[str, Any], noise_N: float) -> TendonCurve:
    """Return the measured force-displacement curve of a tendon, and the stiffness and the knee of this curve.

    Args:
        measured_curve: result of `measure_tendons` for one tendon.
        noise_N: standard deviation of the noise of the load cell [N].
    """
    travel = np.array(measured_curve["travel_m"])
    force = np.array(measured_curve["force_N"])
    is_finite = np.isfinite(travel) & np.isfinite(force)
    travel = travel[is_finite]
    force = force[is_finite]
    linear_mask = (force > LINEAR_TENSION_RANGE_N[0]) & (force < LINEAR_TENSION_RANGE_N[1])
    slope, offset = np.polyfit(travel[linear_mask], force[linear_mask], 1)
    # The extrapolated linear section of the curve reaches the force 0 at the displacement -offset /
    # slope.
    displacement = travel + offset / slope
    residual = float(np.sqrt(np.mean((force - slope * displacement) ** 2)))
    knee, sigma = (
        (None, 0.0)
        if residual <= MAX_RESIDUAL_TO_NOISE_RATIO * noise_N
        else _fit_knee(displacement, force, float(slope))
    )
    return TendonCurve(
        float(measured_curve["knee_N"]), 1000.0 * displacement, force, float(slope), knee, sigma
    )


def _fit_knee(displacement: Array, force: Array, initial_slope: float) -> tuple[float, float]:
    """Fit a curve with a knee to measurements, by least squares.

    Return the tension at the knee, where the slope of the curve changes, and the standard deviation
    of this tension [N].
    """

    def knee_curve(x: Array, knee: float, stiffness_ratio: float, width: float) -> Array:
        tendon = TendonElasticity(initial_slope, stiffness_ratio * initial_slope, knee, width, 0.0)
        return np.array([tendon.elastic_tension(value) for value in x.tolist()])

    bounds = ([100.0, 0.05, 1e-5], [300.0, 0.95, 2e-3])
    # The fit uses only every fourth sample. With all samples, the fit takes longer, and the fitted
    # knee is hardly more accurate.
    parameters, covariance = curve_fit(
        knee_curve, displacement[::4], force[::4], (180.0, 0.5, 2e-4), bounds=bounds
    )
    return float(parameters[0]), float(np.sqrt(covariance[0, 0]))


def curves_of_tendons(measured_results: Mapping[str, Any]) -> list[TendonCurve]:
    """Return the force-displacement curves of all tendons that `measure_tendons` pulled."""
    noise = load_hand(HAND_NAME).sensor_node.tension_noise_N
    return [curve_of_tendon(tendon, noise) for tendon in measured_results["ropes"]]


def knee_errata(measured_results: Mapping[str, Any]) -> list[ErrataItem]:
    """Return errata items about the knees of the curves.

    Each item compares the knee of a measured curve with a knee that the paper states.
    """
    rows = []
    verdict = verdict_of_contradiction([str(knee) for knee in src.KNEE_TENSIONS_N], None)
    for tendon_label, tendon in zip(
        ("Sec. 5", "Abstract"), curves_of_tendons(measured_results), strict=True
    ):
        nominal_knee_N = tendon.nominal_knee_N
        max_force = float(tendon.force.max())
        measured_text = (
            f"{tendon.knee:.1f} ± {tendon.knee_sigma:.1f} N"
            if tendon.knee
            else f"none up to {max_force:.0f} N"
        )
        rows.append(
            ErrataItem(
                f"fig5.measured{nominal_knee_N:g}", f"Fig. 5, {tendon_label}", f"linear up to {nominal_knee_N:g} N",
                tendon.knee, "N", verdict,
                f"Measured on the simulator's bench with a tendon whose knee is at {nominal_knee_N:g} N: "
                f"{measured_text}, with {tendon.stiffness / 1000:.1f} N/mm below the knee. Each claim has its own "
                "curve. Only data of the paper could decide between the claims, and "
                "the paper prints none.", ("simulator",),
            )
        )  # fmt: skip
    return rows
