"""A simulated wire.

A wire carries one frame at a time. If several frames wait for the wire, the frame with the lowest
identifier is sent first. A frame on the wire is never interrupted. The caller calls ``advance`` to
advance the time of the wire. All times come from the caller, and can be real or virtual.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass

from firmware_sim.bus.frame import Frame
from firmware_sim.wire.can_controller import CanController, CanErrorState
from firmware_sim.wire.frame_bits import BitRates

NEVER_NS = 1 << 62
"""Time of an event that will not happen [ns]."""
DEFAULT_QUEUE_DEPTH = 128
"""Default capacity of a controller's queue [frames], as set by ``ip link set can0 txqueuelen 128``."""
SUPERPOSED_ERROR_FLAG_BITS = 12 + 8
"""Number of bits of the superposed error flags of several controllers, plus the bits of the error delimiter."""
SINGLE_ERROR_FLAG_BITS = 6 + 8
"""Number of bits of the error flag of a sender that is alone on the bus, plus the bits of the error delimiter."""
END_OF_FRAME_BITS = 1 + 7
"""Number of bits that a destroyed frame lacks at its end: acknowledge delimiter and end of frame."""
SUSPEND_BITS = 8
"""Number of bits for which an error-passive sender must wait after a frame."""
RECOVERY_BITS = 128 * 11
"""Number of recessive bits that a controller must receive before it returns from bus-off."""


@dataclass(frozen=True, slots=True)
class WireOptions:
    """Options of a simulated wire.

    Attributes:
        queue: largest number of frames in the queue of a controller.
        error_rate: fraction of the frames that the wire destroys at random.
        restart_ms: time from the state bus-off until the controller is restarted [ms]. If the time
            is negative, the controller is not restarted.
        seed: seed of the random errors.
    """

    queue: int = DEFAULT_QUEUE_DEPTH
    error_rate: float = 0.0
    restart_ms: float = -1.0
    seed: int = 0


