"""Test the SYNC frame and the heartbeat of the host for CiA 402 drives.

On a bus with a sensor node, the request to the sensor node can be the SYNC frame. On a bus where no
request to a sensor node is a SYNC frame, one drive object of the host sends SYNC for all drives. On
each bus, one drive object also sends the heartbeat of the host.
"""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handctl.campaign.run_stages import hand_with_protocol
from handctl.controller.bus_load import bus_loads, with_more_buses
from handctl.controller.run_setup import make_drives
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.drives.frame_time import MAX_BUS_LOAD, frame_time_s
from handctl.drives.motor_description import PROTOCOL_TRAITS
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand
from handctl.programs.live_session import LiveProgram
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller
from tests.drives.protocol_bench import hand_file, move_to_second_bus

SYNC_ID = 0x080
HOST_HEARTBEAT_ID = 0x77F
HEARTBEAT_TICKS = 5
"""Period of the host's heartbeat at 250 Hz [ticks]: a third of the watchdog time of 50 ms, rounded up."""


def sync_sender_names(hand: Hand) -> list[str]:
    """Return the names of the drives on whose behalf the host sends SYNC frames."""
    return [drive.name for drive in make_drives(hand) if getattr(drive, "sync", False)]


def hand_without_sensors() -> Hand:
    """Return jamia with CiA 402 drives and without a sensor node."""
    content: dict[str, Any] = hand_content("jamia")
    del content["sensor_node"]
    drive = {"protocol": "cia402", "options": dict(PROTOCOL_TRAITS["cia402"].options)}
    content["motor"] = [motor | drive for motor in content["motor"]]
    return hand_from_content(content, "without sensors")


def test_a_hand_on_two_buses_has_sync_on_both(tmp_path: Path) -> None:
    """Reproduce a defect.

    Earlier, the host sent no SYNC frame on a bus without a sensor node. Therefore a hand with CiA
    402 drives on a bus without a sensor node was never armed.
    """
    path = move_to_second_bus(hand_file(tmp_path, ["cia402"]))
    hand = load_hand(str(path))
    assert sync_sender_names(hand) == ["thumb_motor"], (
        "the last drive of the bus without the sensor node"
    )
    model = HandModel.from_hand(hand, Gains(), 250.0)
    with SimulatorSettings(str(path), None, 0, homed=True).begin_run(
        homed_controller(model, LiveProgram())
    ) as run:
        assert run.run_until(lambda out: out.mode == HandMode.ACTIVE, 5.0)
        buses_and_lengths = [
            (frame.bus, len(frame.data))
            for frame in run.last_output.frames
            if frame.can_id == SYNC_ID
        ]
        assert buses_and_lengths == [(0, 1), (1, 0)], (
            "once on each bus: with the counter for the sensor node, else empty"
        )


def test_the_host_sends_one_heartbeat_on_each_bus(tmp_path: Path) -> None:
    """Reproduce a defect.

    Earlier, the host sent its heartbeat once for each drive. One heartbeat on each bus is enough,
    because every drive on a bus receives the heartbeat.
    """
    path = move_to_second_bus(hand_file(tmp_path, ["cia402"]))
    model = HandModel.from_hand(load_hand(str(path)), Gains(), 250.0)
    with SimulatorSettings(str(path), None, 0, homed=True).begin_run(
        homed_controller(model, LiveProgram())
    ) as run:
        assert run.run_until(lambda out: out.mode == HandMode.ACTIVE, 5.0)
        ticks_by_bus: dict[int, list[int]] = {0: [], 1: []}
        for k in range(100):
            run.run_tick()
            assert run.last_output.mode == HandMode.ACTIVE
            for frame in run.last_output.frames:
                if frame.can_id == HOST_HEARTBEAT_ID:
                    ticks_by_bus[frame.bus].append(k)
    for ticks in ticks_by_bus.values():
        assert len(ticks) == 100 // HEARTBEAT_TICKS
        assert set(np.diff(ticks)) == {HEARTBEAT_TICKS}


def test_the_packaged_hand_on_two_buses_has_sync_on_both() -> None:
    assert sync_sender_names(hand_with_protocol("n_plus_1", "cia402")) == ["middle_f2"], (
        "the last drive of the bus without the sensor node"
    )


@pytest.mark.parametrize(
    ("original_text", "replacement_text", "expected_senders"),
    [
        ("sync_id = 128", "sync_id = 255", ["middle_motor", "thumb_motor"]),
        (
            "counts_per_turn = 65536",
            "counts_per_turn = 65536\nsync = true",
            ["index_motor", "thumb_motor"],
        ),
    ],
)
def test_one_drive_of_a_bus_sends_sync(
    original_text: str, replacement_text: str, expected_senders: list[str], tmp_path: Path
) -> None:
    """If the request to the sensor node has another identifier than SYNC, the host sends SYNC for one drive of the bus.

    For a drive with the option ``sync``, the host always sends SYNC.
    """
    path = move_to_second_bus(hand_file(tmp_path, ["cia402"]))
    text = path.read_text()
    assert original_text in text
    path.write_text(text.replace(original_text, replacement_text, 1))
    assert sync_sender_names(load_hand(str(path))) == expected_senders


def test_other_protocols_have_no_sync(tmp_path: Path) -> None:
    assert (
        sync_sender_names(
            load_hand(str(move_to_second_bus(hand_file(tmp_path, ["mit", "odrive"]))))
        )
        == []
    )


def test_the_bus_load_has_the_sync_without_sensors() -> None:
    (load,) = bus_loads(hand_without_sensors())
    (sync,) = [row for row in load.rows if row.size == 0]
    assert (sync.frames_per_tick, sync.frame_s) == (1.0, frame_time_s(0, False, 1e6))


def test_each_bus_of_a_split_has_room_for_its_sync() -> None:
    for rate in range(200, 1000, 80):
        hand = hand_with_protocol("jamia11", "cia402")
        hand_with_buses = with_more_buses(hand, rate)
        loads = bus_loads(hand_from_content(tomllib.loads(hand_with_buses.to_toml()), "split"))
        assert max(load.load_at_rate(rate) for load in loads) <= MAX_BUS_LOAD, rate
