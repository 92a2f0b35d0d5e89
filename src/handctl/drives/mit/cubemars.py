"""A CubeMars AK motor in MIT mode: commands as Damiao motors have them, and little that tells what became of them.

It has no registers, no watchdog, and no word for enabled or disabled in its feedback, which comes on the identifier of
the command. So a motor counts as enabled once it has answered the order to enable, and as disabled once it has
answered the order to disable several times and reports no torque. Disable is also what it is polled by: nothing else
gets an answer that cannot make torque. What nobody can verify stands in ``caveats``.
Source: facts, mit_damiao (variants).
"""

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from handctl.drives.causes import Cause
from handctl.drives.contract import NEVER_NS, UNSTEADY, DriveState, Phase, Want
from handctl.drives.description import MotorDescription
from handctl.drives.frame import Frame
from handctl.drives.mit import codec
from handctl.drives.signals import Cyclic, Quantity, Signal, Table
from handctl.errors import ConfigError

LISTEN, POLL, ENABLE, DISABLE = Want
SILENT, CONFIGURING, READY, ENABLED, FAULT = Phase
MODELS = {
    "ak60-6": codec.Ranges(12.5, 50.0, 15.0),
    "ak70-10": codec.Ranges(12.5, 50.0, 25.0),
    "ak80-6": codec.Ranges(12.5, 76.0, 12.0),
    "ak80-9": codec.Ranges(12.5, 50.0, 18.0),
    "ak10-9": codec.Ranges(12.5, 50.0, 65.0),
}
"""Full scale of the models. Source: CubeMars AK Series Actuator Driver Manual V1.0.8, 5.3."""
ERRORS = {
    1: "over-temperature",
    2: "over-current",
    3: "over-voltage",
    4: "under-voltage",
    5: "encoder error",
    6: "phase current imbalance",
}
"""Byte 7 of the feedback."""
CAUSES = {1: Cause.HOT, 3: Cause.VOLTAGE, 4: Cause.VOLTAGE} | dict.fromkeys((2, 5, 6), Cause.OTHER)
SIZES = (6, 8)
"""Of the feedback; six bytes on older firmware, without temperature and error."""
ANSWERS = 3
"""Answers to an order that make it count as obeyed; one may have been under way before."""
COLDEST_C = -40.0
"""What byte 6 counts from. Source: CubeMars AK Series Actuator Driver Manual, 5.3, its example of a reply; who reads it
as it is (TMotorCANControl does) is 40 degC too hot."""
QUIET = 0.02
"""Torque that counts as none, as a share of full scale: what a current sensor shows at rest."""
GONE_NS = 250_000_000
"""After this silence a motor counts as not heard of [ns]."""
CAVEATS = (
    "watchdog: CubeMars' MIT mode has none; a dead host leaves torque on",
    "has no torque limit below its model's full scale; torque_max_N_m is this host's alone",
    "does not tell whether it is enabled; "
    f"an answer to disable with at most {QUIET:.0%} of full-scale torque counts as disabled",
    "ranges cannot be read back; motor_type must be right",
    "temperature counts from -40 degC by the manual; a cold motor that reads below zero needs temperature_offset_C = 0",
)


class Progress(NamedTuple):
    """What is kept in ``DriveState.private``.

    Attributes:
        order: the last order, ENABLE or DISABLE.
        since_ns: since when it is given [ns].
        answers: how often it was answered as it should be, in a row.
        asked: whether it was told to enable, and has not been found without torque since.
    """

    order: Want = DISABLE
    since_ns: int = -1
    answers: int = 0
    asked: bool = False


def progress_of(state: DriveState) -> Progress:
    """Return the private part of a state."""
    progress: Progress = state.private
    return progress


