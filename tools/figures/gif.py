"""Draw the animated picture of a grasp.

Without a screen, MuJoCo renders the true poses of a run of `handctl demo`.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np

from tools.figures import runs
from tools.figures.plant_scene import TruePoses, painted_model, rgba
from tools.figures.style import CREATOR_TEXT, DIGIT_COLOURS

PICTURE_SIZE_PX = (480, 400)
"""Width and height of the picture [pixels]."""
RATE_HZ = 12.5
"""Pictures per second of simulated time."""
COLOUR_COUNT = 160
SAMPLED_PICTURES = 8
"""Number of colours in the GIF file, and number of pictures from which the colours are chosen."""
MAX_FILE_BYTES = 3_000_000
"""Largest allowed size of the GIF file [bytes]."""
ARROW_M_PER_N = 0.006
"""Length of the arrow for a contact force, per newton of the force [m/N]."""


def write_gif(folder: Path, path: Path) -> None:
    """Render the grasp of `handctl demo` as an animated GIF.

    Raises:
        RuntimeError: the file has more than ``MAX_FILE_BYTES``.
    """
    os.environ.setdefault("MUJOCO_GL", "egl")
    from PIL import Image

    pictures = [Image.fromarray(picture) for picture in grasp_frames(folder)]
    palette = picture_sheet(pictures[:: len(pictures) // SAMPLED_PICTURES]).quantize(COLOUR_COUNT)
    small = [
        picture.quantize(COLOUR_COUNT, palette=palette, dither=Image.Dither.NONE)
        for picture in pictures
    ]
    small[0].save(path, save_all=True, append_images=small[1:], duration=round(1e3 / RATE_HZ), loop=0, optimize=True,
                  comment=CREATOR_TEXT.encode())  # fmt: skip
    if path.stat().st_size > MAX_FILE_BYTES:
        raise RuntimeError(
            f"{path}: {path.stat().st_size} bytes; expected at most {MAX_FILE_BYTES}"
        )


def picture_sheet(pictures: list[Any]) -> Any:
    """Join all pictures, one below the other.

    The palette of the joined picture has the colours of all pictures.
    """
    from PIL import Image

    sheet = Image.new("RGB", (PICTURE_SIZE_PX[0], PICTURE_SIZE_PX[1] * len(pictures)))
    for i, picture in enumerate(pictures):
        sheet.paste(picture, (0, PICTURE_SIZE_PX[1] * i))
    return sheet


def grasp_frames(folder: Path) -> list[Any]:
    """Render the grasp, and return its pictures with their labels."""
    import mujoco  # type: ignore[import-untyped,unused-ignore]

    log, truth, _ = runs.grasp_run(folder)
    model = painted_model(mujoco, "jamia", "cylinder", DIGIT_COLOURS)
    data = mujoco.MjData(model)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (0.018, 0.0, 0.0)
    camera.distance, camera.azimuth, camera.elevation = 0.21, 192.0, -27.0
    starts = {change.name: change.t_ns for change in log.phases}
    times = np.arange(starts["preshape"], int(log.t_ns[-1]), int(1e9 / RATE_HZ))
    poses = TruePoses(log, truth, times)
    force = {
        name: truth.interpolated_columns(
            [f"contact_force/{name}/{axis}" for axis in "xyz"], poses.times_ns
        )
        for name in DIGIT_COLOURS
    }
    pictures = []
    with mujoco.Renderer(model, PICTURE_SIZE_PX[1], PICTURE_SIZE_PX[0]) as renderer:
        for i in range(len(times)):
            poses.show(mujoco, model, data, i)
            renderer.update_scene(data, camera)
            for name in DIGIT_COLOURS:
                link = f"{name}_link{2 if name == 'thumb' else 3}"
                add_arrow(
                    mujoco,
                    renderer.scene,
                    data.body(link).xpos,
                    force[name][i],
                    rgba(DIGIT_COLOURS[name], 0.9),
                )
            pictures.append(labelled_picture(renderer.render(), log, int(times[i]), force, i))
    return pictures


def add_arrow(
    mujoco: Any, scene: Any, start: Any, force: Any, colour: tuple[float, float, float, float]
) -> None:
    """Add an arrow for a contact force [N] at a point of the rendered scene."""
    if np.linalg.norm(force) < 0.2 or scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    scene.ngeom += 1
    arrow = mujoco.mjtGeom.mjGEOM_ARROW
    mujoco.mjv_initGeom(
        geom, arrow, np.zeros(3), np.zeros(3), np.zeros(9), np.array(colour, np.float32)
    )
    mujoco.mjv_connector(
        geom, arrow, 0.0025, np.array(start), np.array(start) + ARROW_M_PER_N * force
    )


def labelled_picture(picture: Any, log: Any, t_ns: int, force: dict[str, Any], i: int) -> Any:
    """Return a picture with a label: time, phase and true contact forces."""
    from matplotlib import font_manager
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 15)
    phase = [change.name for change in log.phases if change.t_ns <= t_ns][-1]
    draw.text((12, 10), f"{t_ns * 1e-9:4.1f} s   {phase}", fill="#22303c", font=font)
    for row, (name, colour) in enumerate(DIGIT_COLOURS.items()):
        force_N = float(np.linalg.norm(force[name][i]))
        draw.rectangle((12, 36 + 20 * row, 22, 46 + 20 * row), fill=colour)
        draw.text((30, 32 + 20 * row), f"{name} {force_N:4.1f} N", fill="#22303c", font=font)
    return np.asarray(image)
