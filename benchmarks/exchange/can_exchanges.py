"""Define the ways to exchange frames that the benchmark ``bus.py`` compares.

``send(torques)`` sends a torque to each motor in MIT mode, and ``receive()`` reads the reply frames
of the motors. Clients from PyPI are in the module ``pypi_clients``.
"""

from functools import cache
from pathlib import Path

TORQUE_RANGE_N_M = 0.8
POSITION_RANGE_RAD = 12.5
VELOCITY_RANGE_RAD_S = 50.0
FEEDBACK_BYTES_1_TO_7 = bytes((0x80, 0x10, 0x7F, 0xF8, 0x20, 30, 31))
MIT_DBC_TEXT = """VERSION ""
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


def feedback_frame(motor_index: int) -> tuple[int, bytes, int]:
    """Return the feedback frame of an enabled Damiao motor.

    The CAN identifier of the feedback frame is the value of the register MST_ID of the motor.
    """
    return 0x10 + motor_index, bytes((0x10 | motor_index,)) + FEEDBACK_BYTES_1_TO_7, 0


RATE_HZ = 200.0


@cache
def enabled_controller(motor_count):
    """Return the controller of the packaged hand that has ``motor_count`` motors in MIT mode.

    Also return a state of the controller in which all motors are enabled.
    """
    from handctl.core.gains.gains import Gains
    from handctl.core.hand_model import HandModel
    from handctl.core.tick_types import HandMode
    from handctl.hand.hand_loading import load_hand
    from handctl.programs.task_program import TaskProgram
    from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller
    from handctl.session.task_loading import load_task_for_hand

    name = {4: "jamia", 11: "jamia11"}[motor_count]
    model = HandModel.from_hand(load_hand(name), Gains(), RATE_HZ)
    controller = homed_controller(
        model, TaskProgram(load_task_for_hand(Path("grasp"), model.hand)[0])
    )
    with SimulatorSettings(name, homed=True).begin_run(controller) as run:
        assert run.run_until(lambda out: out.mode == HandMode.ACTIVE, 20.0)
        run.run_tick()
        return controller, run.state


class HandctlExchange:
    """Exchange over handctl's bus with handctl's compiled codec.

    The codec also updates the state of each drive, because the controller does so in every tick.
    """

    reply_frame = staticmethod(feedback_frame)

    def __init__(self, interface, channel, motor_count):
        import numpy as np

        from handctl.core import tick_stages
        from handctl.core.wire import cyclic_frames
        from handctl.drives.frame_records import WORDS_PER_RECORD, Frames
        from handctl.runtime.buses.bus_opening import open_bus

        self.controller, state = enabled_controller(motor_count)
        self.state = state.copy()
        self.begin_tick = tick_stages.begin_tick
        self.receive_frames = cyclic_frames.receive_frames
        self.encode_commands = cyclic_frames.encode_commands
        self.frame_type = Frames
        constants = self.controller.derived_constants
        self.receive_args = (*constants.kernel_args, *constants.wire.kernel_args)
        self.send_args = (constants.layout.offsets, *constants.wire.kernel_args)
        self.np = np
        self.shape = 1 + motor_count, WORDS_PER_RECORD
        self.bus = open_bus(f"{interface}:{channel}", 0, 1_000_000)
        self.t_ns = self.state.k * round(1e9 / RATE_HZ)

    def send(self, torques):
        np = self.np
        state = self.state
        frame_words = np.zeros(self.shape, dtype=np.uint64)
        _, count = self.encode_commands(
            state.block, *self.send_args, frame_words, np.array(torques), 0, 0
        )
        self.bus.send(self.frame_type(frame_words[:count]))

    def receive(self):
        frames = self.bus.drain()
        state = self.state
        state_offsets = self.controller.derived_constants.layout.offsets
        self.begin_tick(state.block, state_offsets, state.k, self.t_ns, 0, 0, len(frames))
        self.receive_frames(state.block, *self.receive_args, frames.rows, 0, 0)
        return frames

    def close(self):
        self.bus.close()


class HandwrittenCodecExchange:
    """Exchange over python-can, with typical hand-written code for encoding and decoding.

    The class sends and receives one message at a time.
    """

    reply_frame = staticmethod(feedback_frame)

    def __init__(self, interface, channel, motor_count):
        import can

        self.can = can
        self.ids = range(1, motor_count + 1)
        self.bus = can.Bus(channel, interface=interface, ignore_config=True)

    def encode(self, torque):
        torque_code = int((torque + TORQUE_RANGE_N_M) * 4095 / (2 * TORQUE_RANGE_N_M))
        return bytes((0x7F, 0xFF, 0x7F, 0xF0, 0, 0, torque_code >> 8, torque_code & 0xFF))

    def decode(self, data):
        position = (data[1] << 8 | data[2]) * 2 * POSITION_RANGE_RAD / 65535 - POSITION_RANGE_RAD
        velocity = (
            data[3] << 4 | data[4] >> 4
        ) * 2 * VELOCITY_RANGE_RAD_S / 4095 - VELOCITY_RANGE_RAD_S
        torque = ((data[4] & 0xF) << 8 | data[5]) * 2 * TORQUE_RANGE_N_M / 4095 - TORQUE_RANGE_N_M
        return data[0] >> 4, position, velocity, torque, max(data[6], data[7])

    def send(self, torques):
        for i, torque in zip(self.ids, torques, strict=True):
            self.bus.send(
                self.can.Message(arbitration_id=i, data=self.encode(torque), is_extended_id=False)
            )

    def receive(self):
        return [self.decode(self.bus.recv(0).data) for _ in self.ids]

    def close(self):
        self.bus.shutdown()


class CantoolsExchange(HandwrittenCodecExchange):
    """Exchange over python-can, with a codec that cantools makes from a DBC file.

    The class sends and receives one message at a time.
    """

    def __init__(self, interface, channel, motor_count):
        super().__init__(interface, channel, motor_count)
        import cantools

        database = cantools.database.load_string(MIT_DBC_TEXT, "dbc")
        self.command, self.feedback = (
            database.get_message_by_name(name) for name in ("Command", "Feedback")
        )

    def encode(self, torque):
        values = {"position": 0.0, "velocity": 0.0, "kp": 0.0, "kd": 0.0, "torque": torque}
        return self.command.encode(values, strict=False)

    def decode(self, data):
        return self.feedback.decode(bytes(data))


EXCHANGE_BY_NAME = {
    "handctl": HandctlExchange,
    "python-can, scalar codec": HandwrittenCodecExchange,
    "python-can, cantools": CantoolsExchange,
}
