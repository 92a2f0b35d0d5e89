"""Draw a hand that holds an object, from the true poses of a run of `handctl demo`."""

import contextlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.report.run_figure import digit_colours
from handctl.report.truth_record import read_truth
from handctl.session.task_loading import scene_for_hand
from tools.figures.plant_scene import TruePoses, body_names, painted_model
from tools.figures.tuning import call_handctl, empty_folder

PICTURE_SIZE_PX = (640, 480)
"""Width and height of a picture [pixels]."""
HOLD_DELAY_S = 2.0
"""Time from the start of the hold phase to the picture [s]. At the time of the picture, the table has sunk."""
CAMERA_ANGLES_DEG = {"jamia": (192.0, -27.0), "jamia11": (192.0, -27.0), "t42": (192.0, -27.0)}
"""Azimuth and elevation of the camera for some hands."""
DEFAULT_ANGLES_DEG = (150.0, -20.0)
DISTANCE_PER_EXTENT = 1.5
"""Distance of the camera from the centre of hand and object, divided by the largest extent of hand and object."""
EXAMPLES_FOLDER = Path(__file__).parents[2] / "examples" / "hands"
EXAMPLE_HANDS = ("shadow_like",)
"""Names of hands whose files are in EXAMPLES_FOLDER, with their gains."""
PACKAGED_HANDS = ("jamia", "jamia11", "t42", "n_plus_1", "orca_like")


def picture_of(hand_name: str) -> Callable[[Path], Path]:
    """Return a function that runs the demo of a hand in a folder, and draws a picture of the hand."""

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
    """Render a hand during its hold phase, and save the picture as ``hand.png``.

    The current folder contains the log of the run, and the file with the true values of the
    simulator. ``hand_file`` is the name of a packaged hand, or a file in the current folder.
    """
    import mujoco  # type: ignore[import-untyped,unused-ignore]
    from PIL import Image

    log, truth = RunLog(Path("run.mcap")), read_truth(Path("run.truth"))
    hand = load_hand(hand_file)
    colours = dict(zip(hand.digit_names, digit_colours(hand), strict=True))
    model = painted_model(mujoco, hand_file, str(scene_for_hand(None, hand)), colours)
    data = mujoco.MjData(model)
    hold_ns = next(change.t_ns for change in log.phases if change.name == "hold")
    times_ns = np.array([hold_ns + round(HOLD_DELAY_S * 1e9)])
    TruePoses(log, truth, times_ns).show(mujoco, model, data, 0)
    with mujoco.Renderer(model, PICTURE_SIZE_PX[1], PICTURE_SIZE_PX[0]) as renderer:
        renderer.update_scene(data, camera_of(mujoco, model, data, hand_file))
        Image.fromarray(renderer.render()).save("hand.png")


def camera_of(mujoco: Any, model: Any, data: Any, hand_name: str) -> Any:
    """Return a camera that shows all digits and the object."""
    bodies = body_names(mujoco, model)
    shown_geoms = [geom for geom, body in enumerate(bodies) if "_link" in body or body == "object"]
    places: NDArray[np.float64] = data.geom_xpos[shown_geoms]
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (places.min(axis=0) + places.max(axis=0)) / 2.0
    extent = float(np.ptp(places, axis=0).max()) + 0.04
    camera.distance = DISTANCE_PER_EXTENT * extent
    camera.azimuth, camera.elevation = CAMERA_ANGLES_DEG.get(hand_name, DEFAULT_ANGLES_DEG)
    return camera
