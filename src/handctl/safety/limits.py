"""Thresholds of one hand: what its drives, its sensors and its model allow."""

import math
from dataclasses import dataclass

LOAD_CELLS = "load cells"
"""The sensor node among the nodes."""

SILENT_S, STALLED_S = 0.030, 0.025
"""How long a node may be silent, and the host stand still: less than the drives' watchdog of 50 ms."""
SILENT_TICKS_LEAST, STALLED_TICKS_LEAST = 4, 3
"""The same in ticks at least, for slow rates."""
FRAMES_LEAST = 64
"""Frames in one tick that no hand of few motors sends."""
TEMPERATURE_SOFT_DEGC, TEMPERATURE_HARD_DEGC = 70.0, 85.0
"""Temperature of a drive from which on its tendon's limit falls, and at which it has fallen to the floor."""


def ticks_for(seconds: float, period: float, least: int) -> int:
    """Return a time as whole ticks of a period [s], at least ``least``."""
    return max(least, math.ceil(seconds / period))


@dataclass(frozen=True, slots=True)
class Limits:
    """Thresholds of one hand.

    Attributes:
        tendons: names, (N,). motors: names, (N,). joints: names, (J,).
        tension_trip: (N,) tension of one sample that means relax [N].
        drive_limit: (N,) tension that the drive's own torque limit can make; above it, cut [N].
        tension_rail: reading at which a load cell is saturated [N].
        tension_low: reading, after any tare, that no tendon can make: a broken wire or a sensor without supply [N].
        silent_ticks: replies in a row that may be missing before a node counts as silent.
        one_silent_ticks: the same for a motor while another one answers.
        stalled_ticks: ticks in a row that may be missed before the host counts as standing still.
        temperature_soft, temperature_hard: of a drive [degC].
        frames: frames in one tick that are more than all nodes together can have sent; of a big hand more.
        noise: mean squared jerk of a motor's position that means a noise burst [rad^2].
    """

    tendons: tuple[str, ...]
    motors: tuple[str, ...]
    joints: tuple[str, ...]
    tension_trip: tuple[float, ...]
    drive_limit: tuple[float, ...]
    tension_rail: float
    tension_low: float = -math.inf
    silent_ticks: int = SILENT_TICKS_LEAST
    one_silent_ticks: int = SILENT_TICKS_LEAST
    stalled_ticks: int = STALLED_TICKS_LEAST
    temperature_soft: float = TEMPERATURE_SOFT_DEGC
    temperature_hard: float = TEMPERATURE_HARD_DEGC
    frames: int = FRAMES_LEAST
    noise: float = math.inf

    @property
    def nodes(self) -> tuple[str, ...]:
        """All that answers in every tick: the motors, then the load cells."""
        return (*self.motors, LOAD_CELLS)
