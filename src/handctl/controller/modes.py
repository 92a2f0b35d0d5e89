"""Mode machine of the hand: from silence through inventory and arming to action, and back to a confirmed standstill.

SILENT -> INVENTORY -> READY -> ARMING -> ACTIVE -> RELAX -> DISARM -> DONE. CUT is reached from
every mode with torque. Each mode is a small function. The function returns the next mode, and the
reason of a failure.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from handctl.controller.relaxing import begin_relaxing, hurry, let_go, settled
from handctl.controller.state import State
from handctl.core.model import HandModel
from handctl.core.types import ACTING, BEFORE_ARMING, Event, Mode
from handctl.drives.contract import Drive, DriveState, DriveTarget, Phase
from handctl.drives.frame import Frame
from handctl.errors import REMOVE_POWER
from handctl.safety.action import Action

LISTEN_S = 0.5
"""Silence before the first frame, to notice a second controller [s]."""
INVENTORY_TIMEOUT_S = 3.0
LOOK_FIRST = " (when you have looked why: --clear)"
"""Advice for a drive with a latched error."""
STILL_LATCHED = " (or an error that does not clear)"
READY_S = 0.1
"""Time for a few measurements of the filter before arming [s]."""
ARMING_TIMEOUT_S = 1.0
RELAX_TIMEOUT_S = 1.0
DISARM_TIMEOUT_S = 1.0
CUT_S = 0.1
"""Duration of repeated cut frames [s]."""


@dataclass(frozen=True, slots=True)
class Wishes:
    """Stop and cut requests of the operator in the tick."""

    stop: bool = False
    cut: bool = False


class Circumstances(NamedTuple):
    """Inputs of the mode machine besides the state.

    Attributes:
        model: the hand.
        drives: of the motors.
        elapsed: time in the present mode [s].
        action: reaction demanded by safety.
        wishes: requests of the operator.
        foreign: signs of a second controller: identifiers only sent by a host, and replies of
            motors without a request of this host.
        identities: of the drives at calibration, as ``Drive.identity``. Empty
            where unknown.
    """

    model: HandModel
    drives: tuple[Drive, ...]
    elapsed: float
    action: Action
    wishes: Wishes
    foreign: tuple[str, ...]
    identities: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the motors."""
        return tuple(drive.name for drive in self.drives)

    @property
    def nothing_special(self) -> bool:
        """Return True if neither safety nor the operator overrides the mode."""
        return self.action < RELAX and not (self.foreign or self.wishes.stop or self.wishes.cut)


RELAX = Action.RELAX
Next = tuple[Mode, str]
"""The next mode, and the reason if the run has failed."""


def wanted_of_drives(mode: Mode) -> DriveTarget:
    """Return the target state of every drive in a mode."""
    return _WANTED[mode]


_WANTED = {
    Mode.SILENT: DriveTarget.LISTEN,
    Mode.INVENTORY: DriveTarget.POLL,
    Mode.READY: DriveTarget.POLL,
    Mode.ARMING: DriveTarget.ENABLE,
    Mode.ACTIVE: DriveTarget.ENABLE,
    Mode.RELAX: DriveTarget.ENABLE,
    Mode.DISARM: DriveTarget.DISABLE,
    Mode.CUT: DriveTarget.DISABLE,
    Mode.DONE: DriveTarget.LISTEN,
}


def farewell(drives: tuple[Drive, ...], state: State) -> tuple[Frame, ...]:
    """Return the frames for the release of the drives at the end of a run.

    No frames follow a failure: the drives stay as they are.
    """
    if state.mode != Mode.DONE or state.failure:
        return ()
    return tuple(
        frame for drive, known in zip(drives, state.drives, strict=True) for frame in drive.release_frames(known)
    )


