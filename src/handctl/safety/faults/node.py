"""Rows N01 to N17: what goes wrong in drives and sensors. N03 and N12 before arming are judged by the inventory."""

from collections.abc import Sequence

from handctl.drives.causes import Cause
from handctl.safety.action import Action, Release
from handctl.safety.faults.fault import ITSELF, NOTHING, PERSON, Detector, Fault, Reading, above
from handctl.safety.signals import Limits, Signals

DISOBEYED_N = 15.0
SLIP_WARN_DEG, SLIP_TRIP_DEG = 3.0, 6.0


def _caused_by(*causes: Cause) -> Detector:
    def detect(limits: Limits, s: Signals) -> Sequence[Reading]:
        if not s.armed or not s.drive_errors:
            return NOTHING
        return [(name, float(code)) for name, code, cause in s.drive_errors if cause in causes]

    return detect


def _sensor_silent(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.tendons, s.sensor_age, limits.silent_ticks - 1) if s.armed else NOTHING


def _joints_silent(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.mute if s.armed else NOTHING


def _stuck(limits: Limits, s: Signals) -> Sequence[Reading]:
    return (*s.stuck_motor, *s.stuck_joint) if s.stuck_motor or s.stuck_joint else NOTHING


def _jumped(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.jumped


def _jumping(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.jumping


def _slips(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.tendons, s.slip, SLIP_WARN_DEG)


def _slipped(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.tendons, s.slip, SLIP_TRIP_DEG)


def _noisy(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.motors, s.noise, limits.noise_most)


def _warm(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.motors, s.temperature, limits.temperature_soft)


def _hot(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.motors, s.temperature, limits.temperature_hard)


def _disobeyed(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.motors, s.disobeyed, DISOBEYED_N)


def _swings(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.swinging


def _unfollowed(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.unfollowed


def _halved(limits: Limits, s: Signals) -> Sequence[Reading]:
    return [(name, 0.5) for name in s.halved] if s.halved else NOTHING


def _doubled(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.twice if s.armed else NOTHING


def _limp(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.limp


NODE_FAULTS: tuple[Fault, ...] = (
    Fault("N01", "a drive dropped out", "it says that it is disabled, or has restarted", 1, Action.RELAX, PERSON,
          _caused_by(Cause.DROPPED_OUT)),
    Fault("N02", "load cells silent", "no tension frame for 30 ms, at least four in a row", 1, Action.RELAX, PERSON,
          _sensor_silent),
    Fault("N02b", "joint encoders silent", "no joint frame for 30 ms, at least four in a row", 1, Action.RELAX, PERSON,
          _joints_silent),
    Fault("N04", "an encoder is stuck", "it stands for 100 ms while goal, tension or spool move", 1, Action.RELAX,
          PERSON, _stuck, Release.OPEN),
    Fault("N05a", "an encoder jumped", "a step that no rotor makes; the sample is dropped", 1, Action.WARN, ITSELF,
          _jumped),
    Fault("N05b", "an encoder jumps", "the same in two readings running", 1, Action.RELAX, PERSON, _jumping,
          Release.OPEN),
    Fault("N06a", "joint and spool disagree", "more than 3 deg, filtered", 1, Action.WARN, ITSELF, _slips),
    Fault("N06b", "an encoder slips", "more than 6 deg, filtered", 1, Action.RELAX, PERSON, _slipped, Release.OPEN),
    Fault("N07", "a noisy encoder", "nine times the jerk that drive and noise can make, over 100 ms", 1, Action.HOLD,
          ITSELF, _noisy),
    Fault("N08", "a drive's watchdog fired", "the drive says so", 1, Action.RELAX, PERSON, _caused_by(Cause.WATCHDOG)),
    Fault("N09a", "drive warm", "temperature above the soft limit; its rope's limit falls with it", 20, Action.WARN,
          ITSELF, _warm),
    Fault("N09b", "drive too hot", "temperature above the hard limit", 20, Action.RELAX, PERSON, _hot),
    Fault("N10", "supply voltage", "the drive says too low or too high", 1, Action.RELAX, PERSON,
          _caused_by(Cause.VOLTAGE)),
    Fault("N11", "drive reports an error", "error code in the feedback", 1, Action.RELAX, PERSON,
          _caused_by(Cause.OTHER, Cause.HOT, Cause.LOST)),
    Fault("N11b", "drive reports an unknown error", "an unknown code counts as the most severe", 1, Action.CUT, PERSON,
          _caused_by(Cause.UNKNOWN)),
    Fault("N12", "another drive than configured", "a read-back differs, or somebody else has enabled it", 1,
          Action.CUT, PERSON, _caused_by(Cause.MISMATCH), Release.OPEN),
    Fault("N13", "two nodes with one id", "two answers to a question, three ticks running", 3, Action.RELAX, PERSON,
          _doubled, Release.OPEN),
    Fault("N14", "a command is not obeyed", "torque asked and made differ by 15 N at the rope, filtered", 1,
          Action.RELAX, PERSON, _disobeyed, Release.OPEN),
    Fault("N14b", "the tension swings", "8 N RMS about its command, above 8 Hz, for 250 ms", 1, Action.RELAX, PERSON,
          _swings, Release.OPEN),
    Fault("N15", "a slow node", "misses seven of 20 answers, seldom two running", 1, Action.WARN, ITSELF, _halved),
    Fault("N16", "a drive does not let go", "tension not falling 100 ms after the torque was cut", 1, Action.CUT,
          PERSON, _limp),
    Fault("N17", "torque reports of another motor", "less than 2/5 of the command's small changes are reported, 250 ms",
          1, Action.RELAX, PERSON, _unfollowed, Release.OPEN),
)  # fmt: skip
