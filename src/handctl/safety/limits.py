"""Thresholds of a hand, from drives, sensors and model."""

import math
from dataclasses import dataclass

LOAD_CELLS = "load cells"
"""Name of the sensor node among the nodes."""

SILENT_S = 0.030
STALLED_S = 0.025
"""Longest silence of a node, and longest standstill of the host [s]. Both are below the drives' watchdog of 50 ms."""
MIN_SILENT_TICKS = 4
MIN_STALLED_TICKS = 3
"""Minimum of these two times in ticks, for slow control rates."""
MIN_FRAMES_LIMIT = 64
"""Minimum of the flood threshold: more frames per tick than a small hand sends."""
TEMPERATURE_SOFT_DEGC = 70.0
TEMPERATURE_HARD_DEGC = 85.0
"""Drive temperatures where derating of the tension limit begins, and where the limit reaches the floor [degC]."""


def ticks_for(seconds: float, period: float, minimum: int) -> int:
    """Return a time [s] as a number of ticks of a period [s], rounded up, at least ``minimum``."""
    # Rounded up: a limit must never be shorter than stated.
    return max(minimum, math.ceil(seconds / period))


@dataclass(frozen=True, slots=True)
class Limits:
    """Thresholds of a hand.

    Attributes:
        tendons: names, (N,).
        motors: names, (N,).
        joints: names, (J,).
        tension_trip: (N,) tension limit of each sample, above: RELAX [N].
        drive_limit: (N,) tension at the drive's own torque limit, above: CUT
            [N].
        tension_rail: reading of a saturated load cell [N].
        tension_low: reading below the range of any tendon and tare: a broken wire or a sensor
            without supply [N].
        silent_ticks: consecutive missing replies of a silent node.
        one_silent_ticks: the same for a motor while another motor answers.
        stalled_ticks: consecutive missed ticks of a stalled host.
        temperature_soft: drive temperature where derating begins [degC].
        temperature_hard: drive temperature where derating ends at the floor [degC].
        frames: frames per tick of a flooded bus: more than all nodes together can send.
        noise: mean squared jerk of a motor's position in a noise burst [rad^2].
    """

    tendons: tuple[str, ...]
    motors: tuple[str, ...]
    joints: tuple[str, ...]
    tension_trip: tuple[float, ...]
    drive_limit: tuple[float, ...]
    tension_rail: float
    tension_low: float = -math.inf
    silent_ticks: int = MIN_SILENT_TICKS
    one_silent_ticks: int = MIN_SILENT_TICKS
    stalled_ticks: int = MIN_STALLED_TICKS
    temperature_soft: float = TEMPERATURE_SOFT_DEGC
    temperature_hard: float = TEMPERATURE_HARD_DEGC
    frames: int = MIN_FRAMES_LIMIT
    noise: float = math.inf

    @property
    def nodes(self) -> tuple[str, ...]:
        """Return the names of all nodes: the motors, then the load cells."""
        return (*self.motors, LOAD_CELLS)
