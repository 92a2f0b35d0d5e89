"""Test that MuJoCo draws pictures of the environments of ``handctl.gym`` without a screen."""

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import handctl.gym
from handctl.errors import ConfigError

TRACK_ENV, GRASP_ENV = "handctl/Track-v0", "handctl/Grasp-v0"


def make_env(environment_id: str, **environment_options: Any) -> Any:
    """Return an unwrapped environment that draws pictures."""
    return gymnasium.make(environment_id, render_mode="rgb_array", **environment_options).unwrapped


def closed_picture(environment: Any, seed: int, step_count: int = 40) -> Any:
    """Close the digits for some steps of an episode, and return the picture of the hand."""
    environment.reset(seed=seed)
    action = np.full(environment.action_space.shape, -1.0, np.float32)
    action[: len(environment.names)] = -0.3
    for _ in range(step_count):
        environment.step(action)
    return environment.render()


@pytest.mark.parametrize("environment_id", [TRACK_ENV, GRASP_ENV])
@pytest.mark.parametrize("hand_name", ["jamia", "t42"])
def test_a_picture_shows_the_moving_hand(environment_id: str, hand_name: str) -> None:
    env = make_env(environment_id, hand=hand_name, picture_size_px=(160, 120))
    for seed in range(3):
        env.reset(seed=seed)
        first_picture = env.render()
        assert first_picture.shape == (120, 160, 3)
        assert first_picture.dtype == np.uint8
        # The hand and the object fill at least a tenth of the picture.
        assert (first_picture != first_picture[0, 0]).any(axis=2).mean() > 0.1
        assert (env.render() == first_picture).all()
        later_picture = closed_picture(env, seed)
        assert (later_picture != first_picture).any(axis=2).mean() > 0.01
        assert (closed_picture(env, seed) == later_picture).all(), "equal seeds give equal pictures"
    env.close()


def test_the_object_is_drawn() -> None:
    environment_with_object = make_env(GRASP_ENV)
    environment_without_object = make_env(TRACK_ENV)
    for seed in range(3):
        environment_with_object.reset(seed=seed)
        environment_without_object.reset(seed=seed)
        first_picture, second_picture = (
            environment_with_object.render(),
            environment_without_object.render(),
        )
        assert first_picture.shape == second_picture.shape == (480, 480, 3)
        assert (first_picture != second_picture).any(axis=2).mean() > 0.05


@pytest.mark.parametrize("environment_id", [TRACK_ENV, GRASP_ENV])
def test_the_gymnasium_checker_accepts_the_pictures(environment_id: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = make_env(environment_id, duration_s=0.4)
        check_env(env)
        env.close()


def test_pictures_of_an_episode_are_collected() -> None:
    env = gymnasium.make(TRACK_ENV, render_mode="rgb_array_list", picture_size_px=(64, 64))
    env.reset(seed=0)
    for _ in range(4):
        env.step(env.action_space.sample())
    pictures: Any = env.render()
    assert len(pictures) == 5
    env.close()


@pytest.mark.parametrize(
    ("environment_options", "expected_reason"),
    [
        ({"render_mode": "human"}, "render_mode: 'human'; expected rgb_array or None"),
        ({"picture_size_px": (0, 480)}, "picture_size_px"),
        ({"picture_size_px": (480, 5000)}, "picture_size_px"),
    ],
)
def test_wrong_options_are_refused(
    environment_options: dict[str, Any], expected_reason: str
) -> None:
    with pytest.raises(ConfigError, match=expected_reason):
        handctl.gym.TrackEnv(**environment_options)


def test_without_a_render_mode_there_is_no_picture() -> None:
    env = handctl.gym.TrackEnv()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="no picture without render_mode"):
        assert env.render() is None
