"""Rows B01 to B18: faults of the bus."""

from handctl.safety.action import Action, Release
from handctl.safety.faults.fault import (
    ARMING,
    HAND,
    ITSELF,
    LOST,
    MOTOR,
    NODE,
    OPERATOR,
    REPLACED,
    TICK,
    fault,
    row,
)
from handctl.safety.limits import LOAD_CELLS, SILENT_S, SILENT_TICKS_LEAST

WINDOW, SHORT = 100, 20
"""Windows for the count of losses, and of malformed frames [ticks]."""
LOST_SOME, LOST_MANY = 20, 40
"""Losses within ``WINDOW`` ticks: above the first HOLD, above the second RELAX."""
MISSHAPEN_LIMIT = 3
"""Malformed frames of a node within ``SHORT`` ticks."""
UNKNOWN_LIMIT = 50.0
"""Frames with unknown identifiers per second."""
UNANSWERED = ("no acknowledge", "bus error", "protocol")
"""Texts of error frames without a receiver on the bus."""

# Texts of the catalogue's columns for protocols without a direct sign.
_COUNTER = f"{REPLACED}: load cells by their counter; a drive's answer has none, N14"
_ORDER = f"{REPLACED}: load cells by their counter; drives have none"
_CRC = f"{REPLACED}: no checksum of its own; wrong length, numbers that are none, and jumps (N05) are noticed"
_BESIDE = f"{LOST}: cyclic messages come beside the answers"
SILENT_WHY = "30 ms of silence: a busy host is late now and then; while other motors answer, it is 4 ticks (B17)"
_SILENCE = f"for {SILENT_S * 1e3:g} ms, at least {SILENT_TICKS_LEAST} ticks in a row"

row("B01", "one frame lost", ticks=2, asked=2)
B01 = fault("B01", "a reply is missing", "feedback older than one tick", Action.WARN, ITSELF, MOTOR)

row("B02", "several in a row lost", ticks=1, ms=30, asked=5, why=SILENT_WHY)
B02 = fault("B02", "a motor has gone silent", f"no reply {_SILENCE}", Action.RELAX, OPERATOR, MOTOR)

row("B03", "intermittent loss", ticks=102, asked=102)
B03A = fault("B03a", "replies get lost", f"more than {LOST_SOME} of the last {WINDOW} missing", Action.HOLD, ITSELF,
             NODE)  # fmt: skip
B03B = fault("B03b", "many replies get lost", f"more than {LOST_MANY} of the last {WINDOW} missing", Action.RELAX,
             OPERATOR, NODE)  # fmt: skip

row("B04", "delay", TICK, _COUNTER, _COUNTER, _COUNTER, ticks=4, asked=4)
B04 = fault("B04", "a delayed frame", "an answer of the load cells to an older SYNC", Action.WARN, ITSELF, HAND,
            name=LOAD_CELLS)  # fmt: skip

row("B05", "duplicate, same bytes", odrive=_BESIDE, ticks=2, asked=2)
B05 = fault("B05", "a duplicate frame", "more answers than questions, of the same bytes", Action.WARN, ITSELF, NODE)

row("B06", "duplicate, other bytes", odrive=_BESIDE, ticks=2, asked=2)
B06 = fault("B06", "a masquerade", "more answers than questions, of other bytes", Action.RELAX, OPERATOR, NODE,
            release=Release.OPEN)  # fmt: skip

row("B07", "reordering", TICK, _ORDER, _ORDER, _ORDER, ticks=2, asked=2)
B07 = fault("B07", "frames overtake", "a stale load-cell frame arrives after the fresh one", Action.WARN, ITSELF, HAND,
            name=LOAD_CELLS)  # fmt: skip

row("B08", "corruption above the CAN CRC", TICK, _CRC, _CRC, _CRC, ticks=4, asked=4)
B08 = fault("B08", "corrupt payloads", f"{MISSHAPEN_LIMIT} frames of a node in {SHORT} ticks cannot be read",
            Action.RELAX, OPERATOR, NODE)  # fmt: skip

row("B09", "wrong length, RTR, 29 bit, FD", ticks=2, asked=2)
B09 = fault("B09", "a frame of a wrong shape", "length, RTR, 29 bit or non-numeric values", Action.WARN, ITSELF, NODE)

row("B10", "unknown identifiers", ticks=2, ms=51, asked=2,
    why="counted from the first strange frame, one a millisecond; 51 of them within a second are too many")  # fmt: skip
B10 = fault("B10", "unknown identifiers", f"more than {UNKNOWN_LIMIT:g} frames a second with unassigned identifiers",
            Action.WARN, ITSELF, HAND, name="bus")  # fmt: skip

row("B11", "babbling idiot", ticks=3, asked=3)
B11A = fault("B11a", "a flooded bus", "more frames than all nodes can send, two ticks", Action.RELAX, OPERATOR, HAND,
             debounce=2, name="bus")  # fmt: skip
# Same condition as B11a. The longer debounce makes it the second stage.
B11B = fault("B11b", "a flood that lasts", "the same for ten ticks", Action.CUT, OPERATOR, HAND, debounce=10,
             name="bus")  # fmt: skip

row("B12", "bus off", ticks=1, asked=1)
fault("B12", "bus off", "the interface reports bus-off", Action.CUT, OPERATOR, reports=("bus_off",))

row("B13", "error-warning, error-passive", ticks=21, asked=21)
fault("B13a", "bus errors", "the interface reports error-warning or -passive", Action.WARN, ITSELF,
      reports=("error_warning", "error_passive"))  # fmt: skip
fault("B13b", "bus error-passive", "interface error-passive, 20 ticks", Action.RELAX, OPERATOR, debounce=20,
      reports=("error_passive",))  # fmt: skip

row("B14", "interface down", ticks=1, asked=1)
fault("B14", "bus lost", "the interface is down", Action.CUT, OPERATOR, reports=("enetdown",))

row("B15", "send queue full", ticks=3, asked=3)
fault("B15", "send queue full", "the interface refuses frames, two ticks", Action.RELAX, OPERATOR, debounce=2,
      reports=("enobufs",))  # fmt: skip

row("B16", "adapter unplugged", ticks=1, asked=1)
fault("B16", "adapter unplugged", "the interface has gone", Action.CUT, OPERATOR, reports=("enodev", "ebadf"))

row("B17", "some nodes do not hear", TICK, f"{REPLACED}: no answer for four ticks while others answer",
    f"{REPLACED}: its cyclic messages go on; counted losses (B03), or its watchdog (N08) by the heartbeat",
    f"{REPLACED}: RPDOs are not confirmed; the drive's time-out of the master (N08)",
    ticks=4, odrive_ms=160, asked=4)  # fmt: skip
B17 = fault("B17", "some nodes do not hear",
            f"a motor misses {SILENT_TICKS_LEAST} ticks in a row while others answer", Action.RELAX, OPERATOR,
            MOTOR)  # fmt: skip

row("B18", "alone on the bus", ARMING, tried="tests/safety/test_reported.py")
fault("B18", "alone on the bus", "error frames and no answer, before arming", Action.RELAX, OPERATOR, debounce=20,
      reports=("error_frame",))  # fmt: skip
