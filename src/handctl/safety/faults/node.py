"""Rows N01 to N17: faults of drives and sensors. The inventory judges N03, and N12 before arming."""

from handctl.safety.action import Action, Release
from handctl.safety.faults.bus import SHORT, SILENT_WHY
from handctl.safety.faults.fault import (
    ARMING,
    DETECTED,
    ITSELF,
    JOINT,
    LOST,
    MOTOR,
    NODE,
    OPERATOR,
    REPLACED,
    TENDON,
    TICK,
    fault,
    row,
)
from handctl.safety.limits import SILENT_S, SILENT_TICKS_LEAST

STUCK_S, STUCK_GOAL_M, STUCK_TENSION_N, STUCK_JOINT_DEG = 0.1, 0.5e-3, 8.0, 10.0
"""Longest time of a constant reading while a reference moves, and the motion of each reference.

For a motor: 0.5 mm of goal, or 8 N of tension (a stretch of 80 um). For a joint: 10 degrees
as turned by the spools.
"""
SLIP_WARN_DEG, SLIP_TRIP_DEG = 3.0, 6.0
NOISE_FACTOR = 9.0
"""Variance of a noise burst, as a multiple of the variance from drive torque on the bare rotor and encoder rounding."""
WARM_TICKS = 20
DISOBEYED_N = 15.0
SWING_N, SWING_S, SWING_HZ = 8.0, 0.25, 8.0
"""RMS of a swing of tension [N] (an amplitude of 11 N), duration until the hand relaxes [s], and lowest
frequency [Hz].

A command step of 75 N at 5000 N/s exceeds the RMS for 0.15 s.
"""
HALVED_MISSES = 7
"""Misses within ``SHORT`` ticks of a node at half rate.

Two misses in a row occur where the phase shifts.
"""
LIMP_AFTER_S, LIMP_FRACTION, LIMP_N = 0.1, 0.5, 10.0
"""Time after a cut of the torque [s], and least fraction and tension [N] of a tendon still pulled then.

In a released grasp, the packaged hands' tendons bear at most a third after this time. With a motor
still pulling, at least 0.74.
"""
REPORTED_PART, REPORTED_S = 0.4, 0.25
"""Least reported fraction of the command's changes, and time constant of the comparison [s]."""

# Texts of the catalogue's columns for protocols without a direct sign.
_BEAT = f"{DETECTED}: by the heartbeat, every 100 ms"
_BESIDE = f"{LOST}: cyclic messages come beside the answers"
_JOINTS = f"{REPLACED}: only where there are joint encoders; else the motor's encoder has no second"
_SLOWLY = f"{REPLACED}: cyclic messages come in between; single losses (B01)"
_AGAIN = "limit and watchdog are read by turns while enabled, one each 500 ms"
_SILENCE = f"for {SILENT_S * 1e3:g} ms, at least {SILENT_TICKS_LEAST} in a row"
_MODES = "tests/controller/test_modes.py"

row("N01", "reset in motion", odrive=_BEAT, ticks=4, odrive_ms=100, asked=2,
    why="4 where the drive is silent while it restarts (CiA 402), else 2")  # fmt: skip
N01 = fault("N01", "a drive dropped out", "it says that it is disabled, or has restarted", Action.RELAX, OPERATOR,
            MOTOR)  # fmt: skip

row("N02", "silent node", ticks=1, ms=30, asked=4,
    why=SILENT_WHY + "; joint encoders that are read in every fourth tick: four readings, 85 ms at 200 Hz")  # fmt: skip
N02 = fault("N02", "load cells silent", f"no tension frame {_SILENCE}", Action.RELAX, OPERATOR, TENDON)
N02B = fault("N02b", "joint encoders silent", f"no joint frame {_SILENCE}", Action.RELAX, OPERATOR, JOINT)

row("N03", "missing at start", ARMING, tried=_MODES)

row("N04", "encoder stuck", ticks=2, ms=500, asked=22,
    why="it is wrong only where the goal moves by 0.5 mm or the tension by 8 N, for more than 100 ms")  # fmt: skip
N04 = fault("N04", "an encoder is stuck",
            f"constant for {STUCK_S * 1e3:g} ms while goal, tension or spool move", Action.RELAX, OPERATOR, MOTOR,
            JOINT, release=Release.OPEN)  # fmt: skip

row("N05", "encoder jump", ticks=3, asked=3)
N05A = fault("N05a", "an encoder jumped", "a step that no rotor makes; the sample is dropped", Action.WARN, ITSELF,
             MOTOR, JOINT)  # fmt: skip
N05B = fault("N05b", "an encoder jumps", "the same in two readings running", Action.RELAX, OPERATOR, MOTOR, JOINT,
             release=Release.OPEN)  # fmt: skip

row("N06", "encoder drift or slip", TICK, _JOINTS, _JOINTS, _JOINTS, ticks=4, ms=900, asked=200,
    why="sooner than the 1000 ms asked")  # fmt: skip
N06A = fault("N06a", "joint and spool disagree", f"more than {SLIP_WARN_DEG:g} deg, filtered", Action.WARN, ITSELF,
             TENDON)  # fmt: skip
