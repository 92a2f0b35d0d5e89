"""Base class of the Gymnasium environments.

In each environment, controller and simulated hand run in lockstep, and the hand follows a stream of
targets. At the start of each episode, the hand is homed. An action reaches the controller as text
in ``TickIn``, in the same way as the targets of a client. The controller therefore checks, clips
and limits an action, and the safety monitor reacts as on a real hand. The subclasses ``TrackEnv``
and ``GraspEnv`` define the rewards.
"""

import json
import math
from abc import abstractmethod
from collections.abc import Mapping
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from handctl.controller.target_streams import stream_status
from handctl.controller.tick import Controller
from handctl.core.gains.gains import packaged_gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, StreamTarget, TickOut, TickRequest, Vector
from handctl.errors import ConfigError
from handctl.gym.observation_layout import (
    TELEMETRY_FIELD_BY_PART_NAME,
    Float32Array,
    ObservationLayout,
    ObservationPart,
    telemetry_observation,
)
from handctl.hand.file.display_units import DisplayUnits
from handctl.hand.hand_loading import load_hand
from handctl.programs.live_session import LiveProgram
from handctl.programs.requests import REFUSAL_EVENT_PREFIX
from handctl.programs.stream_plans import target_horizon_s
from handctl.session.lockstep_simulation import SimulatedRun, SimulatorSettings, homed_controller
from handctl.session.run_plan import check_hand_ready, default_control_rate

ACTION_RATE_HZ = 50.0
"""Desired rate of the actions of an environment [Hz].

The actual rate is the nearest rate whose period is a whole number of ticks.
"""
MAX_TARGET_SPEED_DEG_S = 60.0
"""Default of the largest rate of change of a target [deg/s].

The default is a fifth of the default speed limit of a stream.
"""
READY_TIMEOUT_S = 5.0
"""Longest simulated time from power-up until the hand accepts targets [s]."""
STREAM_NAME = "gym"
"""Name of the stream that carries the targets of the actions."""
PICTURE_SIZE_PX = (480, 480)
"""Default of the width and the height of a picture [pixels]."""
MAX_PICTURE_SIZE_PX = 4096
"""Largest width and height of a picture [pixels]."""
TargetSpace = Literal["joint", "digit"]
"""Meaning of an action: one target for each joint, or one target for all joints of each digit."""


