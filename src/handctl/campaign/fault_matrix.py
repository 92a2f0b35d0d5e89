"""Fault matrix as data: the faults of a hand, and the reaction that each fault requires.

Each row of the matrix gives a fault, the affected parts of the hand, the stages of the run, the
required reaction, and the time limit of the reaction. The reaction time counts from the physical
event to the CAN frames that carry the reaction. The time limit of the reaction is a number of
ticks. If a fault or a drive protocol needs more time, its row also gives an additional time in
milliseconds. An ODrive, for example, reports its state only every 100 ms, and the temperature every
200 ms.
"""

import math
from itertools import pairwise
from typing import NamedTuple

from handctl.drives.motor_description import PROTOCOL_TRAITS, VERIFIABLE_PROTOCOLS
from handctl.drives.sensors.sensor_node import TENSION_RAIL_N
from handctl.hand.description import Hand
from handctl.safety.faults.tendon import FORCE_RANGE_ERROR_N, STUCK_CELL_FORCE_RANGE_N
from handctl.safety.safety_action import SafetyAction
from handctl.safety.safety_limits import MAX_STALL_S, MIN_STALLED_TICKS, tick_count_for_time

ARMING_STAGE = "arming"
FREE_MOTION_STAGE = "free motion"
GRASP_STAGE = "grasp"
MIT = "mit"
ODRIVE = "odrive"
CIA402 = "cia402"
MOTEUS = "moteus"
ROBSTRIDE = "robstride"
ALL_PROTOCOLS = VERIFIABLE_PROTOCOLS
"""Drive protocols that the fault matrix covers."""
ALL_STAGES = (ARMING_STAGE, FREE_MOTION_STAGE, GRASP_STAGE)
MOVING_STAGES = (FREE_MOTION_STAGE, GRASP_STAGE)
"""Stages of a run in which the program moves the hand."""
REPORT_DELAY_MS = {ODRIVE: 100.0}
"""Longest delay until a drive reports a change of state, by protocol [ms]."""
DRIVE_RESTART_TICKS = {CIA402: 2}
"""Number of ticks in which a drive that restarts is silent, by protocol."""
MIN_LATE_DELAY_MS = 7.0
"""Smallest value that the place holder {late} in a fault text gets [ms]."""
MIN_LATE_DELAY_TICKS = 1.5
"""Smallest value that the place holder {late} in a fault text gets [control periods]."""
POSITION_JUMP_RAD = 1.0
"""Step of the position that no drive can make within two control periods [rad]."""
POSITION_JUMP_PERIOD_MS = 5.0
"""Control period above which the impossible position step grows in proportion to the period [ms]."""
POSITION_NOISE_RAD = 0.04
"""Noise of the position that no drive can cause by motion within a control period [rad]."""
POSITION_NOISE_PERIOD_MS = 5.0
"""Control period above which the impossible position noise grows with the square of the period [ms]."""
MAX_READABLE_TRIP_N = 0.9 * TENSION_RAIL_N
"""Largest trip tension that a load cell can read without looking saturated (fault T06) [N]."""
TIME_LIMIT_PERIOD_MS = 2.0
"""Control period at which a row with ``scales_with_period`` has exactly its ``max_ticks`` as time limit [ms]."""
HOST_FAULT_PREFIX = "host "
"""Prefix of the fault texts that concern the host: I/O events, missed ticks, requests."""


