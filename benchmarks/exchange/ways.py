"""Ways to send a torque to each of some MIT motors and to read what they answer: ``send(torques)``, ``receive()``.

What users would pick from the package index instead is in ``clients``.
"""

from functools import partial

LIMIT, POSITION, VELOCITY = 0.8, 12.5, 50.0
REPLY = bytes((0x80, 0x10, 0x7F, 0xF8, 0x20, 30, 31))
DBC = """VERSION ""
NS_ :
BS_:
BU_: H
BO_ 1 Command: 8 H
 SG_ position : 7|16@0+ (0.00038147554741741055,-12.5) [-12.5|12.5] "rad" H
 SG_ velocity : 23|12@0+ (0.02442002442002442,-50) [-50|50] "rad/s" H
 SG_ kp : 27|12@0+ (0.1221001221001221,0) [0|500] "" H
 SG_ kd : 47|12@0+ (0.001221001221001221,0) [0|5] "" H
 SG_ torque : 51|12@0+ (0.0003907203907203907,-0.8) [-0.8|0.8] "Nm" H
BO_ 17 Feedback: 8 H
 SG_ state : 7|4@0+ (1,0) [0|15] "" H
 SG_ id : 3|4@0+ (1,0) [0|15] "" H
 SG_ position : 15|16@0+ (0.00038147554741741055,-12.5) [-12.5|12.5] "rad" H
 SG_ velocity : 31|12@0+ (0.02442002442002442,-50) [-50|50] "rad/s" H
 SG_ torque : 35|12@0+ (0.0003907203907203907,-0.8) [-0.8|0.8] "Nm" H
 SG_ mosfet : 55|8@0+ (1,0) [0|255] "C" H
 SG_ winding : 63|8@0+ (1,0) [0|255] "C" H
"""


def feedback(motor: int) -> tuple[int, bytes, int]:
    """Feedback of an enabled Damiao motor, on MST_ID."""
    return 0x10 + motor, bytes((0x10 | motor,)) + REPLY, 0


class Ours:
    """handctl's bus and codec; the frames are those of the drives."""

    answer = staticmethod(feedback)

    def __init__(self, interface, channel, motors):
        from handctl.drives.frame import Frame, make
        from handctl.drives.mit.codec import Ranges, command_message, decode_feedback, feedback_message
        from handctl.drives.signals import Table
        from handctl.runtime.buses.open import open_bus

        self.bus, self.make = open_bus(f"{interface}:{channel}", 0, 1_000_000), make
        self.frame, self.ids, self.ranges = Frame, range(1, motors + 1), Ranges(POSITION, VELOCITY, LIMIT)
        self.commands = [Table(command_message(i, self.ranges)) for i in self.ids]
        self.decode, self.table = decode_feedback, Table(feedback_message(0x11, self.ranges))

    def send(self, torques):
        frame, make, words = self.frame, self.make, zip(self.ids, self.commands, torques, strict=True)
        self.bus.send([make(frame, (i, command.pack(torque), 0, 0, 0)) for i, command, torque in words])

    def receive(self):
        decode, table = self.decode, self.table
        return [decode(frame.data, table) for frame in self.bus.drain()]

    def close(self):
        self.bus.close()


class Drives(Ours):
    """The same as the tick does it: compiled, from records to the values of a block and back."""

    def __init__(self, interface, channel, motors):
        super().__init__(interface, channel, motors)
        import numpy as np

        from handctl.core import block as s
        from handctl.core import wire
        from handctl.core.block import AXES, STATE
        from handctl.drives.contract import NEVER_NS, Phase
        from handctl.drives.mit.drive import MitDrive
        from handctl.drives.records import WORDS, Frames, frames_of
        from handctl.drives.sensors.node import SensorNode

        make = partial(MitDrive, bus=0, ranges=self.ranges, direction=1, zero=0.0, timeout=1000)
        drives = [make(name=str(i), node_id=i, reply_id=i + 0x10) for i in self.ids]
        self.wire, self.tables = wire, wire.Wire(drives, SensorNode(0, 0x080, (), (), (), 0, (-1,) * motors, 1))
        lengths = dict.fromkeys(AXES, 1) | {"tendon": motors, "node": motors + 1, "instance": motors + 1}
        layout = STATE.layout(lengths)
        self.block, self.places = layout.initial.copy(), layout.places
        whole = layout.table(self.block, "tendon_int")
        whole[s.PHASE], whole[s.DUE_NS] = Phase.ENABLED, NEVER_NS
        whole[s.STATUS_EXPECTED] = [0x10 | i for i in self.ids]
        self.out, self.array = np.zeros((motors, WORDS), np.uint64), np.array
        self.frames_of, self.of_rows = frames_of, Frames.of_rows

    def send(self, torques):
        tables = self.tables
        self.wire.send(
            self.block, self.places, self.out, tables.commands, tables.sent_wholes, tables.sent_reals,
            tables.templates, self.array(torques), 0, 0,
        )  # fmt: skip
        self.bus.send(list(self.of_rows(self.out)))

    def receive(self):
        frames, tables = self.frames_of(self.bus.drain()), self.tables
        self.wire.begin(self.block, self.places)
        self.wire.receive(
            self.block, self.places, frames.rows, tables.keys, tables.entries, tables.wholes, tables.reals, 0
        )
        return frames


class Scalar:
    """python-can, a message at a time, and the codec most people write."""

    answer = staticmethod(feedback)

    def __init__(self, interface, channel, motors):
        import can

        self.can, self.ids = can, range(1, motors + 1)
        self.bus = can.Bus(channel, interface=interface, ignore_config=True)

    def encode(self, torque):
        raw = int((torque + LIMIT) * 4095 / (2 * LIMIT))
        return bytes((0x7F, 0xFF, 0x7F, 0xF0, 0, 0, raw >> 8, raw & 0xFF))

    def decode(self, data):
        position = (data[1] << 8 | data[2]) * 2 * POSITION / 65535 - POSITION
        velocity = (data[3] << 4 | data[4] >> 4) * 2 * VELOCITY / 4095 - VELOCITY
        torque = ((data[4] & 0xF) << 8 | data[5]) * 2 * LIMIT / 4095 - LIMIT
        return data[0] >> 4, position, velocity, torque, max(data[6], data[7])

    def send(self, torques):
        for i, torque in zip(self.ids, torques, strict=True):
            self.bus.send(self.can.Message(arbitration_id=i, data=self.encode(torque), is_extended_id=False))

    def receive(self):
        return [self.decode(self.bus.recv(0).data) for _ in self.ids]

    def close(self):
        self.bus.shutdown()


class Cantools(Scalar):
    """python-can, and cantools by a DBC."""

    def __init__(self, interface, channel, motors):
        super().__init__(interface, channel, motors)
        import cantools

        database = cantools.database.load_string(DBC, "dbc")
        self.command, self.feedback = (database.get_message_by_name(name) for name in ("Command", "Feedback"))

    def encode(self, torque):
        values = {"position": 0.0, "velocity": 0.0, "kp": 0.0, "kd": 0.0, "torque": torque}
        return self.command.encode(values, strict=False)

    def decode(self, data):
        return self.feedback.decode(bytes(data))


WAYS = {
    "handctl": Ours,
    "handctl, drives and all": Drives,
    "python-can, scalar codec": Scalar,
    "python-can, cantools": Cantools,
}