class HandEnv(gymnasium.Env[Float32Array, Float32Array]):
    """Gymnasium environment with a simulated hand.

    Attributes:
        hand: description of the hand.
        names: names of the joints or digits to which the V targets of an action belong, in order.
        layout: names, units and bounds of an observation.
        low_deg, high_deg: (V,) angles for the action values -1 and 1 [deg, or mm of prismatic
            joints].
        units: units of the joints or digits (V,).
        ticks: number of control ticks in a step of the environment.
        step_s: duration of a step of the environment [s].
        horizon_s: time from an action until the hand should reach the target of the action [s].
        max_steps: largest number of steps in an episode.
    """

    has_tensions: ClassVar = False
    """True if an action contains a tension for each digit, after its targets."""
    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"], "render_fps": round(ACTION_RATE_HZ)
    }  # fmt: skip

    def __init__(
        self,
        hand: str | Path,
        space: TargetSpace,
        duration_s: float,
        perturb: Mapping[str, float] | None,
        speed_deg_s: float = MAX_TARGET_SPEED_DEG_S,
        render_mode: str | None = None,
        picture_size_px: tuple[int, int] = PICTURE_SIZE_PX,
    ) -> None:
        """Create the environment. Within a process, the controller of a hand is designed only once.

        Args:
            hand: name of a packaged hand, or path of a hand file.
            space: coordinates for which an action has targets, see ``TargetSpace``.
            duration_s: longest duration of an episode [s].
            perturb: factors by which parameters of the simulated plant are multiplied, see
                ``handctl sim --help``.
            speed_deg_s: largest rate of change of the targets [deg/s].
            render_mode: ``rgb_array`` if ``render`` shall return pictures, None otherwise.
            picture_size_px: width and height of the pictures [pixels].

        Raises:
            ConfigError: the hand, the space, the duration, the speed, the render mode or the size
                of the pictures is invalid.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(repr(render_mode), "render_mode", "rgb_array or None")
        if not all(1 <= size <= MAX_PICTURE_SIZE_PX for size in picture_size_px):
            raise ConfigError(
                f"{picture_size_px}",
                "picture_size_px",
                f"two numbers from 1 to {MAX_PICTURE_SIZE_PX}",
            )
        self.render_mode = render_mode
        self._picture_size_px = picture_size_px
        self._camera: Any = None
        if space not in ("joint", "digit"):
            raise ConfigError(repr(space), "space", "joint or digit")
        if not 0.0 < duration_s <= 600.0:
            raise ConfigError(f"{duration_s:g} s", "duration_s", "more than 0, at most 600")
        if not 0.0 < speed_deg_s < math.inf:
            raise ConfigError(f"{speed_deg_s:g} deg/s", "speed_deg_s", "more than 0")
        self._path = str(hand)
        self._controller = _controller_of_file(self._path)
        self.model = self._controller.model
        self.hand = self.model.hand
        self.names = self.hand.joints if space == "joint" else self.hand.digit_names
        self.low_deg, self.high_deg = _target_range_deg(self.model, space)
        rate = 1.0 / self.model.period
        self.ticks = max(1, round(rate / ACTION_RATE_HZ))
        self.step_s = self.ticks * self.model.period
        self.max_steps = max(1, round(duration_s / self.step_s))
        self.horizon_s = target_horizon_s(1.0 / self.step_s, self.model.period)
        self._space = space
        self.units = (
            self.hand.display_units
            if space == "joint"
            else DisplayUnits.of(
                [self.hand.mean_position_units(name).is_prismatic[0] for name in self.names]
            )
        )
        # A prismatic joint moves 10 mm per rad.
        self._largest_step_deg = speed_deg_s * self.step_s * self.units.displayed_per_degree
        self._target_deg = self.low_deg
        self._perturb = dict(perturb or {})
        self.layout = ObservationLayout(self.observation_parts())
        self.observation_space = self.layout.space
        tensions = len(self.hand.digit_names) if self.has_tensions else 0
        self.action_space = Box(-1.0, 1.0, (len(self.names) + tensions,), np.float32)
        self._episode_stack = ExitStack()
        self._run: SimulatedRun | None = None
        self.steps = 0
        self._target_number = 0
        self._last_streamed_names: tuple[str, ...] = ()

    @abstractmethod
    def observation_parts(self) -> list[ObservationPart]:
        """Return the parts of the observation vector, in the order in which the vector contains them."""

    def common_observation_parts(self) -> list[ObservationPart]:
        """Return the parts of an observation that all environments have: joint angles, joint rates and tensions."""
        largest = 2.0 * max(tendon.tension_max_N for tendon in self.hand.tendon)
        return [
            telemetry_observation(self.hand, "q_rad", -math.pi, math.pi),
            telemetry_observation(self.hand, "dq_rad_s", -30.0, 30.0),
            telemetry_observation(self.hand, "tension_N", -largest, largest),
        ]

    @abstractmethod
    def values_outside_telemetry(self, name: str) -> Any:
        """Return the values of the observation part ``name``, which is not a field of the telemetry."""

    @abstractmethod
    def begin_episode(self) -> None:
        """Begin an episode. When this method is called, the simulated hand has just begun to accept targets."""

    @abstractmethod
    def evaluate_step(self) -> tuple[float, bool, dict[str, Any]]:
        """Return the reward of a step, True if the step ends the episode, and entries for ``info``.

        A step ends the episode if the hand has reached the goal of the episode or has failed.
        """

    def choose_scene(self) -> str | None:
        """Return the scene of the next episode, or None for a hand without objects.

        Subclasses that choose a random scene use ``np_random``.
        """
        return None

    def requests_of_action(self, action_vector: Vector) -> list[str]:
        """Return the requests that a step sends to the controller in addition to its target."""
        return []

    def names_of_targets(self, action_vector: Vector) -> tuple[str, ...]:
        """Return the names of the joints or digits for which a step sends targets."""
        return self.names

    @property
    def simulated_run(self) -> SimulatedRun:
        """Return the simulation of the present episode.

        Raises:
            ConfigError: no episode has begun.
        """
        if self._run is None:
            raise ConfigError("no episode has begun", "step", "reset first")
        return self._run

    @property
    def last_output(self) -> TickOut:
        """Return the output of the latest tick."""
        tick_output = self.simulated_run.last_output
        assert tick_output is not None
        return tick_output

    @property
    def t_s(self) -> float:
        """Return the time since the start of the episode [s]."""
        return self.steps * self.step_s

    @property
    def true_q(self) -> Vector:
        """Return the true joint angles of the simulated hand (J,) [rad]."""
        return np.array(self.simulated_run.simulated_hand.world.plant.engine.q)

    @property
    def simulated_world(self) -> Any:
        """Return the simulated world, whose true values determine the rewards in place of measurements."""
        return self.simulated_run.simulated_hand.world

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Begin an episode. The method follows the definition of ``gymnasium.Env``.

        Power up a homed hand, and wait until the hand accepts targets.

        Args:
            seed: seed of the noise, the scene and the reference, for this episode and all later
                episodes.
            options: not used.
        """
        super().reset(seed=seed)
        self._episode_stack.close()
        plant_seed = int(self.np_random.integers(1 << 31))
        simulator = SimulatorSettings(
            self._path, self.choose_scene(), plant_seed, self._perturb or None, homed=True
        )
        run = self._episode_stack.enter_context(simulator.begin_run(self._controller))
        run.are_ticks_recorded = False
        self._run = run
        self._camera = None
        if not run.run_until(lambda out: out.phase == "live", READY_TIMEOUT_S):
            problem = run.state.failure or "not ready"
            raise ConfigError(
                problem, f"the simulated {self.hand.name}", "a hand that can be armed"
            )
        self.steps = 0
        self._target_number = 0
        self._last_streamed_names = ()
        self._target_deg = np.clip(
            self.units.to_display_units(self.coordinates_of_joints(self.last_output.telemetry.q)),
            self.low_deg,
            self.high_deg,
        )
        self.begin_episode()
        return self._observation(), self._step_information()

    def step(self, action: Float32Array) -> tuple[Float32Array, float, bool, bool, dict[str, Any]]:
        """Send the targets of an action to the hand, and simulate the hand until the next action is due.

        The documentation of ``gymnasium.Env.step`` explains the returned values.
        """
        run = self.simulated_run
        clipped_action = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        if clipped_action.shape != self.action_space.shape or not np.isfinite(clipped_action).all():
            raise ConfigError(
                f"{action!r}", "action", f"{math.prod(self.action_space.shape or ())} finite values"
            )
        tick_output = run.run_tick(requests=tuple(self._step_requests(clipped_action)))
        refused_texts = [
            event.text
            for event in tick_output.events
            if event.text.startswith(REFUSAL_EVENT_PREFIX)
        ]
        if refused_texts and tick_output.mode == HandMode.ACTIVE:
            raise ConfigError(
                refused_texts[0], f"the controller of {self.hand.name}", "targets within the limits"
            )
        for _ in range(self.ticks - 1):
            if tick_output.mode == HandMode.DONE:
                break
            tick_output = run.run_tick()
        self.steps += 1
        reward, is_terminated, information = self.evaluate_step()
        has_failed = tick_output.mode != HandMode.ACTIVE
        is_truncated = self.steps >= self.max_steps and not (is_terminated or has_failed)
        return (
            self._observation(),
            float(reward),
            is_terminated or has_failed,
            is_truncated,
            self._step_information() | information,
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture of the hand and the object, drawn by MuJoCo.

        The shape of the picture is (height, width, 3), and its values are from 0 to 255. Without
        the render mode ``rgb_array``, return None.

        Raises:
            ConfigError: no episode has begun, or the machine has no graphics library.
        """
        if self.render_mode is None:
            gymnasium.logger.warn('no picture without render_mode="rgb_array"')
            return None
        world = self.simulated_run.simulated_hand.world
        if self._camera is None:
            # The scene of each episode is a MuJoCo model of its own, so each episode needs a new
            # camera.
            try:
                self._camera = world.open_camera(*self._picture_size_px)
            except ValueError as error:
                raise ConfigError(str(error), "render_mode", "graphics, or None") from error
            self._episode_stack.callback(self._camera.close)
        picture: NDArray[np.uint8] = self._camera.picture(world.plant.engine)
        return picture

    def close(self) -> None:
        """End the simulation of the hand."""
        self._episode_stack.close()
        self._run = self._camera = None

    def angles_deg(self, action: Vector | Float32Array) -> Vector:
        """Return the target angles of an action (V,) [deg]."""
        angle_action = np.asarray(action[: len(self.names)], np.float64)
        return self.low_deg + 0.5 * (angle_action + 1.0) * (self.high_deg - self.low_deg)

    def action_for(self, angles_deg: Vector) -> Float32Array:
        """Return the action with the given target angles (V,) [deg].

        In the returned action, every digit follows its target angles, and no digit holds a tension.
        """
        unclipped_action = (
            2.0 * (np.asarray(angles_deg) - self.low_deg) / (self.high_deg - self.low_deg) - 1.0
        )
        return np.clip(unclipped_action, -1.0, 1.0).astype(np.float32)

    def coordinates_of_joints(self, q: Vector) -> Vector:
        """Convert joint angles (J,) to the quantities for which an action contains targets (V,).

        In the space ``joint``, an action contains targets for joint angles. In the space ``digit``,
        an action contains a target for the mean of the coordinates of each digit.

        The conversion does not change the unit of the angles.
        """
        if self._space == "joint":
            return np.asarray(q)
        return np.array(
            [(digit.joints_to_coordinates @ q[digit.joints]).mean() for digit in self.model.digits]
        )

    def _step_requests(self, action_vector: Vector) -> list[TickRequest]:
        """Return all requests that a step sends to the controller, including the next target.

        If the joints or digits with targets have changed since the last step, a request opens a new
        stream.
        """
        requests: list[TickRequest] = list(self.requests_of_action(action_vector))
        names = self.names_of_targets(action_vector)
        if names and names != self._last_streamed_names:
            open_stream_request = {
                "do": "stream", "stream": STREAM_NAME, "space": self._space, "names": list(names),
                "rate_Hz": 1.0 / self.step_s, "interpolation": "minimum_jerk",
            }  # fmt: skip
            requests.append(json.dumps(open_stream_request))
        self._last_streamed_names = names
        return [*requests, self._next_target(action_vector)] if names else requests

    def _next_target(self, action_vector: Vector) -> StreamTarget:
        """Return the next target of the stream.

        The target moves from the last target towards the target of the action, at most by the
        largest allowed change per step.
        """
        change = self.angles_deg(action_vector) - self._target_deg
        self._target_deg = self._target_deg + np.clip(
            change, -self._largest_step_deg, self._largest_step_deg
        )
        angles = dict(zip(self.names, self._target_deg.tolist(), strict=True))
        target_number = self._target_number
        self._target_number += 1
        return StreamTarget(
            STREAM_NAME,
            target_number,
            self.simulated_run.k * self.simulated_run.period_ns,
            tuple([angles[name] for name in self._last_streamed_names]),
        )

    def _observation(self) -> Float32Array:
        telemetry = self.last_output.telemetry
        return self.layout.to_vector(
            lambda name: (
                getattr(telemetry, TELEMETRY_FIELD_BY_PART_NAME[name])
                if name in TELEMETRY_FIELD_BY_PART_NAME
                else self.values_outside_telemetry(name)
            )
        )

    def _step_information(self) -> dict[str, Any]:
        """Return information about the hand that the observation does not contain."""
        state = self.simulated_run.state
        target_stream_status = stream_status(state)
        return {
            "t_s": self.t_s,
            "mode": self.last_output.mode.name,
            "failure": state.failure,
            "clipped": target_stream_status.clipped,
            "limited": target_stream_status.limited,
        }


@lru_cache(maxsize=8)
def _controller_of_file(path: str) -> Controller:
    """Return the controller of a hand. The returned controller starts with a homed hand.

    Several environments can share one controller, because a controller object never changes after
    its creation.
    """
    hand = load_hand(path)
    check_hand_ready(hand, path)
    model = HandModel.from_hand(hand, packaged_gains(hand.name), default_control_rate(hand))
    return homed_controller(model, LiveProgram())


def _target_range_deg(model: HandModel, space: TargetSpace) -> tuple[Vector, Vector]:
    """Return the lowest and the highest allowed targets of an action [deg].

    The lowest and the highest targets are arrays with one value for each joint or digit, shape
    (V,).

    The range of a digit is the range that all joint coordinates of this digit have in common.
    """
    if space == "joint":
        low, high = zip(*(digit.displayed_joint_limits for digit in model.hand.digit), strict=True)
        return np.concatenate(low), np.concatenate(high)
    displayed_limits = [
        digit.coordinate_units.to_display_units(digit.coordinate_limits) for digit in model.digits
    ]
    return np.array([bound_m[0].max() for bound_m in displayed_limits]), np.array(
        [bound_m[1].min() for bound_m in displayed_limits]
    )
