"""Safety thresholds of a hand.

The safety thresholds are computed from the drives, the sensors and the model of the hand.
"""

import math
from dataclasses import dataclass

LOAD_CELL_NODE_NAME = "load cells"
"""Name of the sensor node in lists of nodes."""

MAX_SILENCE_S = 0.030
MAX_STALL_S = 0.025
"""Longest silence of a node, and longest interruption of the host's ticks, without a fault [s].

The allowed silence and the allowed interruption are shorter than the drives' watchdog time of 50
ms.
"""
MIN_SILENT_TICKS = 4
MIN_STALLED_TICKS = 3
"""Smallest number of ticks for the times ``MAX_SILENCE_S`` and ``MAX_STALL_S``.

At low control rates, ``MIN_SILENT_TICKS`` and ``MIN_STALLED_TICKS`` apply, because these numbers of
ticks last longer than ``MAX_SILENCE_S`` and ``MAX_STALL_S``.
"""
MIN_FLOOD_FRAMES = 64
"""Smallest threshold for a flooded bus [frames per tick]. A small hand sends fewer frames."""
SOFT_TEMPERATURE_LIMIT_DEGC = 70.0
HARD_TEMPERATURE_LIMIT_DEGC = 85.0
"""Drive temperatures at which the tension limit begins to fall, and at which this limit equals the floor [degC]."""


def tick_count_for_time(seconds: float, period: float, min_ticks: int) -> int:
    """Convert a time [s] to a number of ticks, rounded up.

    The result is at least ``min_ticks``.
    """
    # The function rounds up, because a time limit in ticks must never be shorter than the given
    # time limit in seconds.
    return max(min_ticks, math.ceil(seconds / period))


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """Safety thresholds of a hand.

    Attributes:
        tendons: (N,) names of the tendons.
        motors: (N,) names of the motors.
        joints: (J,) names of the joints.
        tension_trip: (N,) tension of each tendon [N] above which a single reading leads to the
            reaction RELAX.
        drive_limit: (N,) tension at the torque limit of the drive itself [N]. Above the tension
            ``drive_limit``, the reaction is CUT.
        tension_rail: load-cell reading minus the tare [N] from which a load cell counts as
            saturated.
        tension_low: load-cell reading minus the tare [N] below which a load cell counts as broken:
            a cut wire, or no supply. The threshold ``tension_low`` is the same for all tendons and
            tares.
        silent_ticks: number of consecutive missing replies after which a motor or a load cell
            counts as silent.
        silent_ticks_of_single_motor: number of consecutive missing replies after which a motor
            counts as silent while another motor answers.
        stalled_ticks: number of consecutive missed ticks after which the host counts as stalled.
        temperature_soft: drive temperature at which the controller begins to lower the tension
            limit [degC].
        temperature_hard: drive temperature at which the tension limit reaches the tension floor
            [degC].
        max_frames_per_tick: number of frames in a tick above which the bus counts as flooded.
        max_position_noise: mean squared jerk of a motor's measured position above which the measurement counts
            as noisy [rad^2].
    """

    tendons: tuple[str, ...]
    motors: tuple[str, ...]
    joints: tuple[str, ...]
    tension_trip: tuple[float, ...]
    drive_limit: tuple[float, ...]
    tension_rail: float
    tension_low: float = -math.inf
    silent_ticks: int = MIN_SILENT_TICKS
    silent_ticks_of_single_motor: int = MIN_SILENT_TICKS
    stalled_ticks: int = MIN_STALLED_TICKS
    temperature_soft: float = SOFT_TEMPERATURE_LIMIT_DEGC
    temperature_hard: float = HARD_TEMPERATURE_LIMIT_DEGC
    max_frames_per_tick: int = MIN_FLOOD_FRAMES
    max_position_noise: float = math.inf

    @property
    def node_names(self) -> tuple[str, ...]:
        """Return the names of all nodes: the motors, followed by one name for the load cells."""
        return (*self.motors, LOAD_CELL_NODE_NAME)
