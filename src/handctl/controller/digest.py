"""Eight bytes for the whole state of a controller: packed, not printed, since every tick pays for it."""

import hashlib
import struct

from handctl.controller.monitor.motors import Motors
from handctl.controller.retune import Coming
from handctl.core.estimation.filter_state import FilterState
from handctl.core.estimation.posture import Posture
from handctl.core.estimation.touch import Touch
from handctl.core.gains.gains import Gains
from handctl.core.kept import Kept
from handctl.core.law.computed_torque import LawState
from handctl.core.plain_bytes import plain_bytes
from handctl.drives.sensors.node import SensorState
from handctl.programs.program import Progress
from handctl.safety.watch import WatchState

PLACE = struct.Struct("<qBdd??")
NO_WORDS = ("", (), (), ())


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


def words(texts: tuple[object, ...]) -> bytes:
    """Texts and names, of which most ticks have none."""
    return b"-" if texts == NO_WORDS else _printed(texts)


def filter_bytes(state: FilterState) -> bytes:
    """The filter's state."""
    x, regimes, stopped, turning, measured, surprise, nis, doubtful, lately, wary, covariance, started = state
    plain = plain_bytes((regimes, stopped, turning, measured, doubtful, started))
    told = plain + b"".join([array.tobytes() for array in (x, surprise, nis, lately, wary)])
    return told if covariance is None else told + covariance.tobytes()


def motor_bytes(motors: Motors) -> bytes:
    """What is known of the drives; their protocols' own progress as text, which rarely changes."""
    phase, *known, private = motors
    return bytes(phase) + plain_bytes(known) + b"".join(map(_private, private))


def sensor_bytes(sensors: SensorState) -> bytes:
    """What is known of the sensor node."""
    groups, *counts = sensors
    return plain_bytes((counts, [tuple(group) for group in groups]))


def watch_bytes(watch: WatchState) -> bytes:
    """What safety remembers."""
    *usual, replays, swings, followed = watch
    motors, joints, filtered, stands, taut, bears, slip_from, derailed, *goals, ropes, counts, owed = usual
    arrays = (
        *(*motors, *joints, *filtered, *stands, bears, slip_from, derailed),
        *(*goals, *replays, swings, *followed),
    )
    plain = plain_bytes((taut, tuple(ropes), tuple(counts), owed))
    return b"".join([array.tobytes() for array in arrays]) + plain


def touch_bytes(touch: Touch) -> bytes:
    """What is felt of the digits."""
    return bytes(touch.blocked) + touch.tension.tobytes()


def posture_bytes(posture: Posture) -> bytes:
    """Pack the joint angles beside those of the free digit."""
    return b"".join([array.tobytes() for array in posture])


def progress_bytes(progress: Progress) -> bytes:
    """Where the program stands."""
    return _progress(progress)


def gains_bytes(gains: Gains | Coming | None) -> bytes:
    """Gains that are set or coming; hardly any run has some."""
    return _gains(gains) if gains else b"-"