class SimulatedWire:
    """A simulated CAN bus on which the transmission of a frame takes time.

    Attributes:
        rate: bit rates of the wire.
        options: options of the wire.
        busy_ns: time during which frames and errors have occupied the wire [ns].
        frames: number of frames sent successfully.
        errors: number of frames that were destroyed or not acknowledged.
        disturbed: how many frames the wire will destroy, beginning with the next frame. Only tests
            set this number.
    """

    def __init__(self, rate: BitRates, options: WireOptions = WireOptions()) -> None:
        """Create an idle wire without controllers.

        Args:
            rate: bit rates of the wire.
            options: options of the wire.
        """
        self.rate = rate
        self.options = options
        self.busy_ns = self.frames = self.errors = self.disturbed = 0
        self._controllers: list[CanController] = []
        self._rng = random.Random(f"wire {options.seed}")
        self._free_ns = 0
        self._senders: list[CanController] = []
        self._acknowledged = self._intact = True
        self._end_ns = NEVER_NS
        self._restarts: list[tuple[int, CanController]] = []

    def add_controller(
        self, on_receive: Callable[[Frame, int], None] | None = None, queue_depth: int | None = None
    ) -> CanController:
        """Create a CAN controller, and connect the controller to the wire.

        Args:
            on_receive: function called with each received frame and its time [ns], None to ignore
                received frames.
            queue_depth: capacity of the controller's queue [frames]. If None, the options of the
                wire give the capacity.
        """
        controller = CanController(
            self.options.queue if queue_depth is None else queue_depth, on_receive
        )
        self._controllers.append(controller)
        return controller

    def remove_controller(self, controller: CanController) -> None:
        """Disconnect a controller from the wire.

        If the controller is sending a frame, the wire still completes this frame.
        """
        self._controllers.remove(controller)
        controller.queue.clear()
        self._senders = [
            other_controller
            for other_controller in self._senders
            if other_controller is not controller
        ]

    def next_event_ns(self) -> int:
        """Return the time of the next event on the wire [ns], or NEVER_NS if there is no next event."""
        due_ns = self._end_ns if self._end_ns != NEVER_NS else self._start_ns()
        return min(due_ns, self._restart_ns()) if self._restarts else due_ns

    def _restart_ns(self) -> int:
        """Return the time when the next controller is restarted after bus-off [ns]."""
        return min((restart_ns for restart_ns, _ in self._restarts), default=NEVER_NS)

    def step(self, t_ns: int) -> bool:
        """Process the next event on the wire, if the event is due at ``t_ns`` or before.

        Returns:
            True if an event was processed.
        """
        restart_ns = self._restart_ns() if self._restarts else NEVER_NS
        end_ns = self._end_ns
        if end_ns == NEVER_NS:
            start_ns = self._start_ns()
            if min(start_ns, restart_ns) > t_ns:
                return False
            if start_ns < restart_ns:
                self._arbitrate(start_ns)
                return True
        elif min(end_ns, restart_ns) > t_ns:
            return False
        elif end_ns <= restart_ns:
            self._finish_frame(end_ns)
            return True
        self._restart_controllers(restart_ns)
        return True

    def advance(self, t_ns: int) -> None:
        """Process all events on the wire that are due at ``t_ns`` or before."""
        while self.step(t_ns):
            pass

    def load(self, busy_before_ns: int, elapsed_ns: int) -> float:
        """Return the fraction of a time interval during which frames occupied the wire.

        Args:
            busy_before_ns: value of ``busy_ns`` at the start of the interval.
            elapsed_ns: length of the interval [ns].
        """
        return (self.busy_ns - busy_before_ns) / elapsed_ns

    def _start_ns(self) -> int:
        """Return the time when the next frame can start [ns]."""
        earliest_ready_ns = min(
            [c.ready_ns() for c in self._controllers if c.queue], default=NEVER_NS
        )
        return max(earliest_ready_ns, self._free_ns) if earliest_ready_ns != NEVER_NS else NEVER_NS

    def _arbitrate(self, t_ns: int) -> None:
        """Start the frame that wins the arbitration among all ready frames."""
        candidates = [c for c in self._controllers if c.queue and c.ready_ns() <= t_ns]
        lowest_priority_number = min([c.queue[0][1] for c in candidates])
        self._senders = [c for c in candidates if c.queue[0][1] == lowest_priority_number]
        frames = [c.queue[0][2] for c in self._senders]
        # Two frames with the same identifier both win the arbitration. If the contents of the two
        # frames differ, both frames are destroyed.
        are_identical = len(frames) == 1 or all(frame[:3] == frames[0][:3] for frame in frames)
        self._acknowledged = self._has_receiver()
        self._intact = are_identical and self._acknowledged and not self._is_next_frame_disturbed()
        frame_duration_ns = max(map(self.rate.frame_duration_ns, frames))
        if not self._intact:
            # After an error, an error flag replaces the rest of the frame. The error flag is longer
            # if several controllers send error flags.
            frame_duration_ns += self.rate.duration_of_bits_ns(
                (SUPERPOSED_ERROR_FLAG_BITS if self._acknowledged else SINGLE_ERROR_FLAG_BITS)
                - END_OF_FRAME_BITS
            )
        self.busy_ns += frame_duration_ns
        self._end_ns = t_ns + frame_duration_ns

    def _has_receiver(self) -> bool:
        """Return True if at least one controller can receive the present frame.

        A controller that sends the frame or is bus-off cannot receive the frame.
        """
        for controller in self._controllers:
            if controller.state != CanErrorState.BUS_OFF and controller not in self._senders:
                return True
        return False

    def _is_next_frame_disturbed(self) -> bool:
        """Decide whether the wire destroys the next frame, either on request of a test or at random."""
        if self.disturbed:
            self.disturbed -= 1
            return True
        return self.options.error_rate > 0.0 and self._rng.random() < self.options.error_rate

    def _finish_frame(self, t_ns: int) -> None:
        """End the frame on the wire: deliver the frame, or keep the frame in the queue for a retry."""
        senders = self._senders
        self._senders = []
        self._end_ns = NEVER_NS
        self._free_ns = t_ns
        if not senders:
            return
        if self._intact:
            self._deliver_frame(senders, t_ns)
        else:
            self._destroy_frame(senders, t_ns)

    def _deliver_frame(self, senders: list[CanController], t_ns: int) -> None:
        """Deliver the sent frame to all controllers except the senders of this frame."""
        self.frames += 1
        can_id, data, flags, bus, _ = senders[0].queue[0][2]
        frame = Frame(can_id, data, flags, bus, t_ns)
        for controller in senders:
            controller.count_sent_frame(t_ns)
            self._suspend_transmission(controller, t_ns)
        for controller in self._controllers:
            if (
                (controller.on_receive or controller.rx_errors)
                and controller.is_on_bus
                and controller not in senders
            ):
                controller.deliver(frame, t_ns)

    def _destroy_frame(self, senders: list[CanController], t_ns: int) -> None:
        """Count an error in all controllers, because a frame was destroyed on the wire.

        The senders keep the frame in their queues for a retry.
        """
        self.errors += 1
        for controller in self._controllers:
            if controller.is_on_bus and controller not in senders:
                controller.count_received_error(t_ns)
        for controller in senders:
            (
                controller.count_destroyed_frame
                if self._acknowledged
                else controller.count_unacknowledged_frame
            )(t_ns)
            self._suspend_transmission(controller, t_ns)
            if not controller.is_on_bus and self.options.restart_ms >= 0.0:
                wait_ns = round(self.options.restart_ms * 1e6) + self.rate.duration_of_bits_ns(
                    RECOVERY_BITS
                )
                self._restarts.append((t_ns + wait_ns, controller))

    def _suspend_transmission(self, controller: CanController, t_ns: int) -> None:
        """Delay the next frame of an error-passive sender."""
        if controller.state == CanErrorState.ERROR_PASSIVE:
            controller.retry_ns = t_ns + self.rate.duration_of_bits_ns(SUSPEND_BITS)

    def _restart_controllers(self, t_ns: int) -> None:
        """Restart the controllers whose restart delay after bus-off has passed."""
        due_controllers = [controller for at, controller in self._restarts if at <= t_ns]
        self._restarts = [(at, controller) for at, controller in self._restarts if at > t_ns]
        for controller in due_controllers:
            if controller in self._controllers:
                controller.restart(t_ns)
