"""Eight bytes for the whole state of a controller: packed, not printed, since every tick pays for it."""

import functools
import hashlib
import itertools
import struct

from handctl.controller.computed_torque import LawState
from handctl.controller.filter_state import FilterState
from handctl.controller.gains import Gains
from handctl.controller.kept import Kept
from handctl.controller.program import Progress
from handctl.controller.retune import Coming
from handctl.drives.contract import DriveState
from handctl.drives.sensor_node import CHANNELS, SensorState

PLACE = struct.Struct("<qBdd??")
DRIVE = struct.Struct("<B4d4qI")
SENSORS = struct.Struct("<bqq")
GROUPS = tuple(struct.Struct(f"<bqqB{channels}H") for channels in range(CHANNELS + 1))


@functools.lru_cache(maxsize=8)
def _regimes(tendons: int) -> struct.Struct:
    return struct.Struct(f"<{tendons}B{tendons}?{tendons}I{tendons}?{tendons}??")


def _printed(thing: object) -> bytes:
    return repr(thing).encode()


_private = Kept[tuple[object, ...]](_printed)
_gains = Kept[Gains | Coming](_printed)
_progress = Kept[Progress](Progress.key)


def digest(*parts: bytes) -> bytes:
    """8 bytes of these parts, each of which tells its own length."""
    return hashlib.blake2b(b"".join(parts), digest_size=8).digest()


def law_bytes(law: LawState) -> bytes:
    """The law's arrays; one of no length for what it does not have."""
    *always, held = law
    told = b"".join([b"-" if array is None else array.tobytes() for array in always])
    return told if held is None else told + held.tobytes()


def filter_bytes(state: FilterState) -> bytes:
    """The filter's state."""
    plain = itertools.chain(state.regimes, state.stopped, state.turning, state.measured, state.doubtful)
    told = _regimes(len(state.regimes)).pack(*plain, state.started)
    return told + state.x.tobytes() + state.surprise.tobytes() + state.nis.tobytes()


def drive_bytes(drive: DriveState) -> bytes:
    """What is known of a drive; its protocol's own progress as text, which rarely changes."""
    *motion, t_ns, count, error, text, misread, private = drive
    known = DRIVE.pack(*motion, t_ns, count, error, misread, len(text)) + _private(private)
    return known + text.encode() if text else known


def sensor_bytes(sensors: SensorState) -> bytes:
    """What is known of the sensor node."""
    groups, *counts = sensors
    rows = [GROUPS[len(raw)].pack(counter, t_ns, frames, len(raw), *raw) for counter, t_ns, frames, raw in groups]
    return SENSORS.pack(*counts) + b"".join(rows)


def progress_bytes(progress: Progress) -> bytes:
    """Where the program stands."""
    return _progress(progress)


def gains_bytes(gains: Gains | Coming | None) -> bytes:
    """Gains that are set or coming; hardly any run has some."""
    return _gains(gains) if gains else b"-"
