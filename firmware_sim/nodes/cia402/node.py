"""A motor with the firmware of a CiA 402 drive in cyclic synchronous torque mode. Source: facts, cia402.

Choices where the fact sheet leaves one: 0x6076 is in mN·m unless ``rated_torque_unit`` says uN_m; leaving operational
while enabled, and a lost master, are faults when 0x6007 is 1 and switch the power stage off when it is 2 or 3; PDOs can
be changed in pre-operational only.
"""

from firmware_sim.bus.frame import FDF, REMOTE, Frame
from firmware_sim.description import MotorSpec
from firmware_sim.nodes.cia402.dictionary import Abort, Dictionary
from firmware_sim.nodes.cia402.laws import (
    CST,
    OPERATIONAL,
    WARM_NS,
    Cia402Row,
    beats,
    follow,
    follows,
    measure,
    schedule,
    starves,
)
from firmware_sim.nodes.cia402.pdo import Pdos
from firmware_sim.nodes.cia402.power import ENABLED, FAULT, OFF, Power, PowerRow
from firmware_sim.nodes.thermal import Thermal
from firmware_sim.plant.motor import Motor

PRE_OPERATIONAL, STOPPED = 0x7F, 0x04
HEARTBEAT_LOST, MOTOR_HOT, STOPPED_WHILE_ENABLED, RPDO_SHORT = 0x8130, 0x4310, 0x8100, 0x8210
NOT_NOW = 0x08000022
HOT_C = 120.0
_UNITS = {"mN_m": 1e3, "uN_m": 1e6}


