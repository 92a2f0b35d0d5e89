"""Test a moteus drive that closes a position loop: commands, settings, and the loss of settings."""

import math
import os
import struct

import numpy as np
import pytest

from firmware_sim.nodes.moteus.node import MoteusNode
from firmware_sim.nodes.moteus.text_channel import FACTORY_CONFIGURATION
from handctl.campaign.fault_matrix import FREE_MOTION_STAGE
from handctl.campaign.run_stages import advance_to_stage, homed_run
from handctl.core import state_block as s
from handctl.core.tick_types import HandMode
from handctl.core.wire import cyclic_frames
from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.frame_records import WORDS_PER_RECORD, Frames
from handctl.drives.moteus import codec
from handctl.drives.moteus.drive import MoteusDrive
from handctl.drives.moteus.settings import (
    MoteusSetting,
    gain_per_turn,
    position_configuration,
    rounded_to_float32,
    write_request,
)
from handctl.drives.signals import SignalQuantity, SignalTable
from handctl.runtime.diagnostics.drive_rig import DriveRig
from tests.controller.test_position_loop import (
    hand_with_position_loop,
    moteus_command,
    start_back_and_forth_run,
)
from tests.drives.protocol_bench import motor_on_bench
from tests.drives.test_guard_readback import freeze_setting
from tests.drives.virtual_bench import DRIVE_NODE_ID, VirtualBench

SIMULATOR_SEEDS = range(20) if os.environ.get("HANDCTL_NIGHTLY") == "1" else range(3)
KP, KD = 2.5, 0.0351
GAIN_BY_ITEM = {"servo.pid_position.kp": 15.708, "servo.pid_position.kd": 0.220540}
NAN_SETTINGS = (
    "servo.default_velocity_limit",
    "servo.default_accel_limit",
    "servo.max_position_slip",
)


def make_position_drive(**option_changes: object) -> MoteusDrive:
    """Return a moteus drive that closes the position loop itself."""
    motor_options = {
        "control": "position",
        "kp_N_m_per_rad": KP,
        "kd_N_m_s_per_rad": KD,
    } | option_changes
    return MoteusDrive.from_motor(
        motor_on_bench("moteus", DRIVE_NODE_ID, 0.5, {}, **motor_options), 0
    )


def armed_rig(virtual_bench: VirtualBench) -> DriveRig:
    return DriveRig(make_position_drive(), virtual_bench, virtual_bench)


def simulated_node(virtual_bench: VirtualBench) -> MoteusNode:
    (node,) = virtual_bench.bench.nodes
    assert isinstance(node, MoteusNode)
    return node


@pytest.mark.parametrize("motor_direction", [1, -1])
def test_the_frame_has_the_registers_of_the_fact_sheet(motor_direction: int) -> None:
    drive = make_position_drive(direction=motor_direction, zero_rad=0.3, watchdog_ms=50)
    message = drive.cyclic_messages.position
    assert message is not None
    assert drive.cyclic_messages.integrates_velocity
    table = SignalTable(message._replace(limit=math.inf))
    can_id, data = table.pack_frame(
        1.7, -4.0, 0.25 * GAINS_PER_RAD[0], 0.5 * GAINS_PER_RAD[1], 0.2, 0.4
    )
    position, velocity, torque, kp, kd, limit = moteus_command(data)
    assert position == pytest.approx(0.3 + motor_direction * 1.7, rel=1e-6)
    assert velocity == pytest.approx(motor_direction * -4.0, rel=1e-6)
    assert torque == pytest.approx(motor_direction * 0.2)
    assert (kp, kd) == (0.25, 0.5)
    assert limit == pytest.approx(0.4)
    assert struct.unpack_from("<f", data, 36)[0] == pytest.approx(0.05)
    assert data[40:] == codec.QUERY_SUBFRAMES
    assert can_id == drive.command.message.can_id
    assert len(data) == drive.command.message.length, (
        "the load of the bus is that of torque commands"
    )


GAINS_PER_RAD = tuple(gain / math.tau for gain in GAIN_BY_ITEM.values())


