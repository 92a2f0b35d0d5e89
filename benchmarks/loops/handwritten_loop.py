"""Run a control loop as engineers typically write it by hand.

The hand-written control loop uses python-can with one frame at a time, one filter per tendon,
pinocchio, and a log in JSON.
"""

import json
import struct
import time
from pathlib import Path

import can
import numpy as np
import pinocchio
from filterpy.kalman import KalmanFilter

from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import load_hand
from handctl.runtime.clocks.realtime_priority import request_priority

ENABLE_PAYLOAD = b"\xff" * 7 + b"\xfc"
DISABLE_PAYLOAD = b"\xff" * 7 + b"\xfd"


def tendon_filter(period_s: float) -> KalmanFilter:
    """Return a Kalman filter whose states are the tension and the rate of change of the tension."""
    kalman_filter = KalmanFilter(dim_x=2, dim_z=1)
    kalman_filter.F = np.array([[1.0, period_s], [0.0, 1.0]])
    kalman_filter.H = np.array([[1.0, 0.0]])
    kalman_filter.Q = np.diag([1e-3, 1e-1])
    kalman_filter.R = np.array([[0.25]])
    return kalman_filter


def torque_payload(torque: float) -> bytes:
    """Encode a torque in the MIT frame of a Damiao motor (range 0.8 N m), with zero position, speed and gains."""
    torque_code = round((torque + 0.8) / 1.6 * 4095)
    return bytes((0x80, 0x00, 0x80, 0x00, 0x00, 0x00, torque_code >> 8, torque_code & 0xFF))


class BaselineLoop:
    """Hand-written control loop on a bus of python-can. The control loop runs tick by tick."""

    def __init__(self, hand_name: str, bus_name: str, log_path: Path) -> None:
        self.hand = load_hand(hand_name)
        self.bus = can.Bus(interface="local", channel=bus_name)
        self.model = pinocchio.buildModelFromXML(urdf_text(self.hand))
        self.data = self.model.createData()
        self.nodes = [motor.node_id for motor in self.hand.motor]
        self.filters = [tendon_filter(1e-3) for _ in self.nodes]
        node = self.hand.sensor_node
        self.sync_id = node.sync_id
        self.sensor_base_id = node.base_id
        self.reply_count = len(self.nodes) + -(-len(self.nodes) // 5)
        self.k = 0
        self.file = log_path.open("w")
        self.path = log_path

    def send_all(self, payload: bytes) -> None:
        """Send the same payload to every motor and discard the reply frames."""
        for node in self.nodes:
            self.bus.send(can.Message(arbitration_id=node, data=payload, is_extended_id=False))
        while self.bus.recv(0.05):
            pass

    def run_tick(self) -> None:
        """Run one tick: compute and send the torques, then read, filter and log the replies of the motors."""
        self.bus.send(
            can.Message(arbitration_id=self.sync_id, data=[self.k & 0xFF], is_extended_id=False)
        )
        torque = pinocchio.rnea(self.model, self.data, np.zeros(self.model.nq), np.zeros(self.model.nv),
                                np.zeros(self.model.nv))  # fmt: skip
        for node, kalman_filter in zip(self.nodes, self.filters, strict=True):
            # The loop computes torques only because the computation takes time. The torques are
            # multiplied by 0, so that no motor moves.
            data = torque_payload(
                0.005 * min(max(float(kalman_filter.x[0, 0]) + float(torque[0]), 0.0), 10.0) * 0.0
            )
            self.bus.send(can.Message(arbitration_id=node, data=data, is_extended_id=False))
        row = {"k": self.k, "t": time.time(), "tension": [], "position": []}
        expected_replies = (
            self.reply_count
            + (self.k % self.hand.sensor_node.joint_decimation == 0) * self.joint_frames()
        )
        for _ in range(expected_replies):
            message = self.bus.recv(0.002)
            if message is None:
                break
            self.add_reply(message, row)
        self.file.write(json.dumps(row) + "\n")
        self.k += 1

    def joint_frames(self) -> int:
        return -(-len(self.hand.sensor_node.joints) // 5)

    def add_reply(self, message: can.Message, log_row: dict) -> None:
        """Decode one reply frame of a motor, and add the decoded values to ``log_row``."""
        if self.sensor_base_id <= message.arbitration_id < self.sensor_base_id + 0x10:
            payload_bits = int.from_bytes(message.data, "little")
            first_cell_index = 5 * (message.arbitration_id - self.sensor_base_id)
            for i in range(first_cell_index, min(first_cell_index + 5, len(self.filters))):
                tension = (payload_bits >> (4 + 12 * (i - first_cell_index)) & 0xFFF) * 0.0625 - 6.0
                self.filters[i].predict()
                self.filters[i].update(tension)
                log_row["tension"].append(float(self.filters[i].x[0, 0]))
        elif len(message.data) == 8:
            position_code = struct.unpack_from(">H", message.data, 1)[0]
            log_row["position"].append(position_code / 65535 * 25.0 - 12.5)

    def close(self) -> None:
        self.send_all(DISABLE_PAYLOAD)
        self.bus.shutdown()
        self.file.close()
        self.path.unlink()


def run_loop(
    hand_name: str, bus_name: str, duration_s: float, rate_hz: float | None, log_path: Path
):
    """Run the hand-written control loop for a time.

    The results have the same form as those of ``handctl_loop.run_loop``.
    """
    loop = BaselineLoop(hand_name, bus_name, log_path)
    request_priority()
    loop.send_all(ENABLE_PAYLOAD)
    start_s = time.monotonic()
    ticks = 0
    missed_ticks = 0
    lateness_ns = []
    deadline_s = start_s
    while time.monotonic() - start_s < duration_s:
        if rate_hz:
            deadline_s += 1.0 / rate_hz
            time.sleep(max(0.0, deadline_s - time.monotonic()))
            lateness_s = time.monotonic() - deadline_s
            lateness_ns.append(int(lateness_s * 1e9))
            skipped_ticks = int(lateness_s * rate_hz)
            missed_ticks += skipped_ticks
            deadline_s += skipped_ticks / rate_hz
        loop.run_tick()
        ticks += 1
    run_time_s = time.monotonic() - start_s
    loop.close()
    return ticks / run_time_s, missed_ticks / ticks, lateness_ns
