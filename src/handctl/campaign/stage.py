"""Hands in each protocol, and a run brought to each stage, from which scenarios branch off as processes."""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, Protocol, TypeVar, cast

from handctl.campaign.scenarios import ARMING, CIA402, FREE, GRASP, MIT, ODRIVE
from handctl.campaign.trial import Result
from handctl.controller.setup import make_controller
from handctl.core.gains.gains import Gains
from handctl.core.types import Mode
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.load import load_hand
from handctl.processes import in_copy
from handctl.programs.grasp import TaskProgram
from handctl.programs.task import Task
from handctl.session.simulate import Simulation, Simulator

FIRST_NODE = 0x10
OPTIONS: dict[str, dict[str, Any]] = {
    MIT: {},
    ODRIVE: {
        "endpoint_enable_watchdog": 201, "endpoint_watchdog_timeout": 202,
        "endpoint_torque_max": 203, "endpoint_torque_min": 204,
    },
    CIA402: {"rated_torque_N_m": 0.4, "counts_per_turn": 65536},
}  # fmt: skip
TASK: dict[str, Any] = {
    "schema": 1,
    "name": "campaign",
    "phase": [
        {"kind": "move", "name": "free", "angle_deg": {"*": 25.0}, "duration_s": 1.2},
        {"kind": "close", "angle_deg": 85.0, "speed_deg_s": 80.0, "contact_tension_N": 14.0},
        {"kind": "hold", "tension_N": 24.0, "rate_N_per_s": 30.0, "duration_s": 60.0},
    ],
}
STAGES = (ARMING, FREE, GRASP)
"""In the order in which a run comes to them."""
FREE_S, STAGE_TIMEOUT_S = 0.2, 12.0
"""Time into the free motion at which it is disturbed; and the longest way to a stage [s]."""


def hand_in(name: str, protocol: str) -> Hand:
    """A hand with all its drives in one protocol."""
    hand = load_hand(name)
    if protocol == MIT and all(motor.protocol == MIT for motor in hand.motor):
        return hand
    changed = [
        motor.model_copy(update={"protocol": protocol, "node_id": FIRST_NODE + i, "options": OPTIONS[protocol]})
        for i, motor in enumerate(hand.motor)
    ]
    return hand.model_copy(update={"motor": tuple(changed)})


@contextmanager
def started(
    hand: Hand,
    rate_hz: float,
    seed: int,
    perturb: dict[str, float] | None = None,
    task: dict[str, Any] = TASK,
) -> Iterator[Simulation]:
    """A run that begins, in a scene with a cylinder, with a hand that is homed; ``task``: its first phase is a move."""
    angles = dict.fromkeys(hand.digit_names, 25.0)
    phases = [dict(phase) for phase in cast(list[dict[str, Any]], task["phase"])]
    phases[0]["angle_deg"] = angles
    program = TaskProgram(Task.model_validate_json(json.dumps({**task, "phase": phases})))
    controller = make_controller(hand, Gains(), rate_hz, program, None, arm_at_once=True)
    with Simulator(hand, "cylinder", seed, perturb, homed=True).against(controller) as run:
        yield run


def bring(course: Simulation, stage: str) -> None:
    """Go on to a stage.

    Raises:
        ConfigError: it is not reached: this hand cannot be tried.
    """
    free_ticks = 0

    def reached(out: Any) -> bool:
        nonlocal free_ticks
        if stage == ARMING:
            return bool(out.mode == Mode.ARMING)
        free_ticks += out.phase == "free"
        free = free_ticks * course.period_ns > FREE_S * 1e9
        holds = out.phase == "hold" and min(out.telemetry.contact.max(), out.telemetry.tension.max() / 16.0) >= 1.0
        return bool(free if stage == FREE else holds)

    if not course.until(reached, STAGE_TIMEOUT_S):
        failure = course.state.failure or course.state.mode.name
        raise ConfigError(f"the simulated hand does not come to {stage}: {failure}", "--hand", "a hand that grasps")


class Trial(Protocol):
    """What is tried from a stage on. Attributes: name: for people. id: of its row. stage: where it begins."""

    @property
    def name(self) -> str: ...
    @property
    def id(self) -> str: ...
    @property
    def stage(self) -> str: ...


T = TypeVar("T", bound=Trial)


def try_all(
    hand: Hand,
    rate_hz: float,
    todo: Sequence[T],
    jobs: int,
    attempt: Callable[[Simulation, T], Result],
    told: Callable[[Result], None],
    keep: Callable[[Simulation, Result], None],
    seed: int = 0,
) -> None:
    """Bring one run of a seed to each stage, and let what is tried there branch off; see ``branch``."""
    with started(hand, rate_hz, seed) as course:
        for stage in STAGES:
            here = [one for one in todo if one.stage == stage]
            if here:
                bring(course, stage)
                branch(course, here, jobs, attempt, told, keep)


def branch(
    course: Simulation,
    todo: Sequence[T],
    jobs: int,
    attempt: Callable[[Simulation, T], Result],
    told: Callable[[Result], None],
    keep: Callable[[Simulation, Result], None],
) -> None:
    """Try things out from here, each in a copy of this process, so many at a time.

    Args:
        course: at their stage; it stays as it is.
        todo: what is tried.
        jobs: processes at a time.
        attempt: tries one out, in the copy.
        told: called with each result.
        keep: called in the copy in which one failed, with its course.
    """
    running: dict[int, tuple[int, T]] = {}
    waiting = list(todo)
    while waiting or running:
        while waiting and len(running) < jobs:
            one = waiting.pop(0)
            child, reading = in_copy(partial(_tried, partial(attempt, course, one), partial(keep, course)))
            running[child] = (reading, one)
        child, status = os.wait()
        if child in running:
            reading, one = running.pop(child)
            told(_result(reading, one, status))


def _tried(attempt: Callable[[], Result], keep: Callable[[Result], None]) -> str:
    """Try one out, keep it if it failed, and return its result as text."""
    result = attempt()
    if not result.ok:
        keep(result)
    return json.dumps(result.plain())


def _result(reading: int, one: Trial, status: int) -> Result:
    with os.fdopen(reading) as pipe:
        text = pipe.read()
    if status or not text:
        return Result(one.name, one.id, one.stage, why=f"its process ended with status {status}")
    return Result(**json.loads(text))
