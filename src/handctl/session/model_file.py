"""Reading of robot descriptions (URDF and MJCF) with MuJoCo, which is a dependency of the simulator."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from handctl.errors import ConfigError
from handctl.runtime.clocks.lockstep import load_entry

MODEL_FILE_READER = "firmware_sim.model_file:read_model_file"
"""Entry point of the function that reads a description. Its docstring describes the result."""


def read_model_file(path: Path, kind: str) -> Mapping[str, Any]:
    """Read the tree of links of a hand as plain values.

    Args:
        path: path of the description.
        kind: ``urdf`` or ``mjcf``.

    Raises:
        ConfigError: the file is unreadable, describes no tree of hinges with inertia, or MuJoCo is missing.
    """
    read: Callable[[str, str], Mapping[str, Any]] = load_entry(MODEL_FILE_READER, "reading a robot description")
    try:
        return read(str(path), kind)
    except ValueError as error:
        raise ConfigError(str(error)) from None
