"""Test a whole simulated hand in lockstep.

The tests move the simulated hand with frames that they compose byte by byte.
"""

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from firmware_sim.bus.frame import Frame
from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.lockstep_hand import LockstepHand
from firmware_sim.truth_file import read_truth

TICK_NS = 2_000_000
MOTOR_NODES = (1, 2, 3, 4)
ENABLE_PAYLOAD, DISABLE_PAYLOAD = b"\xff" * 7 + b"\xfc", b"\xff" * 7 + b"\xfd"
FrameTuple = tuple[int, bytes, int, int, int]


def frame_tuple(can_id: int, data: bytes) -> FrameTuple:
    return (can_id, data, 0, 0, 0)


def torque_payload(torque: float) -> bytes:
    """Return the bytes of a motor command that contains only a torque.

    The motor's torque range is 0.8 N m, the value of its register TMAX.
    """
    return (0x7FFF << 48 | 0x7FF << 36 | round((torque + 0.8) * 4095 / 1.6)).to_bytes(8, "big")


def sync_frame(tick_index: int) -> FrameTuple:
    return frame_tuple(0x080, bytes([tick_index & 0xFF]))


def step_with_torque(rig: LockstepHand, tick_index: int, torque: float) -> list[Frame]:
    return rig.step(
        tick_index * TICK_NS,
        [
            sync_frame(tick_index),
            *[frame_tuple(motor, torque_payload(torque)) for motor in MOTOR_NODES],
        ],
    )


def close_hand(
    rig: LockstepHand, tension: float, duration_s: float, ramp_s: float = 0.8
) -> list[list[Frame]]:
    """Enable all motors, raise the tension of all tendons in a ramp to ``tension`` [N], and keep this tension.

    The commanded torques are proportional to ``tension``, without feedback. Return the replies of
    each tick.
    """
    answers = [rig.step(0, [frame_tuple(motor, ENABLE_PAYLOAD) for motor in MOTOR_NODES])]
    for k in range(1, round(duration_s * 500)):
        answers.append(step_with_torque(rig, k, 0.005 * tension * min(1.0, k / 500 / ramp_s)))
    return answers


def test_answers_of_a_tick_and_their_times() -> None:
    rig = LockstepHand("jamia")
    answers = step_with_torque(rig, 0, 0.0)
    assert [answer.can_id for answer in answers] == [0x1A0, 0x11, 0x12, 0x13, 0x14]
    times = [answer.t_ns for answer in answers]
    assert times == sorted(times)
    assert times[0] > 0
    assert times[-1] < TICK_NS
    assert rig.step(TICK_NS, [frame_tuple(0x123, b"hello")]) == []
    assert rig.world.foreign_frame_count == 1


def test_a_measurement_is_taken_before_the_command_of_its_tick_acts() -> None:
    rigs = [LockstepHand("jamia", seed=3), LockstepHand("jamia", seed=3)]
    for rig in rigs:
        rig.step(0, [frame_tuple(motor, ENABLE_PAYLOAD) for motor in MOTOR_NODES])
    first_steps = [
        step_with_torque(rig, 1, torque) for rig, torque in zip(rigs, (0.0, 0.5), strict=True)
    ]
    assert first_steps[0] == first_steps[1]
    second_steps = [
        step_with_torque(rig, 2, torque) for rig, torque in zip(rigs, (0.0, 0.5), strict=True)
    ]
    assert second_steps[0] != second_steps[1]


def test_equal_seeds_give_equal_bytes_and_others_do_not(tmp_path: Path) -> None:
    run_results = []
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        rig = LockstepHand("jamia", scene="cylinder", seed=seed, truth_path=str(tmp_path / name))
        answers = close_hand(rig, 30.0, 1.0)
        rig.close()
        run_results.append((answers, (tmp_path / name).read_bytes()))
    assert run_results[0] == run_results[1]
    assert run_results[0][0] != run_results[2][0]
    assert run_results[0][1] != run_results[2][1]


