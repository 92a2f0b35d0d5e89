"""Environment ``handctl/Grasp-v0``: the hand shall grasp a cylinder.

After the grasp, the hand shall hold the cylinder while the table below the cylinder sinks.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from handctl.core.tick_types import HandMode, Vector
from handctl.errors import ConfigError
from handctl.gym.environment import (
    MAX_TARGET_SPEED_DEG_S,
    PICTURE_SIZE_PX,
    HandEnv,
    TargetSpace,
)
from handctl.gym.observation_layout import ObservationPart, telemetry_observation

FULL_REWARD_FORCE_N = 1.0
"""Force of a digit on the object above which the reward for this digit no longer grows [N]."""
SUCCESS_HOLD_S = 1.0
"""Time for which the hand must hold the object after the table begins to sink, to count as a success [s]."""
DROP_DISTANCE_M = 0.015
"""Largest distance by which the object is allowed to fall before it counts as dropped [m]."""
TENSION_RATE_N_PER_S = 40.0
"""Rate at which the tension of a digit approaches the tension in an action [N/s]."""
SUCCESS_REWARD = 10.0
FAILURE_REWARD = -1.0
"""Reward if the hand drops the object, or if a fault occurs.

The constant above is the reward for a held object.
"""


class GraspEnv(HandEnv):
    """Environment for a grasp.

    The digits shall close on a cylinder of random diameter, and hold the cylinder while the table
    below the cylinder sinks. The table sinks when three digits or more, including the thumb, have
    pressed on the cylinder with 1 N for 1.5 s. An action consists of targets, followed by one
    tension value t for each digit. If the tension value t of a digit is positive, the digit holds t
    times its largest allowed tension. If the tension value is zero or negative, the digit follows
    its targets. The grip is the mean of min(force / 1 N, 1) over all digits. The reward of a step
    is the change of the grip during the step. A success adds 10 to the reward, and a drop of the
    object or a fault subtracts 1. The reward uses the true forces and the true height of the
    object.
    """

    has_tensions = True

    def __init__(
        self,
        hand: str | Path = "jamia",
        space: TargetSpace = "digit",
        duration_s: float = 6.0,
        perturb: Mapping[str, float] | None = None,
        speed_deg_s: float = MAX_TARGET_SPEED_DEG_S,
        diameter_mm: tuple[float, float] = (30.0, 35.0),
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
            diameter_mm: smallest and largest diameter of the cylinder [mm].
            render_mode: as for ``HandEnv``.
            picture_size_px: as for ``HandEnv``.

        Raises:
            ConfigError: as for ``HandEnv``, or the range of diameters is empty or too large.
        """
        low, high = diameter_mm
        if not 5.0 <= low <= high <= 100.0:
            raise ConfigError(
                f"{diameter_mm}", "diameter_mm", "two ascending numbers from 5 to 100"
            )
        self._diameter_mm = float(low), float(high)
        super().__init__(
            hand, space, duration_s, perturb, speed_deg_s, render_mode, picture_size_px
        )
        self._max_tension_N = np.array(
            [self.model.ceiling[tendons].min() for tendons in self.model.digit_tendons]
        )
        self._digit_of_coordinate = [
            d
            for d, digit in enumerate(self.model.digits)
            for _ in (digit.joint_names if space == "joint" else (0,))
        ]

    def choose_scene(self) -> str:
        """Return the scene of the next episode: a cylinder of random diameter."""
        return f"cylinder:{self.np_random.uniform(*self._diameter_mm):.2f}"

    def observation_parts(self) -> list[ObservationPart]:
        """Return the parts of an observation: joint angles, joint rates, tensions, tip forces and contacts."""
        return [
            *self.common_observation_parts(),
            telemetry_observation(self.hand, "tip_force_N", -50.0, 50.0),
            telemetry_observation(self.hand, "contact", 0.0, 1.0),
        ]

    def values_outside_telemetry(self, name: str) -> Any:
        """Raise KeyError: all observation parts of this environment are fields of the telemetry."""
        raise KeyError(name)

    def begin_episode(self) -> None:
        """Begin an episode: store the initial height of the object.

        Raises:
            ConfigError: the object is too large and touches the open hand.
        """
        engine = self.simulated_world.plant.engine
        self._forces = engine.make_force_reader("contact", list(self.hand.digit_names))
        self._height_m = engine.object_pose()[2]
        if max(np.abs(self._forces())) > FULL_REWARD_FORCE_N:
            scene = self.simulated_world.plant.scene.name
            raise ConfigError(
                f"{scene} touches the open {self.hand.name}", "diameter_mm", "a smaller object"
            )
        self._pressing = 0.0
        self._held: dict[str, float] = {}

    def requests_of_action(self, action_vector: Vector) -> list[str]:
        """Return a request that changes the tensions of digits.

        If an action changes no tension, return no request.
        """
        tension = self._demanded_tensions(action_vector).tolist()
        held_tensions = {
            name: value
            for name, value in zip(self.hand.digit_names, tension, strict=True)
            if value > 0.0
        }
        new_tensions = {
            name: value for name, value in held_tensions.items() if value != self._held.get(name)
        }
        self._held = held_tensions
        return (
            [
                json.dumps(
                    {"do": "hold", "tension_N": new_tensions, "rate_N_per_s": TENSION_RATE_N_PER_S}
                )
            ]
            if new_tensions
            else []
        )

    def names_of_targets(self, action_vector: Vector) -> tuple[str, ...]:
        """Return the names of the joints or digits that follow the targets of an action.

        All digits for which the action demands a positive tension are left out of the result.
        """
        follows_targets = self._demanded_tensions(action_vector) <= 0.0
        return tuple(
            name
            for name, d in zip(self.names, self._digit_of_coordinate, strict=True)
            if follows_targets[d]
        )

    def _demanded_tensions(self, action_vector: Vector) -> Vector:
        """Return the tension that an action demands from each digit (D,) [N].

        If the returned value of a digit is 0 or less, the digit follows its targets instead of a
        tension.
        """
        tensions: Vector = np.round(action_vector[len(self.names) :] * self._max_tension_N, 3)
        return tensions

    def evaluate_step(self) -> tuple[float, bool, dict[str, Any]]:
        """Return the reward of a step, True if the step ends the episode, and entries for ``info``.

        A step ends the episode if the hand has held the object long enough or has dropped the
        object.
        """
        forces = np.linalg.norm(np.reshape(self._forces(), (-1, 3)), axis=1)
        mean_force_reward = float(np.minimum(forces / FULL_REWARD_FORCE_N, 1.0).mean())
        reward = mean_force_reward - self._pressing
        self._pressing = mean_force_reward
        plant = self.simulated_world.plant
        fall_distance_m = self._height_m - plant.engine.object_pose()[2]
        table_drop_time_s = plant.table.dropped_at
        is_object_dropped = fall_distance_m > DROP_DISTANCE_M
        is_object_held = (
            table_drop_time_s is not None
            and plant.t_ns / 1e9 - table_drop_time_s >= SUCCESS_HOLD_S
            and not is_object_dropped
        )
        if is_object_held:
            reward += SUCCESS_REWARD
        elif is_object_dropped or self.last_output.mode != HandMode.ACTIVE:
            reward += FAILURE_REWARD
        step_info = {
            "is_success": is_object_held,
            "force_N": forces,
            "fallen_m": fall_distance_m,
            "table_sinks": table_drop_time_s is not None,
        }
        return reward, is_object_held or is_object_dropped, step_info