@dataclass(frozen=True, slots=True)
class CubemarsDrive:
    """One motor; implements ``contract.Drive``.

    Attributes:
        name: the motor's name.
        bus: index of its bus.
        node_id: its number, and the identifier of commands and feedback.
        ranges: full scale of its model.
        torque_limit: largest torque that can be commanded [N m].
        direction: 1 if positive torque of the motor winds.
        zero: motor angle of the spool's zero [rad].
        coldest: what byte 6 of the feedback counts from [degC].
        sent, heard: tables of its cyclic frames; follow from the others.
    """

    name: str
    bus: int
    node_id: int
    ranges: codec.Ranges
    torque_limit: float
    direction: int
    zero: float
    coldest: float
    sent: Table = field(init=False, repr=False, compare=False)
    heard: Table = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        sent = codec.command_message(self.node_id, self.ranges, self.direction)
        heard = codec.feedback_message(self.node_id, self.ranges, self.direction, self.zero)
        state, position, velocity, torque, _, _ = heard.signals
        own = (
            state._replace(name="node"),
            position,
            velocity,
            torque,
            Signal("temperature", Quantity.TEMPERATURE, 55, 8, True, offset=self.coldest, unit="degC"),
            Signal("error", Quantity.STATUS, 63, 8, True),
        )
        object.__setattr__(self, "sent", Table(sent._replace(limit=self.torque_limit)))
        object.__setattr__(self, "heard", Table(heard._replace(signals=own)))

    @staticmethod
    def of(motor: MotorDescription, bus: int) -> "CubemarsDrive":
        """The drive of a motor description, whose ranges of position and velocity do not count: the model's do.

        Raises:
            ConfigError: no such model, or more torque than it has.
        """
        options, where = dict(motor.options), f"motor[{motor.name}]"
        model: Any = options.pop("motor_type", None)
        if model not in MODELS:
            what = "missing" if model is None else repr(model)
            raise ConfigError(what, f"{where}.options.motor_type", "one of " + ", ".join(MODELS))
        coldest = options.pop("temperature_offset_C", COLDEST_C)
        if isinstance(coldest, bool) or coldest not in (COLDEST_C, 0.0):
            raise ConfigError(repr(coldest), f"{where}.options.temperature_offset_C", f"{COLDEST_C:g} or 0")
        if options:
            known = "motor_type or temperature_offset_C"
            raise ConfigError("unknown key", f"{where}.options.{next(iter(options))}", known)
        ranges = MODELS[model]
        if motor.torque_max_N_m > ranges.torque:
            raise ConfigError(f"{motor.torque_max_N_m:g}", f"{where}.torque_max_N_m", f"at most {ranges.torque:g}")
        most, zero = motor.torque_max_N_m, motor.zero_rad
        return CubemarsDrive(motor.name, bus, motor.node_id, ranges, most, motor.direction, zero, float(coldest))

    @property
    def exchange(self) -> tuple[tuple[int, bool], ...]:
        """Command and answer."""
        return ((8, False), (8, False))

    @property
    def background(self) -> tuple[tuple[int, bool, float], ...]:
        """Nothing: it speaks only when spoken to."""
        return ()

    @property
    def host_ids(self) -> frozenset[int]:
        """Commands; feedback has the same identifier, so nobody can tell a second host by it."""
        return frozenset((self.node_id,))

    @property
    def node_ids(self) -> frozenset[int]:
        """Feedback."""
        return frozenset((self.node_id,))

    @property
    def caveats(self) -> tuple[str, ...]:
        """What this motor cannot tell."""
        return CAVEATS

    @property
    def answers_once(self) -> bool:
        """It speaks only when spoken to."""
        return True

    @property
    def position_step(self) -> float:
        """16 bit over its model's range, both ways."""
        return self.ranges.position_step

    @property
    def feedback_period_s(self) -> float:
        """Every command asks for it."""
        return 0.0

    @property
    def cyclic(self) -> Cyclic:
        """Command and answer."""
        return Cyclic((self.heard.message,), (self.sent.message,))

    def steady_status(self, state: DriveState) -> int:
        """Return number and error of the usual feedback."""
        progress: Progress = state.private
        enabled = state.phase == ENABLED and progress.order == ENABLE and progress.answers >= ANSWERS
        return (self.node_id & 0xFF) << 8 if enabled else UNSTEADY

    def due_ns(self, state: DriveState) -> int:
        """Return never: nothing can be read from it."""
        return NEVER_NS

    def initial(self) -> DriveState:
        """Silent."""
        return DriveState(private=Progress())

    def receive(self, state: DriveState, frame: Frame) -> DriveState:
        """See ``contract.Drive``."""
        can_id, data, _, bus, t_ns = frame
        if can_id != self.node_id or bus != self.bus:
            return state
        if len(data) not in SIZES or data[0] != self.node_id & 0xFF:
            return state._replace(misread=state.misread + 1)
        _, position, velocity, torque, temperature, byte = self.heard.unpack(data)
        if len(data) < 8:
            temperature, byte = math.nan, 0.0
        error = int(byte)
        heard = state._replace(
            position=position,
            velocity=velocity,
            torque=torque,
            temperature=temperature,
            feedback_t_ns=t_ns,
            feedback_count=state.feedback_count + 1,
        )
        known = self._answered(heard, state.private)
        if not error:
            return known
        disabling = known.phase == ENABLED and progress_of(known).order == DISABLE
        told = known._replace(error=error, error_text=ERRORS.get(error, f"unknown error {error}"))
        return told if disabling else told._replace(phase=FAULT)

    def _answered(self, state: DriveState, progress: Progress) -> DriveState:
        """What an answer to the present order means."""
        if state.feedback_t_ns < progress.since_ns:
            return state
        if progress.order == ENABLE:
            if progress.answers >= ANSWERS:
                return state  # as before: more answers say nothing new
            done = state.phase != FAULT and progress.answers + 1 >= ANSWERS
            return state._replace(
                phase=ENABLED if done else state.phase, private=progress._replace(answers=progress.answers + 1)
            )
        quiet = abs(state.torque) <= QUIET * self.ranges.torque
        progress = progress._replace(answers=progress.answers + 1 if quiet else 0)
        if progress.answers < ANSWERS:
            heard = CONFIGURING if state.phase == SILENT else state.phase
            return state._replace(phase=heard, private=progress)
        phase = FAULT if state.error else READY
        return state._replace(phase=phase, private=progress._replace(asked=False))

    def advance(self, state: DriveState, t_ns: int, want: Want, torque: float) -> tuple[DriveState, tuple[Frame, ...]]:
        """See ``contract.Drive``."""
        progress: Progress = state.private
        if state.phase == ENABLED and want == ENABLE and progress.order == ENABLE:
            return state, (self._frame(self._torque(torque)),)
        if want == LISTEN:
            return state, ()
        if state.phase == READY and t_ns - state.feedback_t_ns > GONE_NS and not progress.asked:
            state = state._replace(phase=SILENT)
        if want == ENABLE and state.phase == READY:
            return self._order(state, ENABLE, t_ns), (self._frame(codec.special(codec.ENABLE)),)
        phase = ENABLED if progress.asked and (want == DISABLE or state.phase != FAULT) else state.phase
        return self._order(state._replace(phase=phase), DISABLE, t_ns), self.cut()

    def _order(self, state: DriveState, order: Want, t_ns: int) -> DriveState:
        """The state with an order given; what it is told anew has not been answered yet."""
        progress: Progress = state.private
        if progress.order == order and progress.since_ns >= 0:
            return state
        asked = progress.asked or order == ENABLE
        return state._replace(private=Progress(order, t_ns, 0, asked))

    def _torque(self, torque: float) -> bytes:
        """Return the payload of a pure torque command.

        Args:
            torque: at the spool [N m].

        Raises:
            ValueError: not finite, or beyond the limit.
        """
        try:
            return self.sent.pack(torque)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}") from None

    def cut(self) -> tuple[Frame, ...]:
        """Disable at once."""
        return (self._frame(codec.special(codec.DISABLE)),)

    def clear(self, state: DriveState) -> tuple[DriveState, tuple[Frame, ...]]:
        """Forget the error; there is no frame that clears it, and a motor that still has it says so again."""
        progress: Progress = state.private
        fresh = state._replace(phase=SILENT, error=0, error_text="", private=Progress(asked=progress.asked))
        return fresh, self.cut()

    def leave(self, state: DriveState) -> tuple[Frame, ...]:
        """Nothing: it has no watchdog that would miss this host."""
        return ()

    def identity(self, state: DriveState) -> str:
        """Its number: it tells no serial number."""
        return f"node {self.node_id}"

    def cause(self, error: int) -> Cause:
        """See ``contract.Drive``."""
        return CAUSES.get(error, Cause.UNKNOWN)

    def _frame(self, data: bytes) -> Frame:
        return Frame(self.node_id, data, 0, self.bus)