def test_a_motor_with_torque_commands_has_no_position_command_and_the_settings_of_before() -> None:
    drive = MoteusDrive.from_motor(motor_on_bench("moteus", DRIVE_NODE_ID, 0.5, {}), 0)
    assert drive.cyclic_messages.position is None
    assert not drive.cyclic_messages.integrates_velocity
    assert [setting.name for setting in drive.configuration] == [
        "servopos.position_min", "servo.fixed_voltage_mode", "servo.timeout_mode", "servopos.position_max",
    ]  # fmt: skip


def test_the_settings_are_written_and_read_back_before_arming_and_not_stored() -> None:
    virtual_bench = VirtualBench("moteus")
    rig = armed_rig(virtual_bench)
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 3.0)
    channel = simulated_node(virtual_bench).channel
    for name, value in GAIN_BY_ITEM.items():
        assert channel.items[name] == pytest.approx(value, abs=1e-6)
    assert all(math.isnan(channel.items[name]) for name in NAN_SETTINGS)
    assert all(channel.saved[name] == FACTORY_CONFIGURATION[name] for name in GAIN_BY_ITEM)
    assert channel.saved["servo.default_accel_limit"] == 50.0
    assert virtual_bench.largest_torque == 0.0


@pytest.mark.parametrize("setting_name", [*GAIN_BY_ITEM, *NAN_SETTINGS])
def test_a_setting_that_does_not_read_back_keeps_the_drive_off(setting_name: str) -> None:
    virtual_bench = VirtualBench("moteus")
    setting_values = simulated_node(virtual_bench).channel.items
    setting_values[setting_name] = 3.0
    freeze_setting(virtual_bench, setting_name)
    rig = armed_rig(virtual_bench)
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.FAULT, 3.0)
    assert f"{setting_name} reads 3 after writing, expected" in rig.state.error_text


def test_a_firmware_without_an_item_is_refused_by_name() -> None:
    virtual_bench = VirtualBench("moteus")
    del simulated_node(virtual_bench).channel.items["servo.default_accel_limit"]
    rig = armed_rig(virtual_bench)
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.FAULT, 3.0)
    assert "servo.default_accel_limit reads ERR error reading, expected nan" in rig.state.error_text


@pytest.mark.parametrize("setting_name", [*GAIN_BY_ITEM, *NAN_SETTINGS])
def test_a_setting_that_is_lost_while_enabled_is_found(setting_name: str) -> None:
    virtual_bench = VirtualBench("moteus")
    rig = armed_rig(virtual_bench)
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.ENABLED, 3.0)
    simulated_node(virtual_bench).channel.items[setting_name] = 7.0
    assert rig.run_until(DriveTarget.ENABLE, lambda state: state.phase == DrivePhase.FAULT, 6.0)
    assert f"{setting_name} reads 7" in rig.state.error_text


