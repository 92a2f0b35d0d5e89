"""Answers that were not asked for: one too many from a node that was asked, or any at all from one that was not.

A motor that answers although this host has asked it nothing yet was asked by another one: H13, the second controller,
of which one frame is enough, as one of its own frames is. One answer more than questions is a duplicate (B05) or, with
other bytes, a masquerade (B06). What counts as an answer is what drive and sensor node accept as one: a heartbeat
beside it, or a frame with an old counter, is none.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from handctl.controller.state import State
from handctl.drives.contract import Drive
from handctl.drives.frame import Frame
from handctl.drives.sensors.node import SensorNode, SensorState
from handctl.safety.detectors.answers import Owed, answered
from handctl.safety.signals import LOAD_CELLS, Named

Frames = tuple[Frame, ...]
S = TypeVar("S")
"""State of a node."""


class Surplus(NamedTuple):
    """What one tick's answers leave.

    Attributes:
        owed: per motor, questions that are still open.
        twice: nodes that answered more often than they were asked, and whether with other bytes (1) or the same (0).
        unasked: of motors that were asked nothing and answered, a phrase each.
    """

    owed: Owed
    twice: Named = ()
    unasked: tuple[str, ...] = ()


def surplus(
    drives: tuple[Drive, ...],
    sensors: SensorNode,
    before: State,
    state: State,
    frames: Frames,
    answers: list[int],
) -> Surplus:
    """Compare what was asked with what came.

    Args:
        drives: of the motors; whose commands have no answer of their own each are left out.
        sensors: the sensor node.
        before: state before the tick. state: with what was received in it.
        frames: received in it. answers: per motor, how many of them it accepted as feedback.
    """
    due = before.watch.owed
    owed, often = answered(due, answers)
    strict = [i for i in often if drives[i].answers_once]
    twice = []
    for i in filter(due.__getitem__, strict):
        payloads = _accepted(drives[i].receive, lambda drive: drive.feedback_count, before.drives[i], frames)
        twice.append((drives[i].name, _differ(payloads, len(due[i]))))
    for group, (was, now) in enumerate(zip(before.sensors.groups, state.sensors.groups, strict=True)):
        if now.frames > was.frames + 1:
            payloads = _accepted(sensors.receive, _frames_of(group), before.sensors, frames)
            twice.append((LOAD_CELLS, _differ(payloads, 1)))
    return Surplus(owed, tuple(twice), tuple([f"{drives[i].name} answering it" for i in strict if not due[i]]))


def _differ(payloads: list[bytes], due: int) -> float:
    """1 if what came beyond the questions is not all as the last answer that was due, else 0."""
    return float(len(set(payloads[due - 1 :])) > 1)


def _frames_of(group: int) -> Callable[[SensorState], int]:
    """What counts the answers of one group of the sensor node."""
    return lambda sensors: sensors.groups[group].frames


def _accepted(receive: Callable[[S, Frame], S], count: Callable[[S], int], known: S, frames: Frames) -> list[bytes]:
    """Payloads of the frames that a node's state counts as an answer, in order."""
    taken = []
    for frame in frames:
        after = receive(known, frame)
        taken += [frame.data] if count(after) > count(known) else []
        known = after
    return taken
