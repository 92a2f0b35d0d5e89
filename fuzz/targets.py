"""All fuzzing targets by name, and the initial inputs of each target's corpus."""

from collections.abc import Callable
from pathlib import Path

from fuzz import files, logs, texts, wire
from fuzz.drives import DRIVES
from handctl.hand.load import PACKAGED_HANDS_FOLDER

Target = Callable[[bytes], bool]
TARGETS: dict[str, Callable[[Path], Target]] = {
    **{name: wire.drive(name) for name in DRIVES},
    "sensor-node": wire.sensors,
    "hand": files.hand,
    "hand-text": files.hand_text,
    "task": files.task,
    "trajectory": files.trajectory,
    "gains": files.gains,
    "calibration": files.calibration,
    "log": logs.log,
    "log-bytes": logs.log_bytes,
    "request": texts.request,
    "fault": texts.fault,
}


def seeds(name: str, folder: Path) -> list[bytes]:
    """Return valid inputs with which the corpus of a target starts."""
    if name in DRIVES:
        return wire.answers(name, folder)
    if name == "hand-text":
        return [path.read_bytes() for path in PACKAGED_HANDS_FOLDER.glob("*.toml")]
    if name == "log-bytes":
        return [logs.small(folder).read_bytes()]
    if name == "request":
        return [b'{"do": "arm"}', b'{"do": "move", "angle_deg": {"index": 20}}', b'{"do": "gains", "set": {"a": 1}}']
    if name == "fault":
        return [b"\1\0drop node=3 p=0.05 at=3s for=2s", b"\1\0snap tendon=index_tendon"]
    return []
