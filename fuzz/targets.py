"""All fuzzing targets by name, and the initial inputs in the corpus of each fuzzing target."""

from collections.abc import Callable
from pathlib import Path

from fuzz import file_targets, frame_targets, log_targets, text_targets
from fuzz.fuzzed_drives import FUZZED_DRIVES
from handctl.hand.hand_loading import PACKAGED_HANDS_FOLDER

FuzzTarget = Callable[[bytes], bool]
TARGET_FACTORIES: dict[str, Callable[[Path], FuzzTarget]] = {
    **{name: frame_targets.drive_fuzz_target_factory(name) for name in FUZZED_DRIVES},
    "sensor-node": frame_targets.sensor_fuzz_target,
    "hand": file_targets.hand_fuzz_target,
    "hand-text": file_targets.hand_text_fuzz_target,
    "task": file_targets.task_fuzz_target,
    "trajectory": file_targets.trajectory_fuzz_target,
    "gains": file_targets.gains_fuzz_target,
    "calibration": file_targets.calibration_fuzz_target,
    "log": log_targets.log_fuzz_target,
    "log-bytes": log_targets.log_bytes_fuzz_target,
    "request": text_targets.request_fuzz_target,
    "fault": text_targets.fault_fuzz_target,
}


def seed_inputs(target_name: str, work_folder: Path) -> list[bytes]:
    """Return the valid inputs that form the initial corpus of a fuzzing target."""
    if target_name in FUZZED_DRIVES:
        return frame_targets.recorded_inputs(target_name, work_folder)
    if target_name == "hand-text":
        return [path.read_bytes() for path in PACKAGED_HANDS_FOLDER.glob("*.toml")]
    if target_name == "log-bytes":
        return [log_targets.write_small_log(work_folder).read_bytes()]
    if target_name == "request":
        return [
            b'{"do": "arm"}',
            b'{"do": "move", "angle_deg": {"index": 20}}',
            b'{"do": "gains", "set": {"a": 1}}',
        ]
    if target_name == "fault":
        return [b"\1\0drop node=3 p=0.05 at=3s for=2s", b"\1\0snap tendon=index_tendon"]
    return []
