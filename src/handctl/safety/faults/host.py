"""Rows H01 to H15 (host) and I01 to I11 (files and inputs) of the fault catalogue."""

from handctl.safety.faults.fault import (
    CHECKED_BEFORE_ARMING,
    CHECKED_BY_CONTROL_LOOP,
    CHECKED_BY_DRIVE,
    CHECKED_BY_FILE_READERS,
    CLEARED_BY_ITSELF,
    CLEARED_BY_OPERATOR,
    FAULT_PLACE_HAND,
    VISIBLE_FAULT,
    declare_catalogue_row,
    declare_fault,
)
from handctl.safety.safety_action import RelaxMethod, SafetyAction
from handctl.safety.safety_limits import MAX_STALL_S, MIN_STALLED_TICKS

LATE_TICK_FRACTION = 0.25
"""Delay of a tick's start above which the tick counts as late, as a fraction of the control period."""
REFUSED_REQUESTS_LIMIT = 3
"""Smallest number of malformed requests within a second that is a fault."""
FOREIGN_CONTROLLER_EVENT = "foreign"
"""Kind of the event that reports a second controller."""

_WALL_CLOCK_TEXT = f"{VISIBLE_FAULT}: nothing uses the wall clock"
_NO_CONNECTION_TEXT = f"{VISIBLE_FAULT}: not connected to the loop"

declare_catalogue_row("H01", "one late tick", ticks=1, required_ticks=1)
H01_LATE_TICK = declare_fault(
    "H01", "a late tick", "A tick began later than a quarter of a period after its time",
    SafetyAction.PASS, CLEARED_BY_ITSELF, FAULT_PLACE_HAND, name="loop",
    cause="Another program or the kernel delayed this host for a moment.",
    remedy="Ignore single cases. If it repeats, run handctl doctor.",
)  # fmt: skip

declare_catalogue_row("H02", "a missed tick", ticks=1, required_ticks=1)
H02_MISSED_TICK = declare_fault(
    "H02", "a missed tick", "At least one tick did not run", SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_HAND,
    name="loop",
    cause="Another program or the kernel delayed this host for more than a period.",
    remedy="Run handctl doctor (priority, cores), close other programs, or lower the rate.",
)  # fmt: skip

declare_catalogue_row("H03", "three or more ticks missed", ticks=1, required_ticks=1)
H03_STALLED_HOST = declare_fault(
    "H03", "the host stalled", f"For {MAX_STALL_S * 1e3:g} ms, and for at least {MIN_STALLED_TICKS} ticks, no tick ran",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_HAND, name="loop",
    caused_by_lateness=True,
    cause="Another program, a debugger or the kernel stopped the controller.",
    remedy="Run handctl doctor (priority, cores), close other programs, then start a new run.",
)  # fmt: skip

declare_catalogue_row("H04", "suspend", ticks=1, required_ticks=1)
declare_fault(
    "H04", "the host was suspended", "CLOCK_BOOTTIME is ahead of CLOCK_MONOTONIC, because the host was asleep",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, reports=("suspended",),
    cause="The computer went to sleep.",
    remedy="Disable sleep and lid actions on this machine, then start a new run.",
)  # fmt: skip

declare_catalogue_row("H05", "the controller is killed", CHECKED_BY_DRIVE,
    odrive=f"{VISIBLE_FAULT}: if its watchdog is on, which is read back with endpoints", ms=54, required_ticks=3,
    why="watchdog_ms of the hand file is 50 ms from the last command, and the current decays in 4 ms",
    tested_by="tests/runtime/test_killed.py")  # fmt: skip
declare_catalogue_row(
    "H06", "SIGTERM, SIGINT, also twice", CHECKED_BY_CONTROL_LOOP, ticks=1, required_ticks=1
)
declare_catalogue_row(
    "H07",
    "exception in the loop",
    CHECKED_BY_CONTROL_LOOP,
    ticks=1,
    required_ticks=1,
    tested_by="tests/runtime/test_loop.py",
)

declare_catalogue_row("H08", "disk full", ticks=1, required_ticks=200)
declare_fault(
    "H08", "the disk is full", "The log could not be written",
    SafetyAction.WARN, CLEARED_BY_ITSELF, reports=("recorder:disk_low", "recorder:disk_full"),
    cause="The disk of the log has no space left.",
    remedy="Free space, or write the log to another disk (--log). The hand continues without a log.",
)  # fmt: skip

declare_catalogue_row("H09", "recorder stalls", ticks=1, required_ticks=640)
declare_fault(
    "H09", "log records were dropped", "The recorder is slower than the controller",
    SafetyAction.WARN, CLEARED_BY_ITSELF, reports=("recorder:dropped", "recorder:filling"),
    cause="The disk is too slow, or the recorder gets no processor time.",
    remedy="Write the log to a faster disk, and run handctl doctor.",
)  # fmt: skip

declare_catalogue_row("H10", "recorder dies", ticks=1, required_ticks=1)
declare_fault(
    "H10", "the recorder is lost", "The recorder process or its disk no longer exists",
    SafetyAction.WARN, CLEARED_BY_ITSELF, reports=("recorder:gone", "recorder:error"),
    cause="The recorder was killed, or its disk was removed.",
    remedy="Check disk and memory of this machine. handctl log recover repairs the unfinished log.",
)  # fmt: skip

declare_catalogue_row(
    "H11",
    "wall-clock step",
    CHECKED_BY_CONTROL_LOOP,
    _WALL_CLOCK_TEXT,
    _WALL_CLOCK_TEXT,
    _WALL_CLOCK_TEXT,
    tested_by="tests/vcan/inside/test_host_faults.py",
)
declare_catalogue_row(
    "H12",
    "second controller, same host",
    CHECKED_BEFORE_ARMING,
    tested_by="tests/runtime/test_mailbox.py",
)

