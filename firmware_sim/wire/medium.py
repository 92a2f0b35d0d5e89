"""The wire itself: one frame at a time, the lowest identifier first, nobody interrupts.

Everything is driven by ``advance``; times are those of whoever calls, real or virtual.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass

from firmware_sim.bus.frame import Frame
from firmware_sim.wire.bits import Rate
from firmware_sim.wire.controller import Controller, State

NEVER = 1 << 62
QUEUE = 128
"""Frames that a controller's queue holds unless told otherwise, as ``ip link set can0 txqueuelen 128``."""
FLAGS_BITS, FLAG_BITS = 12 + 8, 6 + 8
"""Error flags of all, or of a lonely sender, and the delimiter."""
CUT_BITS = 1 + 7
"""Acknowledge delimiter and end of frame: what a destroyed frame does not come to."""
SUSPEND_BITS = 8
"""An error-passive sender lets others go first."""
RECOVERY_BITS = 128 * 11
"""Recessive bits that a controller must see before it takes part again."""


@dataclass(frozen=True, slots=True)
class Options:
    """How a wire behaves.

    Attributes:
        queue: frames that a controller's queue holds.
        error_rate: share of frames that are destroyed on the wire.
        restart_ms: after this a controller that is off the bus is started again; negative: never.
        seed: of the errors.
    """

    queue: int = QUEUE
    error_rate: float = 0.0
    restart_ms: float = -1.0
    seed: int = 0


class Wire:
    """A bus with its bit time.

    Attributes:
        rate: speed.
        busy_ns: how long it has been occupied, errors included [ns].
        frames: frames that went over it. errors: frames that did not.
        disturbed: how many of the next frames will be destroyed; tests and fault scripts set it.
    """

    def __init__(self, rate: Rate, options: Options = Options()) -> None:
        """Args: speed; behaviour."""
        self.rate, self.options = rate, options
        self.busy_ns = self.frames = self.errors = self.disturbed = 0
        self._controllers: list[Controller] = []
        self._chance = random.Random(f"wire {options.seed}")
        self._free_ns = 0
        self._sending: list[Controller] = []
        self._acknowledged = self._good = True
        self._end_ns = NEVER
        self._restarts: list[tuple[int, Controller]] = []

    def add(self, heard: Callable[[Frame, int], None] | None = None, queue: int | None = None) -> Controller:
        """Connect another controller.

        Args:
            heard: is called with each frame it receives and the time [ns]; None for one that listens to nothing.
            queue: frames its queue holds; None for what the options say.
        """
        controller = Controller(self.options.queue if queue is None else queue, heard)
        self._controllers.append(controller)
        return controller

    def remove(self, controller: Controller) -> None:
        """Disconnect; a frame that is being sent ends as it began."""
        self._controllers.remove(controller)
        controller.queue.clear()
        self._sending = [other for other in self._sending if other is not controller]

    def next_ns(self) -> int:
        """Return when something happens next [ns]; NEVER if nothing will by itself."""
        due = self._end_ns if self._end_ns != NEVER else self._start_ns()
        return min(due, self._restart_ns()) if self._restarts else due

    def _restart_ns(self) -> int:
        """When the next controller that is off the bus is started again."""
        return min((at for at, _ in self._restarts), default=NEVER)

    def step(self, t_ns: int) -> bool:
        """Let the next thing happen that is due by t_ns; whether there was one."""
        restart, end = self._restart_ns() if self._restarts else NEVER, self._end_ns
        if end == NEVER:
            start = self._start_ns()
            if min(start, restart) > t_ns:
                return False
            if start < restart:
                self._begin(start)
                return True
        elif min(end, restart) > t_ns:
            return False
        elif end <= restart:
            self._finish(end)
            return True
        self._restart(restart)
        return True

    def advance(self, t_ns: int) -> None:
        """Let everything happen that is due by t_ns."""
        while self.step(t_ns):
            pass

    def load(self, busy_before_ns: int, elapsed_ns: int) -> float:
        """Return the share of a time that the wire was occupied.

        Args:
            busy_before_ns: ``busy_ns`` at its beginning. elapsed_ns: its length [ns].
        """
        return (self.busy_ns - busy_before_ns) / elapsed_ns

    def _start_ns(self) -> int:
        """When the next frame can begin."""
        ready = min([c.ready_ns() for c in self._controllers if c.queue], default=NEVER)
        return max(ready, self._free_ns) if ready != NEVER else NEVER

    def _begin(self, t_ns: int) -> None:
        """Arbitration: of all that want to begin now the lowest identifier goes on."""
        candidates = [c for c in self._controllers if c.queue and c.ready_ns() <= t_ns]
        lowest = min([c.queue[0][1] for c in candidates])
        self._sending = [c for c in candidates if c.queue[0][1] == lowest]
        frames = [c.queue[0][2] for c in self._sending]
        # two of one identifier destroy each other
        alike = len(frames) == 1 or all(frame[:3] == frames[0][:3] for frame in frames)
        self._acknowledged = self._answered()
        self._good = alike and self._acknowledged and not self._disturbed()
        span = max(map(self.rate.frame_ns, frames))
        if not self._good:
            span += self.rate.bits_ns((FLAGS_BITS if self._acknowledged else FLAG_BITS) - CUT_BITS)
        self.busy_ns += span
        self._end_ns = t_ns + span

    def _answered(self) -> bool:
        """Whether there is anybody beside the senders."""
        for controller in self._controllers:
            if controller.state != State.BUS_OFF and controller not in self._sending:
                return True
        return False

    def _disturbed(self) -> bool:
        if self.disturbed:
            self.disturbed -= 1
            return True
        return self.options.error_rate > 0.0 and self._chance.random() < self.options.error_rate

    def _finish(self, t_ns: int) -> None:
        """The frame has been sent, or destroyed and will be sent again."""
        sending, self._sending = self._sending, []
        self._end_ns, self._free_ns = NEVER, t_ns
        if not sending:
            return
        if self._good:
            self._deliver(sending, t_ns)
        else:
            self._destroy(sending, t_ns)

    def _deliver(self, sending: list[Controller], t_ns: int) -> None:
        self.frames += 1
        can_id, data, flags, bus, _ = sending[0].queue[0][2]
        frame = Frame(can_id, data, flags, bus, t_ns)
        for controller in sending:
            controller.went_well(t_ns)
            self._suspend(controller, t_ns)
        for controller in self._controllers:
            if (controller.heard or controller.rx_errors) and controller.on_bus and controller not in sending:
                controller.received(frame, t_ns)

    def _destroy(self, sending: list[Controller], t_ns: int) -> None:
        self.errors += 1
        for controller in self._controllers:
            if controller.on_bus and controller not in sending:
                controller.saw_error(t_ns)
        for controller in sending:
            (controller.hit if self._acknowledged else controller.unanswered)(t_ns)
            self._suspend(controller, t_ns)
            if not controller.on_bus and self.options.restart_ms >= 0.0:
                wait_ns = round(self.options.restart_ms * 1e6) + self.rate.bits_ns(RECOVERY_BITS)
                self._restarts.append((t_ns + wait_ns, controller))

    def _suspend(self, controller: Controller, t_ns: int) -> None:
        if controller.state == State.PASSIVE:
            controller.retry_ns = t_ns + self.rate.bits_ns(SUSPEND_BITS)

    def _restart(self, t_ns: int) -> None:
        due = [controller for at, controller in self._restarts if at <= t_ns]
        self._restarts = [(at, controller) for at, controller in self._restarts if at > t_ns]
        for controller in due:
            if controller in self._controllers:
                controller.restart(t_ns)
