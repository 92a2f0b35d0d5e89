"""Simulate drives and load cells at rest.

The replies of the nodes are stored. There are no tendons and no digits.

``python benchmarks/loops/simulated_drives.py HAND NAME`` serves ``local:NAME`` and prints a line
when it is ready.
"""

import select
import sys

from firmware_sim.bus.frame import Frame, pack_record
from firmware_sim.bus.local_ports import HubPort
from firmware_sim.lockstep_hand import LockstepHand
from firmware_sim.realtime_priority import request_realtime_priority

SPECIAL_COMMAND_PREFIX = b"\xff" * 7
ENABLED_STATE = 1


class CachedReplies:
    """Cache of the replies of the simulated nodes.

    A reply that was computed once is not computed again.
    """

    def __init__(self, hand_name: str) -> None:
        self.rig = LockstepHand(hand_name, homed=True)
        self.replies: dict[tuple[int, int], bytes] = {}
        self.sync = self.rig.world.hand.sensors.sync_id

    def replies_to(self, frame: Frame) -> bytes:
        """Return the replies of all nodes to a frame, as frame records of the local bus."""
        if frame.can_id != self.sync and (
            frame.can_id > 0xFF or frame.data.startswith(SPECIAL_COMMAND_PREFIX)
        ):
            self.replies.clear()
            return b"".join(map(pack_record, self.rig.world.receive(frame)))
        key = (frame.can_id, frame.data[0] & 0xF if frame.can_id == self.sync else 0)
        if key in self.replies:
            return self.replies[key]
        answer_frames = self.rig.world.receive(frame)
        records = b"".join(map(pack_record, answer_frames))
        if frame.can_id == self.sync or (
            answer_frames and answer_frames[0].data[0] >> 4 == ENABLED_STATE
        ):
            self.replies[key] = records
        return records


def main(hand_name: str, bus_name: str) -> None:
    """Reply to frames on the bus until the process is killed."""
    echo = CachedReplies(hand_name)
    port = HubPort(bus_name, 0)
    request_realtime_priority()
    print("ready", flush=True)
    while True:
        ready_sockets, _, _ = select.select(port.read_sockets(), port.write_sockets(), [])
        records = b"".join(map(echo.replies_to, port.receive(ready_sockets)))
        if records:
            port._hub.send(records)


if __name__ == "__main__":
    main(*sys.argv[1:])
