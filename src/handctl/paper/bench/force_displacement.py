"""Figure 5, measured: a blocked finger is pulled over the bus, and encoder and load cell give the tendon's curve."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import curve_fit

from handctl.hand.description import Hand
from handctl.hand.digit import Array
from handctl.hand.load import hand_from, load_hand
from handctl.hand.tendons import TendonLaw
from handctl.paper import sources as src
from handctl.paper.bench.run import run
from handctl.paper.item import Item
from handctl.paper.verdict import of_contradiction
from handctl.programs.task import Task

HAND = "jamia_bench"
BLOCKED_DEG = 0.01
"""Travel that a clamp leaves a joint: 1.6 um of rope over three pulleys."""
PULL_N = 238.0
"""Below 244 N, where the bench hand's load cells count as saturated, by what a loop may overshoot."""
RATE_N_PER_S = 60.0
LINEAR_N = (30.0, 150.0)
"""Range in which every rope is straight; the curve's origin is extrapolated from here."""
STRAIGHT = 1.2
"""A residual of so many standard deviations of the load cell still counts as noise."""


@dataclass(frozen=True, slots=True)
class Curve:
    """One rope's measured curve.

    Attributes:
        knee_given: that the simulator's rope has [N].
        displacement: (samples,) of the spool, zero where the straight part meets the axis [mm].
        force: (samples,) load cell [N].
        stiffness: of the straight part [N/m].
        knee: found in the data [N]; None if it is straight to the end.
        knee_sigma: standard deviation of that [N].
    """

    knee_given: float
    displacement: Array
    force: Array
    stiffness: float
    knee: float | None
    knee_sigma: float


def blocked_hand(knees: tuple[float, ...]) -> Hand:
    """The bench hand with clamped joints and ropes that bend at the given tensions, from the first finger on."""
    content = copy.deepcopy(load_hand(HAND).content)
    for digit in content["digit"]:
        digit["joint_max_deg"] = [low + BLOCKED_DEG for low in digit["joint_min_deg"]]
    for tendon, knee in zip(content["tendon"], knees, strict=False):
        tendon["knee_N"] = knee
    return hand_from(content, f"{HAND}, blocked")


def measure(folder: Path) -> dict[str, Any]:
    """Pull index and middle finger; plain values, for the other side of a pipe.

    Args:
        folder: for the files of the experiment.
    """
    knees = tuple(map(float, src.KNEES_N))
    hand = blocked_hand(knees)
    path = folder / "blocked.toml"
    path.write_text(hand.to_toml(), encoding="utf-8")
    pulled = dict.fromkeys(hand.digit_names[: len(knees)], PULL_N)
    recording = run(str(path), None, _task(pulled))
    rows = recording.in_phase("pull")
    force, travel = np.array(recording.tension)[rows], np.array(recording.travel)[rows]
    spools = [hand.motor_of(name).spool_radius_m for name in hand.tendon_names]
    return {
        "ropes": [
            {"knee_N": knee, "travel_m": (travel[:, i] * spools[i]).tolist(), "force_N": force[:, i].tolist()}
            for i, knee in enumerate(knees)
        ]
    }


def _task(tension: dict[str, float]) -> Task:
    phases = (
        {"kind": "close", "name": "touch", "angle_deg": 30.0, "speed_deg_s": 20.0, "contact_tension_N": 12.0},
        {
            "kind": "hold",
            "name": "pull",
            "tension_N": tension,
            "rate_N_per_s": RATE_N_PER_S,
            "duration_s": PULL_N / RATE_N_PER_S + 0.3,
        },
    )
    return Task.model_validate({"schema": 1, "name": "force and displacement", "phase": phases})


def curve(measured: Mapping[str, Any], noise: float) -> Curve:
    """Find the straight part and the knee of what was measured.

    Args:
        measured: a rope of ``measure``.
        noise: standard deviation of the load cell [N].
    """
    travel, force = np.array(measured["travel_m"]), np.array(measured["force_N"])
    good = np.isfinite(travel) & np.isfinite(force)
    travel, force = travel[good], force[good]
    straight = (force > LINEAR_N[0]) & (force < LINEAR_N[1])
    slope, offset = np.polyfit(travel[straight], force[straight], 1)
    displacement = travel + offset / slope
    residual = float(np.sqrt(np.mean((force - slope * displacement) ** 2)))
    knee, sigma = (None, 0.0) if residual <= STRAIGHT * noise else _knee(displacement, force, float(slope))
    return Curve(float(measured["knee_N"]), 1000.0 * displacement, force, float(slope), knee, sigma)


def _knee(displacement: Array, force: Array, slope: float) -> tuple[float, float]:
    """Tension at which the rope's law bends, by least squares, and its standard deviation [N]."""

    def law(x: Array, knee: float, ratio: float, width: float) -> Array:
        rope = TendonLaw(slope, ratio * slope, knee, width, 0.0)
        return np.array([rope.elastic(value) for value in x.tolist()])

    bounds = ([100.0, 0.05, 1e-5], [300.0, 0.95, 2e-3])
    best, spread = curve_fit(law, displacement[::4], force[::4], (180.0, 0.5, 2e-4), bounds=bounds)
    return float(best[0]), float(np.sqrt(spread[0, 0]))


def curves(measured: Mapping[str, Any]) -> list[Curve]:
    """All ropes of ``measure``."""
    noise = load_hand(HAND).sensor_node.tension_noise_N
    return [curve(rope, noise) for rope in measured["ropes"]]


def items(measured: Mapping[str, Any]) -> list[Item]:
    """What the bench found, beside what the paper says."""
    made = []
    verdict = of_contradiction([str(knee) for knee in src.KNEES_N], None)
    for place, found in zip(("Sec. 5", "Abstract"), curves(measured), strict=True):
        given, top = found.knee_given, float(found.force.max())
        seen = f"{found.knee:.1f} ± {found.knee_sigma:.1f} N" if found.knee else f"none up to {top:.0f} N"
        made.append(
            Item(
                f"fig5.measured{given:g}", f"Fig. 5, {place}", f"linear up to {given:g} N", found.knee, "N", verdict,
                f"Measured on the simulator's bench with a rope that was given a knee at {given:g} N: {seen}, "
                f"{found.stiffness / 1000:.1f} N/mm below. Each claim draws a curve of its own; the paper's data, not "
                "printed, would decide.", ("simulator",),
            )
        )  # fmt: skip
    return made
