"""Simulate drives and load cells at rest.

The nodes send stored replies. In a stored reply of a drive, only the reported torque changes: it is
the torque of the preceding command. The simulated tendons and digits do not move. The drives are
Damiao motors in MIT mode.

``python benchmarks/loops/simulated_drives.py HAND NAME`` serves ``local:NAME`` and prints a line
when the drives are ready.
"""

import select
import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_sim.bus.frame import RECORD_SIZE, Frame, pack_record
from firmware_sim.bus.hub import BusHub
from firmware_sim.bus.local_ports import split_records
from firmware_sim.clock.realtime_priority import request_realtime_priority
from firmware_sim.lockstep_hand import LockstepHand

CANFD_PAYLOAD_BYTES = 64
LARGEST_MOTOR_ID = 0xFF
"""Largest identifier of a command to a drive. Requests to read or write a register have larger identifiers."""
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
DATA_OFFSET = RECORD_SIZE - CANFD_PAYLOAD_BYTES
"""Offset of the payload in a frame record [bytes]."""
TORQUE_BYTES = slice(6, 8)
"""Bytes of a command's payload that contain the torque."""
REPLY_TORQUE_OFFSET = DATA_OFFSET + 4
COMMAND_TORQUE_OFFSET = DATA_OFFSET + TORQUE_BYTES.start
"""Offsets of the first torque byte in the record of a reply, and in the record of a command [bytes].

The low half of the first torque byte contains the highest 4 bits of the torque. The next byte
contains the other 8 bits.
"""
HIGH_HALF = 0xF0
LOW_HALF = 0x0F
INT16S_PER_RECORD = RECORD_SIZE // 2
"""Size of a frame record in numbers of 16 bits. The two torque bytes of a record are one such number."""
TORQUE_BITS = np.uint16(LOW_HALF | 0xFF << 8)
"""Bits of the torque in the number that is made of the two torque bytes, the first byte lowest."""