def next_mode(
    model: HandModel,
    drives: tuple[Drive, ...],
    state: State,
    action: Action,
    wishes: Wishes,
    foreign: tuple[str, ...],
    t: float,
    identities: tuple[str, ...] = (),
) -> tuple[Event, ...]:
    """Decide and set the mode of the tick.

    Args:
        model: the hand.
        drives: of the motors.
        state: with the tick's drive and filter states, modified in place.
        action: reaction demanded by safety.
        wishes: requests of the operator.
        foreign: signs of a second controller, as text.
        t: time of the tick [s].
        identities: of the drives in the calibration. May be empty.

    Returns:
        The event of a change of mode. Empty without a change.
    """
    seen = Circumstances(model, drives, t - state.mode_since, action, wishes, foreign, identities)
    before = state.mode
    demanded = None if seen.nothing_special else _demanded(state, seen)
    mode, failure = demanded or _MODES[before](state, seen)
    if mode == before:
        if mode == Mode.RELAX:
            hurry(state)
        return ()
    failure = failure or ("" if state.failure else _latched(state))  # of a fault on the way home, too
    names = seen.names
    level = "error" if failure else "info"
    unconfirmed = _may_pull(model, state, names) if mode == Mode.DONE else ()
    text = f"{before.name} -> {mode.name}" + (f": {failure}" if failure else "")
    if unconfirmed and REMOVE_POWER not in text:  # whoever has ordered the stop reads nothing but this line
        text += f"; {REMOVE_POWER}: not confirmed disabled: {', '.join(unconfirmed)}"
    told = f"{state.failure}; {failure}" if state.failure and unconfirmed else state.failure or failure
    state.decide(failure=told, unconfirmed=unconfirmed)
    state.mode, state.mode_since = mode, t
    if mode == Mode.RELAX:
        begin_relaxing(model, state)
    return (Event(level, "mode", "", text),)


def _demanded(state: State, seen: Circumstances) -> Next | None:
    """Return the mode demanded by safety or the operator, else None."""
    acting = state.mode in ACTING
    if acting and (seen.wishes.cut or seen.action == Action.CUT):
        return Mode.CUT, _latched(state)
    if state.mode in _AWAY and seen.action == Action.RELAX:
        return _AWAY[state.mode], _latched(state)
    if state.mode in _AWAY and seen.wishes.stop:
        return _AWAY[state.mode], ""
    return _before_arming(state, seen) if state.mode in BEFORE_ARMING else None


def _before_arming(state: State, seen: Circumstances) -> Next | None:
    """Return the end of a run before any torque, None if the run continues."""
    if seen.wishes.stop or seen.wishes.cut:
        return Mode.DONE, ""
    if seen.foreign:
        return Mode.DONE, f"another controller is on the bus (heard: {', '.join(seen.foreign)})"
    return (Mode.DONE, _latched(state)) if seen.action >= Action.RELAX else None


_AWAY = {Mode.ARMING: Mode.DISARM, Mode.ACTIVE: Mode.RELAX}
"""Mode after a fault or a stop.

ARMING leads to DISARM: no tension was commanded yet, and no further drive may be enabled.
"""


def _latched(state: State) -> str:
    """Return the latched faults as the reason of a failure. May be empty."""
    if not state.latched:
        return ""
    return "fault " + ", ".join(f"{mark.id} {mark.instance}" for mark in state.latched)


def _silent(state: State, seen: Circumstances) -> Next:
    return (Mode.INVENTORY if seen.elapsed >= LISTEN_S else Mode.SILENT), ""


def _inventory(state: State, seen: Circumstances) -> Next:
    wrong = [f"{name}: {drive.error_text}" for name, drive in _named(state, seen) if drive.phase == Phase.FAULT]
    if wrong and not (state.clearing and seen.elapsed < INVENTORY_TIMEOUT_S):
        return Mode.DONE, "; ".join(wrong) + LOOK_FIRST
    unheard = not state.view("group_frames").all()
    if all(drive.phase == Phase.READY for drive in state.drives) and state.started and not unheard:
        return Mode.READY, ""
    if seen.elapsed < INVENTORY_TIMEOUT_S:
        return Mode.INVENTORY, ""
    behind = [(name, drive) for name, drive in _named(state, seen) if drive.phase != Phase.READY]
    silent = [name for name, drive in behind if drive.phase == Phase.SILENT and not drive.error_text]
    silent += ["the sensor node"] if unheard else []
    stuck = [f"{name}: {drive.error_text or 'not configured in time'}" for name, drive in behind if name not in silent]
    unheard_of = [f"no answer from {', '.join(silent)}{STILL_LATCHED if state.clearing else ''}"] if silent else []
    return Mode.DONE, "; ".join([*stuck, *unheard_of, *_unread(state, seen)])


def _unread(state: State, seen: Circumstances) -> list[str]:
    """Return the missing inputs of the filter, where all drives are ready and all sensor frames were received."""
    blind = [name for name, drive in _named(state, seen) if drive.phase == Phase.READY and math.isnan(drive.position)]
    sensed = seen.model.hand.sensor_node.tendons
    bare = [name for name in seen.model.hand.tendon_names if name not in sensed]
    told = [f"no position from {', '.join(blind)}"] if blind else []
    return [*told, f"no load cell of {', '.join(bare)} in sensor_node.tendons"] if bare else told