class FaultMatrixRow(NamedTuple):
    """Row of the fault matrix.

    Attributes:
        id: id of the fault in the fault catalogue.
        fault: command for the simulator, or text that begins with HOST_FAULT_PREFIX. The text can
            contain place holders for the part of the hand that has the fault: {node}, {tendon},
            {digit}, {bus} or {joint}. The place holder {other} stands for the next motor. Other
            place holders stand for sizes. {trip} and {limit} are a tendon's tension_trip_N and
            drive_limit_N. {late} is a delay that counts as late at the control rate [ms]. {stall}
            is a number of missed ticks that counts as a stall of the host at the control rate.
            {jump} and {rough} are a step and a noise that no drive can make at the control rate
            [rad].
        action: least severe reaction that is sufficient for the fault.
        max_ticks: time limit for the reaction [control periods]. ``max_extra_ms`` is added to this
            time limit.
        max_extra_ms: addition to the time limit ``max_ticks`` [ms].
        accepted_faults: prefixes of the fault ids that are accepted as a detection. The first
            prefix is the fault of the row itself.
        stages: stages of a run in which the fault is tested.
        protocols: drive protocols with which the fault is tested.
        extra_ms_by_protocol: further time that is allowed for the reaction with some protocols
            [ms], by the name of the protocol.
        extra_ticks: further number of ticks that is allowed for the reaction with some protocols,
            by the name of the protocol. The time of these ticks is added to
            ``extra_ms_by_protocol``.
        needs_prompt_torque: True if the fault shows only in a load cell, or in the torque that the
            reply to a command contains. For such a fault, drives that report the torque in a
            separate frame need a load cell.
        extra_ms_without_load_cell: further time that is allowed for the reaction if the tendon of
            the fault has no load cell [ms].
        extra_sensor_frames: number of further frames of the sensor node that the detection needs.
            ``max_ticks`` contains one tick for each further frame of the sensor node. If the hand
            has no load cells, the sensor node sends only joint frames, and each comes after
            ``joint_decimation`` ticks.
        force_change_N: variation of the motor force that the detection of the fault needs [N]. The
            time limit counts from the instant at which the motor force has varied by this force
            since the fault. If the motor force never varies by this force, no reaction is required.
        scales_with_period: True if the detection waits for a time constant or a delay in
            milliseconds. For such a row, the time limit at a control period below
            ``TIME_LIMIT_PERIOD_MS`` is as long as ``max_ticks`` periods of
            ``TIME_LIMIT_PERIOD_MS``.
    """

    id: str
    fault: str
    action: SafetyAction
    max_ticks: int
    max_extra_ms: float = 0.0
    accepted_faults: tuple[str, ...] = ()
    stages: tuple[str, ...] = MOVING_STAGES
    protocols: tuple[str, ...] = ALL_PROTOCOLS
    extra_ms_by_protocol: dict[str, float] = {}  # noqa: RUF012 - read only
    extra_ticks: dict[str, int] = {}  # noqa: RUF012 - read only
    needs_prompt_torque: bool = False
    extra_ms_without_load_cell: float = 0.0
    extra_sensor_frames: int = 0
    force_change_N: float = 0.0
    scales_with_period: bool = False

    def reaction_limit_ticks(self, protocol: str, period_ms: float) -> int:
        """Return the time limit of the row for drives of a given protocol [ticks]."""
        ticks = self.max_ticks + self.extra_ticks.get(protocol, 0)
        if self.scales_with_period:
            ticks = math.ceil(ticks * max(1.0, TIME_LIMIT_PERIOD_MS / period_ms))
        return ticks + math.ceil(
            (self.max_extra_ms + self.extra_ms_by_protocol.get(protocol, 0.0)) / period_ms
        )

    def missing_sensor_ticks(self, hand: Hand, fault: str, period_ms: float) -> int:
        """Return the number of additional ticks that a hand without some sensors may take to react to a fault.

        Args:
            hand: description of the simulated hand.
            fault: text of the fault, in which the place holders are filled in.
            period_ms: control period [ms].
        """
        ticks = 0
        node = hand.sensor_node
        if not node.tendons:
            ticks += self.extra_sensor_frames * (node.joint_decimation - 1)
        if _lacks_load_cell(hand, fault):
            ticks += math.ceil(self.extra_ms_without_load_cell / period_ms)
        return ticks


class FaultScenario(NamedTuple):
    """Row of the fault matrix, with one affected part of the hand and one stage of the run.

    Attributes:
        row: row of the fault matrix.
        fault: fault text of the row, in which the place holders are filled in.
        stage: stage of the run at which the fault is injected.
        second_fault: text of the second fault of a pair. The text is empty for a single fault.
        missing_sensor_ticks: addition to the time limit of the row, see ``FaultMatrixRow.missing_sensor_ticks``.
    """

    row: FaultMatrixRow
    fault: str
    stage: str
    second_fault: str = ""
    missing_sensor_ticks: int = 0

    @property
    def id(self) -> str:
        """Return the identifier of the row that the scenario tests."""
        return self.row.id

    @property
    def name(self) -> str:
        """Return the text that describes the scenario in reports."""
        return (
            f"{self.row.id} {self.fault}"
            + (f" + {self.second_fault}" if self.second_fault else "")
            + f", {self.stage}"
        )