class Cia402Node:
    """One drive.

    Attributes:
        nmt: state of the network slave. power: state machine of the power stage. objects: its dictionary.
        thermal: temperatures. ids: None: many. malformed: frames that it could not read.
        wake_ns: when time must pass next [ns]. fed_ns: last heartbeat of the master [ns]; -1 if it is not watched.
        warmed_ns, beat_ns: of its temperature, and of its last heartbeat [ns]. syncs: SYNCs since the last reset.
        sync_id, master_id, rpdo_id, tpdo_id, tpdo_kind: of the frames that come in every tick, see ``pdo.Pdos``.
        takes: identifiers that it may answer. values: of its dictionary. at_once: whether it has something to send.
    """

    def __init__(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Args: the motor's description; its rotor; shaft angle at theta = 0 [rad]."""
        self.motor, self.offset, self._spec = motor, offset, spec
        self.node_id, self.direction, self.peak = spec.node_id, spec.direction, spec.torque_peak
        self.gear = float(spec.options.get("gear_ratio", 1.0))
        self.rated = float(spec.options.get("rated_torque_N_m", spec.torque_max / self.gear))
        self.counts = int(spec.options.get("counts_per_turn", 1 << 16))
        self.thermal = Thermal(spec.torque_constant)
        self.ids: frozenset[int] | None = None
        self.malformed = 0
        self.wake_ns, self.warmed_ns, self.at_once = 0, -1, False
        self._spoken: list[Frame] = []
        self._reset(announce=True)

    def _reset(self, announce: bool) -> None:
        """Start anew: everything that was not saved is lost, and nothing can be saved."""
        self.motor.servo.release()
        self.objects, self.power, self.nmt = *self._fresh(), PRE_OPERATIONAL
        self.objects[0x6076, 0] = round(self.rated * _UNITS[self._spec.options.get("rated_torque_unit", "mN_m")])
        if self._spec.serial is not None:
            self.objects[0x1018, 4] = self._spec.serial
        self.pdos, self.syncs = Pdos(self.objects), 0
        self.beat_ns = self.fed_ns = -1
        self._renew()
        if announce:
            self._spoken.append(Frame(0x700 + self.node_id, b"\0"))

    def _fresh(self) -> tuple[Dictionary, Power]:
        """Return a dictionary and a power stage as they are at the start."""
        objects = Dictionary(self.node_id)
        self.values = objects.values
        return objects, Power()

    def _renew(self) -> None:
        """Take over what depends on the communication objects."""
        self.sync_id = self.objects[0x1005, 0] & 0x7FF
        self.master_id = 0x700 + (self.objects[0x1016, 1] >> 16 & 0x7F)
        self.rpdo_id, (self.tpdo_id, self.tpdo_kind) = self.pdos.usual_rpdo(), self.pdos.usual_tpdo()
        self.takes = frozenset((0, self.sync_id, 0x600 + self.node_id, self.master_id, *self.pdos.identifiers))

    @property
    def cyclic(self) -> tuple[int, ...]:
        """Identifiers of the frames that come in every tick."""
        usual = {self.master_id, self.rpdo_id} | ({self.sync_id} if self.tpdo_id >= 0 else set())
        return tuple(usual - {-1, 0, 0x600 + self.node_id})

    def receive(self, frame: Frame, t_ns: int) -> list[Frame] | None:
        """Return what it sends because of a frame; None if the frame is not for this node."""
        can_id, data = frame.can_id, frame.data
        if frame.flags & FDF or can_id & REMOTE:
            return None
        if can_id == 0x000:
            known = len(data) == 2 and data[1] in (0, self.node_id)
            if known:
                self._network(data[0])
        elif can_id == self.sync_id:
            known = self._synchronise()
        elif can_id == 0x600 + self.node_id:
            known = self.nmt != STOPPED
            if known:
                self._sdo(data)
        elif can_id == self.master_id:
            known, self.fed_ns = True, t_ns
        else:
            known = self._rpdo(can_id, data)
        schedule(self, t_ns, bool(self._spoken))
        return self._take_spoken() if known else None

    def _take_spoken(self) -> list[Frame]:
        spoken, self._spoken = self._spoken, []
        return spoken

    def _network(self, order: int) -> None:
        if order in (0x81, 0x82):
            self._reset(announce=True)
            return
        state = {0x01: OPERATIONAL, 0x02: STOPPED, 0x80: PRE_OPERATIONAL}.get(order, self.nmt)
        left = self.nmt == OPERATIONAL != state
        self.nmt = state
        if left and self.power.state == ENABLED:
            self._connection_lost(STOPPED_WHILE_ENABLED)
        elif state == OPERATIONAL:
            self._tell_status()

    def _connection_lost(self, code: int) -> None:
        """React as 0x6007 says."""
        option = self.objects[0x6007, 0]
        if option == 1:
            self.trip(code)
        elif option:
            self.power.state = OFF
            self._apply()

    def trip(self, code: int) -> None:
        """Enter fault and say why."""
        self.at_once = True
        self.power.fail()
        self.objects[0x603F, 0] = code
        self.objects[0x1001, 0] = 0x11 if code == HEARTBEAT_LOST else 0x01
        self._emergency(code)
        self._apply()

    def forget(self) -> None:
        """Lose the torque limit and the supervision of the master, and go on as before."""
        fresh = Dictionary(self.node_id)
        for key in ((0x6072, 0), (0x6007, 0), (0x1016, 1)):
            self.objects[key] = fresh[key]
        self.fed_ns = -1
        self._renew()
        self._apply()

    def _emergency(self, code: int) -> None:
        if self.nmt != STOPPED:
            data = code.to_bytes(2, "little") + bytes((self.objects[0x1001, 0],)) + bytes(5)
            self._spoken.append(Frame(0x80 + self.node_id, data))

    def _sdo(self, data: bytes) -> None:
        """Answer a request of the SDO server: objects of up to four bytes, expedited."""
        if len(data) != 8:
            self.malformed += 1
            return
        if data[0] == 0x80:
            return  # the client gives up
        key = (int.from_bytes(data[1:3], "little"), data[3])
        try:
            reply = self._access(data, key)
        except Abort as abort:
            reply = b"\x80" + data[1:4] + abort.code.to_bytes(4, "little")
        self._spoken.append(Frame(0x580 + self.node_id, reply))

    def _access(self, data: bytes, key: tuple[int, int]) -> bytes:
        specifier = data[0]
        if specifier >> 5 == 2:
            self._measure()
            raw = self.objects.read(key)
            return bytes((0x43 | (4 - len(raw)) << 2,)) + data[1:4] + raw.ljust(4, b"\0")
        if specifier >> 5 != 1 or not specifier & 2:
            raise Abort(0x05040001)
        size = 4 - (specifier >> 2 & 3) if specifier & 1 else self.objects.size(key)
        self._write(key, data[4 : 4 + size])
        return b"\x60" + data[1:4] + bytes(4)

    def _write(self, key: tuple[int, int], raw: bytes) -> None:
        if 0x1400 <= key[0] < 0x1C00:
            if self.nmt != PRE_OPERATIONAL:
                raise Abort(NOT_NOW)
            self.pdos.write(key, raw)
        else:
            self.objects.write(key, raw)
        if key[0] < 0x2000:
            self._renew()
        if key == (0x1016, 1):
            self.fed_ns = -1
        elif key == (0x1017, 0):
            self.beat_ns = -1
        self._act(key)

    def _act(self, key: tuple[int, int]) -> None:
        """Let a value that was written act."""
        if key == (0x6040, 0):
            self._control(self.objects[key])
        elif key == (0x6060, 0):
            self.objects[0x6061, 0] = CST if self.objects[key] == CST else 0
        self._apply()

    def _control(self, word: int) -> None:
        before = self.power.state
        self.power.command(word)
        if before == FAULT != self.power.state:
            self.objects[0x603F, 0] = self.objects[0x1001, 0] = 0
            self._emergency(0)
        if self.power.state != before:
            self._tell_status()

    def _tell_status(self) -> None:
        """Send the PDOs that are sent on a change."""
        if self.nmt == OPERATIONAL:
            self._measure()
            self._spoken += self.pdos.on_event()

    def _rpdo(self, can_id: int, data: bytes) -> bool:
        if not self.pdos.receives(can_id):
            return False
        if self.nmt != OPERATIONAL:
            return True
        keys = self.pdos.unpack(can_id, data)
        if keys is None:
            self.malformed += 1
            self._emergency(RPDO_SHORT)
        for key in keys or ():
            self._act(key)
        return True

    def _synchronise(self) -> bool:
        """Apply what waited for SYNC, sample, send."""
        if self.nmt != OPERATIONAL:
            return False
        for key in self.pdos.synchronise():
            self._act(key)
        self._measure()
        self.syncs += 1
        self._spoken += self.pdos.on_sync(self.syncs)
        return True

    def _measure(self) -> None:
        """Renew what is measured."""
        measure(self, self.power, self.motor.encoder(), self.motor.velocity, self.motor.torque)

    def _apply(self) -> None:
        """Make the torque that was asked for, if power stage and mode allow it."""
        if follows(self, self.power):
            follow(self, self.motor.servo)
        else:
            self.motor.servo.release()

    def wake(self, t_ns: int) -> list[Frame]:
        """Judge the master's heartbeat and the temperature; return what is due."""
        if self.warmed_ns < 0 or t_ns - self.warmed_ns >= WARM_NS:
            self._warm(t_ns)
        if beats(self, t_ns):
            self._spoken.append(Frame(0x700 + self.node_id, bytes((self.nmt,))))
            self.beat_ns = t_ns
        if starves(self, t_ns):
            self.fed_ns = -1
            self._connection_lost(HEARTBEAT_LOST)
        schedule(self, t_ns, bool(self._spoken))
        return self._take_spoken()

    def _warm(self, t_ns: int) -> None:
        if self.warmed_ns >= 0:
            self.thermal.advance((t_ns - self.warmed_ns) * 1e-9, self.motor.heat)
        self.motor.heat, self.warmed_ns = 0.0, t_ns
        if self.thermal.winding > HOT_C and self.power.state == ENABLED:
            self.trip(MOTOR_HOT)


class Cia402NodeRow(Cia402Row, Cia402Node):
    """A drive whose numbers are a row of an array."""

    layout = Cia402Row

    def prepare(self, spec: MotorSpec, motor: Motor, offset: float) -> None:
        """Fill the row; see ``Cia402Node``."""
        Cia402Node.__init__(self, spec, motor, offset)
        self.motor_number = motor.number

    def _fresh(self) -> tuple[Dictionary, Power]:
        power: PowerRow = self.power_stage
        Power.__init__(power)
        return Dictionary(self.node_id, self.values), power