def _ready(state: State, seen: Circumstances) -> Next:
    if strange := _strange(state, seen):
        return Mode.DONE, f"{strange}: the calibration is another hand's, name this one's or commission it"
    return (Mode.ARMING if state.armed and seen.elapsed >= READY_S else Mode.READY), ""


def _strange(state: State, seen: Circumstances) -> str:
    """Return the drives other than at calibration.

    Returns:
        A phrase per drive. Empty if all are equal, or the calibration names no drives.
    """
    there = [drive.identity(known) for drive, known in zip(seen.drives, state.drives, strict=True)]
    pairs = zip(seen.names, there, seen.identities, strict=False)
    others = [(name, now, then) for name, now, then in pairs if then not in ("", now)]
    return ", ".join(f"{name} is drive {now}, calibrated was {then}" for name, now, then in others)


def _arming(state: State, seen: Circumstances) -> Next:
    if all(phase == Phase.ENABLED for phase in state.phases):
        return Mode.ACTIVE, ""
    if seen.elapsed < ARMING_TIMEOUT_S:
        return Mode.ARMING, ""
    late = [name for name, drive in _named(state, seen) if drive.phase != Phase.ENABLED]
    return Mode.DISARM, f"not enabled: {', '.join(late)}"


def _active(state: State, seen: Circumstances) -> Next:
    return (Mode.RELAX if state.progress.finished else Mode.ACTIVE), state.progress.failure


def _relax(state: State, seen: Circumstances) -> Next:
    # A load cell that reads too little must not cut a taut tendon: the command has to have fallen, too.
    relaxed = settled(state) and let_go(state)
    return (Mode.DISARM if relaxed or seen.elapsed >= RELAX_TIMEOUT_S else Mode.RELAX), ""


def _disarm(state: State, seen: Circumstances) -> Next:
    pulling = _pulling(seen.model, state, seen.names)
    if pulling:
        return Mode.DONE, f"{REMOVE_POWER}: still pulling after the cut: {', '.join(pulling)}"
    enabled = _enabled(state, seen.names)
    if not enabled:
        return Mode.DONE, ""
    if seen.elapsed < DISARM_TIMEOUT_S:
        return Mode.DISARM, ""
    return Mode.DONE, f"{REMOVE_POWER}: not confirmed disabled: {', '.join(enabled)}"


def _cut(state: State, seen: Circumstances) -> Next:
    return (Mode.DISARM if seen.elapsed >= CUT_S else Mode.CUT), ""


def _done(state: State, seen: Circumstances) -> Next:
    return Mode.DONE, ""


_MODES: dict[Mode, Callable[[State, Circumstances], Next]] = {
    Mode.SILENT: _silent,
    Mode.INVENTORY: _inventory,
    Mode.READY: _ready,
    Mode.ARMING: _arming,
    Mode.ACTIVE: _active,
    Mode.RELAX: _relax,
    Mode.DISARM: _disarm,
    Mode.CUT: _cut,
    Mode.DONE: _done,
}


def _named(state: State, seen: Circumstances) -> Iterator[tuple[str, DriveState]]:
    return zip(seen.names, state.drives, strict=True)


def _enabled(state: State, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the motors without a confirmed disable."""
    disabled = (Phase.READY, Phase.FAULT)
    return tuple(name for name, drive in zip(names, state.drives, strict=True) if drive.phase not in disabled)


def _pulling(model: HandModel, state: State, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the motors whose tendon is still loaded after the torque was cut (N16)."""
    tendons = {mark.instance for mark in state.latched if mark.id == "N16"}
    return tuple(name for name, tendon in zip(names, model.hand.tendon_names, strict=True) if tendon in tendons)


def _may_pull(model: HandModel, state: State, names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the motors with possible torque at the end of a run.

    A run ending before arming has enabled no motor. Only a motor reporting to be enabled
    counts then.
    """
    if state.mode not in BEFORE_ARMING:
        return tuple(dict.fromkeys((*_enabled(state, names), *_pulling(model, state, names))))
    return tuple(name for name, drive in zip(names, state.drives, strict=True) if drive.phase == Phase.ENABLED)