N06B = fault("N06b", "an encoder slips", f"more than {SLIP_TRIP_DEG:g} deg, filtered", Action.RELAX, OPERATOR, TENDON,
             release=Release.OPEN)  # fmt: skip

row("N07", "encoder noise", ticks=4, ms=60, asked=52)
N07 = fault("N07", "a noisy encoder", f"{NOISE_FACTOR:g} times the jerk that drive and noise can make, over 100 ms",
            Action.HOLD, ITSELF, MOTOR)  # fmt: skip

row("N08", "the drive's watchdog fired", odrive=_BEAT, ticks=2, odrive_ms=100, asked=2)
N08 = fault("N08", "a drive's watchdog fired", "the drive says so", Action.RELAX, OPERATOR, MOTOR)

row("N09", "over-temperature", odrive=f"{DETECTED}: asked five times a second",
    cia402=f"{REPLACED}: no temperature in the PDO; the drive's own limit by EMCY (N11)",
    ticks=22, odrive_ms=200, asked=22)  # fmt: skip
N09A = fault("N09a", "drive warm", "temperature above the soft limit; its tendon's limit falls with it", Action.WARN,
             ITSELF, MOTOR, debounce=WARM_TICKS)  # fmt: skip
N09B = fault("N09b", "drive too hot", "temperature above the hard limit", Action.RELAX, OPERATOR, MOTOR,
             debounce=WARM_TICKS)  # fmt: skip

row("N10", "under- or over-voltage", odrive=_BEAT, ticks=2, odrive_ms=100, asked=2)
N10 = fault("N10", "supply voltage", "the drive says too low or too high", Action.RELAX, OPERATOR, MOTOR)

row("N11", "node fault code", odrive=_BEAT, ticks=2, odrive_ms=100, asked=2)
N11 = fault("N11", "drive reports an error", "error code in the feedback", Action.RELAX, OPERATOR, MOTOR)
N11B = fault("N11b", "drive reports an unknown error", "an unknown code counts as the most severe", Action.CUT,
             OPERATOR, MOTOR)  # fmt: skip

row("N12", "wrong firmware or settings", TICK, f"{REPLACED}: registers, no serial number; {_AGAIN}",
    f"{REPLACED}: protocol version and endpoints, no serial number; {_AGAIN}",
    f"{REPLACED}: objects, no serial number; {_AGAIN}", ticks=4, ms=1000)  # fmt: skip
N12 = fault("N12", "another drive than configured", "a read-back differs, or somebody else has enabled it", Action.CUT,
            OPERATOR, MOTOR, release=Release.OPEN)  # fmt: skip

row("N13", "two nodes with one id", odrive=_BESIDE, ticks=4, asked=2,
    why="2 if the second answer has other bytes; the same bytes three times in a row")  # fmt: skip
N13 = fault("N13", "two nodes with one id", "two answers to a question, three ticks running", Action.RELAX, OPERATOR,
            NODE, debounce=3, release=Release.OPEN)  # fmt: skip

row("N14", "command not obeyed", odrive=f"{REPLACED}: by tension (T04) unless torque_feedback is set",
    ticks=22, ms=600, asked=22,
    why="22 where reported and commanded torque differ; a ripple that no drive reports, by its swing (N14b)",
    )  # fmt: skip
N14 = fault("N14", "a command is not obeyed",
            f"commanded and reported torque differ by {DISOBEYED_N:g} N at the tendon, filtered", Action.RELAX,
            OPERATOR, MOTOR, release=Release.OPEN)  # fmt: skip
N14B = fault("N14b", "the tension swings",
             f"{SWING_N:g} N RMS about its command, above {SWING_HZ:g} Hz, for {SWING_S * 1e3:g} ms", Action.RELAX,
             OPERATOR, TENDON, release=Release.OPEN)  # fmt: skip

row("N15", "slow node", odrive=_SLOWLY, ticks=22, asked=22)
N15 = fault("N15", "a slow node", f"misses {HALVED_MISSES} of {SHORT} answers, seldom two running", Action.WARN, ITSELF,
            NODE)  # fmt: skip

row("N16", "node refuses to let go", ticks=2, ms=100, asked=21,
    why="the time of 21 ticks of 5 ms, which the springs need to open the finger")  # fmt: skip
N16 = fault("N16", "a drive does not let go",
            f"tension not falling {LIMP_AFTER_S * 1e3:g} ms after the torque was cut", Action.CUT, OPERATOR,
            TENDON)  # fmt: skip

row("N17", "drives exchanged, or obeying late",
    odrive=f"{REPLACED}: N05, N06 or T04 where motion or unequal tension show it; no torque is reported",
    ticks=2, ms=4000)  # fmt: skip
N17 = fault("N17", "torque reports of another motor",
            f"less than {REPORTED_PART:g} of the command's small changes are reported, {REPORTED_S * 1e3:g} ms",
            Action.RELAX, OPERATOR, MOTOR, release=Release.OPEN)  # fmt: skip