WARN = SafetyAction.WARN
HOLD = SafetyAction.HOLD
RELAX = SafetyAction.RELAX
CUT = SafetyAction.CUT
SINGLE_ANSWER_PROTOCOLS = (MIT, CIA402, MOTEUS, ROBSTRIDE)
"""Protocols whose drives send exactly one answer to each command."""
READBACK_PROTOCOLS = (MIT, ODRIVE, MOTEUS, ROBSTRIDE)
"""Protocols by which the host can read a drive's temperature, and detect that a drive receives no commands."""
PROTOCOLS_WITH_11_BIT_IDS = (MIT, ODRIVE, CIA402)
"""Protocols whose drives answer with 11-bit identifiers."""

_EXCHANGED_DRIVE_FAULTS = ("N14", "N05", "N06", "T04", "T02", "N04", "T03")
"""Faults that can be detected earlier than N17 if two drives are exchanged, in motion or at unequal tensions."""

_TORN_TENDON_FAULTS = ("T08", "N06")
"""Faults that show that joint and spool do not move together.

After a tendon has torn, the controller can report these faults in place of T01 and T02.
"""

FAULT_MATRIX: tuple[FaultMatrixRow, ...] = (
    FaultMatrixRow("B01", "drop node={node} for=2500us", WARN, 2, accepted_faults=("B01", "N02"), stages=ALL_STAGES),
    FaultMatrixRow("B02", "drop bus={bus}", RELAX, 1, 30.0, ("B02", "N02", "B17"), ALL_STAGES),
    FaultMatrixRow("B03", "drop node={node} p=0.3 seed=3", HOLD, 102, 0.0, ("B03", "B17", "N02"),
        protocols=SINGLE_ANSWER_PROTOCOLS),
    FaultMatrixRow("B03", "drop node={node} p=0.6 seed=3", HOLD, 102, 0.0, ("B03", "B17", "N02", "N11"),
        protocols=(ODRIVE,)),
    FaultMatrixRow("B03", "replay node=sensors size=16", RELAX, 102, 0.0, ("B03", "N02", "B04")),
    # A delayed frame shows the fault only when the frame arrives.
    FaultMatrixRow("B04", "delay node=sensors size={late} for=20ms", WARN, 4, accepted_faults=("B04",),
        scales_with_period=True),
    FaultMatrixRow("B05", "duplicate node={node}", WARN, 2, accepted_faults=("B05", "N13", "B06"),
              protocols=SINGLE_ANSWER_PROTOCOLS),
    FaultMatrixRow("B05", "duplicate node=sensors", WARN, 2, accepted_faults=("B05",)),
    FaultMatrixRow("B06", "twin node={node}", RELAX, 2, accepted_faults=("B06",), protocols=SINGLE_ANSWER_PROTOCOLS),
    FaultMatrixRow("B06", "twin node=sensors", RELAX, 2, accepted_faults=("B06",)),
    # If a fault exchanges two frames, the first frame comes after the second frame, so the detector
    # needs two frames.
    FaultMatrixRow("B07", "reorder node=sensors", WARN, 2, accepted_faults=("B07",), extra_sensor_frames=1),
    FaultMatrixRow("B08", "shorten node={node}", RELAX, 4, accepted_faults=("B08", "B17")),
    FaultMatrixRow("B09", "shorten node={node} for=3ms", WARN, 2, accepted_faults=("B09",)),
    FaultMatrixRow("B09", "extend node={node} for=3ms", WARN, 2, accepted_faults=("B09",),
        protocols=PROTOCOLS_WITH_11_BIT_IDS),
    FaultMatrixRow("B10", "unknown bus={bus}", WARN, 2, 51.0, ("B10",), ALL_STAGES),
    FaultMatrixRow("B11", "flood bus={bus} size=100", RELAX, 3, accepted_faults=("B11",)),
    FaultMatrixRow("B11", "flood bus={bus} size=101", CUT, 11, accepted_faults=("B11b", "B11a")),
    FaultMatrixRow("B12", HOST_FAULT_PREFIX + "io bus_off", CUT, 1, accepted_faults=("B12",), stages=ALL_STAGES),
    FaultMatrixRow("B13", HOST_FAULT_PREFIX + "io error_warning", WARN, 1, accepted_faults=("B13a",)),
    FaultMatrixRow("B13", HOST_FAULT_PREFIX + "io error_passive lasting", RELAX, 21, accepted_faults=("B13b",)),
    FaultMatrixRow("B14", HOST_FAULT_PREFIX + "io enetdown", CUT, 1, accepted_faults=("B14",), stages=ALL_STAGES),
    FaultMatrixRow("B15", HOST_FAULT_PREFIX + "io enobufs lasting", RELAX, 3, accepted_faults=("B15",)),
    FaultMatrixRow("B16", HOST_FAULT_PREFIX + "io enodev", CUT, 1, accepted_faults=("B16",), stages=ALL_STAGES),
    FaultMatrixRow("B17", "deaf node={node}", RELAX, 4, accepted_faults=("B17", "N08", "B02", "B03"),
        protocols=READBACK_PROTOCOLS,
        extra_ms_by_protocol={ODRIVE: 160.0}),
    FaultMatrixRow("B17", "drop node={node}", RELAX, 4, accepted_faults=("B17",)),
    # N12: the read-back of the settings can show the restart of a drive before the drive reports
    # the restart.
    FaultMatrixRow("N01", "reset node={node}", RELAX, 2, accepted_faults=("N01", "N11", "N12", "B17"),
        extra_ms_by_protocol=REPORT_DELAY_MS, extra_ticks=DRIVE_RESTART_TICKS),
    FaultMatrixRow("N01", "reset node={node}", RELAX, 2, accepted_faults=("N01", "N11", "B17"), stages=(ARMING_STAGE,),
        protocols=(MIT, CIA402, ROBSTRIDE),
        extra_ticks=DRIVE_RESTART_TICKS),
    # Without load cells, only the frames of the joint encoders are missed, and the sensor node does
    # not send these frames in each tick.
    FaultMatrixRow("N02", "drop node=sensors", RELAX, 1, 30.0, ("N02",), ALL_STAGES, extra_sensor_frames=3),
    FaultMatrixRow("N02", "off node={node}", RELAX, 5, accepted_faults=("B17", "B02", "N01"), stages=ALL_STAGES),
    # Without load cells, the position loop is softer, and the motor reaches its goal later.
    FaultMatrixRow("N04", "stuck encoder={node}", RELAX, 2, 500.0, ("N04", "T04", "N05", "N06", "T08"),
        (FREE_MOTION_STAGE,), extra_ms_without_load_cell=100.0),
    FaultMatrixRow("N04", "stuck joint={joint}", RELAX, 2, 500.0, ("N04", "N06", "T08"), (FREE_MOTION_STAGE,),
        extra_sensor_frames=3),
    FaultMatrixRow("N05", "offset encoder={node} size={jump}", RELAX, 3, accepted_faults=("N05",)),
    FaultMatrixRow("N06", "drift joint={joint} size=0.8", RELAX, 4, 900.0, ("N06", "T08")),
    FaultMatrixRow("N07", "noise encoder={node} size={rough}", HOLD, 4, 60.0, ("N07", "N05")),
    FaultMatrixRow("N08", "watchdog node={node}", RELAX, 2, accepted_faults=("N08",), stages=ALL_STAGES,
        protocols=(MIT, ODRIVE, CIA402, MOTEUS),
        extra_ms_by_protocol=REPORT_DELAY_MS),
    FaultMatrixRow("N08", "watchdog node={node}", RELAX, 2, accepted_faults=("N08", "N01"), stages=ALL_STAGES,
        protocols=(ROBSTRIDE,)),
    FaultMatrixRow("N09", "hot node={node} size=95", RELAX, 22, accepted_faults=("N09b",), protocols=READBACK_PROTOCOLS,
        extra_ms_by_protocol={ODRIVE: 200.0}),
    FaultMatrixRow("N09", "hot node={node} size=80", WARN, 22, accepted_faults=("N09a",), protocols=READBACK_PROTOCOLS,
        extra_ms_by_protocol={ODRIVE: 200.0}),
    FaultMatrixRow("N10", "voltage node={node}", RELAX, 2, accepted_faults=("N10",), stages=ALL_STAGES,
        extra_ms_by_protocol=REPORT_DELAY_MS),
    FaultMatrixRow("N11", "error node={node}", RELAX, 2, accepted_faults=("N11",), stages=ALL_STAGES,
        extra_ms_by_protocol=REPORT_DELAY_MS),
    FaultMatrixRow("N11", "error node={node} size=3", CUT, 2, accepted_faults=("N11b",), protocols=(MIT,)),
    FaultMatrixRow("N11", "error node={node} size=0xff01", CUT, 2, accepted_faults=("N11b",), protocols=(CIA402,)),
    FaultMatrixRow("N11", "error node={node} size=0x20000000", CUT, 2, accepted_faults=("N11b",), protocols=(ODRIVE,),
        extra_ms_by_protocol=REPORT_DELAY_MS),
    FaultMatrixRow("N11", "error node={node} size=60", CUT, 2, accepted_faults=("N11b",), protocols=(MOTEUS,)),
    FaultMatrixRow("N11", "error node={node} size=0x4000", CUT, 2, accepted_faults=("N11b",), protocols=(ROBSTRIDE,)),
    FaultMatrixRow("N12", "forget node={node}", CUT, 4, 1000.0, ("N12",), protocols=(MIT, ODRIVE, CIA402, ROBSTRIDE)),
    # Every command of the drive protocol of this row contains the torque limit and the watchdog
    # time. After a restart, the drive also forgets its position limits. The default position limits
    # make the drive remove its torque. The controller reports the removed torque as N14 (a command
    # is not obeyed). At the edge of its default position limits, the drive also pulls for some
    # ticks. The slack tendon that the drive then winds up looks like a torn tendon (T01).
    FaultMatrixRow("N12", "forget node={node}", RELAX, 4, 1000.0, ("N12", "N14", "T01"), protocols=(MOTEUS,)),
    # If a drive restarts before its first answer to the enable command, the restart looks like a
    # lost command. The controller recognises the restart by the settings that the drive has lost.
    FaultMatrixRow("N12", "reset node={node}", RELAX, 4, 1000.0, ("N12", "N01", "N14"), (ARMING_STAGE,), (MOTEUS,)),
    FaultMatrixRow("N13", "twin node={node} seed=1", RELAX, 2, accepted_faults=("B06", "N13"),
              protocols=SINGLE_ANSWER_PROTOCOLS),
    FaultMatrixRow("N13", "duplicate node={node} seed=1", RELAX, 4, accepted_faults=("N13", "B06"),
              protocols=SINGLE_ANSWER_PROTOCOLS),
    # A load cell shows that the tension of a disobedient drive is missing. Without a load cell, the
    # check for the fault N17 finds the drive within the time constant of the comparison, although
    # the torque command of the drive is smaller than the thresholds of N14. N14 compares low-passed
    # forces, so its detection takes the same time at every control rate.
    FaultMatrixRow("N14", "disobey node={node} size=0", RELAX, 22, accepted_faults=("N14", "T02", "T04", "N17"),
        stages=(GRASP_STAGE,), protocols=SINGLE_ANSWER_PROTOCOLS, extra_ms_without_load_cell=250.0,
        scales_with_period=True),
    FaultMatrixRow("N14", "runaway node={node}", RELAX, 10, accepted_faults=("N14", "T03", "N05", "T04")),
    FaultMatrixRow("N14", "ripple node={node} size=0.2 hz=20", RELAX, 22, 600.0,
        ("N14b", "T03", "N07", "T01", "N17", "N14"), (GRASP_STAGE,), needs_prompt_torque=True),
    FaultMatrixRow("N15", "slow node={node} size=2", WARN, 22, accepted_faults=("N15",),
        protocols=SINGLE_ANSWER_PROTOCOLS),
    FaultMatrixRow("N15", "slow node={node} size=4", WARN, 4, accepted_faults=("B01",), protocols=(ODRIVE,)),
    # An ODrive reports its torque in a separate frame. After a CUT, an ODrive sends no torque
    # frame.
    FaultMatrixRow("N16", "hold_on node={node}", CUT, 2, 100.0, ("N16",), (GRASP_STAGE,),
        needs_prompt_torque=True),
    FaultMatrixRow("N17", "swap node={node} with={other}", RELAX, 2, 1000.0, ("N17", *_EXCHANGED_DRIVE_FAULTS),
        protocols=SINGLE_ANSWER_PROTOCOLS),
    FaultMatrixRow("N17", "cross node={node} with={other}", RELAX, 2, 1000.0, ("N17", *_EXCHANGED_DRIVE_FAULTS),
        protocols=SINGLE_ANSWER_PROTOCOLS),
    FaultMatrixRow("N17", "late node={node} size=50", RELAX, 2, 4000.0, ("N17", *_EXCHANGED_DRIVE_FAULTS),
        protocols=SINGLE_ANSWER_PROTOCOLS),
    # While a grasp is at rest, the velocity limit of ODrive drives hides that two drives have been
    # exchanged.
    FaultMatrixRow("N17", "swap node={node} with={other}", RELAX, 2, 1000.0, ("N17", *_EXCHANGED_DRIVE_FAULTS),
        (FREE_MOTION_STAGE,), (ODRIVE,)),
    FaultMatrixRow("N17", "cross node={node} with={other}", RELAX, 2, 2000.0, ("N17", *_EXCHANGED_DRIVE_FAULTS),
        (FREE_MOTION_STAGE,), (ODRIVE,)),
    # Without a load cell, a torn tendon is visible only after the joint and the spool have moved
    # apart. If the torque command of a motor is smaller than the friction of the motor, the spool
    # does not turn. If the spool does not turn, the joint moves slowly, and the filter in the
    # detector of the fault N06b takes 0.3 s more.
    FaultMatrixRow("T01", "snap tendon={tendon}", RELAX, 10, accepted_faults=("T01", *_TORN_TENDON_FAULTS),
        stages=(GRASP_STAGE,), extra_ms_without_load_cell=500.0),
    FaultMatrixRow("T02", "snap tendon={tendon}", WARN, 4, 110.0, ("T02", "T01", "N04", *_TORN_TENDON_FAULTS),
        (FREE_MOTION_STAGE,),
        extra_ms_without_load_cell=100.0),
    FaultMatrixRow("T02", "slack tendon={tendon} size=30", WARN, 10,
        accepted_faults=("T02", "T01", *_TORN_TENDON_FAULTS),
        stages=(GRASP_STAGE,), extra_ms_without_load_cell=500.0),
    FaultMatrixRow("T03", "offset cell={tendon} size={trip}", RELAX, 2, accepted_faults=("T03",),
        stages=(GRASP_STAGE,)),
    FaultMatrixRow("T03", "offset cell={tendon} size={limit}", CUT, 2, accepted_faults=("T03b",),
        stages=(GRASP_STAGE,)),
    FaultMatrixRow("T03", "runaway node={node} size=1 seed=1", RELAX, 10, accepted_faults=("T03", "N14", "T06"),
        stages=(GRASP_STAGE,)),
    FaultMatrixRow("T04", "drift cell={tendon} size=60", RELAX, 2, 500.0, ("T04", "T03", "N14", "T02"),
        (GRASP_STAGE,)),
    FaultMatrixRow("T04", "drift cell={tendon} size=-60", RELAX, 2, 500.0, ("T04", "T02", "T01"), (GRASP_STAGE,)),
    FaultMatrixRow("T05", "stuck cell={tendon}", RELAX, 42, accepted_faults=("T05", "T04"), stages=(GRASP_STAGE,),
        force_change_N=STUCK_CELL_FORCE_RANGE_N + FORCE_RANGE_ERROR_N),
    FaultMatrixRow("T05", "old cell={tendon} size=16", RELAX, 20, accepted_faults=("T05b",)),
    FaultMatrixRow("T05", "old cell={tendon} size=50", RELAX, 20, accepted_faults=("T05b",)),
    FaultMatrixRow("T06", "saturate cell={tendon} size=1", RELAX, 4, accepted_faults=("T06",), stages=ALL_STAGES),
    FaultMatrixRow("T06", "saturate cell={tendon} size=-1", RELAX, 4, accepted_faults=("T06", "T01"),
        stages=ALL_STAGES),
    FaultMatrixRow("T08", "offset joint={joint} size=0.5", RELAX, 8, 400.0, ("T08", "N06", "N05")),
    FaultMatrixRow("H01", HOST_FAULT_PREFIX + "late 0.4", SafetyAction.PASS, 1, accepted_faults=("H01",)),
    FaultMatrixRow("H02", HOST_FAULT_PREFIX + "skip 1", WARN, 1, accepted_faults=("H02",)),
    FaultMatrixRow("H03", HOST_FAULT_PREFIX + "skip {stall}", RELAX, 1, accepted_faults=("H03",)),
    FaultMatrixRow("H04", HOST_FAULT_PREFIX + "io suspended", RELAX, 1, accepted_faults=("H04",)),
    FaultMatrixRow("H06", HOST_FAULT_PREFIX + "ask stop", RELAX, 1, accepted_faults=("",), stages=ALL_STAGES),
    FaultMatrixRow("H06", HOST_FAULT_PREFIX + "ask cut", CUT, 1, accepted_faults=("",), stages=ALL_STAGES),
    FaultMatrixRow("H08", HOST_FAULT_PREFIX + "io recorder disk_full", WARN, 1, accepted_faults=("H08",)),
    FaultMatrixRow("H09", HOST_FAULT_PREFIX + "io recorder dropped", WARN, 1, accepted_faults=("H09",)),
    FaultMatrixRow("H10", HOST_FAULT_PREFIX + "io recorder gone", WARN, 1, accepted_faults=("H10",)),
    FaultMatrixRow("H13", "foreign node={node}", RELAX, 2, accepted_faults=("H13",), stages=ALL_STAGES),
    FaultMatrixRow("I07", HOST_FAULT_PREFIX + "ask nonsense 3", RELAX, 1, accepted_faults=("I07b",)),
)  # fmt: skip
"""Rows for all faults that the simulator or the control loop can inject while the hand is armed."""

