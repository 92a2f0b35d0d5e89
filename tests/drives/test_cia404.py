"""Test load-cell amplifiers with the CANopen profile CiA 404.

The tests cover the frames and the set-up of amplifiers, and the faults of a hand with amplifiers.
"""

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import cantools
import pytest

from firmware_sim.bus.frame import Frame as WireFrame
from firmware_sim.lockstep_hand import LockstepHand
from handctl.campaign.run_stages import GRASP_STAGE, advance_to_stage, homed_run
from handctl.controller.run_setup import make_drives, make_sensors
from handctl.core.tick_types import HandMode
from handctl.drives.cia404.load_cells import Cia404LoadCells
from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.dbc_export import export_bus_dbc
from handctl.drives.frame import Frame
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_from_content, load_hand
from handctl.runtime.diagnostics.bus_scan import scan_bus
from handctl.session.lockstep_simulation import SimulatedRun
from tests.drives.wired_drives import WiredDrives

TENDON_NAMES = ("a", "b", "c")
PERIOD_NS = 2_000_000
REPLY_DELAY_NS = 300_000
"""Time from the start of a tick to the arrival of an amplifier's reply [ns]."""
AMPLIFIER_KEYS: dict[str, Any] = {
    "protocol": "cia404",
    "node_ids": [0x21, 0x22],
    "channels_per_node": 2,
    "range_N": 300.0,
}
SENSOR_NODE_KEYS = ("base_id", "joints", "joint_decimation", "joint_noise_rad")


@dataclass(frozen=True)
class AmplifierSection:
    """Section of a hand file that describes three load cells on two amplifiers."""

    sync_id: int = 0x080
    tendons: tuple[str, ...] = TENDON_NAMES
    node_ids: tuple[int, ...] = (0x21, 0x22)
    amplifier_channels: tuple[int, ...] = (2, 1)
    range_N: float = 300.0
    process_value: str = "int32"
    decimal_digits: int = 3


def hand_with_amplifiers(hand_name: str = "jamia", **changed_keys: Any) -> Hand:
    """Return a packaged hand whose load cells are connected to CiA 404 amplifiers.

    The arguments ``changed_keys`` replace values in the sensor section of the hand file.
    """
    content = load_hand(hand_name).content
    node = {
        key: value for key, value in content["sensor_node"].items() if key not in SENSOR_NODE_KEYS
    }
    return hand_from_content(
        {**content, "sensor_node": {**node, **AMPLIFIER_KEYS, **changed_keys}}, hand_name
    )


# Frames of an amplifier.


def test_hand_made_frames_become_newtons() -> None:
    cells = Cia404LoadCells.from_description(AmplifierSection(), 0, TENDON_NAMES)
    assert cells.ids == (0x1A1, 0x1A2)
    wired_drives = WiredDrives((), cells)
    assert wired_drives.begin_tick_with_sync(7) == Frame(0x080, b"")
    # In the amplifier frames of these tests, a count is 0.001 N, and the lowest byte comes first.
    first_payload, second_payload = bytes.fromhex("39300000 0cfeffff"), bytes.fromhex("df930400")
    wired_drives.receive(
        [
            Frame(0x1A1, first_payload, t_ns=REPLY_DELAY_NS),
            Frame(0x1A2, second_payload, t_ns=REPLY_DELAY_NS),
        ]
    )
    assert wired_drives.tensions == pytest.approx({0: 12.345, 1: -0.5, 2: 299.999}, abs=1e-9)
    assert (wired_drives.field_number("stale"), wired_drives.has_malformed_frame) == (0, False)


def test_a_float_is_read_as_it_is() -> None:
    wired_drives = WiredDrives(
        (),
        Cia404LoadCells.from_description(AmplifierSection(process_value="real32"), 0, TENDON_NAMES),
    )
    wired_drives.begin_tick_with_sync(0)
    first_payload, second_payload = struct.pack("<ff", 12.5, -0.25), struct.pack("<f", math.nan)
    wired_drives.receive(
        [
            Frame(0x1A1, first_payload, t_ns=REPLY_DELAY_NS),
            Frame(0x1A2, second_payload, t_ns=REPLY_DELAY_NS),
        ]
    )
    assert [wired_drives.tensions[i] for i in (0, 1)] == [12.5, -0.25]
    assert math.isnan(wired_drives.tensions[2])


