"""What safety may know of one tick, and the thresholds of one hand."""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from handctl.drives.causes import Cause

Named = tuple[tuple[str, float], ...]
"""Instances and the value that each shows."""

SILENT_S, STALLED_S = 0.030, 0.025
"""How long a node may be silent, and the host stand still: less than the drives' watchdog of 50 ms."""
LEAST_SILENT, LEAST_STALLED = 4, 3
"""The same in ticks at least, for slow rates."""
LEAST_FRAMES = 64
"""Frames in one tick that no hand of few motors sends."""


def ticks_for(seconds: float, period: float, least: int) -> int:
    """A time as whole ticks of a period [s], at least ``least``."""
    return max(least, math.ceil(seconds / period))


@dataclass(frozen=True, slots=True)
class Limits:
    """Thresholds of one hand.

    Attributes:
        tendons: names, (N,).
        tension_trip: (N,) tension of one sample that means relax [N].
        tension_rail: reading at which a load cell is saturated [N].
        tension_low: reading, after any tare, that no rope can make: a broken wire or a sensor without supply [N].
        motors: names, (M,).
        drive_limit: (N,) tension that the drive's own torque limit can make; above it, cut [N].
        silent_ticks: replies in a row that may be missing before a node counts as silent.
        one_silent_ticks: the same for a motor while another one answers.
        stalled_ticks: ticks in a row that may be missed before the host counts as standing still.
        temperature_hard: of a drive [degC].
        temperature_soft: of a drive [degC].
        frames_most: frames in one tick that are more than all nodes together can have sent; of a big hand more.
        trip_least: tension below which no tendon's limit is met [N].
        warm_least: temperature below which no drive is warm [degC].
        noise_most: mean squared jerk of a motor's position that means a noise burst [rad^2].
    """

    tendons: tuple[str, ...]
    tension_trip: tuple[float, ...]
    tension_rail: float
    motors: tuple[str, ...]
    tension_low: float = -math.inf
    drive_limit: tuple[float, ...] = ()
    silent_ticks: int = 4
    one_silent_ticks: int = LEAST_SILENT
    stalled_ticks: int = 3
    temperature_soft: float = 70.0
    temperature_hard: float = 85.0
    frames_most: int = LEAST_FRAMES
    noise_most: float = math.inf
    trip_least: float = field(init=False, default=math.inf)
    warm_least: float = field(init=False, default=math.inf)

    def __post_init__(self) -> None:
        object.__setattr__(self, "trip_least", min((*self.tension_trip, *self.drive_limit), default=math.inf))
        object.__setattr__(self, "warm_least", min(self.temperature_soft, self.temperature_hard))

    @property
    def nodes(self) -> tuple[str, ...]:
        """All that answers in every tick: the motors, then the load cells."""
        return (*self.motors, LOAD_CELLS)


LOAD_CELLS = "load cells"
"""The sensor node among the nodes."""


class Signals(NamedTuple):
    """What safety may know of one tick; an empty tuple stands for nothing to be seen, e.g. no value near a threshold.

    Attributes:
        armed: whether torque may be acting; node faults count only then.
        missed: ticks that were skipped before this one.
        late: how late this tick began, as a share of the period.
        motor_age: (M,) whole ticks since the tick that should have brought feedback; 0 is on time.
        sensor_age: likewise for the tension frames, (N,).
        tension: (N,) load-cell samples of this tick [N], NaN if missing.
        temperature: (M,) [degC], NaN if unknown.
        frames: frames received in this tick.
        heard: whether any node has ever answered.
        unknown: frames of unknown identifiers in the last second.
        relaxed: whether the hand has been relaxing for so long that no tension can be above its trip any more.
        drive_errors: (motor, code, cause) of every drive in fault; from here on all is seldom told.
        foreign: identifiers of the host seen from somebody else, and motors that answer somebody else, as text.
        io: (kind, where, number) of buses and host.
        misshapen: nodes with a frame of a wrong shape in this tick, and how many there were of late.
        twice: nodes that answered twice, and whether the second answer was another one (1) or the same (0).
        stale: nodes with an answer to an older question; 1 if the fresh one had come before it.
        lost: (M + 1,) answers missing of the last 100 ticks, motors and then load cells.
        halved: nodes that answer about every second tick only.
        jumped: motors and joints whose position made a step that no rotor makes [rad].
        jumping: those whose last reading but one was dropped, too.
        refused: live goals refused in the last second.
        limp: tendons whose tension did not fall after the torque was cut [N].
        snapped: tendons that lost their tension and whose spool runs [m/s].
        slack: tendons that should be taut, and since when they are not [s].
        residual: (N,) tension that motor torque, inertia and friction do not explain [N].
        disobeyed: (N,) tension between asked and made torque [N].
        friction: (N,) friction beyond what the hand file says [N].
        slip: (N,) joint encoders against spool, filtered, as a mean joint angle [deg].
        derailed: (N,) the same, unfiltered, where three readings in a row were beyond any stretch; else 0 [deg].
        noise: (M,) mean squared jerk of the motor's position [rad^2].
        stuck_motor: motors whose position stands although goal or tension moves; what moved [mm or N].
        stuck_joint: joints whose encoder stands although the spool moves [deg].
        stuck_cell: tendons whose load cell repeats itself although the motor's torque moves [N].
        unfollowed: motors whose reported torque does not change with the command; what part of the changes it reports.
        mute: joints whose encoder's frame has not come for as long as several of them take, and since when [s].
        replayed: tendons whose load cell tells what it told before, and how long before [ticks].
        swinging: tendons whose tension swings about what is commanded, and how far, RMS [N].
        railed: tendons whose load cell is at an end of its range, whatever it is tared to, and what it reads [N].
    """

    armed: bool
    missed: int = 0
    late: float = 0.0
    motor_age: tuple[int, ...] = ()
    sensor_age: tuple[int, ...] = ()
    tension: tuple[float, ...] = ()
    temperature: tuple[float, ...] = ()
    frames: int = 0
    heard: bool = True
    unknown: float = 0.0
    relaxed: bool = False
    drive_errors: tuple[tuple[str, int, Cause], ...] = ()
    foreign: tuple[str, ...] = ()
    io: tuple[tuple[str, str, int], ...] = ()
    misshapen: Named = ()
    twice: Named = ()
    stale: Named = ()
    lost: tuple[int, ...] = ()
    halved: tuple[str, ...] = ()
    jumped: Named = ()
    jumping: Named = ()
    refused: int = 0
    limp: Named = ()
    snapped: Named = ()
    slack: Named = ()
    residual: tuple[float, ...] = ()
    disobeyed: tuple[float, ...] = ()
    friction: tuple[float, ...] = ()
    slip: tuple[float, ...] = ()
    derailed: tuple[float, ...] = ()
    noise: tuple[float, ...] = ()
    stuck_motor: Named = ()
    stuck_joint: Named = ()
    stuck_cell: Named = ()
    unfollowed: Named = ()
    mute: Named = ()
    replayed: Named = ()
    swinging: Named = ()
    railed: Named = ()


FIRST_RARE = Signals._fields.index("drive_errors")
"""From this field on most ticks have nothing to tell."""