declare_catalogue_row("H13", "second controller, same bus", ticks=2, required_ticks=2)
declare_fault(
    "H13", "a second controller", "A frame arrives that only the host may send, or a reply arrives without a request",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, relax_method=RelaxMethod.OPEN_LOOP, reports=(FOREIGN_CONTROLLER_EVENT,),
    cause="Another program or computer commands drives on this bus.",
    remedy="Stop the other program or unplug its adapter, then start a new run.",
)  # fmt: skip

declare_catalogue_row(
    "H14",
    "viewer dies or hangs",
    CHECKED_BY_CONTROL_LOOP,
    _NO_CONNECTION_TEXT,
    _NO_CONNECTION_TEXT,
    _NO_CONNECTION_TEXT,
    tested_by="tests/view/test_live.py",
)
declare_catalogue_row(
    "H15", "memory or descriptors leak", CHECKED_BY_CONTROL_LOOP, tested_by="soak"
)
declare_catalogue_row(
    "I01",
    "NaN, inf, bool for number",
    CHECKED_BY_FILE_READERS,
    tested_by="tests/hand/test_hand_file_refusals.py",
)
declare_catalogue_row(
    "I02",
    "negative mass, zero length",
    CHECKED_BY_FILE_READERS,
    tested_by="tests/hand/test_hand_file_refusals.py",
)
declare_catalogue_row(
    "I03", "wrong unit", CHECKED_BY_FILE_READERS, tested_by="tests/hand/test_hand_file_refusals.py"
)
declare_catalogue_row(
    "I04",
    "unknown, missing, duplicate keys",
    CHECKED_BY_FILE_READERS,
    tested_by="tests/hand/test_hand_file_refusals.py",
)
declare_catalogue_row(
    "I05", "contradiction", CHECKED_BY_FILE_READERS, tested_by="tests/hand/test_cross_checks.py"
)
declare_catalogue_row(
    "I06",
    "bad trajectory",
    CHECKED_BY_FILE_READERS,
    tested_by="tests/controller/test_task_files.py",
)

declare_catalogue_row("I07", "bad live goal", ticks=1, required_ticks=2)
I07A_REFUSED_REQUEST = declare_fault(
    "I07a", "a live goal was refused", "A goal is out of range or not a number, and the previous goal remains",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_HAND, name="goal",
    cause="The client sent a goal that the hand cannot reach or that is not a number.",
    remedy="Correct the client. The event before this one contains the wrong value and the valid values.",
)  # fmt: skip
I07B_MALFORMED_REQUESTS = declare_fault(
    "I07b", "requests keep being malformed",
    f"In a second, {REFUSED_REQUESTS_LIMIT} requests are not JSON, have unknown keys, or contain no number",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_HAND, name="goal",
    cause="The client is broken, or speaks to another version of the controller.",
    remedy="Stop and correct the client. The events before this one contain the wrong values.",
)  # fmt: skip

declare_catalogue_row(
    "I08",
    "truncated or corrupt log",
    CHECKED_BY_FILE_READERS,
    tested_by="tests/log/test_recover.py",
)
declare_catalogue_row(
    "I09", "hostile log", CHECKED_BY_FILE_READERS, tested_by="tests/log/test_reader.py"
)
declare_catalogue_row(
    "I10",
    "log of another hand or version",
    CHECKED_BY_FILE_READERS,
    tested_by="tests/replay/test_execute.py",
)

declare_catalogue_row("I11", "a stream of targets goes stale", ticks=1, ms=100, required_ticks=0,
    tested_by="tests/controller/test_target_streams.py")  # fmt: skip
I11A_MISSING_TARGETS = declare_fault(
    "I11a", "streamed targets are missing",
    "No target has arrived for hold_after_ms of the hand file, by default 100 ms",
    SafetyAction.HOLD, CLEARED_BY_ITSELF, FAULT_PLACE_HAND, name="stream",
    cause="The client that streams targets is busy, paused, or has ended without closing its stream.",
    remedy="The hand goes on with the next target. Send targets in time, or close the stream before a pause.",
)  # fmt: skip
I11B_ENDED_STREAM = declare_fault(
    "I11b", "the stream of targets has ended",
    "No target has arrived for relax_after_ms of the hand file, by default 1000 ms",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_HAND, name="stream",
    cause="The client that streams targets has crashed or hangs.",
    remedy="Mend the client, then start a new run. relax_after_ms of the hand file allows longer pauses.",
)  # fmt: skip

ON_HARDWARE: tuple[tuple[str, str], ...] = (
    ("B12", "short CANH to CANL in motion"),
    ("B13", "terminate one end only, and shake the cable"),
    ("B14", "ip link set can0 down in motion"),
    ("B15", "txqueuelen 4 and a second sender at full load"),
    ("B16", "pull the adapter's USB plug in motion"),
    ("B18", "start with the wrong bit rate, and with no node on the bus"),
    ("N10", "lower the supply below the drive's limit in a grasp"),
    ("N11", "cover a motor's vent until the drive trips, without a hand in it"),
    ("T01", "cut a tendon in a grasp, from behind a screen"),
    ("H05", "kill -9 in a grasp, and time the drives with a current probe"),
)
"""Tests that must be done on hardware: row of the catalogue, and instruction.

The document ``docs/evidence/faults.md`` contains the tests on hardware as a checklist with dates.
"""
