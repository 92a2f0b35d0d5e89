"""Camera that draws pictures of the plant, even on a machine without a screen."""

import os
import platform
from typing import Any

import mujoco  # type: ignore[import-untyped,unused-ignore]
import numpy as np
from numpy.typing import NDArray

from firmware_sim.description.hand_description import Hand, SimulatorError
from firmware_sim.plant.mjcf import model_text
from firmware_sim.plant.rigid_body_engine import RigidBodyEngine
from firmware_sim.scene.scene import Scene

AZIMUTH_DEG = 200.0
ELEVATION_DEG = -38.0
"""Direction of view of the camera: from the front onto the side of the hand [deg]."""
PICTURE_FILL_FRACTION = 0.95
"""Radius of the hand as a fraction of the largest radius that fits into the picture."""
LINK_COLOURS = (
    (0.23, 0.44, 0.71),
    (0.85, 0.49, 0.22),
    (0.33, 0.62, 0.39),
    (0.64, 0.38, 0.65),
    (0.75, 0.64, 0.20),
)
"""Colours of the digits, in turn: red, green, blue from 0 to 1."""
COLOUR_BY_BODY = {"object": (0.85, 0.83, 0.77), "table": (0.55, 0.60, 0.65)}
"""Colours of object and table."""
PALM_COLOUR = (0.36, 0.40, 0.44)
SKY_COLOUR = (0.87, 0.91, 0.94)
"""Colour of the background, and colour of the palm (above)."""
SKY_XML = '<asset><texture type="skybox" builtin="flat" rgb1="{0} {1} {2}" width="8" height="48"/></asset>'


class Camera:
    """Camera with a fixed view of the whole open hand and of the object.

    Attributes:
        height_px, width_px: size of the pictures [pixels].
    """

    def __init__(self, hand: Hand, scene: Scene, width_px: int, height_px: int) -> None:
        """Build the MuJoCo model for drawing, with the meshes of the links, and open a graphics context.

        Args:
            hand: description of the hand.
            scene: object and support.
            width_px: width of the pictures [pixels].
            height_px: height of the pictures [pixels].

        Raises:
            SimulatorError: a graphics context cannot be opened.
        """
        self.width_px = width_px
        self.height_px = height_px
        sky_element = SKY_XML.format(*SKY_COLOUR)
        text = model_text(hand, scene, meshes=True).replace(
            "<worldbody>", sky_element + "<worldbody>"
        )
        self._model: Any = mujoco.MjModel.from_xml_string(text)
        self._data: Any = mujoco.MjData(self._model)
        self._model.vis.global_.offwidth = width_px
        self._model.vis.global_.offheight = height_px
        self._model.vis.headlight.ambient[:] = 0.45
        self._model.vis.headlight.diffuse[:] = 0.55
        _set_colours(self._model, [digit.name for digit in hand.digits])
        mujoco.mj_kinematics(self._model, self._data)
        self._view = _view_of_hand(self._model, self._data, width_px / height_px)
        self._scene: Any = mujoco.MjvScene(model=self._model, maxgeom=2000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_HAZE.value] = 0
        self._options: Any = mujoco.MjvOption()
        self._gl: Any = _open_graphics(width_px, height_px)
        self._gl.make_current()
        self._context: Any = mujoco.MjrContext(
            self._model, mujoco.mjtFontScale.mjFONTSCALE_150.value
        )

    def picture(self, engine: RigidBodyEngine) -> NDArray[np.uint8]:
        """Return a picture of the present state of a plant, (height, width, 3): red, green, blue from 0 to 255.

        Args:
            engine: rigid bodies of the plant with the hand and the scene of this camera.
        """
        engine.copy_pose(self._data)
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        mujoco.mjv_updateScene(
            self._model,
            self._data,
            self._options,
            None,
            self._view,
            mujoco.mjtCatBit.mjCAT_ALL.value,
            self._scene,
        )
        # Another camera of the process can have made its own graphics context the current context.
        self._gl.make_current()
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        picture_rectangle = mujoco.MjrRect(0, 0, self.width_px, self.height_px)
        mujoco.mjr_render(picture_rectangle, self._scene, self._context)
        picture = np.empty((self.height_px, self.width_px, 3), np.uint8)
        mujoco.mjr_readPixels(picture, None, picture_rectangle, self._context)
        # OpenGL returns the lowest row of the picture first.
        return np.ascontiguousarray(picture[::-1])

    def close(self) -> None:
        """Free the graphics context. A second call of this method has no effect."""
        if self._gl is not None:
            self._gl.make_current()
            self._context.free()
            self._gl.free()
            self._gl = None


