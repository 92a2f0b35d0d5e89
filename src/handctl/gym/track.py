"""Environment ``handctl/Track-v0``: the joints of an empty hand shall follow a smooth random reference."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from handctl.core.tick_types import Vector
from handctl.errors import ConfigError
from handctl.gym.environment import (
    MAX_TARGET_SPEED_DEG_S,
    PICTURE_SIZE_PX,
    HandEnv,
    TargetSpace,
)
from handctl.gym.observation_layout import ObservationPart
from handctl.hand.file.display_units import DisplayUnits

HALF_REWARD_ERROR_DEG = 5.0
"""Tracking error at which the reward of a step is half the largest reward [deg]."""
REFERENCE_RANGE_FRACTIONS = (0.15, 0.55)
"""Default of the lowest and the highest reference, as fractions of the range of each joint or digit."""
SINE_PERIOD_RANGE_S = (1.5, 4.0)
"""Shortest and longest period of the two sines in the reference [s]."""
MAX_REFERENCE_RATE_DEG_S = 45.0
"""Largest rate of change of the reference, except in the first second [deg/s]."""
REFERENCE_BLEND_S = 1.0
"""Time at the start of an episode in which the reference moves from the initial posture to the sines [s]."""


class TrackEnv(HandEnv):
    """Environment in which each joint or digit follows a reference.

    Each reference is the sum of two sine waves with random periods and phases.

    The error e of a step is the root mean square of the true tracking errors of all joints or
    digits. The reward of a step with the error e is 1 / (1 + (e / 5 deg)^2). Only a fault ends an
    episode early.
    """

    def __init__(
        self,
        hand: str | Path = "jamia",
        space: TargetSpace = "digit",
        duration_s: float = 5.0,
        perturb: Mapping[str, float] | None = None,
        speed_deg_s: float = MAX_TARGET_SPEED_DEG_S,
        span: tuple[float, float] = REFERENCE_RANGE_FRACTIONS,
        render_mode: str | None = None,
        picture_size_px: tuple[int, int] = PICTURE_SIZE_PX,
    ) -> None:
        """Create the environment. The docstring of ``HandEnv`` explains the common arguments.

        Args:
            hand: as for ``HandEnv``.
            space: as for ``HandEnv``.
            duration_s: as for ``HandEnv``.
            perturb: as for ``HandEnv``.
            speed_deg_s: as for ``HandEnv``.
            span: lowest and highest value of the references, as fractions of the range of each
                joint or digit. If digits can touch each other within these ranges, the span must be
                smaller.
            render_mode: as for ``HandEnv``.
            picture_size_px: as for ``HandEnv``.

        Raises:
            ConfigError: as for ``HandEnv``, or the span is empty or outside 0 to 1.
        """
        if not 0.0 <= span[0] < span[1] <= 1.0:
            raise ConfigError(f"{span}", "span", "two ascending numbers from 0 to 1")
        self._span = span
        super().__init__(
            hand, space, duration_s, perturb, speed_deg_s, render_mode, picture_size_px
        )

    def observation_parts(self) -> list[ObservationPart]:
        """Return the parts of an observation: joint angles and rates, tensions, present and future references."""
        return [
            *self.common_observation_parts(),
            ObservationPart("reference_rad", self.names, -math.pi, math.pi),
            ObservationPart("reference_ahead_rad", self.names, -math.pi, math.pi),
        ]

    def begin_episode(self) -> None:
        """Begin an episode: choose a random reference."""
        low, high = self._reference_limits_deg()
        shape = (2, len(low))
        period = self.np_random.uniform(*SINE_PERIOD_RANGE_S, shape)
        self._rate = 2.0 * np.pi / period
        self._phase = self.np_random.uniform(0.0, 2.0 * np.pi, shape)
        self._middle = low + sum(self._span) / 2.0 * (high - low)
        amplitudes = (self._span[1] - self._span[0]) / 2.0 * (high - low) * np.array([[0.6], [0.4]])
        self._swing = np.minimum(amplitudes, 0.5 * MAX_REFERENCE_RATE_DEG_S / self._rate)
        self._start = self._reference_coordinates_at(self.last_output.telemetry.q)

    def reference_deg(self, t_s: float) -> Vector:
        """Return the reference of each joint or digit (V,) at a time since the start of the episode [deg]."""
        sine_reference = self._middle + (self._swing * np.sin(self._rate * t_s + self._phase)).sum(
            axis=0
        )
        s = min(t_s / REFERENCE_BLEND_S, 1.0)
        blend_fraction = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        angles = (
            self._reference_units.to_display_units(self._start) * (1.0 - blend_fraction)
            + sine_reference * blend_fraction
        )
        return angles if self._space == "digit" else self._joint_angles_at(angles)

    def values_outside_telemetry(self, name: str) -> Any:
        """Return the reference angles of the joints or digits for one part of the observation [rad].

        For the part ``reference_rad``, return the references at the present time. For the part
        ``reference_ahead_rad``, return the references at the time ``horizon_s`` from now.
        """
        time_ahead_s = self.horizon_s if name == "reference_ahead_rad" else 0.0
        return self.units.to_si_units(self.reference_deg(self.t_s + time_ahead_s))

    def evaluate_step(self) -> tuple[float, bool, dict[str, Any]]:
        """Return the reward of a step, False, and a dictionary that contains the tracking error.

        The reward depends on the true tracking error. The second result is False, because the
        environment has neither a success nor a failure.
        """
        error = self.units.to_display_units(
            self.coordinates_of_joints(self.true_q)
        ) - self.reference_deg(self.t_s)
        rms = float(np.sqrt(np.mean(error**2)))
        return 1.0 / (1.0 + (rms / HALF_REWARD_ERROR_DEG) ** 2), False, {"error_deg": rms}

    def _reference_limits_deg(self) -> tuple[Vector, Vector]:
        """Return the lowest and the highest value of each reference [deg].

        A reference belongs to a digit or to a coordinate of joints.
        """
        if self._space == "digit":
            return self.low_deg, self.high_deg
        low, high = self._reference_units.to_display_units(self.model.coordinate_limits)
        return low, high

    @property
    def _reference_units(self) -> DisplayUnits:
        """Return the display units of the references. A reference belongs to a digit or to a joint coordinate."""
        if self._space == "digit":
            return self.units
        return DisplayUnits.of(
            np.concatenate([digit.coordinate_units.is_prismatic for digit in self.model.digits])
        )

    def _reference_coordinates_at(self, q: Vector) -> Vector:
        """Convert joint angles (J,) to the coordinates in which the references are given.

        The conversion does not change the unit of the angles.
        """
        if self._space == "digit":
            return self.coordinates_of_joints(q)
        return np.concatenate(
            [digit.joints_to_coordinates @ q[digit.joints] for digit in self.model.digits]
        )

    def _joint_angles_at(self, coordinates: Vector) -> Vector:
        """Return the joint angles (J,) at given coordinates.

        The conversion does not change the unit of the angles. Joints that share a coordinate have
        the same angle.
        """
        rows = zip(self.model.digits, self.model.digit_coordinates, strict=True)
        return np.concatenate(
            [digit.coupling @ coordinates[coordinate_slice] for digit, coordinate_slice in rows]
        )
