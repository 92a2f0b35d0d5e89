"""Base class of the environments: a homed simulated hand in lockstep, commanded by a stream of targets.

An action is processed like a client's target: as text in ``TickIn``. Therefore the controller
checks, clips, and limits the action, and the safety monitor reacts as on a real hand. Only
``Track`` and ``Grasp`` define rewards.
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

from handctl.controller.bus_load import bus_loads
from handctl.controller.streams import stream_status
from handctl.controller.tick import Controller
from handctl.core.gains.gains import packaged_gains
from handctl.core.model import HandModel
from handctl.core.types import Mode, TickOut, Vector
from handctl.errors import ConfigError
from handctl.gym.observed import FIELD_OF_NAME, Numbers, ObservationLayout, ObservationPart, telemetry_part
from handctl.hand.load import load_hand
from handctl.programs.live import LiveProgram
from handctl.programs.requests import REFUSED_PREFIX, target_text
from handctl.programs.streams import horizon_s
from handctl.session.plan import check_ready, highest_rate_of_buses
from handctl.session.simulate import Simulation, Simulator, homed_controller

RATE_HZ = 50.0
"""Rate of the actions [Hz].

The stream of targets has the nearest rate whose period is a whole number of ticks.
"""
SPEED_DEG_S = 60.0
"""Default for the largest rate of change of a target [deg/s], a fifth of the default limit of a stream."""
READY_TIMEOUT_S = 5.0
"""Longest time from power-up until the hand accepts targets [s]."""
STREAM_NAME = "gym"
"""Name of the stream."""
TargetSpace = Literal["joint", "digit"]
"""Meaning of an action: one target per joint, or one target for all joints of a digit."""


class HandEnv(gymnasium.Env[Numbers, Numbers]):
    """Environment of a simulated hand.

    Attributes:
        hand: description of the hand.
        names: names of the joints or digits in an action, in order.
        layout: names, units and bounds of an observation.
        low_deg, high_deg: (V,) angles for the action values -1 and 1 [deg].
        ticks: number of control ticks per step.
        step_s: duration of a step [s].
        horizon_s: time from an action until the hand should reach its target [s].
        longest: largest number of steps in an episode.
    """

    has_tensions: ClassVar = False
    """True if an action includes one tension per digit after the targets."""
    metadata: dict[str, Any] = {"render_modes": [], "render_fps": round(RATE_HZ)}  # noqa: RUF012

    def __init__(
        self,
        hand: str | Path,
        space: TargetSpace,
        duration_s: float,
        perturb: Mapping[str, float] | None,
        speed_deg_s: float = SPEED_DEG_S,
    ) -> None:
        """Create the environment. The controller is designed only once for each hand.

        Args:
            hand: name of a packaged hand, or path of a hand file.
            space: meaning of an action.
            duration_s: longest duration of an episode [s].
            perturb: factors for the parameters of the simulated plant, see ``handctl sim --help``.
            speed_deg_s: largest rate of change of the targets [deg/s].

        Raises:
            ConfigError: hand, space, duration or speed is invalid.
        """
        if space not in ("joint", "digit"):
            raise ConfigError(repr(space), "space", "joint or digit")
        if not 0.0 < duration_s <= 600.0:
            raise ConfigError(f"{duration_s:g} s", "duration_s", "more than 0, at most 600")
        if not 0.0 < speed_deg_s < math.inf:
            raise ConfigError(f"{speed_deg_s:g} deg/s", "speed_deg_s", "more than 0")
        self._path = str(hand)
        self._controller = _controller(self._path)
        self.model = self._controller.model
        self.hand = self.model.hand
        self.names = self.hand.joints if space == "joint" else self.hand.digit_names
        self.low_deg, self.high_deg = _target_range_deg(self.model, space)
        rate = 1.0 / self.model.period
        self.ticks = max(1, round(rate / RATE_HZ))
        self.step_s = self.ticks * self.model.period
        self.longest = max(1, round(duration_s / self.step_s))
        self.horizon_s = horizon_s(1.0 / self.step_s, self.model.period)
        self._space = space
        self._largest_step_deg = speed_deg_s * self.step_s
        self._target_deg = self.low_deg
        self._perturb = dict(perturb or {})
        self.layout = ObservationLayout(self.parts())
        self.observation_space = self.layout.space
        tensions = len(self.hand.digit_names) if self.has_tensions else 0
        self.action_space = Box(-1.0, 1.0, (len(self.names) + tensions,), np.float32)
        self._open = ExitStack()
        self._run: Simulation | None = None
        self.steps = 0
        self._number = 0
        self._streamed: tuple[str, ...] = ()

    @abstractmethod
    def parts(self) -> list[ObservationPart]:
        """Return the parts of an observation."""

    def body_parts(self) -> list[ObservationPart]:
        """Return the parts that all environments have: joint angles and rates, and tensions."""
        largest = 2.0 * max(tendon.tension_max_N for tendon in self.hand.tendon)
        return [
            telemetry_part(self.hand, "q_rad", -math.pi, math.pi),
            telemetry_part(self.hand, "dq_rad_s", -30.0, 30.0),
            telemetry_part(self.hand, "tension_N", -largest, largest),
        ]

    @abstractmethod
    def extra_values(self, name: str) -> Any:
        """Return the values of a part of the observation that the telemetry does not contain."""

    @abstractmethod
    def begin(self) -> None:
        """Begin an episode, after the simulated hand has started to accept targets."""

    @abstractmethod
    def judge(self) -> tuple[float, bool, dict[str, Any]]:
        """Return the reward of the step, True if the episode has ended by success or failure, and information."""

    def scene(self) -> str | None:
        """Return the scene of the next episode, or None for a hand without objects.

        Random choices use ``np_random``.
        """
        return None

    def requests(self, action: Vector) -> list[str]:
        """Return the requests of a step in addition to the target of the stream."""
        return []

    def streamed(self, action: Vector) -> tuple[str, ...]:
        """Return the names of the action that are streamed in this step."""
        return self.names

    @property
    def run(self) -> Simulation:
        """Return the simulation of the episode.

        Raises:
            ConfigError: no episode has begun.
        """
        if self._run is None:
            raise ConfigError("no episode has begun", "step", "reset first")
        return self._run

    @property
    def out(self) -> TickOut:
        """Return the output of the latest tick."""
        out = self.run.out
        assert out is not None
        return out

    @property
    def t_s(self) -> float:
        """Return the time of the episode [s]."""
        return self.steps * self.step_s

    @property
    def true_q(self) -> Vector:
        """Return the true joint angles of the plant (J,) [rad]."""
        return np.array(self.run.peer.world.plant.engine.q)

    @property
    def world(self) -> Any:
        """Return the simulated plant, for rewards."""
        return self.run.peer.world

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Numbers, dict[str, Any]]:
        """Power up a homed hand, and wait until it accepts targets. See ``gymnasium.Env``.

        Args:
            seed: seed for noise, scene and reference of this and the following episodes.
            options: no options are supported.
        """
        super().reset(seed=seed)
        self._open.close()
        plant_seed = int(self.np_random.integers(1 << 31))
        simulator = Simulator(self._path, self.scene(), plant_seed, self._perturb or None, homed=True)
        run = self._open.enter_context(simulator.against(self._controller))
        run.record = False
        self._run = run
        if not run.until(lambda out: out.phase == "live", READY_TIMEOUT_S):
            problem = run.state.failure or "not ready"
            raise ConfigError(problem, f"the simulated {self.hand.name}", "a hand that can be armed")
        self.steps = 0
        self._number = 0
        self._streamed = ()
        self._target_deg = np.clip(np.degrees(self.values_of(self.out.telemetry.q)), self.low_deg, self.high_deg)
        self.begin()
        return self._observation(), self._extra_information()

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, dict[str, Any]]:
        """Send the targets of an action, and run the ticks until the next action. See ``gymnasium.Env``."""
        run = self.run
        clipped = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        if clipped.shape != self.action_space.shape or not np.isfinite(clipped).all():
            raise ConfigError(f"{action!r}", "action", f"{math.prod(self.action_space.shape or ())} finite values")
        out = run.tick(requests=tuple(self._step_requests(clipped)))
        refused = [event.text for event in out.events if event.text.startswith(REFUSED_PREFIX)]
        if refused and out.mode == Mode.ACTIVE:
            raise ConfigError(refused[0], f"the controller of {self.hand.name}", "targets within the limits")
        for _ in range(self.ticks - 1):
            if out.mode == Mode.DONE:
                break
            out = run.tick()
        self.steps += 1
        reward, ended, information = self.judge()
        failed = out.mode != Mode.ACTIVE
        truncated = self.steps >= self.longest and not (ended or failed)
        return self._observation(), float(reward), ended or failed, truncated, self._extra_information() | information

    def close(self) -> None:
        """Delete the simulated hand."""
        self._open.close()
        self._run = None

    def angles_deg(self, action: Vector | Numbers) -> Vector:
        """Return the target angles of an action (V,) [deg]."""
        part = np.asarray(action[: len(self.names)], np.float64)
        return self.low_deg + 0.5 * (part + 1.0) * (self.high_deg - self.low_deg)

    def action_for(self, angles_deg: Vector) -> Numbers:
        """Return the action whose targets are the given angles (V,) [deg], without extra actions."""
        scaled = 2.0 * (np.asarray(angles_deg) - self.low_deg) / (self.high_deg - self.low_deg) - 1.0
        return np.clip(scaled, -1.0, 1.0).astype(np.float32)

    def values_of(self, q: Vector) -> Vector:
        """Return the angle for each name of an action (V,) at joint angles (J,), in the unit of these angles."""
        if self._space == "joint":
            return np.asarray(q)
        return np.array([(digit.joints_to_coordinates @ q[digit.joints]).mean() for digit in self.model.digits])

    def _step_requests(self, action: Vector) -> list[str]:
        """Return the requests of a step. If the streamed names change, a new stream is opened."""
        requests = self.requests(action)
        names = self.streamed(action)
        if names and names != self._streamed:
            opening = {
                "do": "stream", "stream": STREAM_NAME, "space": self._space, "names": list(names),
                "rate_Hz": 1.0 / self.step_s, "interpolation": "minimum_jerk",
            }  # fmt: skip
            requests.append(json.dumps(opening))
        self._streamed = names
        return [*requests, self._target_request(action)] if names else requests

    def _target_request(self, action: Vector) -> str:
        """Return the request of the next target, which approaches the action at the largest rate."""
        change = self.angles_deg(action) - self._target_deg
        self._target_deg = self._target_deg + np.clip(change, -self._largest_step_deg, self._largest_step_deg)
        angles = dict(zip(self.names, self._target_deg.tolist(), strict=True))
        number = self._number
        self._number += 1
        return target_text(
            STREAM_NAME, number, self.run.k * self.run.period_ns, [angles[name] for name in self._streamed]
        )

    def _observation(self) -> Numbers:
        telemetry = self.out.telemetry
        return self.layout.vector(
            lambda name: getattr(telemetry, FIELD_OF_NAME[name]) if name in FIELD_OF_NAME else self.extra_values(name)
        )

    def _extra_information(self) -> dict[str, Any]:
        """Return further information about the hand, in addition to the observation."""
        state = self.run.state
        stream = stream_status(state)
        return {
            "t_s": self.t_s,
            "mode": self.out.mode.name,
            "failure": state.failure,
            "clipped": stream.clipped,
            "limited": stream.limited,
        }


@lru_cache(maxsize=8)
def _controller(path: str) -> Controller:
    """Return the controller of a homed hand.

    A controller is constant, so that environments can share the object.
    """
    hand = load_hand(path)
    check_ready(hand, path)
    model = HandModel.of(hand, packaged_gains(hand.name), highest_rate_of_buses(bus_loads(hand)))
    return homed_controller(model, LiveProgram())


def _target_range_deg(model: HandModel, space: TargetSpace) -> tuple[Vector, Vector]:
    """Return the lowest and the highest target of each name (V,) [deg].

    The range of a digit is the range of its coordinate with the smallest range.
    """
    if space == "joint":
        digits = model.hand.digit
        lowest = [angle for digit in digits for angle in digit.joint_min_deg]
        return np.array(lowest), np.array([angle for digit in digits for angle in digit.joint_max_deg])
    reach = [digit.reach for digit in model.digits]
    low = np.array([math.degrees(bounds[0].max()) for bounds in reach])
    high = np.array([math.degrees(bounds[1].min()) for bounds in reach])
    return low, high