def test_the_watchdog_removes_the_torque_after_its_timeout() -> None:
    rig = LockstepHand("jamia")
    write_requests = [
        frame_tuple(0x7FF, struct.pack("<HBBI", motor, 0x55, 9, 1000)) for motor in MOTOR_NODES
    ]
    rig.step(0, [*write_requests, *[frame_tuple(motor, ENABLE_PAYLOAD) for motor in MOTOR_NODES]])
    for k in range(1, 200):
        step_with_torque(rig, k, 0.1)
    tension = rig.world.plant.tensions()[0]
    assert tension == pytest.approx(20.0, abs=3.5)
    torque = []
    for k in range(200, 240):
        rig.step(k * TICK_NS, [sync_frame(k)])
        torque.append(rig.world.plant.motors["index_motor"].torque)
    # The last command was sent in tick 199, so the watchdog time of 50 ms ends in tick 224.
    assert all(value == pytest.approx(torque[0], rel=1e-6) for value in torque[:24])
    assert abs(torque[26]) < 1e-3
    answers = step_with_torque(rig, 240, 0.1)
    assert [answer.data[0] >> 4 for answer in answers[1:]] == [0xD] * 4


def test_disable_lets_the_finger_open() -> None:
    rig = LockstepHand("jamia")
    close_hand(rig, 15.0, 1.0)
    assert rig.world.plant.engine.q[0] > 0.3
    for k in range(500, 1000):
        rig.step(k * TICK_NS, [frame_tuple(motor, DISABLE_PAYLOAD) for motor in MOTOR_NODES])
    assert max(rig.world.plant.tensions()) < 10.0
    assert rig.world.plant.engine.q[0] < 0.3


@pytest.mark.parametrize("tension", [30.0, 40.0])
def test_friction_alone_carries_the_cylinder_after_the_table_has_sunk(
    tension: float, tmp_path: Path
) -> None:
    path = tmp_path / "grasp.truth"
    rig = LockstepHand("jamia", scene="cylinder", truth_path=str(path))
    close_hand(rig, tension, 8.0)
    rig.close()
    table = rig.world.plant.table
    assert table is not None
    assert table.dropped_at is not None
    assert table.depth == pytest.approx(0.2)
    truth = read_truth(path)
    is_after_drop = truth.t_ns > (table.dropped_at + 1.0) * 1e9
    position_mm = (
        np.stack([truth.column(f"object/{axis}") for axis in "xyz"], axis=1)[is_after_drop] * 1e3
    )
    fall_mm = position_mm[0, 2] - position_mm[-1, 2]
    drift = float(np.linalg.norm(position_mm[-1, :2] - position_mm[0, :2]))
    print(
        f"{tension:.0f} N: falls {fall_mm:.3f} mm, creeps {drift:.3f} mm sideways in {is_after_drop.sum() / 1000:.1f} s"
    )
    assert abs(fall_mm) < 0.2
    assert drift < 1.5
    forces = [
        truth.column(f"contact_force/{digit}/y")[-1]
        for digit in ("index", "middle", "ring", "thumb")
    ]
    assert min(forces[:3]) > 0.3, "the object pushes fingers towards +y"
    assert forces[3] < -1.0, "the object pushes the thumb towards -y"


def test_an_object_too_heavy_for_friction_falls(tmp_path: Path) -> None:
    scene = tmp_path / "heavy.toml"
    scene.write_text(
        'name = "heavy"\n[object]\nshape = "cylinder"\ndiameter_m = 0.035\nlength_m = 0.093\nmass_kg = 3.0\n'
        'friction = 0.5\nposition_m = [0.0195, 0.0, 0.0]\n[support]\ndrop_when = "grasped"\n'
    )
    rig = LockstepHand("jamia", scene=str(scene))
    close_hand(rig, 30.0, 5.0)
    assert rig.world.plant.engine.object_pose()[2] < -0.05


