"""The whole fault catalogue: where each row is judged, what each protocol can see of it, by when, and how it is tried.

The rows of ``table`` are those that a tick can judge. The catalogue has the others, too, so that none is forgotten, and
says openly what a real protocol cannot show: *detected*, *replaced* by a weaker sign, or *lost*.
"""

from typing import NamedTuple

DETECTED, REPLACED, LOST = "detected", "replaced", "lost"
TABLE_, ARMING, NODE, LOOP, FILES = "fault table", "before arming", "the drive itself", "loop and recorder", "files"
"""Where a row is judged."""


class Entry(NamedTuple):
    """One row of the catalogue.

    Attributes:
        id: of the row. title: what goes wrong.
        where: it is judged.
        mit, odrive, cia402: how far each protocol shows it; detected, or "replaced: by what", or "lost: why".
        ticks, ms: latest reaction, together: so many ticks, and a time besides.
        odrive_ms: what an ODrive needs besides, since it tells its state every 100 ms [ms].
        asked: ticks of 5 ms that the project's fault catalogue gives an ideal drive; 0: none given, as before torque.
        why: more ticks are needed than that; empty if not.
        tried: ``campaign``, or the test that produces it.
    """

    id: str
    title: str
    where: str
    mit: str = DETECTED
    odrive: str = DETECTED
    cia402: str = DETECTED
    ticks: int = 0
    ms: float = 0.0
    odrive_ms: float = 0.0
    asked: int = 0
    why: str = ""
    tried: str = "campaign"

    def latest_ms(self, rate_hz: float) -> float:
        """Latest reaction at a control rate [ms]; an ODrive's may take ``odrive_ms`` more."""
        return self.ticks * 1e3 / rate_hz + self.ms


_CRC = f"{REPLACED}: no checksum of its own; wrong length, numbers that are none, and jumps (N05) are noticed"
_BEAT = f"{DETECTED}: by the heartbeat, every 100 ms"
_COUNTER = f"{REPLACED}: load cells by their counter; a drive's answer has none, N14"
_ORDER = f"{REPLACED}: load cells by their counter; drives have none"
_JOINTS = f"{REPLACED}: only where there are joint encoders; else the motor's encoder has no second"
_SLACK = f"{REPLACED}: only where there are joint encoders, by three readings; else by slack (T02)"
_NO_CLOCK = f"{DETECTED}: nothing uses the wall clock"
_APART = f"{DETECTED}: not connected to the loop"
_SILENT = "30 ms of silence: a busy host is late now and then; while other motors answer, it is 4 ticks (B17)"
_SLOWLY = f"{REPLACED}: cyclic messages come in between; single losses (B01)"
_AGAIN = "limit and watchdog are read by turns while enabled, one each 500 ms"
_MODES = "tests/controller/test_modes.py"

