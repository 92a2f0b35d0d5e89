"""Test environments of hands with prismatic joints.

Targets are in mm for prismatic joints, and in degrees for revolute joints.
"""

from pathlib import Path

import numpy as np
import pytest

from handctl.gym.track import TrackEnv

HAND_FILE_FOLDER = Path(__file__).parents[1] / "hand"


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("hand", ["parallel_gripper", "mixed_gripper"])
def test_streamed_prismatic_joints_follow_their_reference(hand: str, seed: int) -> None:
    env = TrackEnv(hand=HAND_FILE_FOLDER / f"{hand}.toml", space="joint", speed_deg_s=200.0)
    try:
        env.reset(seed=seed)
        errors = []
        for _ in range(100):
            target = env.reference_deg(env.t_s + env.horizon_s)
            *_, info = env.step(env.action_for(target))
            errors.append(info["error_deg"])
        # The reference positions of prismatic joints move by up to 20 mm, and reference angles by
        # up to 40 deg.
        assert np.mean(errors[30:]) < 0.3
        assert env.high_deg[0] == 28.0
    finally:
        env.close()
