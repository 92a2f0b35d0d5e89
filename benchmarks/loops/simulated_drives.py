"""Simulate drives and load cells at rest.

The replies of the nodes are stored, and each drive reports the torque of the preceding command.
Tendons and digits do not move. The drives are Damiao motors in MIT mode.

``python benchmarks/loops/simulated_drives.py HAND NAME`` serves ``local:NAME`` and prints a line
when the drives are ready.
"""

import select
import sys

from firmware_sim.bus.frame import RECORD_SIZE, Frame, pack_record
from firmware_sim.bus.local_ports import HubPort
from firmware_sim.lockstep_hand import LockstepHand
from firmware_sim.realtime_priority import request_realtime_priority

CANFD_PAYLOAD_BYTES = 64
SPECIAL_COMMAND_PREFIX = b"\xff" * 7
ENABLE_COMMAND = SPECIAL_COMMAND_PREFIX + b"\xfc"
ENABLED_STATE = 1
SYNC_COUNTER_VALUES = 16
"""Number of values of the counter in SYNC frames and in the replies of the sensor node."""
SENSOR_TURNS = 5
"""Number of turns of the SYNC counter after which the stored replies of the sensor node repeat.

The controller compares each reading with the last 64 readings. If a sequence of 64 readings
repeats, the controller reports old readings (fault T05b).
"""
HOLD_TENSION_N = 5.0
"""Tension of each tendon after its drive was enabled [N]."""
FIRST_TORQUE_BYTE = RECORD_SIZE - CANFD_PAYLOAD_BYTES + 4
"""Byte of a frame record that contains the highest bits of the reported torque."""


class CachedReplies:
    """Cache of the replies of the simulated nodes.

    A reply that was computed once is not computed again. Only the torque in the reply of a drive
    follows the commands. If the reported torque were constant, the controller would report that the
    drive does not obey (fault N14).
    """

    def __init__(self, hand_name: str) -> None:
        self.rig = LockstepHand(hand_name, homed=True)
        self.replies: dict[tuple[int, int], bytes] = {}
        self.last_commands: dict[int, bytes] = {}
        self.sync = self.rig.world.hand.sensors.sync_id
        self.sync_count = 0

    def replies_to(self, frame: Frame) -> bytes:
        """Return the replies of all nodes to a frame, as frame records of the local bus."""
        if frame.can_id != self.sync and (
            frame.can_id > 0xFF or frame.data.startswith(SPECIAL_COMMAND_PREFIX)
        ):
            self.replies.clear()
            if frame.data == ENABLE_COMMAND:
                self.pull_tendon(frame.can_id)
            return b"".join(map(pack_record, self.rig.world.receive(frame)))
        key = (frame.can_id, 0)
        if frame.can_id == self.sync:
            self.sync_count += 1
            turn = self.sync_count // SYNC_COUNTER_VALUES % SENSOR_TURNS
            key = (frame.can_id, SYNC_COUNTER_VALUES * turn + frame.data[0] % SYNC_COUNTER_VALUES)
        if key in self.replies:
            reply = self.replies[key]
            if frame.can_id == self.sync:
                return reply
            previous_command = self.last_commands.get(frame.can_id, frame.data)
            self.last_commands[frame.can_id] = frame.data
            return with_torque_of_command(reply, previous_command)
        answer_frames = self.rig.world.receive(frame)
        records = b"".join(map(pack_record, answer_frames))
        if frame.can_id == self.sync or (
            answer_frames and answer_frames[0].data[0] >> 4 == ENABLED_STATE
        ):
            self.replies[key] = records
        return records

    def pull_tendon(self, node_id: int) -> None:
        """Turn a motor until the tension of its tendon is ``HOLD_TENSION_N``.

        If the tendons were slack, the controller would turn the motors to take up the slack. The
        controller would then report a fault, because the tensions of simulated drives at rest do
        not rise.
        """
        plant = self.rig.world.plant
        index = next(i for i, motor in enumerate(plant.hand.motors) if motor.node_id == node_id)
        motor = list(plant.motors.values())[index]
        for _ in range(1000):
            if plant.tensions()[index] >= HOLD_TENSION_N:
                return
            motor.theta += 1e-4
        raise RuntimeError(f"the tendon of node {node_id:#x} does not become taut")


def with_torque_of_command(reply: bytes, command: bytes) -> bytes:
    """Copy the torque of a command into the stored reply of a drive, and return the changed reply.

    The lowest 12 bits of the command contain the torque. In the reply, 4 bits of byte 4 and all
    bits of byte 5 contain the torque. Both have the same scale.
    """
    record = bytearray(reply)
    record[FIRST_TORQUE_BYTE] = reply[FIRST_TORQUE_BYTE] & 0xF0 | command[6] & 0x0F
    record[FIRST_TORQUE_BYTE + 1] = command[7]
    return bytes(record)


def main(hand_name: str, bus_name: str) -> None:
    """Reply to frames on the bus until the process is killed."""
    cached_replies = CachedReplies(hand_name)
    port = HubPort(bus_name, 0)
    request_realtime_priority()
    print("ready", flush=True)
    while True:
        ready_sockets, _, _ = select.select(port.read_sockets(), port.write_sockets(), [])
        records = b"".join(map(cached_replies.replies_to, port.receive(ready_sockets)))
        if records:
            port._hub.send(records)


if __name__ == "__main__":
    main(*sys.argv[1:])
