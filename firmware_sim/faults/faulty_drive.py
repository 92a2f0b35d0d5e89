"""Simulated drives with deliberate faults, to test programs that must find faulty drives."""

from dataclasses import replace

from firmware_sim.bus.frame import Frame
from firmware_sim.description.hand_description import MotorSpec, SimulatorError
from firmware_sim.nodes import PROTOCOL_SPECS
from firmware_sim.nodes.protocol_spec import (
    DriveNode,
    ProtocolSpec,
    SimulatedNode,
    unchanged_frame,
)

DRIVE_FAULTS = {
    "deaf": "ignores commands to disable",
    "eager": "follows torque commands while it is disabled",
    "mute": "never answers",
    "readback": "reads back wrong settings",
    "sign": "makes torque of the wrong sign",
    "twin": "shares its number with a second drive",
    "watchdog": "its watchdog never fires",
}
"""Effect of each kind of deliberate fault of a drive."""
TWIN_SERIAL_NUMBER = 0x7714_0000
"""Serial number of the second drive of the fault ``twin``, for node number 0. Other nodes add their node number."""


PROTOCOLS_WITHOUT_WATCHDOG = ("cubemars", "robstride_mit")
"""Protocols whose motors have no watchdog.

Some motors with one of these protocols have a watchdog that only another protocol can switch on.
"""


def check_fault_has_effect(protocol: str, fault: str) -> None:
    """Check that a deliberate fault changes the behaviour of a drive with the given protocol.

    Args:
        protocol: key of ``PROTOCOL_SPECS``.
        fault: key of ``DRIVE_FAULTS``, or an empty text for no fault.

    Raises:
        SimulatorError: the drives of the protocol cannot have the fault.
    """
    spec = PROTOCOL_SPECS[protocol]
    reasons = {
        "eager": spec.force_command is None and "a torque command also enables it",
        "readback": spec.corrupt_reply is unchanged_frame and "it has no settings to read back",
        "watchdog": protocol in PROTOCOLS_WITHOUT_WATCHDOG and "it has no watchdog",
    }
    if reason := reasons.get(fault):
        raise SimulatorError(f"--broken {fault}: not possible with drive {protocol}, {reason}")


class FaultyDrive:
    """A drive node with a deliberate fault, and with the methods of ``protocol_spec.SimulatedNode``.

    Attributes:
        node: simulated drive without the fault.
    """

    def __init__(self, node: DriveNode, fault: str, spec: ProtocolSpec) -> None:
        """Wrap a simulated drive, and give the drive a deliberate fault.

        Args:
            node: simulated drive without the fault.
            fault: key of ``DRIVE_FAULTS``.
            spec: protocol of the node, with the functions for corrupting frames.
        """
        self.node = node
        self._fault = fault
        self._spec = spec

    @property
    def wake_ns(self) -> int:
        """See ``protocol_spec.SimulatedNode.wake_ns``."""
        return self.node.wake_ns

    @property
    def ids(self) -> frozenset[int] | None:
        """See ``protocol_spec.SimulatedNode.ids``."""
        return self.node.ids

    @property
    def malformed_frame_count(self) -> int:
        """See ``protocol_spec.SimulatedNode.malformed_frame_count``."""
        return self.node.malformed_frame_count

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """See ``protocol_spec.SimulatedNode.receive``."""
        self._feed_watchdog(t_ns)
        answer_frames = self.node.receive(
            self._spec.make_ineffective_disable(frame) if self._fault == "deaf" else frame, t_ns
        )
        if self._fault == "eager" and self._spec.force_command:
            self._spec.force_command(self.node, frame)
        if self._fault == "mute":
            return [] if answer_frames is not None else None
        if self._fault == "readback" and answer_frames:
            return [self._spec.corrupt_reply(answer) for answer in answer_frames]
        return answer_frames

    def wake(self, t_ns: int) -> list[Frame] | None:
        """See ``protocol_spec.SimulatedNode.wake``."""
        self._feed_watchdog(t_ns)
        unsolicited_frames = self.node.wake(t_ns)
        return None if self._fault == "mute" else unsolicited_frames

    def _feed_watchdog(self, t_ns: int) -> None:
        if self._fault == "watchdog" and self.node.watchdog_fed_ns >= 0:
            # Every call of ``wake`` restarts the watchdog of the drive, so that the watchdog never
            # fires.
            self.node.watchdog_fed_ns = t_ns


def with_fault(node: DriveNode, protocol: str, fault: str) -> SimulatedNode:
    """Return a simulated drive with a deliberate fault.

    If no fault is given, return the drive itself.

    Args:
        node: simulated drive without a fault.
        protocol: key of ``PROTOCOL_SPECS``.
        fault: key of ``DRIVE_FAULTS``, or an empty text for no fault. The faults ``sign`` and
            ``twin`` do not change the drive. For the faults ``sign`` and ``twin``, the caller uses
            ``motor_specs_with_fault``.
    """
    return (
        node
        if fault in ("", "sign", "twin")
        else FaultyDrive(node, fault, PROTOCOL_SPECS[protocol])
    )


def motor_specs_with_fault(motor_specs: list[MotorSpec], fault: str) -> list[MotorSpec]:
    """Apply the fault ``sign`` or ``twin`` to the descriptions of drives.

    The fault ``sign`` inverts the torque of each drive. For each drive, the fault ``twin`` adds a
    second drive with the same node number. All faults except ``sign`` and ``twin`` leave the
    descriptions unchanged.
    """
    if fault == "sign":
        return [replace(spec, torque_gain=-1.0) for spec in motor_specs]
    if fault == "twin":
        return motor_specs + [
            replace(spec, name=f"{spec.name}_twin", serial=TWIN_SERIAL_NUMBER + spec.node_id)
            for spec in motor_specs
        ]
    return motor_specs
