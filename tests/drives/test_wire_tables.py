"""Test the wire tables of a hand, which are in one block of words."""

import numpy as np
import pytest

from handctl.controller.run_setup import make_drives, make_sensors
from handctl.core.wire.wire_table_building import build_wire_tables
from handctl.core.wire.wire_tables import (
    FRAME_KIND_COLUMN,
    GROUP_COLUMN,
    SENSOR_FRAMES,
    STATE_MACHINE_FRAMES,
    WireBlock,
    WireTables,
    wire_tables,
)
from handctl.hand.hand_loading import load_hand, packaged_hands
from tests.controller.synthetic_states import uncompiled_function


def wire_block(hand_name: str) -> WireBlock:
    """Return the wire tables of a packaged hand whose drives close the position loop if they can."""
    hand = load_hand(hand_name)
    drives = make_drives(hand)
    closes_loop = [drive.cyclic_messages.position is not None for drive in drives]
    return WireBlock(build_wire_tables(drives, make_sensors(hand), closes_loop))


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_the_block_contains_every_table(hand_name: str) -> None:
    block = wire_block(hand_name)
    tables_in_block = uncompiled_function(wire_tables)(block.words, block.offsets)
    for name, table, table_in_block in zip(
        WireTables._fields, block.tables, tables_in_block, strict=True
    ):
        assert table_in_block.dtype == table.dtype, name
        np.testing.assert_array_equal(table_in_block, table, err_msg=name)
        assert table_in_block.base is not None, "a table of the block is no copy"


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_state_machines_get_the_frames_of_removed_groups(hand_name: str) -> None:
    block = wire_block(hand_name)
    sensor_rows = block.tables.entries[:, FRAME_KIND_COLUMN] == SENSOR_FRAMES
    groups = sorted(set(block.tables.entries[sensor_rows, GROUP_COLUMN].tolist()))
    removed = tuple(groups[1:])
    entries = block.without_groups(removed).tables.entries
    kinds = {
        int(row[GROUP_COLUMN]): int(row[FRAME_KIND_COLUMN])
        for row in entries[np.flatnonzero(sensor_rows)]
    }
    expected = {
        group: STATE_MACHINE_FRAMES if group in removed else SENSOR_FRAMES for group in groups
    }
    assert kinds == expected
    np.testing.assert_array_equal(entries[~sensor_rows], block.tables.entries[~sensor_rows])
    assert block.without_groups(removed) is block.without_groups(removed)