FAULT_IDS_TESTED_IN_PAIRS = (
    "B01",
    "B02",
    "B03",
    "B17",
    "N01",
    "N02",
    "N08",
    "N11",
    "T01",
    "T04",
    "T06",
    "H02",
)
"""Ids of the faults that are also tested in pairs.

The faults concern wires, connectors, supply, tendons and a busy host.
"""
TEST_PLACE_BY_UNTESTED_FAULT = {
    "B18": "before arming: unit tests with error frames", "N03": "before arming: tests of the modes",
    "T07": "commissioning: its own tests",
    "T09": "needs minutes of motion: tests of the residuals", "H05": "real processes: tests/runtime",
    "H07": "real processes: tests of the loop", "H11": "real processes, as root in a virtual machine: tests/vcan",
    "H12": "real processes",
    "H14": "real processes", "H15": "the soak",
}  # fmt: skip
"""Faults in sections 2.1 to 2.4 of the fault catalogue that the matrix lacks, each with the tests of the fault."""


def scenarios_of_hand(hand: Hand, protocol: str, period_ms: float) -> list[FaultScenario]:
    """Return the scenarios of every row of the matrix.

    Each row of the fault matrix is tested in all its stages. If the fault can affect several parts
    of the hand, such as motors, two tests are made: one with the first part, and one with the last
    part.

    Args:
        hand: description of the simulated hand.
        protocol: protocol of the drives.
        period_ms: control period [ms].
    """
    scenarios = []
    for row in FAULT_MATRIX:
        if protocol in row.protocols:
            fault_texts = fault_texts_for_hand(hand, row.fault, period_ms)
            first_and_last_texts = dict.fromkeys(fault_texts[:1] + fault_texts[-1:])
            scenarios += [
                FaultScenario(
                    row,
                    text,
                    stage,
                    missing_sensor_ticks=row.missing_sensor_ticks(hand, text, period_ms),
                )
                for stage in row.stages
                for text in first_and_last_texts
                if not (
                    row.needs_prompt_torque
                    and PROTOCOL_TRAITS[protocol].has_separate_torque_frame
                    and _lacks_load_cell(hand, text)
                )
            ]
    return scenarios