@dataclass(frozen=True)
class CommandBatch:
    """Stored replies of the drives to the commands of one tick. The commands arrive together.

    Attributes:
        nodes: (drives,) node number of each drive, in the order of the commands.
        replies: (drives, ``INT16S_PER_RECORD``) reply of each drive, as the 16-bit numbers of a frame record.
    """

    nodes: NDArray[np.intp]
    replies: NDArray[np.uint16]

    def replies_to(self, commands: bytes, last_torques: NDArray[np.uint16]) -> bytes:
        """Return the replies of all drives to the commands of one tick, as frame records.

        Each reply contains the torque of the preceding command to the same drive.

        Args:
            commands: frame records of the commands.
            last_torques: (nodes,) torque bytes of the preceding command to each node, which become
                those of the given commands.
        """
        reply_torques = self.replies[:, REPLY_TORQUE_OFFSET // 2]
        reply_torques &= ~TORQUE_BITS
        reply_torques |= last_torques[self.nodes] & TORQUE_BITS
        last_torques[self.nodes] = np.frombuffer(commands, np.uint16)[
            COMMAND_TORQUE_OFFSET // 2 :: INT16S_PER_RECORD
        ]
        return self.replies.tobytes()


class CachedReplies:
    """Cache of the replies of the simulated nodes.

    Each reply is computed once and then stored. In a stored reply of a drive, only the reported
    torque changes: it is the torque of the preceding command. If the reported torque were constant,
    the controller would report that the drive does not obey (fault N14).

    A control loop can send all commands of a tick as one batch. The replies to a batch are sent
    together, because drives on a real bus compute their replies at the same time.
    """

    def __init__(self, hand_name: str) -> None:
        self.rig = LockstepHand(hand_name, homed=True)
        self.replies: dict[tuple[int, int], bytes] = {}
        self.last_torques = np.zeros(LARGEST_MOTOR_ID + 1, np.uint16)
        self.sync = self.rig.world.hand.sensors.sync_id
        self.sync_record_start = self.sync.to_bytes(4, "little")
        self.sync_count = 0
        self.batches: dict[bytes, CommandBatch] = {}

    def replies_to_records(self, records: bytes) -> bytes:
        """Return the replies of all nodes to frames that arrived together.

        The frames and the replies are frame records of the local bus.
        """
        batch_start = RECORD_SIZE if records.startswith(self.sync_record_start) else 0
        commands = records[batch_start:]
        # The two bytes of the identifiers, for all records.
        identifiers = commands[0::RECORD_SIZE] + commands[1::RECORD_SIZE]
        batch = self.batches.get(identifiers)
        if batch and SPECIAL_COMMAND_PREFIX not in commands:
            sync_replies = self.sensor_replies(records[DATA_OFFSET]) if batch_start else b""
            return sync_replies + batch.replies_to(commands, self.last_torques)
        if SPECIAL_COMMAND_PREFIX in commands:
            self.batches.clear()
        frames, _ = split_records(records, 0)
        replies = b"".join(map(self.replies_to, frames))
        command_frames = frames[1:] if batch_start else frames
        # A second SYNC frame belongs to the next tick.
        cached_replies = [
            b"" if frame.can_id == self.sync else self.replies.get((frame.can_id, 0), b"")
            for frame in command_frames
        ]
        if len(command_frames) > 1 and {len(reply) for reply in cached_replies} == {RECORD_SIZE}:
            reply_rows = np.frombuffer(b"".join(cached_replies), np.uint16).reshape(
                -1, INT16S_PER_RECORD
            )
            nodes = np.array([frame.can_id for frame in command_frames], np.intp)
            self.batches[identifiers] = CommandBatch(nodes, reply_rows.copy())
        return replies

    def sensor_replies(self, sync_counter: int) -> bytes:
        """Return the replies of the sensor node to a SYNC frame with this counter, as frame records."""
        self.sync_count += 1
        turn = self.sync_count // SYNC_COUNTER_VALUES % SENSOR_TURNS
        key = (self.sync, SYNC_COUNTER_VALUES * turn + sync_counter % SYNC_COUNTER_VALUES)
        if key not in self.replies:
            self.replies[key] = self.packed_replies(Frame(self.sync, bytes([sync_counter])))
        return self.replies[key]

    def packed_replies(self, frame: Frame) -> bytes:
        """Return the replies that the simulated nodes compute, as frame records."""
        return b"".join(map(pack_record, self.rig.world.receive(frame)))

    def replies_to(self, frame: Frame) -> bytes:
        """Return the replies of all nodes to one frame of the host. Each reply is a record of the local bus."""
        if frame.can_id == self.sync:
            return self.sensor_replies(frame.data[0])
        if frame.can_id > LARGEST_MOTOR_ID:
            # The host reads or writes a register.
            return self.packed_replies(frame)
        if frame.data.startswith(SPECIAL_COMMAND_PREFIX):
            self.replies.clear()
            if frame.data == ENABLE_COMMAND:
                self.pull_tendon(frame.can_id)
            return self.packed_replies(frame)
        preceding_torque = self.last_torques[frame.can_id].tobytes()
        self.last_torques[frame.can_id] = int.from_bytes(frame.data[TORQUE_BYTES], "little")
        key = (frame.can_id, 0)
        if key in self.replies:
            return with_torque(self.replies[key], preceding_torque)
        records = self.packed_replies(frame)
        if records and records[DATA_OFFSET] >> 4 == ENABLED_STATE:
            self.replies[key] = records
        return records

    def pull_tendon(self, node_id: int) -> None:
        """Turn a motor until the tension of its tendon is ``HOLD_TENSION_N``.

        If the tendons were slack, the controller would turn the motors to take up the slack. The
        simulated drives of this benchmark do not move. With slack tendons, the tensions would not
        rise, and the controller would report a fault.
        """
        plant = self.rig.world.plant
        index = next(i for i, motor in enumerate(plant.hand.motors) if motor.node_id == node_id)
        motor = list(plant.motors.values())[index]
        for _ in range(1000):
            if plant.tensions()[index] >= HOLD_TENSION_N:
                return
            motor.theta += 1e-4
        raise RuntimeError(f"the tendon of node {node_id:#x} does not become taut")


def with_torque(reply: bytes, torque_bytes: bytes) -> bytes:
    """Copy the torque of a command into the stored reply of a drive, and return the changed reply.

    The lowest 12 bits of the two torque bytes contain the torque. In the reply, 4 bits of byte 4 and
    all bits of byte 5 contain the torque. The torques of command and reply have the same scale.
    """
    record = bytearray(reply)
    record[REPLY_TORQUE_OFFSET] = (
        reply[REPLY_TORQUE_OFFSET] & HIGH_HALF | torque_bytes[0] & LOW_HALF
    )
    record[REPLY_TORQUE_OFFSET + 1] = torque_bytes[1]
    return bytes(record)


def main(hand_name: str, bus_name: str) -> None:
    """Reply to frames on the bus until the process is killed."""
    cached_replies = CachedReplies(hand_name)
    hub = BusHub(bus_name)
    request_realtime_priority()
    print("ready", flush=True)
    while True:
        ready_sockets, _, _ = select.select(hub.read_sockets(), hub.write_sockets(), [])
        if records := hub.serve(ready_sockets):
            hub.send(cached_replies.replies_to_records(records))


if __name__ == "__main__":
    main(*sys.argv[1:])
