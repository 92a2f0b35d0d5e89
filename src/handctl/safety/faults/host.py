"""Rows H01 to H15 and I01 to I10: faults of the host, and of files and inputs."""

from handctl.safety.action import Action, Release
from handctl.safety.faults.fault import (
    ARMING,
    DETECTED,
    DRIVE,
    FILES,
    HAND,
    ITSELF,
    LOOP,
    OPERATOR,
    fault,
    row,
)
from handctl.safety.limits import STALLED_S, STALLED_TICKS_LEAST

LATE_FRACTION = 0.25
REFUSED_LIMIT = 3
FOREIGN = "foreign"
"""Kind of report of a second controller."""

_NO_CLOCK = f"{DETECTED}: nothing uses the wall clock"
_APART = f"{DETECTED}: not connected to the loop"

row("H01", "one late tick", ticks=1, asked=1)
H01 = fault("H01", "late tick", "the tick began more than a quarter period late", Action.PASS, ITSELF, HAND,
            name="loop")  # fmt: skip

row("H02", "a missed tick", ticks=1, asked=1)
H02 = fault("H02", "missed tick", "the tick number jumped", Action.WARN, ITSELF, HAND, name="loop")

row("H03", "three or more missed", ticks=1, asked=1)
H03 = fault("H03", "the host stood still",
            f"{STALLED_S * 1e3:g} ms without a tick, at least {STALLED_TICKS_LEAST} missed", Action.RELAX, OPERATOR,
            HAND, name="loop")  # fmt: skip

row("H04", "suspend", ticks=1, asked=1)
fault("H04", "the host was suspended", "CLOCK_BOOTTIME ran ahead of CLOCK_MONOTONIC", Action.RELAX, OPERATOR,
      reports=("suspended",))  # fmt: skip

row("H05", "the controller is killed", DRIVE,
    odrive=f"{DETECTED}: if its watchdog is on; with endpoints it is read back", ms=54, asked=3,
    why="watchdog_ms of the hand file, 50, from the last command on, and 4 ms in which the current decays",
    tried="tests/runtime/test_killed.py")  # fmt: skip
row("H06", "SIGTERM, SIGINT; a second one", LOOP, ticks=1, asked=1)
row("H07", "exception in the loop", LOOP, ticks=1, asked=1, tried="tests/runtime/test_loop.py")

row("H08", "disk full", ticks=1, asked=200)
fault("H08", "disk full", "the log could not be written", Action.WARN, ITSELF,
      reports=("recorder:disk_low", "recorder:disk_full"))  # fmt: skip

row("H09", "recorder stalls", ticks=1, asked=640)
fault("H09", "log records dropped", "the recorder does not keep up", Action.WARN, ITSELF,
      reports=("recorder:dropped", "recorder:filling"))  # fmt: skip

row("H10", "recorder dies", ticks=1, asked=1)
fault("H10", "recorder lost", "the recorder process or its disk is gone", Action.WARN, ITSELF,
      reports=("recorder:gone", "recorder:error"))  # fmt: skip

row("H11", "wall-clock step", LOOP, _NO_CLOCK, _NO_CLOCK, _NO_CLOCK, tried="tests/vcan/inside/test_host_faults.py")
row("H12", "second controller, same host", ARMING, tried="tests/runtime/test_mailbox.py")

row("H13", "second controller, same bus", ticks=2, asked=2)
fault("H13", "a second controller", "a frame that only the host may send, or an answer it did not ask for",
      Action.RELAX, OPERATOR, release=Release.OPEN, reports=(FOREIGN,))  # fmt: skip

row("H14", "viewer dies or hangs", LOOP, _APART, _APART, _APART, tried="tests/view/test_live.py")
row("H15", "memory or descriptors leak", LOOP, tried="soak")
row("I01", "NaN, inf, bool for number", FILES, tried="tests/hand/test_refusals.py")
row("I02", "negative mass, zero length", FILES, tried="tests/hand/test_refusals.py")
row("I03", "wrong unit", FILES, tried="tests/hand/test_refusals.py")
row("I04", "unknown, missing, double keys", FILES, tried="tests/hand/test_refusals.py")
row("I05", "contradiction", FILES, tried="tests/hand/test_cross_checks.py")
row("I06", "bad trajectory", FILES, tried="tests/controller/test_task.py")

row("I07", "bad live goal", ticks=1, asked=2)
I07A = fault("I07a", "a bad live goal", "refused; the last good one stays", Action.WARN, ITSELF, HAND, name="goal")
I07B = fault("I07b", "bad live goals", f"{REFUSED_LIMIT} refused within a second", Action.RELAX, OPERATOR, HAND,
             name="goal")  # fmt: skip

row("I08", "truncated or corrupt log", FILES, tried="tests/log/test_recover.py")
row("I09", "hostile log", FILES, tried="tests/log/test_reader.py")
row("I10", "log of another hand or version", FILES, tried="tests/replay/test_execute.py")

ON_HARDWARE: tuple[tuple[str, str], ...] = (
    ("B12", "short CANH to CANL in motion"),
    ("B13", "terminate one end only, and shake the cable"),
    ("B14", "ip link set can0 down in motion"),
    ("B15", "txqueuelen 4 and a second sender at full load"),
    ("B16", "pull the adapter's USB plug in motion"),
    ("B18", "start with the wrong bit rate, and with nobody on the bus"),
    ("N10", "lower the supply below the drive's limit in a grasp"),
    ("N11", "cover a motor's vent until the drive trips, without a hand in it"),
    ("T01", "cut a tendon in a grasp, from behind a screen"),
    ("H05", "kill -9 in a grasp; time the drives with a current probe"),
)
"""Tests on hardware. ``docs/faults.md`` has them as a checklist with dates."""