def test_a_restart_is_found_by_two_reads() -> None:
    """The controller reads the settings of a moteus back one after the other.

    After a restart of the drive, at least one of any two settings that are read one after the other
    has a wrong value.
    """
    settings = position_configuration(codec.PositionGains(*GAIN_BY_ITEM.values()))
    for first_setting, second_setting in zip(settings, settings[1:] + settings[:1], strict=True):
        assert not all(
            setting.is_required_value(FACTORY_CONFIGURATION[setting.name])
            for setting in (first_setting, second_setting)
        )


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
def test_gains_survive_the_text_of_the_drive_and_are_never_rounded_down(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for gain in (0.0, 0.001, 5000.0, *10.0 ** rng.uniform(-4.0, 3.69, 2000)):
        value = gain_per_turn(float(gain))
        assert math.tau * gain <= value <= math.tau * gain + max(1.01e-6, 1.1e-5 * value)
        setting = MoteusSetting("servo.pid_position.kp", value)
        text = write_request(setting).decode().split()[-1]
        assert "e" not in text
        assert setting.is_required_value(float(f"{rounded_to_float32(float(text)):f}"))


VALUES_OUT_OF_RANGE = [
    (s.SERVO_POSITION, 256.1 * math.tau), (s.SERVO_VELOCITY, 51.0), (s.SERVO_KP, 2.6), (s.SERVO_KD, 1.0),
    (s.SERVO_TORQUE, 0.81), (s.SERVO_TORQUE_LIMIT, 0.81), (s.SERVO_TORQUE_LIMIT, -0.01), (s.SERVO_KD, -0.01),
]  # fmt: skip


@pytest.mark.parametrize(
    ("target_row", "target_value"),
    [
        *VALUES_OUT_OF_RANGE,
        *((row, bad) for row, _ in VALUES_OUT_OF_RANGE[:6] for bad in (math.nan, math.inf)),
    ],
)
def test_a_number_that_cannot_be_encoded_becomes_a_torque_command(
    target_row: int, target_value: float
) -> None:
    with start_back_and_forth_run(hand_with_position_loop(protocol="moteus")) as run:
        for _ in range(10):
            run.run_tick()
        assert run.state.view("servo_kp").all()
        layout, wire = run.state.layout, run.controller.derived_constants.wire
        torque = run.state.tendon[s.COMMANDED_TORQUE].copy()
        if target_row == s.SERVO_KP and math.isnan(target_value):
            # A comparison of NaN with 0 is false. A command whose kp is NaN is therefore always a
            # torque command.
            target_value = math.inf
        block = run.state.block.copy()
        assert len(sent_frames(block, layout, wire, torque)) == 4
        valid_sent_frame = sent_frames(block, layout, wire, torque)[1]
        layout.table(block, "servo")[target_row, 1] = target_value
        frames = sent_frames(block, layout, wire, torque)
        drive = run.controller.drives[1]
        assert isinstance(drive, MoteusDrive)
        assert valid_sent_frame[17:19] == b"\x0f\x23"
        assert frames[1] == drive.command.pack(torque[1])
        assert layout.table(block, "servo")[s.SERVO_KP, 1] == 0.0
        assert moteus_command(frames[0])[3] > 0.0


def sent_frames(block, layout, wire, torque) -> list[bytes]:
    """Encode the drive commands in the controller state ``block``, and return the payloads of the frames."""
    out = np.zeros((wire.max_frames, WORDS_PER_RECORD), np.uint64)
    first_drive, count = cyclic_frames.encode_commands(
        block, layout.offsets, *wire.kernel_args, out, torque, 0, 0
    )
    assert first_drive == len(torque)
    return [frame.data for frame in Frames(out[:count])]


def test_every_signal_has_its_range() -> None:
    message = make_position_drive().cyclic_messages.position
    assert message is not None
    limits_by_quantity = {signal.quantity: signal.value_limits for signal in message.signals}
    assert limits_by_quantity[SignalQuantity.STIFFNESS] == (0.0, GAINS_PER_RAD[0])
    assert limits_by_quantity[SignalQuantity.DAMPING] == pytest.approx((0.0, GAINS_PER_RAD[1]))
    assert limits_by_quantity[SignalQuantity.VELOCITY] == pytest.approx((-30.0, 30.0))
    assert limits_by_quantity[SignalQuantity.POSITION] == pytest.approx(
        (-256.0 * math.tau, 256.0 * math.tau)
    )


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
def test_a_hand_whose_moteus_lost_its_settings_relaxes(seed: int) -> None:
    """A moteus that loses the gains of its position loop changes its torque at once.

    The repeated read-back of the settings finds that the gains are lost.
    """
    hand = hand_with_position_loop(protocol="moteus")
    with homed_run(hand, 500.0, seed) as hand_run:
        advance_to_stage(hand_run, FREE_MOTION_STAGE)
        motor = hand.motor[seed % 4].name
        hand_run.simulated_hand.inject(f"forget node={motor}")
        assert hand_run.run_until(lambda out: out.mode in (HandMode.RELAX, HandMode.CUT), 1.2)
        latched_faults = {(mark.id, mark.part_name) for mark in hand_run.state.latched_faults}
        assert latched_faults
        assert latched_faults <= {("N12", motor), ("N14", motor), ("N17", motor)}
        assert max(hand_run.simulated_hand.truth()["tension"]) < 60.0