@pytest.mark.parametrize("frame_data", [b"", bytes(4), bytes(7)])
def test_a_frame_of_another_length_is_malformed(frame_data: bytes) -> None:
    wired_drives = WiredDrives(
        (), Cia404LoadCells.from_description(AmplifierSection(), 0, TENDON_NAMES)
    )
    wired_drives.begin_tick_with_sync(0)
    wired_drives.receive([Frame(0x1A1, frame_data, t_ns=REPLY_DELAY_NS)])
    assert (wired_drives.tensions, wired_drives.has_malformed_frame) == ({}, True)


def test_a_frame_before_any_answer_to_the_sync_is_stale() -> None:
    cells = Cia404LoadCells.from_description(AmplifierSection(), 0, TENDON_NAMES)
    wired_drives = WiredDrives((), cells)
    wired_drives.field_view("t_ns")[...] = 10_000_000
    wired_drives.begin_tick_with_sync(0)
    wired_drives.receive([Frame(0x1A1, bytes(8), t_ns=10_000_000 + 99_999)])
    assert (wired_drives.field_number("stale"), wired_drives.tensions) == (1, {})
    wired_drives.receive([Frame(0x1A1, bytes(8), t_ns=10_000_000 + 126_000)])
    assert (wired_drives.field_number("stale"), wired_drives.tensions) == (1, {0: 0.0, 1: 0.0})


def test_channels_go_to_further_tpdos() -> None:
    names = tuple(f"t{i}" for i in range(7))
    section = AmplifierSection(tendons=names, node_ids=(5, 6), amplifier_channels=(5, 2))
    cells = Cia404LoadCells.from_description(section, 0, names)
    assert cells.ids == (0x185, 0x285, 0x385, 0x186)
    assert cells.channels == ((0, 1), (2, 3), (4,), (5, 6))
    assert cells.lengths == (8, 8, 4, 8)
    assert [cells.group_of_tendon(i) for i in range(7)] == [0, 0, 1, 1, 2, 3, 3]


@pytest.mark.parametrize(
    ("value_format", "raw_bytes"),
    [("int32", struct.pack("<ii", 1500, -2)), ("real32", struct.pack("<ff", 1.5, -2e-3))],
)
def test_the_dbc_decodes_the_same_tensions(value_format: str, raw_bytes: bytes) -> None:
    hand = hand_with_amplifiers(process_value=value_format)
    text = export_bus_dbc(0, make_drives(hand), make_sensors(hand), hand.tendon_names, hand.joints)
    database = cantools.database.load_string(text, "dbc", strict=True)
    decoded_tensions = database.decode_message(0x1A1, raw_bytes)  # type: ignore[union-attr]
    assert decoded_tensions == pytest.approx({"index_tendon": 1.5, "middle_tendon": -2e-3})


# Set-up of the amplifiers.


class AmplifierBench:
    """Bench without drives that connects handctl's code for load-cell amplifiers to simulated amplifiers."""

    def __init__(self, hand: Hand, hand_path: str) -> None:
        """Start the simulator for the hand that a file describes."""
        self.simulated_hand = LockstepHand(hand_path, seed=1, period_ns=PERIOD_NS)
        self.sensors = make_sensors(hand)
        self.states = [amplifier.initial_state() for amplifier in self.sensors.amplifiers]
        self.k = 0
        self.sent_frames: list[Frame] = []
        self.answers: list[Frame] = []

    @property
    def simulated_amplifiers(self) -> list[Any]:
        """Return the simulated amplifiers."""
        return self.simulated_hand.world.sensor_nodes

    def tick(self, target: DriveTarget = DriveTarget.POLL, with_sync: bool = True) -> None:
        """Exchange the frames of one tick between the host and the amplifiers."""
        out = [self.sensors.sync(self.k)] if with_sync else []
        for i, amplifier in enumerate(self.sensors.amplifiers):
            self.states[i], frames = amplifier.advance(self.states[i], self.k * PERIOD_NS, target)
            out += frames
        self.sent_frames += out
        self.answers = [
            Frame(*frame_fields)
            for frame_fields in self.simulated_hand.step(
                self.k * PERIOD_NS, [tuple(frame_fields) for frame_fields in out]
            )
        ]
        for frame in self.answers:
            for i, amplifier in enumerate(self.sensors.amplifiers):
                self.states[i] = amplifier.receive(self.states[i], frame)
        self.k += 1

    def run_until_phase(self, phase: DrivePhase, max_ticks: int = 400) -> None:
        """Run ticks until all amplifiers are in a given drive phase.

        If the amplifiers do not all reach the given drive phase, the test fails.
        """
        for _ in range(max_ticks):
            self.tick()
            if all(state.phase == phase for state in self.states):
                return
        raise AssertionError(self.states)


