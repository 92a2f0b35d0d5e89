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
        from handctl.drives.mit.codec import Ranges, decode_feedback, encode_torque, lines
        from handctl.runtime.buses.open import open_bus

        self.bus, self.make = open_bus(f"{interface}:{channel}", 0, 1_000_000), make
        self.frame, self.encode, self.ids = Frame, encode_torque, range(1, motors + 1)
        self.decode, self.ranges = decode_feedback, Ranges(POSITION, VELOCITY, LIMIT)
        self.lines = lines(self.ranges)

    def send(self, torques):
        frame, encode, make = self.frame, self.encode, self.make
        self.bus.send([make(frame, (i, encode(t, LIMIT), 0, 0, 0)) for i, t in zip(self.ids, torques, strict=True)])

    def receive(self):
        decode, lines = self.decode, self.lines
        return [decode(frame.data, lines) for frame in self.bus.drain()]

    def close(self):
        self.bus.close()


class Drives(Ours):
    """The same with each drive's state machine, as the tick runs it."""

    def __init__(self, interface, channel, motors):
        super().__init__(interface, channel, motors)
        from handctl.drives.contract import DriveState, Phase, Want
        from handctl.drives.mit.drive import MitDrive
        from handctl.drives.mit.progress import Progress

        self.want = Want.ENABLE
        make = partial(MitDrive, bus=0, ranges=self.ranges, direction=1, zero=0.0, timeout=1000)
        self.drives = [make(name=str(i), node_id=i, reply_id=i + 0x10) for i in self.ids]
        state = DriveState(phase=Phase.ENABLED, private=Progress(configured=True, asked=True))
        self.states = [state] * motors
        self.by_id = {drive.reply_id: i for i, drive in enumerate(self.drives)}

    def send(self, torques):
        frames, states, want = [], [], self.want
        for drive, state, torque in zip(self.drives, self.states, torques, strict=True):
            state, out = drive.advance(state, 0, want, torque)
            states.append(state)
            frames += out
        self.states = states
        self.bus.send(frames)

    def receive(self):
        frames, drives, states, by_id = self.bus.drain(), self.drives, self.states, self.by_id
        for frame in frames:
            i = by_id[frame[0]]
            states[i] = drives[i].receive(states[i], frame)
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
