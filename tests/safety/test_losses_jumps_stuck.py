"""Test the detection of lost frames, position jumps and stuck readings.

Each detector is tested just below and just above its limit.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from handctl.controller.controller_state import ControllerDecisions, ControllerState
from handctl.controller.tick import Controller
from handctl.core.detectors import frame_losses, stuck_sensors
from handctl.core.detectors.residuals import TENSION
from handctl.core.tick_types import TickEvent
from handctl.safety.faults.bus import LOSS_WINDOW_TICKS, MALFORMED_WINDOW_TICKS
from tests.safety.synthetic_monitor import (
    NOW_NS,
    PERIOD_NS,
    SPOOL_RADIUS_M,
    StateValues,
    SyntheticMonitor,
    call_interpreted,
    synthetic_limits,
)

NAN = np.nan


def loss_bits(bits_text: str) -> int:
    """Convert a string of the characters 0 and 1 to a number. Each character becomes one bit.

    The last character of ``bits_text`` stands for the newest tick.
    """
    return int(bits_text, 2)


def loss_window_words(loss_window: int) -> tuple[int, int]:
    """Return the two words that store a window of lost frames.

    One word has the newer half of the window, and the other word has the older half.
    """
    return loss_window & frame_losses.WORD_MASK, loss_window >> frame_losses.BITS_PER_WORD


class LostFrameWindows(SyntheticMonitor):
    """Safety monitor of a motor and a load cell, with a window of lost frames for each of them.

    A window of lost frames is an integer in which each bit stands for one tick. A bit is 1 if the
    frame of its tick was lost.
    """

    def __init__(
        self, motor_loss_window: int = 0, cell_loss_window: int = 0, **constants: Any
    ) -> None:
        super().__init__(synthetic_limits(1), **constants)
        pairs = (loss_window_words(motor_loss_window), loss_window_words(cell_loss_window))
        self.set_state_values(
            {
                "lost": {
                    (half, node): pair[half] for node, pair in enumerate(pairs) for half in (0, 1)
                }
            }
        )

    def run_tick_without_replies(
        self, is_motor_missing: bool = False, are_cells_missing: bool = False, **value_by_field: Any
    ) -> tuple[int, int]:
        """Run one tick in which the given nodes have not replied.

        Return the windows of lost frames of the motor and of the load cell.
        """
        self.tick(
            {
                "feedback_ns": NOW_NS - is_motor_missing * PERIOD_NS,
                "group_ns": NOW_NS - are_cells_missing * PERIOD_NS,
            },
            **value_by_field,
        )
        return self.loss_windows

    @property
    def loss_windows(self) -> tuple[int, int]:
        """Return the lost frames of the motor and of the load cells, with one bit for each tick."""
        lost_words = self.view("lost")
        return tuple(
            int(lost_words[1, node]) << frame_losses.BITS_PER_WORD | int(lost_words[0, node])
            for node in (0, 1)
        )  # type: ignore


HALF_WINDOW = LOSS_WINDOW_TICKS // 2


@pytest.mark.parametrize(("windows_before", "missing_replies", "windows_after"), [
    ((0, 0), (False, False), (0, 0)),
    ((0, 0), (True, False), (0b1, 0b0)),
    ((0, 0), (True, True), (0b1, 0b1)),
    ((0b1, 0b0), (False, True), (0b10, 0b1)),
    ((0b101, 0b1), (True, True), (0b1011, 0b11)),
    # In the tick of this test case, the bit of the oldest tick is dropped from the window.
    ((1 << (LOSS_WINDOW_TICKS - 1), 0), (False, False), (0, 0)),
    ((1 << (LOSS_WINDOW_TICKS - 1), 0), (True, False), (1, 0)),
    ((1 << (LOSS_WINDOW_TICKS - 2), 0), (False, False), (1 << (LOSS_WINDOW_TICKS - 1), 0)),
    ((1 << (HALF_WINDOW - 1), 1 << HALF_WINDOW), (False, True), (1 << HALF_WINDOW, 1 << HALF_WINDOW + 1 | 1)),
])  # fmt: skip
def test_window_shifts_by_one_bit_per_tick(windows_before, missing_replies, windows_after):
    assert (
        LostFrameWindows(*windows_before).run_tick_without_replies(*missing_replies)
        == windows_after
    )


def test_lost_replies_are_counted_per_window():
    monitor = LostFrameWindows(0b1011, (1 << LOSS_WINDOW_TICKS) - 1)
    assert [
        call_interpreted(frame_losses.count_lost_replies, monitor.state_tables, node)
        for node in (0, 1)
    ] == [
        3,
        LOSS_WINDOW_TICKS,
    ]
    for number, set_bit_count in (
        (0b1011, 3),
        (0, 0),
        (1 << (MALFORMED_WINDOW_TICKS - 1), 1),
        ((1 << 62) - 1, 62),
    ):
        assert call_interpreted(frame_losses.count_set_bits, number) == set_bit_count
    monitor.set_state_values({"misshapen": 1 << (MALFORMED_WINDOW_TICKS - 1) | 0b1})
    monitor.tick({"misread_now": 1})
    assert monitor.field_values("misshapen") == [0b11, 0b11], (
        "so many of the last ticks, and no longer"
    )


@pytest.mark.parametrize(("reply_pattern", "misses_every_second_reply"), [
    ("01" * 10, True), ("10" * 10, True), ("01" * 9 + "11", False), ("01" * 9 + "00", True), ("0" * 20, False),
    ("1" * 20, False), ("1" + "01" * 10, True), ("0011" * 5, False), ("01" * 7 + "000000", True),
    ("01" * 6 + "00000000", False), ("1" + "01" * 6 + "0000000", True), ("11" + "01" * 8 + "00", True),
    ("11" + "01" * 7 + "1100", False), ("1110" + "01" * 8, False),
    ("11" + "01" * 8 + "0000", True), ("01010010101010010101", True),
])  # fmt: skip
def test_missing_every_second_tick_is_detected(reply_pattern, misses_every_second_reply):
    assert (
        call_interpreted(
            frame_losses.misses_every_second_reply,
            LostFrameWindows(loss_bits(reply_pattern)).state_tables,
            0,
        )
        is misses_every_second_reply
    )


def test_the_count_of_unknown_frames_decays_in_a_second():
    def unknown_frame_count(
        unknown_count: float, new_unknown_frames: int = 0, control_rate_hz: float = 100.0
    ) -> float:
        monitor = LostFrameWindows(period=1.0 / control_rate_hz)
        monitor.run_tick_without_replies(strange=new_unknown_frames, unknown=unknown_count)
        return float(monitor.view("unknown").item())

    assert unknown_frame_count(0.0, 3) == 3.0
    assert unknown_frame_count(3.0, 2) == pytest.approx(3.0 * 0.99 + 2.0)
    assert unknown_frame_count(1.02e-3) > 0.0
    assert unknown_frame_count(1.01e-3) == 0.0
    assert unknown_frame_count(2e-3, control_rate_hz=2.0) == 0.0, "a thousandth is forgotten"


def refusal_counter(control_rate_hz: float) -> Any:
    """Return a function that counts refused targets.

    The arguments of the returned function are the number of targets that were refused in a tick,
    and the index of the tick. The returned function returns the ticks of all refusals in the last
    second.
    """
    monitor = LostFrameWindows()
    state = ControllerState(monitor.layout, monitor.block, ControllerDecisions((), None))  # type: ignore[arg-type]
    controller: Any = SimpleNamespace(model=SimpleNamespace(period=1.0 / control_rate_hz))

    def count_refusals(refused_count: int, tick_index: int) -> tuple[int, ...]:
        monitor.set_state_values({"k": tick_index})
        Controller._count_refusals(
            controller, state, (TickEvent("warn", "request", "", ""),) * refused_count
        )
        recent_refusals = state.decisions.refusals
        assert int(monitor.view("refused").item()) == len(recent_refusals)
        return recent_refusals

    return count_refusals


def test_refused_goals_are_those_of_the_last_second():
    count_refusals = refusal_counter(100.0)
    assert count_refusals(2, 10) == (10, 10)
    assert count_refusals(1, 109) == (10, 10, 109)
    assert count_refusals(0, 110) == (109,)
    assert count_refusals(0, 209) == ()


def test_lost_and_malformed_replies_are_counted_separately():
    monitor = LostFrameWindows()
    monitor.set_state_values({"misread_now": {1: 1}})
    assert monitor.run_tick_without_replies(is_motor_missing=True) == (1, 0)
    assert monitor.field_values("misshapen") == [0, 1]
    assert monitor.run_tick_without_replies(misread_now=0) == (2, 0)
    assert monitor.field_values("misshapen") == [0, 2]


class PositionJumpMonitor(SyntheticMonitor):
    """Motors, and a safety monitor that checks the reported motor positions for jumps.

    Each motor has its own largest permitted change of the position in a control period [rad].
    """

    def __init__(self, step_limits: list[float], **value_by_field: list[float]) -> None:
        super().__init__(synthetic_limits(len(step_limits)), step_limit=step_limits)
        self.set_state_values(value_by_field)

    def position_jumps(self, reported_positions: list[float], missed_ticks: int = 0) -> list[float]:
        """Check one position per motor, and return how far each motor has jumped.

        A missing position is NaN.
        """
        positions = np.array(reported_positions)
        self.observe_readings(
            {"answered": ~np.isnan(positions), "position": positions, "missed": missed_ticks}
        )
        return self.field_values("jump")


def test_the_first_position_is_accepted_wherever_it_is():
    positions = PositionJumpMonitor([0.1] * 3)
    assert positions.position_jumps([5.0, -1e9, NAN]) == [0.0] * 3
    accepted = positions.field_values("accepted")
    assert accepted[:2] == [5.0, -1e9]
    assert np.isnan(accepted[2])
    assert positions.field_values("accepted_gap") == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(("reported_position", "missed_readings", "expected_jump"), [
    (1.1, 0, 0.0), (1.125, 0, 0.0), (1.13, 0, 0.13), (0.8, 0, 0.2),
    (1.25, 1, 0.0), (1.26, 1, 0.26),       # after one missed reading, the permitted change is twice as large
    (1.5, 3, 0.0), (1.51, 3, 0.51),
])  # fmt: skip
def test_an_impossible_step_is_rejected_and_the_allowed_step_grows(
    reported_position, missed_readings, expected_jump
):
    positions = PositionJumpMonitor([0.125], accepted=[1.0], accepted_gap=[float(missed_readings)])
    assert positions.position_jumps([reported_position])[0] == pytest.approx(expected_jump)
    assert positions.field_values("accepted") == [1.0 if expected_jump else reported_position]
    assert positions.field_values("accepted_gap") == [missed_readings + 1 if expected_jump else 0]
    assert np.isnan(positions.view("measured_position")[0]) == bool(expected_jump), (
        "nothing else sees it"
    )


def test_a_missing_position_is_no_jump():
    positions = PositionJumpMonitor([0.1], accepted=[1.0], accepted_gap=[2.0])
    assert positions.position_jumps([NAN]) == [0.0]
    assert (positions.field_values("accepted"), positions.field_values("accepted_gap")) == (
        [1.0],
        [3.0],
    )


def test_tick_without_measurements_changes_nothing():
    positions = PositionJumpMonitor(
        [0.1] * 2, accepted=[1.0, 2.0], accepted_gap=[0.0, 3.0], dropped=[0.0, 2.0]
    )
    positions.position_jumps([NAN, NAN])
    assert (positions.field_values("accepted"), positions.field_values("accepted_gap")) == (
        [1.0, 2.0],
        [1.0, 4.0],
    )
    assert positions.field_values("dropped") == [0.0, 2.0]


def test_consecutive_rejected_readings_are_counted_and_missing_ones_are_not():
    positions, dropped = PositionJumpMonitor([0.125] * 2, accepted=[0.0, 0.0]), []
    for position_pair in [
        (1.0, 0.0),
        (NAN, 0.0),
        (1.0, NAN),
        (NAN, 0.0),
        (0.1, NAN),
        (1.5, 2.0),
        (0.1, 0.0),
    ]:
        positions.position_jumps(list(position_pair))
        dropped.append(positions.field_values("dropped"))
    assert [int(a) for a, _ in dropped] == [1, 1, 2, 2, 0, 1, 0]
    assert [int(b) for _, b in dropped] == [0, 0, 0, 0, 0, 1, 0]


@pytest.mark.parametrize(("missed_ticks", "position_steps", "allowed_steps"), [
    # In the test cases, the change between two positions is given in units of the largest change
    # that one control period allows. In the expected results, the number 1 marks a jump. The first
    # reading after missed ticks is the reply to a request from before or from after the missed
    # ticks. If the first reading is the reply to a request from before the missed ticks, the missed
    # ticks lie between the first and the second reading.
    (0, (1.0, 1.0), (0, 0)), (0, (1.1, 0.9), (1, 0)), (0, (1.0, 1.1), (0, 1)),
    (1, (2.0, 1.0), (0, 0)), (1, (1.0, 2.0), (0, 0)), (1, (2.1, 0.0), (1, 0)), (1, (1.0, 2.1), (0, 1)),
    (1, (1.0, 2.0, 1.1), (0, 0, 1)), (4, (5.0, 5.0), (0, 0)), (4, (5.1, 0.0), (1, 0)), (4, (5.0, 5.1), (0, 1)),
])  # fmt: skip
def test_allowed_step_grows_over_skipped_ticks(missed_ticks, position_steps, allowed_steps):
    """The check of the first motor does not depend on the position of the second motor.

    The test runs once with a known position of the second motor, and once with a position that has
    never been read.
    """
    for other_position in (0.0, NAN):
        positions, at, jump_flags = (
            PositionJumpMonitor([1.0] * 2, accepted=[0.0, other_position]),
            0.0,
            [],
        )
        for k, step in enumerate(position_steps):
            at += step
            jump_flags.append(
                int(
                    positions.position_jumps([at, other_position], 0 if k else missed_ticks)[0]
                    > 0.0
                )
            )
        assert tuple(jump_flags) == allowed_steps, other_position


def test_a_missing_reading_after_skipped_ticks_increases_the_allowed_step():
    positions = PositionJumpMonitor([0.1], accepted=[1.0], accepted_gap=[1.0])
    positions.position_jumps([NAN], 3)
    assert positions.field_values("accepted_gap") == [5.0]


def add_reading(
    monitor: SyntheticMonitor, motor_position: float, goal_travel: float, tension: float
) -> tuple[int, float, float]:
    """Run a tick with an encoder reading, a target and a tension.

    Return the number of ticks since the last change of the encoder reading. Also return how much
    the target and the tension have changed since the last change of the encoder reading.
    """
    rows: StateValues = {
        "measured_position": motor_position,
        "followed": goal_travel,
        "residual": {TENSION: tension},
    }
    monitor.tick(rows)
    anchor_values = monitor.view("motor_anchor")[:, 0].tolist()
    changes = [
        call_interpreted(stuck_sensors.change_since_reading, *pair)
        for pair in zip((goal_travel, tension), anchor_values, strict=True)
    ]
    return int(monitor.view("motor_stuck")[0]), *changes


def add_readings(motor_positions, goals_and_tensions):
    """Return the monitor and, for each tick, the results of ``add_reading``.

    The target and the tension are the signals that should change together with an encoder reading.
    """
    monitor = SyntheticMonitor(synthetic_limits(1), residual_fraction=0.0)
    return monitor, [
        add_reading(monitor, value, *pair)
        for value, pair in zip(motor_positions, goals_and_tensions, strict=True)
    ]


def test_constant_reading_counts_while_its_references_move():
    _, ticks_and_motions = add_readings(
        [1.0, 1.0, 1.0, 2.0, 2.0], [(0.0, 5.0), (0.5, 5.0), (-1.0, 7.0), (-1.0, 7.0), (-1.0, 8.0)]
    )
    assert ticks_and_motions == [
        (0, 0.0, 0.0),
        (1, 0.5, 0.0),
        (2, 1.0, 2.0),
        (0, 0.0, 0.0),
        (1, 0.0, 1.0),
    ]


def test_an_encoder_is_stuck_although_the_carrier_of_its_digit_moves():
    """The motion of a wrist changes the excursion of the tendons that pass the wrist.

    The motors of tendons that pass the wrist need not turn when the wrist moves.
    """
    monitor = SyntheticMonitor(synthetic_limits(1), residual_fraction=0.0)
    for k in range(5):
        monitor.tick({"measured_position": 1.0, "measured_travel": 1e-4 * k, "followed": 0.0})
    assert monitor.field_values("motor_stuck") == [4.0]


def test_a_missing_reading_is_neither_constant_nor_changed():
    monitor, ticks_and_motions = add_readings(
        [1.0, NAN, 1.0, NAN, 2.0], [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (3.0, 0.0)]
    )
    assert [ticks for ticks, *_ in ticks_and_motions] == [0, 0, 1, 1, 0]
    assert [first_motion for _, first_motion, _ in ticks_and_motions] == [0.0, 1.0, 2.0, 3.0, 0.0]
    assert monitor.field_values("motor_value") == [pytest.approx(2.0 * SPOOL_RADIUS_M)]


def test_missing_reference_is_used_once_it_is_read():
    _, ticks_and_motions = add_readings([1.0] * 4, [(NAN, 0.0), (5.0, NAN), (7.0, 3.0), (NAN, 1.0)])
    assert [first_motion for _, first_motion, _ in ticks_and_motions] == [0.0, 0.0, 2.0, 0.0]
    assert [second_motion for _, _, second_motion in ticks_and_motions] == [0.0, 0.0, 3.0, 1.0]


def test_goal_jump_moves_the_reference_of_the_stuck_test():
    """A motor that does not follow a jump of its target is not stuck if a reset has caused the jump.

    A reset sets the target to the measured position.
    """
    monitor = SyntheticMonitor(synthetic_limits(3), moment_arms=0.02 * np.eye(3))
    rows = {
        "followed": [0.0, 1e-3, 2e-3], "motor_anchor": [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], "motor_stuck": [7, 8, 9],
        "motor_value": 0.5, "excursion": [0.0, 11e-3, 2.3e-3], "q_goal": [0.0, 11e-3 / 0.02, 2.3e-3 / 0.02],
    }  # fmt: skip
    monitor.store_commands(rows)
    np.testing.assert_allclose(
        monitor.view("motor_anchor"), [[1.0, 2.010, 3.0], [4.0, 5.0, 6.0]], rtol=0, atol=1e-12
    )
    assert monitor.field_values("followed") == rows["excursion"]
    assert (monitor.field_values("motor_value"), monitor.field_values("motor_stuck")) == (
        [0.5] * 3,
        [7, 8, 9],
    )


def test_no_history_is_known_at_first():
    monitor = SyntheticMonitor(synthetic_limits(2))
    for name in (
        "motor_anchor",
        "cell_anchor",
        "joint_anchor",
        "motor_value",
        "cell_value",
        "joint_value",
    ):
        assert np.isnan(monitor.view(name)).all()
    for name in ("motor_stuck", "cell_stuck", "joint_stuck"):
        assert monitor.field_values(name) == [0, 0]
        assert monitor.view(name).dtype == np.int64