@pytest.fixture
def bench(tmp_path: Any) -> Iterator[AmplifierBench]:
    new_bench = make_bench(tmp_path)
    yield new_bench
    new_bench.simulated_hand.close()


def make_bench(hand_folder: Any, **changed_keys: Any) -> AmplifierBench:
    """Return a bench with the amplifiers of a hand.

    The arguments ``changed_keys`` replace values in the sensor section of the hand file.
    """
    hand = hand_with_amplifiers(**changed_keys)
    path = hand_folder / "hand.toml"
    path.write_text(hand.to_toml())
    return AmplifierBench(hand, str(path))


def test_the_set_up_reads_each_object_back_and_starts_the_amplifier(bench: AmplifierBench) -> None:
    bench.run_until_phase(DrivePhase.READY)
    for node in bench.simulated_amplifiers:
        objects = node.objects
        assert node.nmt == 0x05
        assert (objects[0x1800, 1], objects[0x1800, 2]) == (0x180 + node.node_id, 1)
        assert [objects[0x1A00, i] for i in range(3)] == [2, 0x9130_0120, 0x9130_0220]
        assert [objects[0x6131, 1], objects[0x6132, 1], objects[0x1017, 0]] == [0x0021_0000, 3, 100]
        assert all(objects[0x1801 + i, 1] & 1 << 31 for i in range(3))
    bench.tick()
    assert {frame.can_id for frame in bench.answers} >= {0x1A1, 0x1A2}


def test_a_unit_that_is_right_already_is_not_written(bench: AmplifierBench) -> None:
    bench.run_until_phase(DrivePhase.READY)
    written_objects = [
        frame.data[1:4]
        for frame in bench.sent_frames
        if frame.can_id == 0x621 and frame.data[0] & 0xE0 == 0x20
    ]
    assert bytes.fromhex("316101") in written_objects
    bench.states = [amplifier.initial_state() for amplifier in bench.sensors.amplifiers]
    bench.sent_frames.clear()
    bench.run_until_phase(DrivePhase.READY)
    written_objects = [
        frame.data[1:4]
        for frame in bench.sent_frames
        if frame.can_id == 0x621 and frame.data[0] & 0xE0 == 0x20
    ]
    assert bytes.fromhex("316101") not in written_objects
    assert bytes.fromhex("001801") in written_objects


def test_nothing_but_sdo_nmt_and_sync_is_sent(bench: AmplifierBench) -> None:
    bench.run_until_phase(DrivePhase.READY)
    assert {frame.can_id for frame in bench.sent_frames} == {0x000, 0x080, 0x621, 0x622}
    assert {frame.data[0] for frame in bench.sent_frames if frame.can_id == 0x000} == {0x80, 0x01}


def ignore_unit_writes(node: Any) -> None:
    """Make an amplifier confirm each command that sets its unit of measurement, but keep the old unit."""
    original_write = node.objects.write
    node.objects.write = lambda key, raw: None if key == (0x6131, 2) else original_write(key, raw)


def identify_as_drive(node: Any) -> None:
    node.objects[0x1000, 0] = 0x0002_0192


def ignore_transmission_type(node: Any) -> None:
    """Make an amplifier keep its transmission type when the host sets the type to synchronous."""
    original_write = node.objects.write
    node.objects.write = lambda key, raw: None if key == (0x1800, 2) else original_write(key, raw)


