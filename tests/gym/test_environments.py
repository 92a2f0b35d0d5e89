"""Test the environments of ``handctl.gym``: their interface, determinism and safety.

Test that the tasks of both environments can be solved.
"""

import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

import handctl.gym
from handctl.client.observation import AXIS_BY_FIELD
from handctl.errors import ConfigError

GYM_PAGE_PATH = Path(__file__).parents[2] / "docs" / "how-to" / "gym.md"
TRACK_ENV, GRASP_ENV = "handctl/Track-v0", "handctl/Grasp-v0"
GRASP_PARAMETERS = {
    "jamia": (70, 0.3),
    "jamia11": (70, 0.3),
    "jamia_bench": (70, 0.3),
    "t42": (15, 0.15),
}
"""Step and tension action of a scripted grasp for each packaged hand.

The first number of a scripted grasp is the episode step after which the digits are close to the
object. The second number is the tension action that holds the object.
"""
DIAMETER_OPTIONS = {"t42": {"diameter_mm": (33.4, 35.0)}}
"""Range of the object's diameter for the hand t42 [mm].

The two fingers of the hand t42 would squeeze out a smaller object.
"""


def make_env(environment_id: str, **environment_options: Any) -> Any:
    """Return a Gymnasium environment without wrappers."""
    return gymnasium.make(environment_id, **environment_options).unwrapped


def action_towards_reference(environment: Any, observation: Any) -> Any:
    """Return the action that makes the hand follow the reference angles in an observation.

    The hand reaches the targets of an action only after a delay. The observation contains the
    reference angles for the time at which the hand will reach the targets of the next action. The
    returned action has the reference angles in the observation as its targets.
    """
    first_element = environment.layout.names.index(f"reference_ahead_rad[{environment.names[0]}]")
    return environment.action_for(
        np.degrees(observation[first_element : first_element + len(environment.names)])
    )


def closing_action(environment: Any, step_index: int) -> Any:
    """Return the action of a scripted grasp in the given step of an episode.

    The scripted grasp first closes the hand, and then holds the object.
    """
    action = np.full(environment.action_space.shape, min(1.0, -1.0 + step_index / 60), np.float32)
    begin, tension = GRASP_PARAMETERS[environment.hand.name]
    action[len(environment.names) :] = tension if step_index > begin else -1.0
    return action


def run_episode(environment: Any, seed: int, step_count: int) -> bytes:
    """Run an episode with random actions, and return its observations and rewards as bytes."""
    rng = np.random.default_rng(seed)
    observation, _ = environment.reset(seed=seed)
    rows = [observation.tobytes()]
    for _ in range(step_count):
        observation, reward, is_terminated, *_ = environment.step(
            rng.uniform(-1.0, 1.0, environment.action_space.shape).astype(np.float32)
        )
        rows += [observation.tobytes(), np.float64(reward).tobytes()]
        if is_terminated:
            break
    return b"".join(rows)


