"""Reading of robot descriptions (URDF and MJCF) with MuJoCo.

MuJoCo is a dependency of the simulator only.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from handctl.errors import ConfigError
from handctl.runtime.clocks.lockstep import load_simulator_object

MODEL_FILE_READER = "firmware_sim.model_file:read_model_file"
"""Module and name of the function that reads a description.

The docstring of this function describes the result.
"""


def read_model_file(path: Path, kind: str) -> Mapping[str, Any]:
    """Read the tree of links of a hand from a robot description, as plain values.

    Args:
        path: path of the robot description.
        kind: ``urdf`` or ``mjcf``.

    Raises:
        ConfigError: the file is unreadable, it does not describe a tree of hinges and links with
            inertia, or MuJoCo is not installed.
    """
    read: Callable[[str, str], Mapping[str, Any]] = load_simulator_object(
        MODEL_FILE_READER, "reading a robot description"
    )
    try:
        return read(str(path), kind)
    except ValueError as error:
        raise ConfigError(str(error)) from None