WRONG_OBJECTS: dict[str, tuple[Callable[[Any], None], str]] = {
    "unit": (ignore_unit_writes, "object 0x6131:2 reads 0xfd0000 after writing, expected 0x210000"),
    "profile": (identify_as_drive, "object 0x1000:0 reads 0x20192, expected 0x194"),
    "transmission type": (
        ignore_transmission_type,
        "object 0x1800:2 reads 0xfe after writing, expected 0x1",
    ),
}


@pytest.mark.parametrize("wrong_object", WRONG_OBJECTS)
def test_a_wrong_object_refuses_to_arm(wrong_object: str) -> None:
    change_object, text = WRONG_OBJECTS[wrong_object]
    with homed_run(hand_with_amplifiers(), 500.0, 0) as simulation:
        change_object(simulated_nodes(simulation)[0])
        assert simulation.run_until(lambda out: out.mode == HandMode.DONE, 4.0)
    assert simulation.state.failure == f"amplifier 0x21: {text}"
    assert not any(
        HandMode.ARMING <= out.mode <= HandMode.RELAX for _, out in simulation.recorded_ticks
    )


@pytest.mark.nightly
def test_a_missing_amplifier_is_named() -> None:
    with homed_run(hand_with_amplifiers(), 500.0, 0) as simulation:
        simulated_nodes(simulation)[1].ids = frozenset()
        simulation.simulated_hand.world.refresh_identifiers()  # type: ignore[attr-defined]
        assert simulation.run_until(lambda out: out.mode == HandMode.DONE, 5.0)
    assert simulation.state.failure == "no answer from amplifier 0x22"


def test_frames_before_the_set_up_are_not_used() -> None:
    """In this test, the amplifiers send readings in the unit of the manufacturer before the host sets them up.

    Numbers in the unit of the manufacturer are 100 times the tension in newtons.
    """
    with homed_run(hand_with_amplifiers(), 500.0, 0) as simulation:
        for node in simulated_nodes(simulation):
            node.receive(WireFrame(0x000, bytes((0x01, 0x00))), 0)
            node.objects[0x1800, 2] = 1
        groups = simulation.state.view("group_frames")
        assert simulation.run_until(lambda out: out.mode == HandMode.INVENTORY, 2.0)
        assert not simulation.state.view("group_frames").any(), groups
        assert simulation.run_until(lambda out: out.mode == HandMode.READY, 4.0)
        assert abs(simulation.state.view("cell")).max() < 20.0


def test_a_restart_needs_the_set_up_again_and_not_while_torque_may_act(
    bench: AmplifierBench,
) -> None:
    bench.run_until_phase(DrivePhase.READY)
    bench.simulated_amplifiers[0].restart()
    bench.tick(DriveTarget.ENABLE)
    bench.tick(DriveTarget.ENABLE)
    assert [state.phase for state in bench.states] == [DrivePhase.SILENT, DrivePhase.READY]
    bench.sent_frames.clear()
    for _ in range(50):
        bench.tick(DriveTarget.ENABLE)
    assert {frame.can_id for frame in bench.sent_frames} == {0x080}
    bench.run_until_phase(DrivePhase.READY)


# Faults of the amplifiers.


def simulated_nodes(simulation: SimulatedRun) -> list[Any]:
    """Return the simulated amplifiers of a run."""
    return simulation.simulated_hand.world.sensor_nodes  # type: ignore[attr-defined]


def observed_faults(
    hand: Hand, seed: int, disturb: Callable[[SimulatedRun], None], tick_count: int = 60
) -> tuple[set[str], int]:
    """Disturb the amplifiers of a hand during a grasp.

    Return the reported faults, and the number of ticks from the disturbance to the reaction of the
    controller. If the controller does not react, the number of ticks is -1.
    """
    with homed_run(hand, 500.0, seed) as simulation:
        advance_to_stage(simulation, GRASP_STAGE)
        disturb(simulation)
        fault_ids: set[str] = set()
        first_tick = -1
        for i in range(tick_count):
            out = simulation.run_tick()
            fault_ids |= {event.text.split()[0] for event in out.events if event.name == "fault"}
            if first_tick < 0 and out.mode != HandMode.ACTIVE:
                first_tick = i
        return fault_ids, first_tick


