"""Gymnasium environments with a simulated hand, explained in ``docs/how-to/gym.md``.

The import of ``handctl.gym`` registers the environments ``handctl/Track-v0`` and
``handctl/Grasp-v0``. The call ``gymnasium.make("handctl.gym:handctl/Track-v0")`` imports
``handctl.gym`` itself.
"""

from handctl.extras import require_extra

require_extra("handctl.gym", "gymnasium", "mujoco")

from gymnasium.envs.registration import register  # noqa: E402

from handctl.gym.environment import HandEnv  # noqa: E402
from handctl.gym.grasp import GraspEnv  # noqa: E402
from handctl.gym.track import TrackEnv  # noqa: E402

__all__ = ["GraspEnv", "HandEnv", "TrackEnv"]

register("handctl/Track-v0", entry_point="handctl.gym.track:TrackEnv", disable_env_checker=False)
register("handctl/Grasp-v0", entry_point="handctl.gym.grasp:GraspEnv", disable_env_checker=False)