@pytest.mark.parametrize("environment_id", [TRACK_ENV, GRASP_ENV])
@pytest.mark.parametrize("hand_name", ["jamia", "t42"])
@pytest.mark.parametrize("control_space", ["digit", "joint"])
def test_environments_pass_the_gymnasium_checker(
    environment_id: str, hand_name: str, control_space: str
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = make_env(environment_id, hand=hand_name, space=control_space, duration_s=0.4)
        check_env(env)
        env.close()


@pytest.mark.parametrize("environment_id", [TRACK_ENV, GRASP_ENV])
def test_equal_seeds_and_actions_give_equal_episodes(environment_id: str) -> None:
    env = make_env(environment_id)
    first_episodes = [run_episode(env, seed, 12) for seed in range(20)]
    assert [run_episode(make_env(environment_id), seed, 12) for seed in range(20)] == first_episodes
    assert len(set(first_episodes)) == 20


@pytest.mark.parametrize(
    ("hand_name", "reference_span"),
    [("jamia", None), ("jamia11", None), ("jamia_bench", None), ("t42", 0.05)],
)
def test_the_reference_can_be_tracked(hand_name: str, reference_span: float | None) -> None:
    """The reference angles of the hand t42 are small, because its fingers touch each other at 9 degrees."""
    env = make_env(
        TRACK_ENV,
        hand=hand_name,
        **({} if reference_span is None else {"span": (0.0, reference_span)}),
    )
    observation, _ = env.reset(seed=3)
    rewards, is_terminated, is_truncated = [], False, False
    while not (is_terminated or is_truncated):
        observation, reward, is_terminated, is_truncated, info = env.step(
            action_towards_reference(env, observation)
        )
        rewards.append(reward)
    assert is_truncated, info
    assert len(rewards) == env.max_steps == 250
    assert np.mean(rewards) > 0.8
    assert info["error_deg"] < 3.0


@pytest.mark.parametrize("hand_name", GRASP_PARAMETERS)
def test_the_object_can_be_grasped(hand_name: str) -> None:
    env = make_env(GRASP_ENV, hand=hand_name, **DIAMETER_OPTIONS.get(hand_name, {}))
    for seed in range(3):
        env.reset(seed=seed)
        total, step, is_terminated, is_truncated = 0.0, 0, False, False
        while not (is_terminated or is_truncated):
            _, reward, is_terminated, is_truncated, info = env.step(closing_action(env, step))
            total, step = total + reward, step + 1
        assert is_terminated, info
        assert info["is_success"], info
        assert total > 10.5


def test_an_object_that_does_not_fit_is_refused() -> None:
    env = make_env(GRASP_ENV, hand="t42", diameter_mm=(38.0, 38.0))
    with pytest.raises(ConfigError, match=r"diameter_mm: cylinder:38.00 touches the open t42"):
        env.reset(seed=0)


def test_hand_without_action_grasps_nothing() -> None:
    env = make_env(GRASP_ENV, duration_s=1.0)
    env.reset(seed=0)
    open_action = np.full(env.action_space.shape, -1.0, np.float32)
    rows = [env.step(open_action) for _ in range(env.max_steps)]
    assert sum(row[1] for row in rows) == pytest.approx(0.0)
    assert [row[2] for row in rows] == [False] * env.max_steps
    assert rows[-1][3]
    assert rows[-1][4]["is_success"] is False


def test_a_fault_ends_an_episode() -> None:
    env = make_env(TRACK_ENV)
    observation, _ = env.reset(seed=0)
    env.simulated_run.simulated_hand.inject("snap tendon=index_tendon at=1s")
    is_terminated = False
    while not is_terminated:
        observation, _, is_terminated, is_truncated, info = env.step(
            action_towards_reference(env, observation)
        )
        assert not is_truncated
    assert re.match("fault T0(1|2b) index_tendon", info["failure"])
    assert info["mode"] == "RELAX"


def test_random_actions_are_limited_and_trip_nothing_on_a_free_hand() -> None:
    """With each of the 20 seeds, the environment keeps random actions within safe limits.

    No fault ends an episode, and the true tensions stay below the tension limit.
    """
    env = make_env(TRACK_ENV, duration_s=1.0)
    tension_limit_N = max(tendon.tension_max_N for tendon in env.hand.tendon)
    for seed in range(20):
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        is_truncated = False
        while not is_truncated:
            *_, is_terminated, is_truncated, info = env.step(
                rng.uniform(-1.0, 1.0, 4).astype(np.float32)
            )
            assert not is_terminated, (seed, info)
            assert max(env.simulated_run.simulated_hand.truth()["tension"]) < tension_limit_N


def test_names_are_those_of_the_client_s_observations() -> None:
    env = make_env(TRACK_ENV, hand="jamia11")
    telemetry = {part.name for part in env.layout.parts if not part.name.startswith("reference")}
    assert telemetry <= AXIS_BY_FIELD.keys()
    assert env.layout.names[:2] == ("q_rad[index_j1]", "q_rad[index_j2]")
    assert len(env.layout.names) == env.observation_space.shape[0]
    observation, _ = env.reset(seed=0)
    np.testing.assert_array_equal(observation[:11], env.last_output.telemetry.q.astype(np.float32))


def test_several_processes_give_the_episodes_of_one_process() -> None:
    def make_short_track_env() -> gymnasium.Env[Any, Any]:
        return gymnasium.make("handctl.gym:handctl/Track-v0", duration_s=0.2)

    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (15, 2, 4)).astype(np.float32)  # longer than one episode
    results = []
    for vector_class in (SyncVectorEnv, AsyncVectorEnv):
        vector_environment = vector_class([make_short_track_env, make_short_track_env])
        observations = [vector_environment.reset(seed=[7, 8])[0]]
        steps = [vector_environment.step(action) for action in actions]
        results.append(np.array([*observations, *(step[0] for step in steps)]))
        assert any(step[3].all() for step in steps)
        vector_environment.close()
    np.testing.assert_array_equal(*results)
    assert not np.array_equal(results[0][:, 0], results[0][:, 1])


@pytest.mark.parametrize(
    ("environment_id", "environment_options", "expected_message"),
    [
        (TRACK_ENV, {"hand": "jamja"}, "no such hand or file"),
        (TRACK_ENV, {"space": "tip"}, "space: 'tip'; expected joint or digit"),
        (TRACK_ENV, {"duration_s": 0.0}, "duration_s: 0 s; expected more than 0"),
        (TRACK_ENV, {"speed_deg_s": -1.0}, "speed_deg_s: -1 deg/s; expected more than 0"),
        (TRACK_ENV, {"span": (0.5, 0.5)}, "span: "),
        (GRASP_ENV, {"diameter_mm": (40.0, 30.0)}, "diameter_mm: "),
    ],
)
def test_a_wrong_option_is_one_line(
    environment_id: str, environment_options: dict[str, Any], expected_message: str
) -> None:
    environment_classes = {TRACK_ENV: handctl.gym.TrackEnv, GRASP_ENV: handctl.gym.GraspEnv}
    with pytest.raises(ConfigError) as error:
        environment_classes[environment_id](**environment_options)
    assert expected_message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_wrong_action_is_one_line() -> None:
    env = handctl.gym.TrackEnv()
    with pytest.raises(ConfigError, match="no episode has begun"):
        env.step(np.zeros(4, np.float32))
    env.reset(seed=0)
    for action in (np.zeros(3), np.full(4, np.nan)):
        with pytest.raises(ConfigError, match="expected 4 finite values"):
            env.step(action)


def test_a_missing_extra_is_one_line_that_names_it() -> None:
    program_text = "import sys\nsys.modules['gymnasium'] = None\nimport handctl.gym"
    result = subprocess.run(
        [sys.executable, "-c", program_text], capture_output=True, text=True, check=False
    )
    assert result.stderr.splitlines()[-1].endswith(
        "handctl.gym needs gymnasium: pip install 'handctl[gym]'"
    )


def test_the_program_of_the_page_grasps(capsys: pytest.CaptureFixture[str]) -> None:
    program = re.findall(r"```python[^\n]*\n(.*?)```", GYM_PAGE_PATH.read_text("utf-8"), re.DOTALL)[
        0
    ]
    exec(program, {})
    assert capsys.readouterr().out.endswith("True\n")


def test_perturbed_plants_differ_from_the_nominal_one() -> None:
    episodes = [
        run_episode(make_env(TRACK_ENV, perturb=perturb), 0, 5)
        for perturb in (None, {"friction": 1.5})
    ]
    assert episodes[0] != episodes[1]
