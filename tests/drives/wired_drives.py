"""Run compiled code and the Python code of drives and of a sensor node on one array of state values.

Compiled code receives and sends the frames of the drives and of the sensor node, as in a tick of
the controller.
"""

from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from handctl.controller.controller_state import drive_values
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.constants import CONSTANT_SCHEMA, FILTER_DESIGN_COUNT, FILTER_DESIGN_SIZE
from handctl.core.state_block import STATE_SCHEMA
from handctl.core.wire import cyclic_frames
from handctl.core.wire.wire_table_building import build_wire_tables
from handctl.core.wire.wire_tables import WireBlock
from handctl.drives.contract import Drive, DriveState, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.frame_records import WORDS_PER_RECORD, Frames, frames_as_records
from handctl.drives.sensors.contract import SensorInterface


class WiredDrives:
    """Drives and a sensor node whose state between two ticks is an array of numbers, the state block.

    Attributes:
        block: state block with the numbers of the drives and of the sensor node.
        states: states of the drives after the last run of their state machines. The values of the
            drives are in the state block.
        frames_for_drives: frames of the last ``receive`` that compiled code left to the state
            machine of a drive.
        foreign_frames: frames of the last ``receive`` whose identifiers only the host may use.
    """

    def __init__(self, drives: Sequence[Drive], sensors: SensorInterface) -> None:
        """Build the state block and the tables with which compiled code reads and writes frames."""
        self.drives, self.sensors = drives, sensors
        n = len(sensors.tendon_frame_indices)
        joint_count = 1 + max(
            (j for group in sensors.channels[sensors.tension_frames :] for j in group), default=0
        )
        axes = {"tendon": n, "joint": joint_count, "digit": 1, "coordinate": 1, "node": n + 1}
        self.layout = STATE_SCHEMA.layout(
            {**axes, "group": max(1, len(sensors.ids)), "instance": n + joint_count, "run": 1}
        )
        self.wire = WireBlock(build_wire_tables(drives, sensors))
        self.block = self.layout.initial.copy()
        self.owners = {
            (drive.bus, can_id): i for i, drive in enumerate(drives) for can_id in drive.node_ids
        }
        self.states: list[DriveState] = [drive.initial_state() for drive in drives]
        self.frames_for_drives: list[Frame] = []
        self.foreign_frames: list[Frame] = []
        for i, state in enumerate(self.states):
            self.store_drive_state(i, state)

    def field_view(self, field_name: str) -> NDArray:
        """Return the numbers of one field of the state block as a view."""
        return self.layout.view(self.block, field_name)

    def field_number(self, field_name: str) -> int:
        """Return a single number of the state block by its name."""
        return int(self.field_view(field_name)[0])

    def begin_tick(self) -> None:
        """Begin a tick without changing the number and the time of the tick."""
        numbers = [self.field_number(name) for name in ("k", "t_ns", "late_ns", "missed", "frames")]
        tick_stages.begin_tick(self.block, self.layout.offsets, *numbers)

    def begin_tick_with_sync(self, k: int) -> Frame:
        """Begin the next tick.

        Return the frame with which the host requests the sensor values at the end of a tick.
        """
        frame = self.sensors.sync(k)
        self.field_view("sync_asked")[...], self.field_view("syncs")[...] = (
            self.sensors.counter(k) & 0xF,
            self.field_number("syncs") + 1,
        )
        self.begin_tick()
        return frame

    def receive(self, frames: Iterable[Frame]) -> "WiredDrives":
        """Receive frames in the same way as a tick of the controller does, and return ``self``."""
        frames, at = frames_as_records(frames), 0
        self.frames_for_drives, self.foreign_frames = [], []
        while True:
            at = cyclic_frames.receive_frames(
                self.block, self.layout.offsets, *self._load_cell_constants, *self.wire.kernel_args,
                frames.rows, at, self.sensors.earliest_answer_time_ns(self.field_number("t_ns")),
            )  # fmt: skip
            if at >= len(frames):
                return self
            frame = frames[at]
            i = self.owners.get((frame.bus, frame.can_id))
            if i is None:
                self.foreign_frames.append(frame)
            else:
                self.frames_for_drives.append(frame)
                self.store_drive_state(i, self.drives[i].receive(self.drive_state(i), frame))
            at += 1

    def send(self, target: DriveTarget, torque: Sequence[float], t_ns: int) -> list[Frame]:
        """Return the frames that the host sends to the drives in a tick.

        The frames request the drive state ``target``, and command the torques ``torque`` [N m].
        """
        self.field_view("t_ns")[...] = t_ns
        sent, first_drive = list[Frame](), 0
        while True:
            if target == DriveTarget.ENABLE:
                out = np.zeros((self.wire.max_frames, WORDS_PER_RECORD), np.uint64)
                first_drive, count = cyclic_frames.encode_commands(
                    self.block, self.layout.offsets, *self.wire.kernel_args, out,
                    np.asarray(torque, dtype=np.float64), first_drive, 0,
                )  # fmt: skip
                sent += Frames(out[:count])
            if first_drive >= len(self.drives):
                return sent
            state, frames = self.drives[first_drive].advance(
                self.drive_state(first_drive), t_ns, target, torque[first_drive]
            )
            self.store_drive_state(first_drive, state)
            sent += frames
            first_drive += 1

    def store_drive_state(self, drive_index: int, drive_state: DriveState) -> None:
        """Store the state of the drive ``drive_index``, and write its values to the state block."""
        drive, integers, table = (
            self.drives[drive_index],
            *(self.layout.table(self.block, name) for name in ("tendon_int", "tendon")),
        )
        table[s.POSITION : s.POSITION + 4, drive_index] = drive_state[1:5]
        integers[s.FEEDBACK_COUNT, drive_index], integers[s.FEEDBACK_RECEIVED_NS, drive_index] = (
            drive_state.feedback_count,
            drive_state.feedback_t_ns,
        )
        integers[s.RECHECK_STEP : s.RECHECK_TRIES + 1, drive_index] = drive_state.recheck
        integers[s.DRIVE_PHASE, drive_index] = drive_state.phase
        integers[s.EXPECTED_DRIVE_STATUS, drive_index], integers[s.DRIVE_DUE_NS, drive_index] = (
            drive.steady_status(drive_state),
            drive.due_ns(drive_state),
        )
        self.states[drive_index] = drive_state

    def drive_state(self, drive_index: int) -> DriveState:
        """Return the state of the drive ``drive_index``, updated with its values from the state block."""
        values = drive_values(self.layout, self.block, drive_index)
        return self.states[drive_index].with_values(*values)

    # Readings that the sensor node has sent.

    @property
    def tensions(self) -> dict[int, float]:
        """Return the load-cell readings that arrived in the present tick [N], by tendon."""
        fresh_field_values, cells = self.field_view("cell_fresh"), self.field_view("cell")
        return {i: float(cells[i]) for i in np.flatnonzero(fresh_field_values).tolist()}

    @property
    def joint_readings(self) -> dict[int, float]:
        """Return the joint-encoder readings that arrived in the present tick [rad], by joint."""
        fresh_field_values, angles = self.field_view("joint_fresh"), self.field_view("joint_angle")
        return {j: float(angles[j]) for j in np.flatnonzero(fresh_field_values).tolist()}

    @property
    def has_malformed_frame(self) -> bool:
        """Return True if a frame of the sensor node had a wrong form in the present tick."""
        return bool(self.field_view("misread_now")[-1])

    def observe_readings(self) -> "WiredDrives":
        """Convert the received sensor values to measurements for the state filter.

        The state filter starts as soon as every sensor has been read once.
        """
        tick_stages.observe_tick(self.block, self.layout.offsets, *self._load_cell_constants)
        return self

    @cached_property
    def _load_cell_constants(self) -> tuple[NDArray, NDArray]:
        """Return the array with a hand's constants, and the offsets of the constants in the array.

        The function sets only the constants for load-cell frames. All other constants in the
        returned array keep their initial values.
        """
        axes = self.layout.axes
        used_axes = {name: axes[name] for name in ("tendon", "joint", "digit", "coordinate")}
        layout = CONSTANT_SCHEMA.layout(
            {
                **used_axes,
                "kind": FILTER_DESIGN_COUNT,
                "element": FILTER_DESIGN_SIZE,
                "place": 1,
                "run": 1,
            }
        )
        block = layout.initial.copy()
        table = layout.table(block, "tendon_int")
        table[h.CELL_GROUP] = [self.sensors.group_of_tendon(i) for i in range(axes["tendon"])]
        layout.table(block, "run")[[h.MIN_CELL_RANGE, h.MAX_CELL_RANGE], 0] = (
            self.sensors.cell_range
        )
        return block, layout.offsets