def fault_injection(fault_text: str) -> Callable[[SimulatedRun], None]:
    return lambda simulation: simulation.simulated_hand.inject(fault_text)


def restart_all_nodes(simulation: SimulatedRun) -> None:
    for node in simulated_nodes(simulation):
        node.restart()


FAULT_BY_CASE = {
    "silent": ("drop node=sensors", "N02"),
    "mute": ("mute cell=index_tendon", "N02"),
    "over the range": ("saturate cell=index_tendon", "T06"),
    "broken wire": ("saturate cell=index_tendon size=-1", "T06"),
}


NIGHTLY_CASES = [
    pytest.param(name, marks=pytest.mark.nightly) for name in FAULT_BY_CASE if name != "mute"
]


@pytest.mark.parametrize("fault_case", ["mute", *NIGHTLY_CASES])
def test_a_fault_is_found_as_with_the_sensor_node_of_handctl(fault_case: str) -> None:
    text, row = FAULT_BY_CASE[fault_case]
    sensor_node_faults = observed_faults(load_hand("jamia"), 0, fault_injection(text))
    amplifiers = observed_faults(hand_with_amplifiers(), 0, fault_injection(text))
    assert row in sensor_node_faults[0], sensor_node_faults
    assert row in amplifiers[0], amplifiers
    assert 0 <= amplifiers[1] <= sensor_node_faults[1] + 1, (sensor_node_faults, amplifiers)


def test_amplifiers_that_restart_in_a_grasp_relax_the_hand() -> None:
    fault_ids, ticks = observed_faults(hand_with_amplifiers(), 0, restart_all_nodes)
    assert "N02" in fault_ids
    assert 0 <= ticks <= 17  # an amplifier that is silent for 30 ms causes a fault


def test_late_answers_are_delays_and_no_second_node() -> None:
    """Frames of an amplifier have no counter.

    Earlier defect: a late reply and the next reply of the same amplifier caused the fault B06 (a
    conflicting duplicate frame).
    """
    fault_ids, ticks = observed_faults(
        hand_with_amplifiers(), 0, fault_injection("delay node=sensors size=2.5 p=0.05")
    )
    assert (fault_ids, ticks) == ({"B04"}, -1)


@pytest.mark.nightly
def test_two_amplifiers_with_one_number_are_found() -> None:
    fault_ids, ticks = observed_faults(
        hand_with_amplifiers(), 0, fault_injection("twin node=sensors")
    )
    assert "B06" in fault_ids
    assert 0 <= ticks <= 2


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(5))
def test_a_hand_with_amplifiers_holds_a_grasp(seed: int) -> None:
    for value in ("int32", "real32"):
        with homed_run(hand_with_amplifiers(process_value=value), 500.0, seed) as simulation:
            advance_to_stage(simulation, GRASP_STAGE)
            for _ in range(500):
                assert simulation.run_tick().mode == HandMode.ACTIVE
            truth = simulation.simulated_hand.truth()["tension"]
            error = (
                simulation.state.tendon[:1]
                if simulation.last_output is None
                else simulation.last_output.telemetry.tension - truth
            )
            assert abs(error).max() < 3.0
            assert simulation.state.latched_faults == ()


# Hand files with amplifiers.

