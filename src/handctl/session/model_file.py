"""Reading of robot descriptions, URDF and MJCF, by the simulator, which has MuJoCo."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from handctl.errors import ConfigError
from handctl.runtime.clocks.lockstep import load_entry

READER = "firmware_sim.model_file:read_model_file"
"""Function that reads a description, see there for its result."""


def read_model_file(path: Path, kind: str) -> Mapping[str, Any]:
    """Read the tree of links of a hand as plain values.

    Args:
        path: the file.
        kind: ``urdf`` or ``mjcf``.

    Raises:
        ConfigError: the file is unreadable, describes no tree of hinges with inertia, or MuJoCo is missing.
    """
    read: Callable[[str, str], Mapping[str, Any]] = load_entry(READER, "reading a robot description")
    try:
        return read(str(path), kind)
    except ValueError as error:
        raise ConfigError(str(error)) from None
