"""Gymnasium environments of a simulated hand, see ``docs/how-to/gym.md``.

``import handctl.gym`` registers ``handctl/Track-v0`` and ``handctl/Grasp-v0``.
``gymnasium.make("handctl.gym:handctl/Track-v0")`` needs no import.
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