def test_content_of_the_truth_file(tmp_path: Path) -> None:
    path = tmp_path / "t.truth"
    rig = LockstepHand("jamia", scene="cylinder:35", seed=5, truth_path=str(path))
    close_hand(rig, 20.0, 0.5, ramp_s=0.2)
    rig.close()
    truth = read_truth(path)
    names = truth.header["columns"]
    for name in ("tension/index_tendon", "q/thumb_j2", "dq/ring_j3", "motor/thumb_motor", "torque/thumb_motor",
                     "contact_force/middle/z",
                 "object/x", "object/qw", "slip", "support"):  # fmt: skip
        assert name in names
    assert len(names) == len(truth.header["units"]) == 4 + 11 + 11 + 4 + 4 + 12 + 7 + 1 + 1
    assert (truth.header["clock"], truth.header["seed"], truth.header["period_ns"]) == (
        "virtual",
        5,
        1_000_000,
    )
    assert truth.header["scene"] == "cylinder:35"
    assert truth.header["shapes"]["object"] == {
        "shape": "cylinder",
        "size_m": [0.035, 0.035, 0.093],
    }
    assert truth.header["shapes"]["table"]["shape"] == "box"
    assert np.array_equal(np.diff(truth.t_ns), np.full(len(truth.t_ns) - 1, 1_000_000))
    assert len(truth.t_ns) == 500
    assert np.isfinite(truth.values).all()
    # In a row of the truth file, joint speed dq and joint angle q belong to the same time. For this
    # reason, the slope of q must equal dq.
    q, dq = truth.column("q/index_j1"), truth.column("dq/index_j1")
    assert q[-1] - q[0] == pytest.approx(float(np.sum(dq[1:] + dq[:-1]) / 2 * 1e-3), abs=5e-3)
    # The true tension is close to the tension that corresponds to the commanded torque.
    assert truth.column("tension/index_tendon")[-1] == pytest.approx(20.0, abs=4.0)


def test_the_load_cell_reads_the_present_true_tension(tmp_path: Path) -> None:
    path = tmp_path / "t.truth"
    rig = LockstepHand("jamia", truth_path=str(path), perturb={"noise": 0.0})
    answers = close_hand(rig, 15.0, 1.0)
    rig.close()
    tension = read_truth(path).column("tension/index_tendon")
    read = [
        (int.from_bytes(tick[0].data, "little") >> 4 & 0xFFF) * 0.0625 - 6.0 for tick in answers[1:]
    ]
    error = np.array(read) - tension[2::2][: len(read)]
    # The permitted error is half a count of the load cell, plus the largest drift of the load
    # cell's zero in one second.
    assert np.abs(error).max() < 0.03125 + 0.6
    assert np.std(np.diff(error)) < 0.05


def test_perturbations_change_the_plant_not_the_wire() -> None:
    soft, stiff_hand = (
        LockstepHand("jamia", perturb={"stiffness": factor}) for factor in (0.7, 1.3)
    )
    angles = []
    for rig in (soft, stiff_hand):
        close_hand(rig, 100.0, 1.5)
        plant = rig.world.plant
        stretch = 0.005 * plant.motors["index_motor"].theta - 0.003 * sum(plant.engine.q[:3])
        angles.append(plant.tensions()[0] / stretch)
    assert angles == pytest.approx([0.7e5, 1.3e5], rel=5e-3)


@pytest.mark.parametrize(
    ("wrong_arguments", "expected_message"),
    [
        ({"hand_path": "nohand"}, "no such hand"),
        ({"hand_path": "jamia", "scene": "cone"}, "no such scene"),
        ({"hand_path": "jamia", "scene": "cylinder:wide"}, "diameter"),
        ({"hand_path": "jamia", "perturb": {"colour": 1.0}}, "perturb"),
        ({"hand_path": "jamia", "perturb": {"mass": 0.0}}, "a factor above 0"),
        ({"hand_path": "jamia", "perturb": {"friction": math.nan}}, "finite"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(
    wrong_arguments: dict[str, object], expected_message: str
) -> None:
    with pytest.raises(SimulatorError, match=expected_message) as caught:
        LockstepHand(**wrong_arguments)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
