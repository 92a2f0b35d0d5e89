"""Simulation of a controller and a simulated hand in lockstep.

All programs that need a run in lockstep begin the run with this module.

``simulate_controller`` executes a whole run. ``SimulatedRun`` executes single ticks. A run that
writes a log uses the clock from ``SimulatorSettings.lockstep_clock``.
"""

import math
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from handctl.controller.controller_state import ControllerState
from handctl.controller.run_setup import make_drives, make_sensors
from handctl.controller.tick import Controller
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, IoEvent, TickIn, TickOut, TickRequest
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_path
from handctl.programs.program import Program
from handctl.runtime.clocks.lockstep import (
    SIMULATED_HAND_ENTRY,
    LockstepBus,
    LockstepClock,
    LockstepSimulator,
    load_simulator,
)
from handctl.safety.safety_action import SafetyAction

CHECKED_CONTROL_PERIOD_NS = 2_000_000
"""Control period of a simulated hand that is constructed only to check its settings, and never runs [ns]."""


class SimulatedHand(LockstepSimulator, Protocol):
    """Simulated hand to which the controller is connected by the simulated buses.

    Tests can inject faults into this hand.

    Attributes:
        world: simulated plant and simulated nodes. Tests and rewards read true values from the
            simulated world directly, and not through the bus.
    """

    world: Any

    def inject(self, fault_text: str) -> None:
        """Inject the fault that a text describes."""
        ...

    def fault_states(self) -> list[dict[str, Any]]:
        """Return every injected fault, with its state and the number of its effects."""
        ...

    def truth(self) -> dict[str, list[float]]:
        """Return the present true tensions [N] and the commanded torques of the motors [N m]."""
        ...


@dataclass(frozen=True)
class SimulatorSettings:
    """Settings of a simulated hand.

    Attributes:
        hand: name of a packaged hand, path of a hand file, or description of a hand.
        scene: name of a packaged scene, or path or text of a scene. None for a hand without
            objects.
        seed: random seed for the noise, the slack of the tendons, and the encoder offsets.
        perturb: factors by which parameters of the simulated plant are multiplied.
        homed: True if the hand starts with taut tendons and zero encoder readings.
        truth: file to which the true values of the simulated hand are written. If ``truth`` is
            None, no truth file is written.
        is_truth_once_per_tick: True to write the true values only at the times of the ticks. By
            default, the true values are written in every millisecond.
        wire: words KEY=VALUE that describe a simulated wire with delays. If ``wire`` is None,
            frames arrive without delay.
        serials: serial numbers of the drives.
    """

    hand: str | Path | Hand
    scene: str | None = None
    seed: int = 0
    perturb: Mapping[str, float] | None = None
    homed: bool = False
    truth: Path | None = None
    is_truth_once_per_tick: bool = False
    wire: Sequence[str] | None = None
    serials: Sequence[str] = ()

    @contextmanager
    def simulated_hand(self, period_ns: int) -> Iterator[SimulatedHand]:
        """Construct the simulated hand.

        At the end of the context, the hand and its truth file are closed.

        Args:
            period_ns: control period [ns].

        Raises:
            ConfigError: the simulated hand cannot be constructed.
        """
        with tempfile.TemporaryDirectory(prefix="handctl-simulated-") as folder:
            simulated_hand = load_simulator(
                SIMULATED_HAND_ENTRY,
                hand_path=self._hand_file(Path(folder)),
                scene=self._scene_file(Path(folder)),
                seed=self.seed,
                truth_path=str(self.truth) if self.truth else None,
                **({"truth_period_ns": period_ns} if self.is_truth_once_per_tick else {}),
                perturb=None if self.perturb is None else dict(self.perturb),
                period_ns=period_ns,
                homed=self.homed,
                wire=self.wire,
                serials=self.serials,
            )
        try:
            yield cast(SimulatedHand, simulated_hand)
        finally:
            simulated_hand.close()

    def check_hand_constructible(self) -> None:
        """Raise an error if the simulated hand cannot be constructed. See ``simulated_hand``."""
        with self.simulated_hand(CHECKED_CONTROL_PERIOD_NS):
            pass

    @contextmanager
    def lockstep_clock(self, period_ns: int) -> Iterator[LockstepClock]:
        """Construct the simulated hand and its lockstep clock, for one run or for several successive runs.

        See ``simulated_hand``.
        """
        with self.simulated_hand(period_ns) as simulated_hand:
            yield LockstepClock(simulated_hand, period_ns)

    @contextmanager
    def begin_run(self, controller: Controller) -> Iterator["SimulatedRun"]:
        """Construct the simulated hand, and begin a run in which a controller controls this hand.

        See ``simulated_hand``.
        """
        with self.simulated_hand(round(1e9 * controller.model.period)) as simulated_hand:
            yield SimulatedRun.start_run(controller, simulated_hand)

    def _hand_file(self, folder: Path) -> str:
        if not isinstance(self.hand, Hand):
            return str(hand_path(self.hand))
        path = folder / f"{re.sub('[^a-z0-9_]', '_', self.hand.name)}.toml"
        path.write_text(self.hand.to_toml(), "utf-8")
        return str(path)

    def _scene_file(self, folder: Path) -> str | None:
        if self.scene is None or "\n" not in self.scene:
            return self.scene
        path = folder / "scene.toml"
        path.write_text(self.scene, "utf-8")
        return str(path)