CATALOGUE: tuple[Entry, ...] = (
    Entry("B01", "one frame lost", TABLE_, ticks=2, asked=2),
    Entry("B02", "several in a row lost", TABLE_, ticks=1, ms=30, asked=5, why=_SILENT),
    Entry("B03", "intermittent loss", TABLE_, ticks=102, asked=102),
    Entry("B04", "delay", TABLE_, _COUNTER, _COUNTER, _COUNTER, ticks=4, asked=4),
    Entry("B05", "duplicate, same bytes", TABLE_, odrive=f"{LOST}: cyclic messages come beside the answers",
          ticks=2, asked=2),
    Entry("B06", "duplicate, other bytes", TABLE_, odrive=f"{LOST}: cyclic messages come beside the answers",
          ticks=2, asked=2),
    Entry("B07", "reordering", TABLE_, _ORDER, _ORDER, _ORDER, ticks=2, asked=2),
    Entry("B08", "corruption above the CAN CRC", TABLE_, _CRC, _CRC, _CRC, ticks=4, asked=4),
    Entry("B09", "wrong length, RTR, 29 bit, FD", TABLE_, ticks=2, asked=2),
    Entry("B10", "unknown identifiers", TABLE_, ticks=2, ms=51, asked=2,
          why="counted from the first strange frame, one a millisecond; 51 of them within a second are too many"),
    Entry("B11", "babbling idiot", TABLE_, ticks=3, asked=3),
    Entry("B12", "bus off", TABLE_, ticks=1, asked=1),
    Entry("B13", "error-warning, error-passive", TABLE_, ticks=21, asked=21),
    Entry("B14", "interface down", TABLE_, ticks=1, asked=1),
    Entry("B15", "send queue full", TABLE_, ticks=3, asked=3),
    Entry("B16", "adapter unplugged", TABLE_, ticks=1, asked=1),
    Entry("B17", "some nodes do not hear", TABLE_, f"{REPLACED}: no answer for four ticks while others answer",
          f"{REPLACED}: its cyclic messages go on; counted losses (B03), or its watchdog (N08) by the heartbeat",
          f"{REPLACED}: RPDOs are not confirmed; the drive's time-out of the master (N08)",
          ticks=4, odrive_ms=160, asked=4),
    Entry("B18", "alone on the bus", ARMING, tried="tests/safety/test_table.py"),
    Entry("N01", "reset in motion", TABLE_, odrive=_BEAT, ticks=4, odrive_ms=100, asked=2,
          why="4 where the drive is silent while it restarts (CiA 402), else 2"),
    Entry("N02", "silent node", TABLE_, ticks=1, ms=30, asked=4,
          why=_SILENT + "; joint encoders that are read in every fourth tick: four readings, 85 ms at 200 Hz"),
    Entry("N03", "missing at start", ARMING, tried=_MODES),
    Entry("N04", "encoder stuck", TABLE_, ticks=2, ms=500, asked=22,
          why="it is wrong only where the goal moves by 0.5 mm or the tension by 8 N, for more than 100 ms"),
    Entry("N05", "encoder jump", TABLE_, ticks=3, asked=3),
    Entry("N06", "encoder drift or slip", TABLE_,
          _JOINTS, _JOINTS, _JOINTS, ticks=4, ms=900, asked=200,
          why="sooner than the 1000 ms asked"),
    Entry("N07", "encoder noise", TABLE_, ticks=4, ms=60, asked=52),
    Entry("N08", "the drive's watchdog fired", TABLE_, odrive=_BEAT, ticks=2, odrive_ms=100, asked=2),
    Entry("N09", "over-temperature", TABLE_, odrive=f"{DETECTED}: asked five times a second",
          cia402=f"{REPLACED}: no temperature in the PDO; the drive's own limit by EMCY (N11)",
          ticks=22, odrive_ms=200, asked=22),
    Entry("N10", "under- or over-voltage", TABLE_, odrive=_BEAT, ticks=2, odrive_ms=100, asked=2),
    Entry("N11", "node fault code", TABLE_, odrive=_BEAT, ticks=2, odrive_ms=100, asked=2),
    Entry("N12", "wrong firmware or settings", TABLE_, f"{REPLACED}: registers, no serial number; {_AGAIN}",
          f"{REPLACED}: protocol version and endpoints, no serial number; {_AGAIN}",
          f"{REPLACED}: objects, no serial number; {_AGAIN}", ticks=4, ms=1000),
    Entry("N13", "two nodes with one id", TABLE_, odrive=f"{LOST}: cyclic messages come beside the answers",
          ticks=4, asked=2,
          why="2 if the second answer has other bytes; the same bytes three times in a row"),
    Entry("N14", "command not obeyed", TABLE_, odrive=f"{REPLACED}: by tension (T04) unless torque_feedback is set",
          ticks=22, ms=600, asked=22,
          why="22 where reported and commanded torque differ; a ripple that no drive reports, by its swing (N14b)"),
    Entry("N15", "slow node", TABLE_, odrive=_SLOWLY, ticks=22, asked=22),
    Entry("N16", "node refuses to let go", TABLE_, ticks=2, ms=100, asked=21,
          why="the time of 21 ticks of 5 ms, which the springs need to open the finger"),
    Entry("N17", "drives exchanged, or obeying late", TABLE_,
          odrive=f"{REPLACED}: N05, N06 or T04 where motion or unequal tension show it; no torque is reported",
          ticks=2, ms=4000),
    Entry("T01", "snap", TABLE_, ticks=10, asked=3,
          why="a torn rope's spool takes three to seven ticks to run fast enough, and must do so for two"),
    Entry("T02", "slack", TABLE_, ticks=4, ms=110, asked=12,
          why="50 ms, as asked, behind the cell's filter of 20 ms; slack that comes at once is T01, in 10 ticks"),
    Entry("T03", "over-tension", TABLE_, ticks=10, asked=2,
          why="2 from the first sample above the limit; 10 from the moment at which a drive runs away"),
    Entry("T04", "load cell drifts", TABLE_, odrive=f"{DETECTED}: against the torque asked for",
          ticks=2, ms=500, asked=200,
          why="sooner than the 1000 ms asked; from the first newton on of 60 a second"),
    Entry("T05", "load cell stuck", TABLE_, ticks=42, ms=300, asked=42,
          why="42 from the moment at which the torque moves; a grasp at rest shows nothing"),
    Entry("T06", "load cell saturated", TABLE_, ticks=4, asked=4),
    Entry("T07", "load cells swapped or inverted", ARMING, tried="tests/controller/test_commission.py"),
    Entry("T08", "derailed or crossed", TABLE_,
          _SLACK, _SLACK, _SLACK, ticks=8, ms=400, asked=4,
          why="three readings of joints that come by turns; below 15 degrees a filter of 300 ms finds it (N06)"),
    Entry("T09", "friction grows", TABLE_, odrive=f"{DETECTED}: against the torque asked for", ticks=4, ms=15000,
          tried="tests/safety/test_residuals.py"),
    Entry("H01", "one late tick", TABLE_, ticks=1, asked=1),
    Entry("H02", "a missed tick", TABLE_, ticks=1, asked=1),
    Entry("H03", "three or more missed", TABLE_, ticks=1, asked=1),
    Entry("H04", "suspend", TABLE_, ticks=1, asked=1),
    Entry("H05", "the controller is killed", NODE,
          odrive=f"{DETECTED}: if its watchdog is on; with endpoints it is read back", ms=54, asked=3,
          why="watchdog_ms of the hand file, 50, from the last command on, and 4 ms in which the current decays",
          tried="tests/runtime/test_killed.py"),
    Entry("H06", "SIGTERM, SIGINT; a second one", LOOP, ticks=1, asked=1),
    Entry("H07", "exception in the loop", LOOP, ticks=1, asked=1, tried="tests/runtime/test_loop.py"),
    Entry("H08", "disk full", TABLE_, ticks=1, asked=200),
    Entry("H09", "recorder stalls", TABLE_, ticks=1, asked=640),
    Entry("H10", "recorder dies", TABLE_, ticks=1, asked=1),
    Entry("H11", "wall-clock step", LOOP, _NO_CLOCK, _NO_CLOCK, _NO_CLOCK,
          tried="tests/vcan/inside/test_host_faults.py"),
    Entry("H12", "second controller, same host", ARMING, tried="tests/runtime/test_mailbox.py"),
    Entry("H13", "second controller, same bus", TABLE_, ticks=2, asked=2),
    Entry("H14", "viewer dies or hangs", LOOP, _APART, _APART, _APART,
          tried="tests/view/test_live.py"),
    Entry("H15", "memory or descriptors leak", LOOP, tried="soak"),
    Entry("I01", "NaN, inf, bool for number", FILES, tried="tests/hand/test_refusals.py"),
    Entry("I02", "negative mass, zero length", FILES, tried="tests/hand/test_refusals.py"),
    Entry("I03", "wrong unit", FILES, tried="tests/hand/test_refusals.py"),
    Entry("I04", "unknown, missing, double keys", FILES, tried="tests/hand/test_refusals.py"),
    Entry("I05", "contradiction", FILES, tried="tests/hand/test_cross_checks.py"),
    Entry("I06", "bad trajectory", FILES, tried="tests/controller/test_task.py"),
    Entry("I07", "bad live goal", TABLE_, ticks=1, asked=2),
    Entry("I08", "truncated or corrupt log", FILES, tried="tests/log/test_recover.py"),
    Entry("I09", "hostile log", FILES, tried="tests/log/test_reader.py"),
    Entry("I10", "log of another hand or version", FILES, tried="tests/replay/test_execute.py"),
)  # fmt: skip
"""All rows."""

ON_HARDWARE: tuple[tuple[str, str], ...] = (
    ("B12", "short CANH to CANL in motion"),
    ("B13", "terminate one end only, and shake the cable"),
    ("B14", "ip link set can0 down in motion"),
    ("B15", "txqueuelen 4 and a second sender at full load"),
    ("B16", "pull the adapter's USB plug in motion"),
    ("B18", "start with the wrong bit rate, and with nobody on the bus"),
    ("N10", "lower the supply below the drive's limit in a grasp"),
    ("N11", "cover a motor's vent until the drive trips, without a hand in it"),
    ("T01", "cut a rope in a grasp, from behind a screen"),
    ("H05", "kill -9 in a grasp; time the drives with a current probe"),
)
"""What only hardware can show; done with a date in ``docs/faults.md``."""