def _open_graphics(width_px: int, height_px: int) -> Any:
    """Open a graphics context.

    As in MuJoCo, the environment variable ``MUJOCO_GL`` chooses the graphics library. If
    ``MUJOCO_GL`` is not set and the machine has no screen, the library EGL draws on the graphics
    card or on the processor.

    Raises:
        SimulatorError: a graphics context cannot be opened.
    """
    has_screen = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    headless = platform.system() == "Linux" and not has_screen
    try:
        if headless and not os.environ.get("MUJOCO_GL"):
            from mujoco.egl import GLContext  # type: ignore[import-untyped,unused-ignore]
        else:
            from mujoco.gl_context import GLContext  # type: ignore[import-untyped,unused-ignore]
        return GLContext(width_px, height_px)
    except _graphics_errors() as error:
        raise SimulatorError(
            f"no graphics for pictures: {error}; expected an OpenGL library such as libegl1, "
            "or MUJOCO_GL=egl, osmesa or glfw"
        ) from error


def _graphics_errors() -> tuple[type[Exception], ...]:
    """Return the exceptions with which graphics libraries report that they cannot be used."""
    # If the graphics library lacks an EGL function, Python raises an AttributeError.
    graphics_error_types = (
        AttributeError,
        ImportError,
        OSError,
        RuntimeError,
        ValueError,
        mujoco.FatalError,
    )
    try:
        from OpenGL.error import Error  # type: ignore[import-untyped,unused-ignore]
    except ImportError:
        return graphics_error_types
    return (*graphics_error_types, Error)


def _set_colours(model: Any, digits: list[str]) -> None:
    """Set the colours of links, palm, object and table in the model."""
    for geom in range(model.ngeom):
        body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, model.geom_bodyid[geom]) or ""
        colour = COLOUR_BY_BODY.get(body, PALM_COLOUR)
        for number, digit in enumerate(digits):
            if body.startswith(f"{digit}_"):
                colour = LINK_COLOURS[number % len(LINK_COLOURS)]
        model.geom_rgba[geom] = (*colour, 1.0)


def _view_of_hand(model: Any, data: Any, aspect_ratio: float) -> Any:
    """Return a camera view that shows all bodies except the table.

    Args:
        model: MuJoCo model that is drawn.
        data: MuJoCo state of the model, in which the hand is open.
        aspect_ratio: width of the picture divided by the height of the picture.
    """
    bodies = [
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, model.geom_bodyid[geom])
        for geom in range(model.ngeom)
    ]
    shown_geoms = [geom for geom, body in enumerate(bodies) if body != "table"]
    centre = 0.5 * (
        data.geom_xpos[shown_geoms].max(axis=0) + data.geom_xpos[shown_geoms].min(axis=0)
    )
    distance = np.linalg.norm(data.geom_xpos[shown_geoms] - centre, axis=1)
    radius = float((distance + model.geom_rbound[shown_geoms]).max())
    half_angle = np.radians(model.vis.global_.fovy / 2.0)
    if aspect_ratio < 1.0:
        half_angle = np.arctan(aspect_ratio * np.tan(half_angle))
    view = mujoco.MjvCamera()
    view.lookat[:] = centre
    view.distance = PICTURE_FILL_FRACTION * radius / np.sin(half_angle)
    view.azimuth = AZIMUTH_DEG
    view.elevation = ELEVATION_DEG
    return view