@dataclass
class SimulatedRun:
    """Run of a controller with a simulated hand. The caller executes the run tick by tick.

    Attributes:
        controller, simulated_hand: controller on one side of the bus, and simulated hand on the
            other side.
        period_ns: control period [ns].
        state: state of the controller after the last tick.
        k: number of the next tick.
        last_output: output of the last tick, or None before the first tick.
        recorded_ticks: input and output of every tick, if ``are_ticks_recorded`` is True.
        are_ticks_recorded: True to store the input and output of every tick.
    """

    controller: Controller
    simulated_hand: SimulatedHand
    period_ns: int
    state: ControllerState
    k: int = 0
    last_output: TickOut | None = None
    recorded_ticks: list[tuple[TickIn, TickOut]] = field(default_factory=list)
    are_ticks_recorded: bool = True

    @staticmethod
    def start_run(controller: Controller, simulated_hand: SimulatedHand) -> "SimulatedRun":
        """Begin a run in which a controller controls a simulated hand."""
        return SimulatedRun(
            controller,
            simulated_hand,
            round(1e9 * controller.model.period),
            controller.initial_state(),
        )

    def __post_init__(self) -> None:
        """Create the clock and the bus of the run."""
        self._clock = LockstepClock(self.simulated_hand, self.period_ns)
        self._bus = LockstepBus(self._clock)

    def run_tick(
        self,
        io_events: tuple[IoEvent, ...] = (),
        requests: tuple[TickRequest, ...] = (),
        late_ns: int = 0,
        skipped_ticks: int = 0,
    ) -> TickOut:
        """Run one tick, and then advance the simulated hand to the next tick.

        Args:
            io_events: additional events of buses and host for the controller in this tick.
            requests: requests of the operator in this tick.
            late_ns: lateness of the tick [ns].
            skipped_ticks: number of ticks to leave out before this tick, as if the host had missed their
                deadlines.
        """
        for _ in range(skipped_ticks):
            self._advance_simulated_hand()
        _, tick_output = self._run_controller_tick(io_events, requests, late_ns)
        self._advance_simulated_hand()
        return tick_output

    def run_ticks(self, max_duration_s: float = math.inf) -> Iterator[tuple[TickIn, TickOut]]:
        """Run ticks until the controller is done.

        Yield the input and output of each tick. When the caller gets the output of a tick, the
        simulated hand is still at the time of this tick.

        Args:
            max_duration_s: longest duration of the run [s].
        """
        while self.k * self.period_ns < max_duration_s * 1e9:
            tick_input, tick_output = self._run_controller_tick((), (), 0)
            yield tick_input, tick_output
            if tick_output.mode == HandMode.DONE:
                return
            self._advance_simulated_hand()

    def run_until(self, is_condition_met: Callable[[TickOut], bool], timeout_s: float) -> bool:
        """Run ticks until the output of a tick fulfils a condition.

        The method runs ticks for at most ``timeout_s`` [s]. Return True if the output of a tick has
        fulfilled the condition.
        """
        for _ in range(round(timeout_s * 1e9 / self.period_ns)):
            tick_output = self.run_tick()
            if is_condition_met(tick_output):
                return True
            if tick_output.mode == HandMode.DONE:
                return False
        return False

    def _run_controller_tick(
        self, io_events: tuple[IoEvent, ...], requests: tuple[TickRequest, ...], late_ns: int
    ) -> tuple[TickIn, TickOut]:
        frames = self._bus.drain()
        if bus_events := self._bus.take_events():
            io_events = (*(IoEvent(*event) for event in bus_events), *io_events)
        tick_input = TickIn(self.k, self.k * self.period_ns, late_ns, frames, io_events, requests)
        self.state, self.last_output = self.controller.tick(self.state, tick_input)
        if self.are_ticks_recorded:
            self.recorded_ticks.append((tick_input, self.last_output))
        self._bus.send(self.last_output.frames)
        return tick_input, self.last_output

    def _advance_simulated_hand(self) -> None:
        self.k += 1
        self._clock.wait(self.k)


def homed_controller(model: HandModel, program: Program, hand: Hand | None = None) -> Controller:
    """Construct the controller for a simulated hand that is already homed and tared.

    Args:
        model: model of the hand with designed gains.
        program: program to run.
        hand: description of the drives and sensors that the hand really has. The default is the
            hand of the model.
    """
    target_hand = hand or model.hand
    zero_vector = np.zeros(model.tendon_count)
    return Controller(
        model,
        make_drives(target_hand),
        make_sensors(target_hand),
        program,
        zero_vector,
        zero_vector,
    )


def simulate_controller(
    controller: Controller,
    simulator: SimulatorSettings,
    on_tick: Callable[[TickIn, TickOut], None] = lambda tick_input, out: None,
    max_duration_s: float = math.inf,
    max_held_s: float = math.inf,
) -> ControllerState:
    """Run a controller with a simulated hand until the controller is done.

    While the reaction to a fault is HOLD, the time of the program stops. Without a time limit, a
    run in which a fault causes HOLD might never end.

    Args:
        controller: controller with its program.
        simulator: settings of the simulated hand.
        on_tick: function called with the input and the output of each tick.
        max_duration_s: longest duration of the run [s].
        max_held_s: time for which faults are allowed to hold the hand, in total [s].

    Returns:
        The last state of the controller. The mode of the state is DONE, unless one of the two times
        was exceeded.
    """
    held_ticks = 0
    with simulator.begin_run(controller) as run:
        run.are_ticks_recorded = False
        for tick_input, tick_output in run.run_ticks(max_duration_s):
            on_tick(tick_input, tick_output)
            held_ticks += (
                tick_output.mode == HandMode.ACTIVE and tick_output.action >= SafetyAction.HOLD
            )
            if held_ticks * controller.model.period > max_held_s:
                break
        return run.state
