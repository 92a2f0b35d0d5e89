"""State machine that sets up a CiA 404 measuring amplifier.

After the set-up, the amplifier answers every SYNC. The host sets the amplifier to the NMT state
pre-operational, reads and writes its objects, and then starts the amplifier. The host uses received
TPDOs of the amplifier only after the start of the amplifier. If an amplifier restarts, the host
sets up the amplifier again before the next arming. The host never sets up an amplifier while a
motor may make torque. No frame of this module moves a motor.
"""

from dataclasses import dataclass
from typing import NamedTuple

from handctl.drives.canopen import codec, setup
from handctl.drives.canopen.setup import REPEAT_PERIOD_NS
from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.readback import ReadbackCursor

SILENT, CONFIGURING, READY = DrivePhase.SILENT, DrivePhase.CONFIGURING, DrivePhase.READY


class AmplifierState(NamedTuple):
    """State of an amplifier while the host sets it up.

    Attributes:
        node_id: node number of the amplifier.
        phase: phase of the set-up: SILENT, CONFIGURING, READY or FAULT.
        cursor: position in the list of objects to read back.
        started_ns: time of the latest NMT start [ns].
        error_text: problem of the amplifier in words, or an empty text without a problem.
    """

    node_id: int
    phase: DrivePhase = DrivePhase.SILENT
    cursor: ReadbackCursor = ReadbackCursor()
    started_ns: int = -REPEAT_PERIOD_NS
    error_text: str = ""

    @property
    def name(self) -> str:
        """Return the name of the amplifier, for messages to the operator."""
        return f"amplifier 0x{self.node_id:02x}"


@dataclass(frozen=True, slots=True)
class LoadCellAmplifier:
    """Measuring amplifier with one or more load cells. Objects are immutable.

    Attributes:
        bus: index of the bus of the amplifier.
        node_id: node number, from 1 to 0x7e.
        tpdo_ids: identifiers of the frames with tensions from the amplifier.
        setup_steps: objects of the amplifier, with the values that the objects must have before
            arming.
    """

    bus: int
    node_id: int
    tpdo_ids: tuple[int, ...]
    setup_steps: tuple[setup.SetupStep, ...]

    def initial_state(self) -> AmplifierState:
        """Return the state of the amplifier before the first frame."""
        return AmplifierState(self.node_id)

    @property
    def service_ids(self) -> frozenset[int]:
        """Return the identifiers of the amplifier's SDO replies, emergencies, and heartbeats."""
        return frozenset(
            base + self.node_id for base in (codec.SDO_REPLY, codec.EMERGENCY, codec.HEARTBEAT)
        )

    def receive(self, state: AmplifierState, frame: Frame) -> AmplifierState:
        """Return the state of the amplifier after a received frame.

        Frames of other nodes and frames with a wrong length have no effect.
        """
        if frame.bus != self.bus or state.phase == DrivePhase.FAULT:
            return state
        if frame.can_id in self.tpdo_ids:
            return self._on_life_sign(state)
        if frame.can_id == codec.HEARTBEAT + self.node_id and len(frame.data) == 1:
            return self._on_heartbeat(state, frame.data[0])
        if frame.can_id == codec.SDO_REPLY + self.node_id and len(frame.data) == 8:
            return self._on_sdo_reply(state, frame.data)
        return state

    def _on_life_sign(self, state: AmplifierState) -> AmplifierState:
        """Return the amplifier state after a frame that proves the NMT state operational.

        A TPDO or a heartbeat has an effect only if the host has set up and started the amplifier.
        """
        if state.cursor.step < len(self.setup_steps) or state.started_ns < 0:
            return state
        return state._replace(phase=READY, error_text="")

    def _on_heartbeat(self, state: AmplifierState, nmt_state: int) -> AmplifierState:
        """Return the amplifier state after a heartbeat.

        If an amplifier has restarted or was stopped, the host must set up the amplifier again.
        """
        if nmt_state == codec.OPERATIONAL:
            return self._on_life_sign(state)
        if nmt_state == codec.BOOT_UP or state.phase == READY:
            return self.initial_state()
        return state

    def _on_sdo_reply(self, state: AmplifierState, data: bytes) -> AmplifierState:
        """Return the amplifier state after an SDO reply of the amplifier."""
        reply = codec.decode_sdo_reply(data)
        if reply is None or state.cursor.step >= len(self.setup_steps):
            return state
        cursor, _, problem = setup.on_reply(state.cursor, self.setup_steps, reply)
        next_state = state._replace(phase=CONFIGURING, cursor=cursor)
        return (
            next_state._replace(phase=DrivePhase.FAULT, error_text=problem)
            if problem
            else next_state
        )

    def advance(
        self, state: AmplifierState, t_ns: int, target: DriveTarget
    ) -> tuple[AmplifierState, tuple[Frame, ...]]:
        """Return the next state of the amplifier and the frames to send.

        The host sets up the amplifier only if the target is ``DriveTarget.POLL``.
        """
        if target != DriveTarget.POLL or state.phase in (READY, DrivePhase.FAULT):
            return state, ()
        if state.cursor.step < len(self.setup_steps):
            return self._configure(state, t_ns)
        if t_ns - state.started_ns < REPEAT_PERIOD_NS:
            return state, ()
        text = "does not become operational" if state.started_ns >= 0 else ""
        return state._replace(started_ns=t_ns, error_text=text), (
            self._nmt_frame(codec.START_NODE),
        )

    def _configure(
        self, state: AmplifierState, t_ns: int
    ) -> tuple[AmplifierState, tuple[Frame, ...]]:
        """Return the next state of the amplifier and the next SDO request.

        Before the first SDO request, the host sends the NMT command pre-operational.
        """
        cursor, data, problem = setup.next_request(state.cursor, self.setup_steps, t_ns)
        next_state = state._replace(cursor=cursor)
        if problem:
            return next_state._replace(phase=DrivePhase.FAULT, error_text=problem), ()
        frames = (Frame(codec.SDO_REQUEST + self.node_id, data, 0, self.bus),) if data else ()
        return next_state, (
            self._nmt_frame(codec.PRE_OPERATIONAL),
            *frames,
        ) if cursor.step == 0 and data else frames

    def _nmt_frame(self, nmt_command: int) -> Frame:
        """Return the frame of an NMT command to the amplifier."""
        return Frame(codec.NMT, bytes((nmt_command, self.node_id)), 0, self.bus)