def fault_pairs(hand: Hand, protocol: str, period_ms: float) -> list[FaultScenario]:
    """Return the scenarios with two faults: one for every pair of the faults in `FAULT_IDS_TESTED_IN_PAIRS`.

    All scenarios with two faults happen during a grasp. The fault with the more severe reaction
    comes first. The second fault starts a few ticks later. Most faults can affect several parts of
    the hand, for example any one of the motors. The first fault is injected into the first part
    that this fault can affect. The second fault is injected into the last part that the second
    fault can affect. Some faults can affect only parts that the hand does not have, for example
    load cells. The function leaves out every pair that contains a fault of a missing part.
    `period_ms` is the control period [ms].
    """
    rows = [
        next(row for row in FAULT_MATRIX if row.id == id_ and protocol in row.protocols)
        for id_ in FAULT_IDS_TESTED_IN_PAIRS
    ]
    scenarios = []
    for i, first_row in enumerate(rows):
        for second_row in rows[i + 1 :]:
            # If two faults are present, the controller must react as if only the more severe fault
            # were present.
            main_row, other_row = (
                (first_row, second_row)
                if first_row.action >= second_row.action
                else (second_row, first_row)
            )
            texts = fault_texts_for_hand(hand, main_row.fault, period_ms)
            second_fault_texts = fault_texts_for_hand(hand, other_row.fault, period_ms)
            if texts and second_fault_texts:
                extra_ticks = main_row.missing_sensor_ticks(hand, texts[0], period_ms)
                scenarios.append(
                    FaultScenario(
                        main_row, texts[0], GRASP_STAGE, second_fault_texts[-1], extra_ticks
                    )
                )
    return scenarios


