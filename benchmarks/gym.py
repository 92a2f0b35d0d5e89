"""Measure the steps per second and the reset time of ``handctl.gym``.

For comparison, the benchmark also measures an environment that uses only MuJoCo.

``python benchmarks/gym.py [--quick] [--json]``. The MuJoCo environment has the same rigid bodies,
time step and action rate as ``handctl.gym``. An action of the MuJoCo environment consists of joint
torques. The MuJoCo environment has no tendons, drives, bus or controller. The actions are random,
but change so slowly that they cause no fault of the hand. The benchmark measures CPU time for one
environment, and wall time for several environments in parallel.
"""

import argparse
import json
import time
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AsyncVectorEnv

import handctl.gym
from firmware_sim.description.hand_description import load_hand
from firmware_sim.plant.mjcf import STEP_S
from firmware_sim.plant.plant import Plant
from firmware_sim.scene.scene import load_scene

MEASURED_HANDS = ("jamia", "jamia11", "t42")
SCENE_BY_ENVIRONMENT = {"Track": None, "Grasp": "cylinder:33"}
BARE_JOINT_TORQUE_N_M = 0.05
STEP_COUNT = 2000
QUICK_STEP_COUNT = 300
RESET_COUNT = 10
PROCESS_COUNT = 2


class PlainMujocoEnvironment(gymnasium.Env[np.ndarray, np.ndarray]):
    """Environment that simulates only the rigid bodies of a hand.

    An action consists of joint torques. An observation consists of joint angles and rates.
    """

    def __init__(self, hand_name: str, scene_name: str | None, step_s: float) -> None:
        """Build the MuJoCo model of the rigid bodies of a hand."""
        self.plant = Plant(load_hand(hand_name), load_scene(scene_name), homed=True)
        self.engine = self.plant.engine
        self.count = round(step_s / STEP_S)
        joints = len(self.engine.q)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (joints,), np.float32)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2 * joints,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict]:
        """Set the initial state of the rigid bodies."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.engine._model, self.engine._data)
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Apply the joint torques of an action until the next action is due."""
        self.engine.applied[:] = BARE_JOINT_TORQUE_N_M * action
        mujoco.mj_step(self.engine._model, self.engine._data, nstep=self.count)
        return self._observation(), 0.0, False, False, {}

    def _observation(self) -> np.ndarray:
        return np.concatenate([self.engine.q, self.engine.dq]).astype(np.float32)


def main() -> None:
    """Measure the step time and the reset time of all environments, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="short measurement (less than half a minute)"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    args = parser.parse_args()
    steps = QUICK_STEP_COUNT if args.quick else STEP_COUNT
    rows = [
        measure_environment(hand, name, steps)
        for hand in MEASURED_HANDS
        for name in SCENE_BY_ENVIRONMENT
    ]
    print(json.dumps(rows, indent=2)) if args.json else print_results(rows)


def measure_environment(hand_name: str, environment_name: str, step_count: int) -> dict[str, Any]:
    """Measure the step time and the reset time for one hand, with handctl and with MuJoCo alone."""
    options = {
        "hand": hand_name,
        **({"diameter_mm": (33.0, 33.0)} if environment_name == "Grasp" else {"span": (0.0, 0.05)}),
    }
    environment_id = f"handctl/{environment_name}-v0"
    env = gymnasium.make(environment_id, **options)
    mujoco_environment = PlainMujocoEnvironment(
        hand_name, SCENE_BY_ENVIRONMENT[environment_name], env.unwrapped.step_s
    )
    environment_s = step_cpu_s(env, step_count)
    plain_mujoco_s = step_cpu_s(mujoco_environment, step_count)
    step_s = env.unwrapped.step_s
    vector = AsyncVectorEnv([lambda: gymnasium.make(environment_id, **options)] * PROCESS_COUNT)
    return {
        "hand": hand_name,
        "environment": environment_id,
        "control_rate_hz": 1.0 / env.unwrapped.model.period,
        "steps_per_s": 1.0 / environment_s,
        "times_real_time": step_s / environment_s,
        "bare_steps_per_s": 1.0 / plain_mujoco_s,
        "fraction_of_bare": plain_mujoco_s / environment_s,
        "processes": PROCESS_COUNT,
        "vector_steps_per_s": vector_steps_per_s(vector, step_count // PROCESS_COUNT),
        "reset_ms": 1e3 * reset_cpu_s(env),
        "bare_reset_ms": 1e3 * reset_cpu_s(mujoco_environment),
    }


def random_action(action_space: gymnasium.spaces.Box, rng: np.random.Generator) -> np.ndarray:
    """Return a random action that keeps the hand nearly open."""
    return np.asarray(-1.0 + 0.1 * rng.uniform(0.0, 1.0, action_space.shape), np.float32)


def step_cpu_s(env: gymnasium.Env, step_count: int) -> float:
    """Return the CPU time of a step of the environment [s]. The time of resets is not included."""
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    cpu_time_s = 0.0
    for _ in range(step_count):
        action = random_action(env.action_space, rng)
        start_time_s = time.process_time()
        _, _, is_terminated, is_truncated, info = env.step(action)
        cpu_time_s += time.process_time() - start_time_s
        if is_terminated:
            raise RuntimeError(f"the episode ended: {info}")
        if is_truncated:
            env.reset()
    return cpu_time_s / step_count


def reset_cpu_s(env: gymnasium.Env) -> float:
    """Return the CPU time of a reset of the environment [s]."""
    start_time_s = time.process_time()
    for _ in range(RESET_COUNT):
        env.reset()
    return (time.process_time() - start_time_s) / RESET_COUNT


def vector_steps_per_s(environments: AsyncVectorEnv, step_count: int) -> float:
    """Measure how many steps all processes together compute per second of wall time.

    The time of resets is included in the wall time.
    """
    rng = np.random.default_rng(0)
    environments.reset(seed=0)
    start_time_s = time.monotonic()
    for _ in range(step_count):
        environments.step(random_action(environments.action_space, rng))
    rate = PROCESS_COUNT * step_count / (time.monotonic() - start_time_s)
    environments.close()
    return rate


def print_results(rows: list[dict[str, Any]]) -> None:
    """Print the steps per second and the reset times as a table."""
    for row in rows:
        print(
            f"{row['hand']:8} {row['environment']}, {row['control_rate_hz']:g} Hz: {row['steps_per_s']:.0f} steps/s, "
            f"{row['times_real_time']:.0f} times real time; bare MuJoCo {row['bare_steps_per_s']:.0f} steps/s "
            f"({100 * row['fraction_of_bare']:.0f} %)"
        )
        print(
            f"         {row['processes']} processes {row['vector_steps_per_s']:.0f} steps/s; reset "
            f"{row['reset_ms']:.0f} ms, bare {row['bare_reset_ms']:.2f} ms"
        )


if __name__ == "__main__":
    assert handctl.gym
    main()
