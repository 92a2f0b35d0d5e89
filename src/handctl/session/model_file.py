"""Reading of robot descriptions (URDF and MJCF) with MuJoCo.

Only the simulator needs MuJoCo. The other parts of handctl work without MuJoCo.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from handctl.errors import ConfigError
from handctl.runtime.clocks.lockstep import load_simulator_object

MODEL_FILE_READER = "firmware_sim.description.model_file:read_model_file"
"""Module and name of the simulator's function that reads a robot description.

The docstring of that function describes the result.
"""


def read_model_file(path: Path, kind: str) -> Mapping[str, Any]:
    """Read the tree of the links of a hand from a robot description.

    The returned tree consists of plain Python values.

    Args:
        path: path of the robot description.
        kind: ``urdf`` or ``mjcf``.

    Raises:
        ConfigError: the file is unreadable, or does not describe a tree of hinges and links with
            inertia, or MuJoCo is not installed.
    """
    read: Callable[[str, str], Mapping[str, Any]] = load_simulator_object(
        MODEL_FILE_READER, "reading a robot description"
    )
    try:
        return read(str(path), kind)
    except ValueError as error:
        raise ConfigError(str(error)) from None
