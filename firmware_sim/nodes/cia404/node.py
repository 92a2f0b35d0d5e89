"""Simulated CiA 404 measuring amplifiers for load cells. Source: docs/facts/cia404.md.

Frames (COB-ID, payload little-endian):

    0x000         NMT          u8 command, u8 node (0 for all)
    0x080         SYNC         object 0x1005
    0x180.. + n   TPDO 1 to 4  mapped objects, at every SYNC that the transmission type selects
    0x580+n       SDO reply    u8 specifier, u16 index, u8 sub-index, u32 value or abort code
    0x600+n       SDO request  u8 specifier, u16 index, u8 sub-index, u32 value
    0x700+n       heartbeat    u8 NMT state, 0 once after a restart

The fact sheet cia404 does not determine the following behaviour. The node ignores a SYNC frame with
a payload, because object 0x1019 does not exist. TPDOs of the types 254 and 255 (on a change) are
sent only once, when the node becomes operational. The host can write communication objects only
while the node is pre-operational. The node loses its settings at a restart.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from firmware_sim.bus.frame import FDF, REMOTE_FLAG, Frame
from firmware_sim.description.hand_description import SensorSpec
from firmware_sim.nodes.cia402.object_dictionary import (
    ABORT_UNKNOWN_COMMAND,
    ABORT_WRONG_STATE,
    SDO_CLIENT_ABORT_COMMAND,
    SdoAbort,
    sdo_reply,
)
from firmware_sim.nodes.cia404.objects import PDO_DISABLED_BIT, TPDO_COUNT, AmplifierObjects
from firmware_sim.nodes.noise import NormalNoise

OPERATIONAL_STATE = 0x05
"""NMT state: operational."""
STOPPED_STATE = 0x04
"""NMT state: stopped."""
PRE_OPERATIONAL = 0x7F
"""NMT state: pre-operational."""
MAX_SYNCHRONOUS_TYPE = 240
"""Highest transmission type with which a TPDO depends on SYNC."""
_NEVER_NS = 1 << 62
"""Time of an event that will not happen [ns]."""


class LoadCellAmplifiers:
    """The load cells of a hand, connected to CiA 404 amplifiers.

    The class simulates the noise, the bias and the faults of these load cells.

    Attributes:
        nodes: the amplifiers of the hand.
        bias: present bias of each load cell [N].
        cell_faults: functions by which faults change the readings, by the index of the load cell.
        joint_faults: empty mapping, because amplifiers have no joint encoders.
        suppressed: functions by the identifier of a frame, for faults that suppress the frame. The
            node calls the function in place of sending the frame.
    """

    def __init__(self, spec: SensorSpec, tensions: Callable[[], Any], seed: int) -> None:
        """Set up the amplifiers in the state after power-up.

        Args:
            spec: description of the amplifiers.
            tensions: function that returns the true tensions [N] in the order of the load cells.
            seed: seed of the noise of the load cells.
        """
        self._tensions = tensions
        self.tension_noise = spec.tension_noise
        self.bias_drift = spec.bias_drift
        self.noise = NormalNoise(f"sensors {seed}")
        self.bias: Any = np.full(len(spec.tendons), spec.tension_bias)
        self.cell_faults: dict[int, Callable[[float], float]] = {}
        self.joint_faults: dict[int, Callable[[float], float]] = {}
        self.suppressed: dict[int, Callable[[], None]] = {}
        self._sampled_ns = -1
        self._readings: Any = self.bias.copy()
        size = spec.channels_per_node
        self.nodes = [
            AmplifierNode(
                self,
                spec,
                node_id,
                range(size * i, min(size * (i + 1), len(spec.tendons))),
                1000 * seed + i,
            )
            for i, node_id in enumerate(spec.node_ids)
        ]

    def frame_id_of_cell(self, index: int) -> int:
        """Return the identifier of the frame that contains the reading of a given load cell.

        The identifier is valid for the mapping that a host usually sets.
        """
        node = next(node for node in self.nodes if index in node.cells)
        return 0x180 + 0x100 * ((index - node.cells.start) // 2) + node.node_id

    def sample_tensions(self, t_ns: int) -> Any:
        """Return the readings of all load cells [N].

        After each SYNC frame, all amplifiers use the same sampled tensions.
        """
        if t_ns != self._sampled_ns:
            elapsed_s = (t_ns - self._sampled_ns) * 1e-9 if self._sampled_ns >= 0 else 0.0
            self._sampled_ns = t_ns
            count = len(self.bias)
            normal = self.noise.take(2 * count)
            self.bias = self.bias + normal[:count] * self.bias_drift * math.sqrt(elapsed_s / 100.0)
            self._readings = self._tensions() + self.bias + normal[count:] * self.tension_noise
            for i, fault in sorted(self.cell_faults.items()):
                self._readings[i] = fault(float(self._readings[i]))
        return self._readings


class AmplifierNode:
    """A simulated CiA 404 amplifier.

    Attributes:
        node_id: node number of the amplifier.
        cells: indices of the load cells of this amplifier in the hand's list of load cells.
        nmt: NMT state of the amplifier.
        objects: object dictionary of the amplifier.
        ids: identifiers of the frames that the node accepts.
        malformed_frame_count: number of frames that the node could not decode.
        wake_ns: time of the next heartbeat [ns].
        serial: serial number of the amplifier.
    """

    def __init__(
        self,
        load_cells: LoadCellAmplifiers,
        spec: SensorSpec,
        node_id: int,
        cell_indices: range,
        serial: int,
    ) -> None:
        """Set up the amplifier in the state after power-up."""
        self._load_cells = load_cells
        self._range = spec.rated_load
        self.node_id = node_id
        self.cells = cell_indices
        self.serial = serial
        self.malformed_frame_count = 0
        self._now_ns = 0
        self._out: list[Frame] = []
        self.restart()

    def restart(self) -> None:
        """Restart the amplifier with all objects as delivered, and announce the restart on the bus."""
        self.objects = AmplifierObjects(self.node_id, len(self.cells), self._range, self.serial)
        self.nmt = PRE_OPERATIONAL
        self._syncs = 0
        self._update_ids()
        self._out.append(Frame(0x700 + self.node_id, b"\0"))
        self.wake_ns = 0

    def _update_ids(self) -> None:
        """Update the identifiers of the frames that the node answers."""
        self._sync_id = self.objects[0x1005, 0] & 0x7FF
        self.ids = frozenset((0x000, self._sync_id, 0x600 + self.node_id))

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Process a frame from the bus.

        Returns:
            The frames that the amplifier sends in response, or None if the frame is not meant for
            this node.
        """
        can_id = frame.can_id
        data = frame.data
        if frame.flags & FDF or can_id & REMOTE_FLAG or can_id not in self.ids:
            return None
        self._now_ns = t_ns
        if can_id == 0x000:
            if len(data) != 2 or data[1] not in (0, self.node_id):
                return None
            self._nmt_command(data[0])
        elif can_id == self._sync_id:
            self._synchronise(data)
        elif self.nmt != STOPPED_STATE:
            self._answer_sdo_request(data)
        return self._take_queued_frames()

    def wake(self, t_ns: int) -> list[Frame]:
        """Return all frames that wait to be sent, with the heartbeat if it is due."""
        self._now_ns = t_ns
        period_ns = self.objects[0x1017, 0] * 1_000_000
        if period_ns and not self._out:
            self._out.append(Frame(0x700 + self.node_id, bytes((self.nmt,))))
        self.wake_ns = t_ns + period_ns if period_ns else _NEVER_NS
        return self._take_queued_frames()

    def _take_queued_frames(self) -> list[Frame]:
        """Return the frames that wait to be sent, except suppressed frames, and empty the list of waiting frames."""
        queued_frames = self._out
        self._out = []
        suppressed = self._load_cells.suppressed
        for frame in queued_frames:
            if frame.can_id in suppressed:
                suppressed[frame.can_id]()
        return [frame for frame in queued_frames if frame.can_id not in suppressed]

    def _nmt_command(self, nmt_command: int) -> None:
        """Execute a command of the CANopen network management (NMT)."""
        if nmt_command in (0x81, 0x82):
            self.restart()
            return
        nmt_before = self.nmt
        self.nmt = {0x01: OPERATIONAL_STATE, 0x02: STOPPED_STATE, 0x80: PRE_OPERATIONAL}.get(
            nmt_command, nmt_before
        )
        if self.nmt == OPERATIONAL_STATE != nmt_before:
            self._syncs = 0
            self._send_tpdos(lambda kind: kind > MAX_SYNCHRONOUS_TYPE)

    def _synchronise(self, data: bytes) -> None:
        """Process a SYNC frame: read the load cells, and send the TPDOs that are due."""
        if data:
            self.malformed_frame_count += 1
            return
        if self.nmt == OPERATIONAL_STATE:
            self._syncs += 1
            self._send_tpdos(
                lambda kind: 1 <= kind <= MAX_SYNCHRONOUS_TYPE and self._syncs % kind == 0
            )

    def _send_tpdos(self, is_due: Callable[[int], bool]) -> None:
        """Send all TPDOs that are due.

        The argument ``is_due`` is a function that takes a transmission type, and returns True if
        TPDOs of this type are due.
        """
        self._sample_load_cells()
        for i in range(TPDO_COUNT):
            can_id = self.objects[0x1800 + i, 1]
            if not can_id & PDO_DISABLED_BIT and is_due(self.objects[0x1800 + i, 2]):
                self._out.append(Frame(can_id & 0x7FF, self.objects.payload(i)))

    def _sample_load_cells(self) -> None:
        """Read the load cells of this amplifier."""
        readings = self._load_cells.sample_tensions(self._now_ns)
        self.objects.readings = [float(readings[i]) for i in self.cells]

    def _answer_sdo_request(self, data: bytes) -> None:
        """Answer a request for an object (SDO request).

        An object has up to four bytes and is transferred in one frame.
        """
        if len(data) != 8:
            self.malformed_frame_count += 1
            return
        if data[0] != SDO_CLIENT_ABORT_COMMAND:
            self._out.append(
                Frame(0x580 + self.node_id, sdo_reply(data, self._execute_sdo_request))
            )

    def _execute_sdo_request(self, data: bytes, key: tuple[int, int]) -> bytes:
        """Execute a request for an object (SDO request).

        Returns:
            Payload of the SDO reply.

        Raises:
            SdoAbort: the amplifier refuses the request.
        """
        if data[0] >> 5 == 2:
            self._sample_load_cells()
            raw_bytes = self.objects.read(key)
            return (
                bytes((0x43 | (4 - len(raw_bytes)) << 2,)) + data[1:4] + raw_bytes.ljust(4, b"\0")
            )
        # Command 1 is a download request. Bit 1 of the specifier is set if the transfer is
        # expedited (in one frame). Bit 0 is set if the request gives the size of the value.
        if data[0] >> 5 != 1 or data[0] & 3 != 3:
            raise SdoAbort(ABORT_UNKNOWN_COMMAND)
        if 0x1000 <= key[0] < 0x1C00 and self.nmt != PRE_OPERATIONAL and key != (0x1017, 0):
            raise SdoAbort(ABORT_WRONG_STATE)
        self.objects.write(key, data[4 : 8 - (data[0] >> 2 & 3)])
        if key[0] < 0x1C00:
            self._update_ids()
        if key == (0x1017, 0):
            self.wake_ns = (
                self._now_ns + self.objects[key] * 1_000_000 if self.objects[key] else _NEVER_NS
            )
        return b"\x60" + data[1:4] + bytes(4)
