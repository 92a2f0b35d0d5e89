"""A motor with the firmware of a CiA 402 drive. Source: fact sheet cia402.

The mode cyclic synchronous torque is in this module and in ``kernels``. All other modes are in
``motion_modes``.

Frames (COB-ID, payload little-endian):

    0x000       NMT          u8 command, u8 node (0 for all)
    0x080       SYNC         object 0x1005
    0x080+node  EMCY         u16 error code, u8 error register, 5 bytes 0
    0x580+node  SDO reply    u8 specifier, u16 index, u8 sub-index, u32 value or abort code
    0x600+node  SDO request  u8 specifier, u16 index, u8 sub-index, u32 value
    0x700+node  heartbeat    u8 NMT state
    RPDO, TPDO  see ``pdo``

A text object is uploaded in several segments. The first reply is 0x41 with the length of the text.
The requests 0x60 and 0x70 of the host then alternate, and each reply has up to seven bytes of the
text. Writing ``save`` to 0x1010:1 stores the settings.

SDO specifiers: 0x40 upload request, 0x43 | 4 n upload reply with n unused bytes, 0x23 | 4 n
download request, 0x60 download reply, 0x80 abort.

Choices of this simulator where the fact sheet is not definite:

- Object 0x6076 has the unit mN·m, unless the option ``rated_torque_unit`` is uN_m.
- If the value of object 0x6007 is 1, two events are faults: the node leaves the state operational
  while enabled, or the master's heartbeat is lost. If the value is 2 or 3, each of these two events
  switches the power stage off.
- A host can change PDOs only while the node is in the state pre-operational.
"""

from firmware_sim.bus.frame import FDF, REMOTE_FLAG, Frame
from firmware_sim.description.hand_description import MotorSpec
from firmware_sim.nodes.cia402.kernels import (
    CYCLIC_TORQUE_MODE,
    OPERATIONAL_STATE,
    THERMAL_PERIOD_NS,
    Cia402Struct,
    apply_torque,
    heartbeat_due,
    is_in_torque_mode,
    schedule_wake,
    update_measured_objects,
    watchdog_expired,
)
from firmware_sim.nodes.cia402.motion_modes import MOTION_MODES, MotionModes, check_object_value
from firmware_sim.nodes.cia402.object_dictionary import (
    ABORT_UNKNOWN_COMMAND,
    ABORT_WRONG_STATE,
    SDO_CLIENT_ABORT_COMMAND,
    ObjectDictionary,
    ObjectKey,
    SdoAbort,
    sdo_reply,
)
from firmware_sim.nodes.cia402.pdo import NodePdos
from firmware_sim.nodes.cia402.power_stage import (
    ENABLED_STATE,
    FAULT_STATE,
    OFF_STATE,
    PowerStage,
    PowerStruct,
)
from firmware_sim.nodes.drive_temperatures import DriveTemperatures
from firmware_sim.plant.motor import Motor

PRE_OPERATIONAL = 0x7F
"""NMT state: pre-operational."""
STOPPED_STATE = 0x04
"""NMT state: stopped."""
HEARTBEAT_LOST = 0x8130
"""Emergency code: the master's heartbeat is lost."""
MOTOR_OVERHEATED_ERROR = 0x4310
"""Emergency code: over-temperature of the motor."""
STOPPED_WHILE_ENABLED_ERROR = 0x8100
"""Emergency code: the node left the NMT state operational while the drive was enabled."""
PDO_LENGTH_ERROR = 0x8210
"""Emergency code: an RPDO is too short."""
OVERHEATING_C = 120.0
"""Winding temperature at which the drive trips [degC]."""
_UNITS_PER_N_M = {"mN_m": 1e3, "uN_m": 1e6}
"""Value of object 0x6076 for a torque of 1 N m, by the unit of the object."""