HAND_FILE_MISTAKES: dict[str, tuple[dict[str, Any], str]] = {
    "no range": ({"range_N": None}, "sensor_node.range_N: missing"),
    "small range": ({"range_N": 100.0}, "sensor_node.range_N: 100; expected at least"),
    "few channels": (
        {"node_ids": [0x21]},
        "sensor_node.node_ids: 1 amplifiers of 2 channels for 4 load cells",
    ),
    "unused amplifier": (
        {"node_ids": [0x21, 0x22, 0x23]},
        "sensor_node.node_ids: 0x23 has no load cell",
    ),
    "twice": ({"node_ids": [0x21, 0x21]}, "sensor_node.node_ids: 0x21 twice"),
    "the host's number": (
        {"node_ids": [0x21, 0x7F]},
        "sensor_node.node_ids[1]: 127; expected a whole number from 1",
    ),
    "a reply's identifier": ({"node_ids": [0x21, 1]}, ""),
    "another SYNC": ({"sync_id": 0x90}, "sensor_node.sync_id: 0x90; expected 0x080"),
    "joint encoders": ({"joints": ["index_j1"]}, "sensor_node.joints: given; expected no such key"),
    "a key of the other protocol": (
        {"base_id": 0x1A0},
        "sensor_node.base_id: given; expected no such key",
    ),
    "too many digits": (
        {"decimal_digits": 6, "range_N": 4000.0},
        "sensor_node.decimal_digits: 4000 N has more",
    ),
    "a wrong word": (
        {"process_value": "float"},
        'sensor_node.process_value: "float"; expected "int32" or "real32"',
    ),
    "a wrong protocol": (
        {"protocol": "cia405"},
        'sensor_node.protocol: "cia405"; expected "handctl" or "cia404"',
    ),
}


@pytest.mark.parametrize("mistake_name", HAND_FILE_MISTAKES)
def test_a_mistake_is_one_line(mistake_name: str) -> None:
    changed, text = HAND_FILE_MISTAKES[mistake_name]
    keys = {key: value for key, value in changed.items() if value is not None}
    if not text:
        assert hand_with_amplifiers(**keys).sensor_node.tension_ids == (0x1A1, 0x181)
        return
    content = load_hand("jamia").content
    node = (
        {key: value for key, value in content["sensor_node"].items() if key not in SENSOR_NODE_KEYS}
        | AMPLIFIER_KEYS
        | keys
    )
    node = {key: value for key, value in node.items() if changed.get(key, 0) is not None}
    with pytest.raises(ConfigError) as error:
        hand_from_content({**content, "sensor_node": node}, "hand.toml")
    assert str(error.value).startswith(f"hand.toml: {text}")
    assert "\n" not in str(error.value)


def test_a_drive_on_an_amplifier_s_identifier_is_a_mistake() -> None:
    content = hand_with_amplifiers().content
    motors = [
        {**motor, "node_id": 0x7D, "options": {"reply_id": 0x1A1}} for motor in content["motor"][:1]
    ]
    with pytest.raises(ConfigError, match='0x1A1 on bus "main" is taken'):
        hand_from_content({**content, "motor": [*motors, *content["motor"][1:]]}, "hand.toml")


def test_keys_of_amplifiers_are_refused_for_the_sensor_node() -> None:
    content = load_hand("jamia").content
    with pytest.raises(
        ConfigError,
        match=r"sensor_node.node_ids: given; expected no such key, it belongs to protocol",
    ):
        hand_from_content(
            {**content, "sensor_node": {**content["sensor_node"], "node_ids": [0x21]}}, "hand.toml"
        )


def test_hands_without_amplifiers_keep_their_content_and_identity() -> None:
    hand = load_hand("jamia")
    assert set(hand.content["sensor_node"]) == {
        "bus", "sync_id", "base_id", "tendons", "joints", "joint_decimation", "tension_noise_N",
        "tension_bias_drift_N", "joint_noise_rad",
    }  # fmt: skip
    assert hand.identity.startswith("dfe326d335b4750c")


def test_the_log_s_hand_is_the_same() -> None:
    import tomllib

    hand = hand_with_amplifiers(process_value="real32")
    repeated_hand = hand_from_content(tomllib.loads(hand.to_toml()), "log")
    assert repeated_hand == hand
    assert repeated_hand.identity == hand.identity


def test_a_scan_finds_amplifiers_with_their_channels(bench: AmplifierBench) -> None:
    from tests.cli.test_scan import BenchBus, advance_and_listen

    result = scan_bus(BenchBus(bench.simulated_hand.world), listen_function=advance_and_listen)
    found_nodes = [node for node in result.found_nodes if node.protocol == "cia404"]
    assert [(node.node_id, node.options["channels_per_node"]) for node in found_nodes] == [
        (0x21, 2),
        (0x22, 2),
    ]
