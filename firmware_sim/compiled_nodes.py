"""Answers to the frames of one tick. Frames and answers are records in arrays.

A compiled kernel answers the cyclic frames. Python methods of the nodes answer the frames that are
not cyclic.
"""

from operator import is_not
from typing import Any

import numpy as np

from firmware_sim.bus.frame import Frame
from firmware_sim.bus.frame_records import FRAME_DTYPE, frames_to_records, records_to_frames
from firmware_sim.compiled import array_addresses, code_of_kernel, compile_module_kernels
from firmware_sim.nodes import cyclic_kernels
from firmware_sim.nodes.cia402.kernels import Cia402Struct
from firmware_sim.nodes.cyclic_kernels import (
    ANSWERS,
    IN_ORDER,
    NEXT_FRAME,
    SENT,
    WAKE_NS,
    ReceiverStruct,
)
from firmware_sim.nodes.mit.codec import MitStruct
from firmware_sim.nodes.odrive.kernels import OdriveStruct
from firmware_sim.nodes.protocol_spec import SENSOR_NODE_KIND
from firmware_sim.nodes.sensor_node import CHANNELS_PER_FRAME, SensorStruct

INITIAL_CAPACITY = 64
"""Initial capacity of the array for the answers of a tick [frames]."""


class CompiledNodes:
    """Object that computes the answers of the nodes in a tick.

    The states of the nodes are in array rows.

    Attributes:
        sends_unsolicited: True if the compiled kernel sends the frames that drives send without a
            request. False if the simulated world sends the unsolicited frames.
    """

    def __init__(self, simulated_world: Any, rows: dict[type, Any]) -> None:
        """Collect the arrays that the compiled kernel reads and writes.

        Args:
            simulated_world: world to which the nodes belong.
            rows: arrays with the states of nodes in their rows, by the type of the row.
        """
        self._world, self._kernels = simulated_world, compile_module_kernels(cyclic_kernels)
        self._answer_kernel = code_of_kernel(self._kernels.answer)
        self._capacity = INITIAL_CAPACITY
        self._progress_array = np.zeros(5, np.int64)
        # An element of a memoryview is read in half the time of an element of an array.
        self._progress = self._progress_array.data
        sensor_node = simulated_world.sensor_node if SensorStruct in rows else None
        self._noise = sensor_node.noise if sensor_node else None
        self._max_answers = 1
        orders = (np.empty(0, np.int64),) * 2
        bias = np.empty(0)
        if sensor_node:
            orders = simulated_world.sensor_orders
            bias = sensor_node.bias
            self._max_answers += sum(-(-len(order) // CHANNELS_PER_FRAME) for order in orders)
        self._max_answers += len(simulated_world.row_of)
        self._draws = 2 * len(orders[0]) + len(orders[1])
        self._drive_structs = tuple(
            rows.get(layout, np.empty(0, layout))
            for layout in (MitStruct, OdriveStruct, Cia402Struct)
        )
        self._sensor_arrays = rows.get(SensorStruct, np.empty(0, SensorStruct)), *orders, bias
        self.sends_unsolicited = True
        self._sent = np.empty(INITIAL_CAPACITY, FRAME_DTYPE)
        noise = (
            (sensor_node.noise.numbers, sensor_node.noise.bounds)
            if sensor_node
            else (np.empty(0), np.zeros(2, np.int64))
        )
        self._sample_arrays = *noise, *simulated_world.plant.sampled
        self._table: Any = None
        self._receivers: Any = None

    def refresh_identifiers(self) -> None:
        """Delete the table of receivers, so that it is built again before the next frame."""
        self._table = None

    def answer(self, frames: Any, t_ns: int, max_delay_ns: int) -> tuple[Any, bool]:
        """Answer the frames that the host has sent in a tick.

        Args:
            frames: frames of the host, an array of ``FRAME_DTYPE``.
            t_ns: start of the tick [ns].
            max_delay_ns: largest time from the start of the tick to an answer [ns].

        Returns:
            The answers, with times as if the answers were sent one after the other. The second
            value is True if these times are in rising order.
        """
        world = self._world
        progress = self._progress
        answer_frames = np.empty(self._capacity, FRAME_DTYPE)
        if not (frames.flags.writeable and frames.flags.c_contiguous):
            frames = frames.copy()
        progress[NEXT_FRAME] = progress[ANSWERS] = progress[IN_ORDER] = 0
        is_sequential = world.faults.in_frames
        while True:
            if is_sequential:
                for frame in records_to_frames(frames):
                    answer_frames = self._append_frames(answer_frames, world.receive(frame))
                progress[NEXT_FRAME] = len(frames)
                self._drop_stale_table()
            self._run_kernel(frames, answer_frames, t_ns, max_delay_ns)
            frame_index = progress[NEXT_FRAME]
            if frame_index == len(frames):
                return answer_frames[: progress[ANSWERS]], bool(progress[IN_ORDER])
            if progress[ANSWERS] + self._max_answers > len(answer_frames):
                answer_frames = self._enlarge_buffer(answer_frames)
                continue
            (frame,) = records_to_frames(frames[frame_index : frame_index + 1])
            answer_frames = self._append_frames(answer_frames, world.receive(frame))
            progress[NEXT_FRAME] = frame_index + 1
            self._drop_stale_table()

    def _run_kernel(self, frames: Any, answer_frames: Any, t_ns: int, max_delay_ns: int) -> None:
        """Run the compiled kernel until a frame comes that a node must answer in Python."""
        if self._table is None:
            self._build_table()
        if self._noise:
            self._noise.draw(self._draws)
        self._answer_kernel(
            frames, answer_frames, self._addresses, t_ns, max_delay_ns, self._max_answers
        )

    def _enlarge_buffer(self, answer_frames: Any) -> Any:
        """Return the array of answers, copied into an array with twice the capacity."""
        self._capacity = 2 * len(answer_frames)
        return np.concatenate((answer_frames, np.empty(len(answer_frames), FRAME_DTYPE)))

    def _append_frames(self, answer_frames: Any, frames: list[Frame]) -> Any:
        """Return the array of answers, with the given frames appended."""
        count = self._progress[ANSWERS]
        frame_count = len(frames)
        while count + frame_count > len(answer_frames):
            answer_frames = self._enlarge_buffer(answer_frames)
        answer_frames[count : count + frame_count] = frames_to_records(frames)
        self._progress[ANSWERS] = count + frame_count
        return answer_frames

    def _build_table(self) -> None:
        """Build the table of receivers. For each identifier, the table contains the nodes that receive the identifier.

        If the state of a node is not in an array row, Python code handles all frames with
        identifiers of this node.
        """
        world = self._world
        receivers = list[tuple[int, int, int]]()
        table = cyclic_kernels.empty_table(len(world.nodes))
        for bus, nodes in enumerate(world.nodes):
            # If a test has replaced the method ``receive`` of a node, Python must handle every
            # frame for this node.
            has_kernel = [
                id(node) in world.row_of and "receive" not in vars(node) for node in nodes
            ]
            cyclic_ids = {
                id(node): node.cyclic_ids if compiled else ()
                for node, compiled in zip(nodes, has_kernel, strict=True)
            }
            for can_id in {can_id for ids in cyclic_ids.values() for can_id in ids}:
                accepting_nodes = [node for node in nodes if _does_node_accept(node, can_id)]
                # A node whose state is not in an array row accepts the identifier as well. So
                # Python must handle frames with the identifier.
                if not all(can_id in cyclic_ids[id(node)] for node in accepting_nodes):
                    continue
                next_receiver = -1
                # Each entry of the list of receivers contains the index of the next receiver. So
                # the list is built from its end.
                for node in reversed(accepting_nodes):
                    receivers.append((*world.row_of[id(node)], next_receiver))
                    next_receiver = len(receivers) - 1
                table[cyclic_kernels.table_index(bus, can_id)] = next_receiver
        self._identifiers_seen = self._accepted_identifiers()
        self._table = table
        self._receivers = np.array(receivers, ReceiverStruct)
        rows = [
            world.row_of.get(id(node), (SENSOR_NODE_KIND, 0))
            for nodes in world.nodes
            for node in nodes
        ]
        self._drive_rows = np.array(
            [(*row, -1) for row in rows if row[0] != SENSOR_NODE_KIND], ReceiverStruct
        )
        arrays = (
            self._progress_array,
            table,
            self._receivers,
            *self._drive_structs,
            self._drive_rows,
            *self._sensor_arrays,
            *self._sample_arrays,
        )
        self._addresses = np.array(array_addresses(arrays), np.int64)

    def _accepted_identifiers(self) -> list[Any]:
        """Return the identifiers that each node accepts now.

        The returned list contains one object for each node, with the identifiers of the node. When
        the identifiers of a node change, the node makes a new object.
        """
        return [
            getattr(node, "accepted_ids", node.ids) for nodes in self._world.nodes for node in nodes
        ]

    def _drop_stale_table(self) -> None:
        """Remove the table of receivers if the identifiers of a node have changed."""
        if self._table is not None and any(
            map(is_not, self._identifiers_seen, self._accepted_identifiers())
        ):
            self._table = None

    @property
    def wake_ns(self) -> int:
        """Return the earliest wake time of the drives whose states are in array rows [ns].

        The last call of ``answer`` or ``send_due_frames`` has stored the wake time.
        """
        return self._progress[WAKE_NS]

    def next_wake(self) -> int:
        """Compute the earliest wake time from the present states of the drives in array rows [ns]."""
        if self._table is None:
            self._build_table()
        return int(self._kernels.next_wake(self._drive_rows, *self._drive_structs))

    def send_due_frames(self, now_ns: int) -> bool:
        """Send the due unsolicited frames of drives.

        Args:
            now_ns: present time [ns].

        Returns:
            False if Python must wake a node. If a node must be woken, no frame is sent.
        """
        if not self.sends_unsolicited or self._world.faults.in_frames:
            return False
        if self._table is None:
            self._build_table()
        # In one call, a drive sends at most two frames: a heartbeat and its encoder estimates.
        while self._progress[SENT] + 2 * len(self._drive_rows) > len(self._sent):
            self._sent = np.concatenate((self._sent, np.empty(len(self._sent), FRAME_DTYPE)))
        rotors = self._world.plant.sampled[3]
        return bool(
            self._kernels.send_due_frames(
                self._drive_rows,
                *self._drive_structs,
                rotors,
                now_ns,
                self._sent,
                self._progress_array,
            )
        )

    def take_sent_frames(self) -> Any:
        """Return the unsolicited frames that drives have sent since the last call.

        The array is valid until a drive sends the next frame.
        """
        count = self._progress[SENT]
        self._progress[SENT] = 0
        return self._sent[:count]

    def merge_frames(self, frames: Any, other_frames: Any) -> Any:
        """Return the frames of two arrays as one array, sorted by time."""
        merged_frames = np.empty(len(frames) + len(other_frames), FRAME_DTYPE)
        self._kernels.merge_sorted_frames(frames, other_frames, merged_frames)
        return merged_frames


def _does_node_accept(node: Any, can_id: int) -> bool:
    """Return True if a node accepts frames with the given identifier."""
    accepted_ids = getattr(node, "accepted_ids", node.ids)
    return accepted_ids is None or can_id in accepted_ids
