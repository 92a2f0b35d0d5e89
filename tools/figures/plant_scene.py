"""Coloured MuJoCo model of a simulated hand for pictures, and the true poses of a run."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim.description.hand_description import load_hand
from firmware_sim.plant.mjcf import model_text
from firmware_sim.scene.scene import load_scene
from handctl.log.read.reader import RunLog
from handctl.report.truth_record import TruthRecord

SKYBOX_XML = """<asset><texture type="skybox" builtin="gradient"
  rgb1="0.95 0.97 0.99" rgb2="0.78 0.83 0.88" width="32" height="192"/></asset>"""
BODY_COLOURS = {"object": "#d8d2c4", "table": "#8d99a5"}
PALM_COLOUR = "#5b6670"
OBJECT_OPACITY = 0.55
POSE_PARTS = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""Parts of the pose of the object, as the truth file names them."""


def rgba(colour: str, opacity: float = 1.0) -> tuple[float, float, float, float]:
    """Return red, green, blue and opacity of a colour such as #3b6fb6."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue, opacity


def painted_model(
    mujoco: Any, hand_file: str, scene_name: str, digit_colours: Mapping[str, str]
) -> Any:
    """Return the MuJoCo model of a hand and a scene, with background, light and colours.

    Args:
        mujoco: module mujoco.
        hand_file: name of a packaged hand, or path of a hand file.
        scene_name: name of a scene.
        digit_colours: colour of each digit, for example #3b6fb6.
    """
    xml = model_text(load_hand(hand_file), load_scene(scene_name), meshes=True)
    model = mujoco.MjModel.from_xml_string(xml.replace("<worldbody>", f"{SKYBOX_XML}<worldbody>"))
    for geom, body in enumerate(body_names(mujoco, model)):
        colour = digit_colours.get(body.rpartition("_link")[0])
        model.geom_rgba[geom] = rgba(
            colour or BODY_COLOURS.get(body, PALM_COLOUR),
            OBJECT_OPACITY if body == "object" else 1.0,
        )
    model.vis.headlight.ambient[:] = 0.45
    model.vis.headlight.diffuse[:] = 0.55
    return model


def body_names(mujoco: Any, model: Any) -> list[str]:
    """Return the name of the body of each geometry."""
    return [
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or "" for body in model.geom_bodyid
    ]


class TruePoses:
    """True poses of hand, object and table at some times of a run.

    Attributes:
        offset_ns: time of the truth file at the start of the log [ns].
        times_ns: (n,) times in the truth file [ns].
    """

    def __init__(self, log: RunLog, truth: TruthRecord, times_ns: NDArray[np.int64]) -> None:
        """Read the true poses at given times of a run.

        Args:
            log: log of the run.
            truth: true values of the run.
            times_ns: (n,) times in the log [ns].
        """
        self.offset_ns = int(log.header.metadata.get("truth_offset_ns", "0"))
        self.times_ns = times_ns + self.offset_ns
        self._joints = truth.interpolated_columns(
            [f"q/{joint}" for joint in log.header.joints], self.times_ns
        )
        self._object = truth.interpolated_columns(
            [f"object/{pose_part}" for pose_part in POSE_PARTS], self.times_ns
        )
        self._sunk_m = truth.interpolated_column("support", self.times_ns)

    def show(self, mujoco: Any, model: Any, data: Any, index: int) -> None:
        """Move the bodies of a model to their poses at the time with the index ``index``."""
        joint_count = self._joints.shape[1]
        data.qpos[:joint_count] = self._joints[index]
        data.qpos[joint_count:] = self._object[index]
        table = model.body("table")
        data.mocap_pos[0, 2] = table.pos[2] - self._sunk_m[index]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