class Cia402Node:
    """A simulated CiA 402 drive.

    Attributes:
        nmt: NMT state of the node.
        power: state machine of the drive's power stage.
        objects: object dictionary.
        thermal: temperatures of the drive.
        ids: None, because the node answers many identifiers.
        malformed_frame_count: number of frames that the node could not decode.
        wake_ns: time of the next call of ``wake`` [ns].
        watchdog_fed_ns: time of the master's last heartbeat [ns], or -1 if the drive does not
            supervise the master.
        thermal_ns: time of the last update of the temperatures [ns].
        heartbeat_ns: time of the drive's last heartbeat [ns].
        syncs: number of SYNC frames since the last reset.
        sync_id: identifier of the SYNC frame.
        master_id: identifier of the master's heartbeat.
        rpdo_id: identifier of the standard RPDO, see ``pdo.NodePdos``.
        tpdo_id: identifier of the standard TPDO, see ``pdo.NodePdos``.
        tpdo_kind: transmission type of the standard TPDO.
        accepted_ids: identifiers of the frames that the node answers.
        values: values of the object dictionary.
        frame_pending: True if a frame of the drive waits to be sent.
        motion: position, velocity and homing modes of the drive.
        motion_due_ns: time of the next update of ``motion_modes`` [ns], or 0 in torque mode.
        mode_bits: status word bits that the active mode sets, or -1 in torque mode.
    """

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Set up the drive in the state after power-up.

        Args:
            spec: description of the motor.
            motor: rotor of the motor.
            offset: shaft angle when the spool angle theta is 0 [rad].
        """
        self.motor = motor
        self.offset = offset
        self._spec = spec
        self.node_id = spec.node_id
        self.direction = spec.direction
        self.peak = spec.torque_peak
        self.gear = float(spec.options.get("gear_ratio", 1.0))
        self.rated = float(spec.options.get("rated_torque_N_m", spec.torque_max / self.gear))
        self.counts = int(spec.options.get("counts_per_turn", 1 << 16))
        self.thermal = DriveTemperatures(spec.torque_constant)
        self.ids: frozenset[int] | None = None
        self.malformed_frame_count = 0
        self.wake_ns = 0
        self.thermal_ns = -1
        self.frame_pending = False
        self._now_ns = 0
        self.motion_due_ns = 0
        self.mode_bits = -1
        self.motion = MotionModes(self)
        self._unsolicited: list[Frame] = []
        self._stored: dict[ObjectKey, int] = {}
        self._segments: list[bytes] = []
        self._reset(sends_boot_message=True)

    def _reset(self, sends_boot_message: bool) -> None:
        """Restart the drive with its stored settings.

        Args:
            sends_boot_message: True to send the boot-up message.
        """
        self.motor.servo.release()
        self.motion.end()
        self.objects, self.power, self.nmt = *self._initial_objects(), PRE_OPERATIONAL
        self.objects[0x608F, 1] = int(self.counts)
        for key, value in self._stored.items():
            self.objects[key] = value
        self.objects[0x6076, 0] = round(
            self.rated * _UNITS_PER_N_M[self._spec.options.get("rated_torque_unit", "mN_m")]
        )
        if self._spec.serial is not None:
            self.objects[0x1018, 4] = self._spec.serial
        self.pdos = NodePdos(self.objects)
        self.syncs = 0
        self.heartbeat_ns = self.watchdog_fed_ns = -1
        self._update_derived_values()
        if sends_boot_message:
            self._unsolicited.append(Frame(0x700 + self.node_id, b"\0"))

    def _initial_objects(self) -> tuple[ObjectDictionary, PowerStage]:
        """Create the object dictionary and the power stage, both in the state after power-up."""
        objects = ObjectDictionary(self.node_id)
        self.values = objects.values
        return objects, PowerStage()

    def _update_derived_values(self) -> None:
        """Update the node attributes derived from communication objects."""
        self.sync_id = self.objects[0x1005, 0] & 0x7FF
        self.master_id = 0x700 + (self.objects[0x1016, 1] >> 16 & 0x7F)
        self.rpdo_id, (self.tpdo_id, self.tpdo_kind) = (
            self.pdos.standard_rpdo(),
            self.pdos.standard_tpdo(),
        )
        self.accepted_ids = frozenset(
            (0, self.sync_id, 0x600 + self.node_id, self.master_id, *self.pdos.identifiers)
        )

    @property
    def cyclic_ids(self) -> tuple[int, ...]:
        """Return the identifiers of the frames that the node receives in every tick."""
        standard = {self.master_id, self.rpdo_id} | ({self.sync_id} if self.tpdo_id >= 0 else set())
        return tuple(standard - {-1, 0, 0x600 + self.node_id})

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Process a frame from the bus.

        Returns:
            The frames sent in response by the drive, or None if the frame is not for this node.
        """
        can_id = frame.can_id
        data = frame.data
        self._now_ns = t_ns
        if frame.flags & FDF or can_id & REMOTE_FLAG:
            return None
        if can_id == 0x000:
            is_handled = len(data) == 2 and data[1] in (0, self.node_id)
            if is_handled:
                self._nmt_command(data[0])
        elif can_id == self.sync_id:
            is_handled = self._synchronise()
        elif can_id == 0x600 + self.node_id:
            is_handled = self.nmt != STOPPED_STATE
            if is_handled:
                self._answer_sdo_request(data)
        elif can_id == self.master_id:
            is_handled = True
            self.watchdog_fed_ns = t_ns
        else:
            is_handled = self._process_rpdo(can_id, data)
        schedule_wake(self, t_ns, bool(self._unsolicited))
        return self._take_unsolicited_frames() if is_handled else None

    def _take_unsolicited_frames(self) -> list[Frame]:
        """Return the frames waiting to be sent, and empty the list."""
        unsolicited_frames = self._unsolicited
        self._unsolicited = []
        return unsolicited_frames

    def _nmt_command(self, nmt_command: int) -> None:
        """Execute a command of the CANopen network management (NMT)."""
        if nmt_command in (0x81, 0x82):
            self._reset(sends_boot_message=True)
            return
        state = {0x01: OPERATIONAL_STATE, 0x02: STOPPED_STATE, 0x80: PRE_OPERATIONAL}.get(
            nmt_command, self.nmt
        )
        leaves_operational_state = self.nmt == OPERATIONAL_STATE != state
        self.nmt = state
        if leaves_operational_state and self.power.state == ENABLED_STATE:
            self._connection_lost(STOPPED_WHILE_ENABLED_ERROR)
        elif state == OPERATIONAL_STATE:
            self._send_event_pdos()

    def _connection_lost(self, error_code: int) -> None:
        """React to a lost connection.

        Object 0x6007 (abort connection option) selects the reaction to a lost connection. The drive
        does not react if the value is 0, and enters the fault state if the value is 1. With any
        other value, the drive switches the power stage off.
        """
        option = self.objects[0x6007, 0]
        if option == 1:
            self.trip(error_code)
        elif option:
            self.power.state = OFF_STATE
            self._apply_torque()

    def trip(self, error_code: int) -> None:
        """Enter the fault state and send an emergency message."""
        self.frame_pending = True
        self.power.enter_fault_state()
        self.objects[0x603F, 0] = error_code
        self.objects[0x1001, 0] = 0x11 if error_code == HEARTBEAT_LOST else 0x01
        self._send_emergency(error_code)
        self._apply_torque()

    def lose_settings(self) -> None:
        """Reset the torque limit and the supervision of the master to the defaults, but keep the drive's state."""
        initial = ObjectDictionary(self.node_id)
        for key in ((0x6072, 0), (0x6007, 0), (0x1016, 1)):
            self.objects[key] = initial[key]
        self.watchdog_fed_ns = -1
        self._update_derived_values()
        self._apply_torque()

    def _send_emergency(self, error_code: int) -> None:
        """Send an emergency message, unless the node is in the NMT state *stopped*."""
        if self.nmt != STOPPED_STATE:
            data = error_code.to_bytes(2, "little") + bytes((self.objects[0x1001, 0],)) + bytes(5)
            self._unsolicited.append(Frame(0x80 + self.node_id, data))

    def _answer_sdo_request(self, data: bytes) -> None:
        """Answer a request for an object (SDO request).

        A number has up to four bytes and is transferred in one frame.
        """
        if len(data) != 8:
            self.malformed_frame_count += 1
            return
        if data[0] != SDO_CLIENT_ABORT_COMMAND:
            self._unsolicited.append(
                Frame(0x580 + self.node_id, sdo_reply(data, self._execute_sdo_request))
            )

    def _execute_sdo_request(self, data: bytes, key: tuple[int, int]) -> bytes:
        """Execute a request for an object (SDO request).

        Returns:
            The payload of the SDO reply.

        Raises:
            SdoAbort: the drive refuses the request.
        """
        specifier = data[0]
        if specifier >> 5 == 3:
            return self._next_segment(specifier >> 4 & 1)
        if specifier >> 5 == 2 and key in self.objects.texts:
            return self._first_segment(data[1:4], self.objects.texts[key])
        if specifier >> 5 == 2:
            self._update_measured_objects()
            raw_bytes = self.objects.read(key)
            return (
                bytes((0x43 | (4 - len(raw_bytes)) << 2,)) + data[1:4] + raw_bytes.ljust(4, b"\0")
            )
        # Command 1 is a download request. Bit 1 of the specifier is set if the transfer is
        # expedited (in one frame).
        if specifier >> 5 != 1 or not specifier & 2:
            raise SdoAbort(ABORT_UNKNOWN_COMMAND)
        # If bit 0 of the specifier is set, bits 3..2 give the number of unused bytes. If bit 0 is
        # not set, the size of the object is used, because the request contains no size.
        size = 4 - (specifier >> 2 & 3) if specifier & 1 else self.objects.object_size(key)
        self._write_object(key, data[4 : 4 + size])
        return b"\x60" + data[1:4] + bytes(4)

    def _first_segment(self, object_address: bytes, text: bytes) -> bytes:
        """Return the reply that announces a text, and store the text in segments of up to seven bytes."""
        self._segments = [text[i : i + 7] for i in range(0, len(text), 7)]
        return b"\x41" + object_address + len(text).to_bytes(4, "little")

    def _next_segment(self, toggle_bit: int) -> bytes:
        """Return the reply with the next segment of a text.

        Args:
            toggle_bit: toggle bit of the request.

        Raises:
            SdoAbort: no upload of a text is in progress.
        """
        if not self._segments:
            raise SdoAbort(ABORT_UNKNOWN_COMMAND)
        segment = self._segments.pop(0)
        # In the specifier of the reply, bit 4 is the toggle bit, bits 3..1 are the number of unused
        # bytes, and bit 0 marks the last segment.
        command_byte = toggle_bit << 4 | (7 - len(segment)) << 1 | (not self._segments)
        return bytes((command_byte,)) + segment.ljust(7, b"\0")

    def _write_object(self, key: tuple[int, int], value_bytes: bytes) -> None:
        """Write the value that a host has sent to an object, and apply the new value."""
        # The range of indices below contains the communication and mapping objects of RPDOs
        # (0x1400, 0x1600) and TPDOs (0x1800, 0x1A00).
        if 0x1400 <= key[0] < 0x1C00:
            if self.nmt != PRE_OPERATIONAL:
                raise SdoAbort(ABORT_WRONG_STATE)
            self.pdos.write(key, value_bytes)
        else:
            check_object_value(key[0], int.from_bytes(value_bytes, "little", signed=True))
            self.objects.write(key, value_bytes)
        if key[0] < 0x2000:
            self._update_derived_values()
        if key == (0x1010, 1):
            if value_bytes == b"save":
                self._stored = self.objects.settings()
            self.objects[key] = 1
        if key == (0x1016, 1):
            self.watchdog_fed_ns = -1
        elif key == (0x1017, 0):
            self.heartbeat_ns = -1
        self._apply_object_value(key)

    def _apply_object_value(self, key: tuple[int, int]) -> None:
        """Apply the new value of an object that a host has written."""
        if key == (0x6040, 0):
            self._apply_control_word(self.objects[key])
        elif key == (0x6060, 0):
            mode = self.objects[key]
            self.objects[0x6061, 0] = mode if mode in (CYCLIC_TORQUE_MODE, *MOTION_MODES) else 0
        self.motion.take(key[0])
        self._apply_torque()

    def _apply_control_word(self, control_word: int) -> None:
        """Apply a control word to the power stage."""
        state_before = self.power.state
        self.power.command(control_word)
        if state_before == FAULT_STATE != self.power.state:
            self.objects[0x603F, 0] = self.objects[0x1001, 0] = 0
            self._send_emergency(0)
        if self.power.state != state_before:
            self._send_event_pdos()

    def _send_event_pdos(self) -> None:
        """Send the TPDOs whose transmission type is *on a change*."""
        if self.nmt == OPERATIONAL_STATE:
            self._update_measured_objects()
            self._unsolicited += self.pdos.event_driven_frames()

    def _process_rpdo(self, can_id: int, payload: bytes) -> bool:
        """Process an RPDO of this node, and ignore any other frame.

        Returns:
            True if the identifier belongs to an RPDO of this node.
        """
        if not self.pdos.accepts_identifier(can_id):
            return False
        if self.nmt != OPERATIONAL_STATE:
            return True
        keys = self.pdos.unpack(can_id, payload)
        if keys is None:
            self.malformed_frame_count += 1
            self._send_emergency(PDO_LENGTH_ERROR)
        for key in keys or ():
            self._apply_object_value(key)
        return True

    def _synchronise(self) -> bool:
        """Process a SYNC frame: apply the stored RPDOs, update the measured objects, and send TPDOs.

        Returns:
            True if the node is in the state operational.
        """
        if self.nmt != OPERATIONAL_STATE:
            return False
        for key in self.pdos.synchronise():
            self._apply_object_value(key)
        self._update_measured_objects()
        self.syncs += 1
        self._unsolicited += self.pdos.frames_on_sync(self.syncs)
        return True

    def _update_measured_objects(self) -> None:
        """Update the objects of the drive with measured values."""
        update_measured_objects(
            self, self.power, self.motor.encoder(), self.motor.velocity, self.motor.torque
        )

    def _apply_torque(self) -> None:
        """Follow a motion mode or the target torque, as the mode of operation requires.

        If the drive is not enabled, or if its mode of operation is not simulated, release the
        servo.
        """
        mode = self.objects[0x6061, 0]
        if self.power.state == ENABLED_STATE and mode in MOTION_MODES:
            if not self.motion.is_active:
                self.motor.servo.release()
            self.motion.start(mode, self._now_ns)
            return
        if self.motion.is_active:
            self.motor.servo.release()
        self.motion.end()
        if is_in_torque_mode(self, self.power):
            apply_torque(self, self.motor.servo)
        else:
            self.motor.servo.release()

    def wake(self, t_ns: int) -> list[Frame]:
        """Do the work that is due: update temperatures and motion, send the heartbeat, check the master's heartbeat.

        Returns:
            The frames that the drive sends.
        """
        self._now_ns = t_ns
        if self.thermal_ns < 0 or t_ns - self.thermal_ns >= THERMAL_PERIOD_NS:
            self._update_temperatures(t_ns)
        self.motion.advance(t_ns)
        if heartbeat_due(self, t_ns):
            self._unsolicited.append(Frame(0x700 + self.node_id, bytes((self.nmt,))))
            self.heartbeat_ns = t_ns
        if watchdog_expired(self, t_ns):
            self.watchdog_fed_ns = -1
            self._connection_lost(HEARTBEAT_LOST)
        schedule_wake(self, t_ns, bool(self._unsolicited))
        return self._take_unsolicited_frames()

    def _update_temperatures(self, t_ns: int) -> None:
        """Advance the temperatures of the drive.

        If the winding is too hot, enter the fault state.
        """
        if self.thermal_ns >= 0:
            self.thermal.advance((t_ns - self.thermal_ns) * 1e-9, self.motor.heat)
        self.motor.heat = 0.0
        self.thermal_ns = t_ns
        if self.thermal.winding > OVERHEATING_C and self.power.state == ENABLED_STATE:
            self.trip(MOTOR_OVERHEATED_ERROR)


class Cia402NodeRow(Cia402Struct, Cia402Node):
    """A simulated drive whose state is in an array row, for compiled kernels."""

    layout = Cia402Struct

    def initialise(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Set the array row of the drive to the state after power-up.

        The class ``Cia402Node`` explains the arguments.
        """
        Cia402Node.__init__(self, spec, motor, offset)
        self.motor_number = motor.number

    def _initial_objects(self) -> tuple[ObjectDictionary, PowerStage]:
        power: PowerStruct = self.power_stage
        PowerStage.__init__(power)
        return ObjectDictionary(self.node_id, self.values), power
