"""Draw the picture of a hand that holds an object, from the true poses of a run of `handctl demo`."""

import contextlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_sim.hand_description import load_hand
from firmware_sim.plant.mjcf import model_text
from firmware_sim.scene.scene import load_scene
from handctl.digit_colours import colour_numbers
from handctl.hand.hand_loading import load_hand as load_hand_file
from handctl.log.read.reader import RunLog
from handctl.report.truth_record import read_truth
from handctl.session.tasks import scene_for_hand
from tools.figures.gif import SKYBOX_XML, rgba
from tools.figures.style import DIGIT_COLOURS
from tools.figures.tuning import call_handctl, empty_folder

PICTURE_SIZE_PX = (640, 480)
"""Width and height of a picture [pixels]."""
PALETTE = (*DIGIT_COLOURS.values(), "#7a5ea8", "#8a6d3b", "#4aa3a2")
"""Colours of digits, in the order of ``digit_colours.colour_numbers``."""
BODY_COLOURS = {"object": "#d8d2c4", "table": "#8d99a5"}
PALM_COLOUR = "#5b6670"
HOLD_DELAY_S = 2.0
"""Time from the start of the hold to the picture [s]. The table has sunk by then."""
CAMERA_ANGLES_DEG = {"jamia": (192.0, -27.0), "jamia11": (192.0, -27.0), "t42": (192.0, -27.0)}
"""Azimuth and elevation of the camera for some hands."""
DEFAULT_ANGLES_DEG = (150.0, -20.0)
DISTANCE_PER_EXTENT = 1.5
"""Distance of the camera from the centre of hand and object, divided by their largest extent."""
EXAMPLES_FOLDER = Path(__file__).parents[2] / "examples" / "hands"
EXAMPLE_HANDS = ("shadow_like",)
"""Names of hands whose files are in EXAMPLES_FOLDER, with their gains."""
PACKAGED_HANDS = ("jamia", "jamia11", "t42", "n_plus_1", "orca_like")


def picture_of(hand_name: str) -> Callable[[Path], Path]:
    """Return a function that runs the demo of a hand in a folder, and returns the path of the picture."""

    def draw(folder: Path) -> Path:
        os.environ.setdefault("MUJOCO_GL", "egl")
        with empty_folder(folder, f"hand-{hand_name}") as path:
            hand_file = hand_name
            if hand_name in EXAMPLE_HANDS:
                for source in EXAMPLES_FOLDER.glob(f"{hand_name}.*"):
                    shutil.copy(source, path)
                hand_file = f"{hand_name}.toml"
            words = ("demo", "--lockstep", "--hand", hand_file, "--seed", "0", "--log", "run.mcap")
            call_handctl(path, *words)
            with contextlib.chdir(path):
                save_still(hand_file)
            return path / "hand.png"

    return draw


def save_still(hand_file: str) -> None:
    """Render a hand during its hold, and save the picture as ``hand.png``.

    The current folder has the log and the truth file of the run. ``hand_file`` is the name of a
    packaged hand, or a file in this folder.
    """
    import mujoco  # type: ignore[import-untyped,unused-ignore]
    from PIL import Image

    log, truth = RunLog(Path("run.mcap")), read_truth(Path("run.truth"))
    scene = load_scene(str(scene_for_hand(None, load_hand_file(hand_file))))
    xml = model_text(load_hand(hand_file), scene, meshes=True)
    model = mujoco.MjModel.from_xml_string(xml.replace("<worldbody>", f"{SKYBOX_XML}<worldbody>"))
    paint_digits(mujoco, model, log.header.digits)
    model.vis.headlight.ambient[:] = 0.45
    model.vis.headlight.diffuse[:] = 0.55
    data = mujoco.MjData(model)
    hold = next(change.t_ns for change in log.phases if change.name == "hold")
    offset = int(log.header.metadata.get("truth_offset_ns", "0"))
    time_ns = np.array([hold + offset + round(HOLD_DELAY_S * 1e9)])
    joints = truth.interpolated_columns([f"q/{joint}" for joint in log.header.joints], time_ns)[0]
    parts = ("x", "y", "z", "qw", "qx", "qy", "qz")
    data.qpos[: len(joints)] = joints
    data.qpos[len(joints) :] = truth.interpolated_columns(
        [f"object/{part}" for part in parts], time_ns
    )[0]
    data.mocap_pos[0, 2] -= truth.interpolated_column("support", time_ns)[0]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    with mujoco.Renderer(model, PICTURE_SIZE_PX[1], PICTURE_SIZE_PX[0]) as renderer:
        renderer.update_scene(data, camera_of(mujoco, model, data, hand_file))
        Image.fromarray(renderer.render()).save("hand.png")


def body_names(mujoco: Any, model: Any) -> list[str]:
    """Return the name of the body of each geometry."""
    return [
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body) or "" for body in model.geom_bodyid
    ]


def paint_digits(mujoco: Any, model: Any, digits: tuple[str, ...]) -> None:
    """Set the colours of links, palm, object and table in the model."""
    colours = dict(zip(digits, colour_numbers(digits), strict=True))
    for geom, body in enumerate(body_names(mujoco, model)):
        digit = body.rpartition("_link")[0]
        if digit in colours:
            model.geom_rgba[geom] = rgba(PALETTE[colours[digit] % len(PALETTE)])
        else:
            opacity = 0.55 if body == "object" else 1.0
            model.geom_rgba[geom] = rgba(BODY_COLOURS.get(body, PALM_COLOUR), opacity)


def camera_of(mujoco: Any, model: Any, data: Any, hand_name: str) -> Any:
    """Return a camera that shows all digits and the object."""
    bodies = body_names(mujoco, model)
    shown = [geom for geom, body in enumerate(bodies) if "_link" in body or body == "object"]
    places: NDArray[np.float64] = data.geom_xpos[shown]
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (places.min(axis=0) + places.max(axis=0)) / 2.0
    extent = float(np.ptp(places, axis=0).max()) + 0.04
    camera.distance = DISTANCE_PER_EXTENT * extent
    camera.azimuth, camera.elevation = CAMERA_ANGLES_DEG.get(hand_name, DEFAULT_ANGLES_DEG)
    return camera