def fault_texts_for_hand(hand: Hand, fault: str, period_ms: float) -> list[str]:
    """Return the text of a fault for each part of the hand that the fault can affect.

    If the hand has no part that the fault can affect, the list is empty.
    """
    value_by_placeholder = {
        # The number of missed ticks is one more than in the shortest stall of the host that counts
        # as a fault.
        "stall": tick_count_for_time(MAX_STALL_S, period_ms * 1e-3, MIN_STALLED_TICKS) + 1,
        "late": max(MIN_LATE_DELAY_MS, MIN_LATE_DELAY_TICKS * period_ms),
        "jump": POSITION_JUMP_RAD * max(1.0, period_ms / POSITION_JUMP_PERIOD_MS),
        "rough": POSITION_NOISE_RAD * max(1.0, (period_ms / POSITION_NOISE_PERIOD_MS) ** 2),
    }
    text_by_placeholder = {name: f"{size:g}" for name, size in value_by_placeholder.items()}
    return [
        fault.format(**text_by_placeholder, **part_texts)
        for part_texts in _placeholder_values(hand, fault)
    ]


def _placeholder_values(hand: Hand, fault: str) -> list[dict[str, str]]:
    """Return a list of placeholder values: one dict for each part of the hand that a fault can affect.

    If the fault text has no placeholder for a part, the list has one element.
    """
    if "{tendon}" in fault:
        has_limit = "{trip}" in fault or "{limit}" in fault
        is_load_cell_fault = "cell={tendon}" in fault
        return [
            {
                "tendon": tendon.name,
                "trip": f"{tendon.tension_trip_N:g}",
                "limit": f"{tendon.drive_limit_N:g}",
            }
            for tendon in hand.tendon
            if not is_load_cell_fault or tendon.name in hand.sensor_node.tendons
            # The controller would report a trip tension near the end of the load cell's range as
            # saturation.
            if not has_limit or tendon.tension_trip_N < MAX_READABLE_TRIP_N
        ]
    if "{other}" in fault:
        motors = [motor.name for motor in hand.motor]
        return [{"node": motor, "other": next_motor} for motor, next_motor in pairwise(motors)]
    names = {
        "node": [motor.name for motor in hand.motor],
        "digit": list(hand.digit_names),
        "bus": list(hand.bus_names),
        "joint": list(hand.sensor_node.joints),
    }
    return next(
        ([{key: name} for name in names[key]] for key in names if f"{{{key}}}" in fault), [{}]
    )


def parse_fault_text(fault: str) -> dict[str, str]:
    """Return the KEY=VALUE words of a fault text, by key."""
    return dict(word.split("=", 1) for word in fault.split() if "=" in word)


def _lacks_load_cell(hand: Hand, fault: str) -> bool:
    """Return True if a fault concerns a tendon without load cell, or the motor of such a tendon."""
    words = parse_fault_text(fault)
    names = (words.get("tendon"), words.get("node"), words.get("encoder"))
    return any(
        not has_cell and (tendon.name in names or tendon.motor in names)
        for tendon, has_cell in zip(hand.tendon, hand.has_cell.tolist(), strict=True)
    )
