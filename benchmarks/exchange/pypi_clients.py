"""Exchange frames with client libraries from PyPI instead of handctl.

Each client library is used with motors and payloads that the library supports.

This module stops the threads of the clients and does the work of these threads itself, so that all
clients are measured in the same way. The client of moteus needs asyncio, and runs in an event loop
of asyncio.
"""

import asyncio
import contextlib
import io
import logging
import struct
from types import SimpleNamespace

import can
from exchange.can_exchanges import feedback_frame


class DamiaoClient:
    """Client of the package damiao-motor, whose polling thread is stopped.

    Instead of the polling thread, the method `receive` polls the bus.
    """

    reply_frame = staticmethod(feedback_frame)

    def __init__(self, interface, channel, motor_count):
        from damiao_motor import DaMiaoController

        self.controller = DaMiaoController(channel=channel, bustype=interface)
        add_motor = self.controller.add_motor
        self.motors = [
            add_motor(motor_id=i, feedback_id=i + 0x10, motor_type="4310")
            for i in range(1, motor_count + 1)
        ]
        self.controller._stop_polling()

    def send(self, torques):
        for motor, torque in zip(self.motors, torques, strict=True):
            motor.send_cmd_mit(feedforward_torque=torque)

    def receive(self):
        self.controller.poll_feedback()
        return [motor.get_states() for motor in self.motors]

    def close(self):
        self.controller.shutdown()


class OdriveClient:
    """Client odrive-can.

    odrive-can encodes a torque with the package's own DBC file, and decodes a position with the
    package's own frame reader.
    """

    DBC_AXIS_COUNT = 8
    """Number of axes in the DBC file of odrive-can."""

    def __init__(self, interface, channel, motor_count):
        from odrive_can import odrive

        if motor_count > self.DBC_AXIS_COUNT:
            raise ValueError(f"the DBC of odrive-can has {self.DBC_AXIS_COUNT} axes")
        self.bus = can.Bus(channel, interface=interface, ignore_config=True)
        self.read = odrive.CanMsg
        self.drives = [odrive.ODriveCAN(axis_id=i, can_bus=self.bus) for i in range(motor_count)]

    @staticmethod
    def reply_frame(motor_index):
        return (motor_index - 1) << 5 | 0x09, struct.pack("<ff", 1.5, 0.1), 0

    def send(self, torques):
        for drive, torque in zip(self.drives, torques, strict=True):
            drive.set_input_torque(torque)

    def receive(self):
        return [self.read(self.bus.recv(0)).data for _ in self.drives]

    def close(self):
        for drive in self.drives:
            del drive._bus  # If the object kept ``_bus``, it would shut down the bus at its end.
        self.bus.shutdown()


class TMotorClient:
    """Client TMotorCANControl for a CubeMars AK80-9.

    The class calls the functions that the notifier thread of TMotorCANControl would call.
    TMotorCANControl supports only the interface can0. By default, TMotorCANControl also runs the
    command ``sudo ip link set can0``, but ``TMotorClient`` does not.
    """

    def __init__(self, interface, channel, motor_count):
        from TMotorCANControl import mit_can

        manager = object.__new__(mit_can.CAN_Manager)
        manager.bus = can.Bus(channel, interface=interface, ignore_config=True)
        listeners = []
        manager.notifier = SimpleNamespace(add_listener=listeners.append)
        mit_can.CAN_Manager.__del__ = lambda self: None
        mit_can.CAN_Manager._instance = manager
        with contextlib.redirect_stdout(io.StringIO()):
            manager_class = mit_can.TMotorManager_mit_can
            self.motors = [
                manager_class(motor_type="AK80-9", motor_ID=i) for i in range(1, motor_count + 1)
            ]
        self.bus = manager.bus
        self.listeners = listeners
        for motor in self.motors:
            motor._entered = True
            motor._last_command_time = 0.0
            motor.set_current_gains()

    @staticmethod
    def reply_frame(motor_index):
        return motor_index, bytes((motor_index, 0x80, 0x10, 0x7F, 0xF8, 0x20, 30, 0)), 0

    def send(self, torques):
        for motor, torque in zip(self.motors, torques, strict=True):
            motor.set_output_torque_newton_meters(torque)
            motor.update()

    def receive(self):
        for _ in self.motors:
            message = self.bus.recv(0)
            for listener in self.listeners:
                listener.on_message_received(message)
        return [motor.get_output_torque_newton_meters() for motor in self.motors]

    def close(self):
        self.bus.shutdown()


class MoteusClient:
    """Client of the package moteus, which sends CAN FD frames over python-can.

    The client sends a position command with a feedforward torque, and requests the values that
    moteus requests by default.
    """

    def __init__(self, interface, channel, motor_count):
        import moteus
        from moteus.pythoncan_device import PythonCanDevice

        logging.getLogger("asyncio").setLevel(logging.CRITICAL)
        self.loop = asyncio.new_event_loop()
        self.device = PythonCanDevice(interface=interface, channel=channel, fd=True)
        self.transport = moteus.Transport([self.device])
        self.count = motor_count
        devices = dict.fromkeys(range(1, motor_count + 1), self.device)
        self.controllers = [moteus.Controller(id=i, transport=self.transport) for i in devices]
        self.transport._routing_table = {}
        self.nan = float("nan")

    @staticmethod
    def reply_frame(motor_index):
        motion = b"\x2f\x01" + struct.pack("<fff", 0.1, 0.2, 0.3)
        data = b"\x21\x00\x0a" + motion + b"\x23\x0d\x30\x20\x00"
        extended_id_flag = 0x80000000 if motor_index << 8 > 0x7FF else 0
        return motor_index << 8 | extended_id_flag, data + b"\x50" * (24 - len(data)), 4 | 1

    async def _exchange_once(self, torques):
        commands = [
            controller.make_position(position=self.nan, feedforward_torque=torque, query=True)
            for controller, torque in zip(self.controllers, torques, strict=True)
        ]
        for command in commands:
            command.channel = self.device
        return await self.transport.cycle(commands)

    def send(self, torques):
        self.sent = 0
        self.task = self.loop.create_task(self._exchange_once(torques))
        self.loop.run_until_complete(self._close_transport())

    async def _close_transport(self):
        """Run the asyncio task until it has sent all frames. The task then waits for the reply frames of the motors."""
        for _ in range(4):
            await asyncio.sleep(0)

    def receive(self):
        return self.loop.run_until_complete(asyncio.wait_for(self.task, 5.0))

    def close(self):
        self.device.close()
        self.loop.close()


CLIENT_BY_PACKAGE = {
    "damiao-motor": DamiaoClient,
    "odrive-can": OdriveClient,
    "TMotorCANControl": TMotorClient,
    "moteus": MoteusClient,
}
