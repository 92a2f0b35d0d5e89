"""Test the results of the commissioning program with scripted tensions, and its reaction to each fault of a tendon."""

import os
import re
from collections.abc import Callable

import numpy as np
import pytest

from handctl.campaign.run_stages import hand_with_protocol
from handctl.controller.run_setup import make_controller
from handctl.core.calibration import Calibration
from handctl.core.control_law.digit_goal import GoalKind
from handctl.core.gains.gains import Gains, packaged_gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.drives.frame import Frame
from handctl.errors import ConfigError
from handctl.hand.hand_loading import hand_from_content, load_hand
from handctl.programs.commission import (
    MAX_CROSSTALK_FRACTION,
    PULL_FORCE_LIMIT_N,
    PULL_TENSION_N,
    CommissionProgram,
    calibration_of_result,
)
from handctl.programs.program import ProgramProgress
from handctl.session.calibration import load_calibration
from handctl.session.lockstep_simulation import SimulatorSettings
from handctl.session.run_plan import default_control_rate
from tests.controller.controller_bench import ControllerBench, make_controller_bench
from tests.controller.synthetic_states import (
    empty_readings,
    estimate_under_tension,
    slack_hand_estimate,
)
from tests.hand.many_motor_hands import fifteen_motor_hand


@pytest.fixture(scope="module")
def jamia() -> HandModel:
    """Return the model of ``jamia`` at a low control rate.

    The low rate makes the tests fast. All times in the commissioning program are in seconds, and do
    not depend on the control rate.
    """
    return HandModel.from_hand(load_hand("jamia"), Gains(), 50.0)


@pytest.fixture(scope="module")
def jamia11() -> HandModel:
    return HandModel.from_hand(load_hand("jamia11"), Gains(), 50.0)


CELL_BIAS_N, TAUT_TRAVEL_M = 0.7, 1.2e-3
NOISE_SEEDS = range(20 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 4)

TensionsDuringPull = Callable[[int], np.ndarray]
"""Function that takes the index i of a tendon, and returns the tension at each load cell while this tendon is pulled.

For i = -1, the function returns the tensions while no tendon is pulled.
"""


def tensions_without_fault(model: HandModel) -> TensionsDuringPull:
    return lambda i: np.where(np.arange(model.tendon_count) == i, PULL_TENSION_N, 0.0)


def run_commissioning(
    model: HandModel,
    tensions_during_pull: TensionsDuringPull,
    noise: float = 0.2,
    lost_reading_fraction: float = 0.0,
    slack_tendon: int = -9,
    cell_drift_N: float = 0.0,
    seed: int = 7,
) -> ProgramProgress:
    """Run the commissioning program with scripted tensions.

    The tendon ``slack_tendon`` stays slack. In a fraction ``lost_reading_fraction`` of the ticks,
    no frames arrive.

    The zero of each load cell drifts as a random walk of ``cell_drift_N`` [N] rms in 100 s.
    """
    rng, program = np.random.default_rng(seed), CommissionProgram()
    progress, n = program.initial_progress(model), model.tendon_count
    walked, step = np.zeros(n), cell_drift_N * np.sqrt(model.period / 100.0)
    for k in range(round(60.0 / model.period)):
        walked += step * rng.normal(size=n) if cell_drift_N else 0.0
        i = progress.step - 1
        has_pulled = any(goal.kind != GoalKind.LIMP for goal in progress.goals)
        tension = (
            tensions_during_pull(i if has_pulled else -1)
            + CELL_BIAS_N
            + walked
            + noise * rng.normal(size=n)
        )
        travel = (
            np.full(n, TAUT_TRAVEL_M) + (tension - CELL_BIAS_N) / model.tendon_constants.stiffness
        )
        tared_tension = tension - (progress.tare or 0.0)
        measured = empty_readings(model)._replace(travel=travel, tension=tared_tension)
        if rng.random() < lost_reading_fraction:
            measured = empty_readings(model)
        estimate = slack_hand_estimate(model)
        if has_pulled and i != slack_tendon and k * model.period - progress.since > 0.2:
            estimate = estimate_under_tension(model, PULL_TENSION_N)
        progress, _ = program.advance(model, progress, estimate, measured, k * model.period)
        if has_pulled and not progress.finished and progress.phase.startswith("pull"):
            pulling_digits = [
                d for d, goal in enumerate(progress.goals) if goal.kind != GoalKind.LIMP
            ]
            assert pulling_digits == [
                next(d for d, s in enumerate(model.digit_tendons) if s.start <= i < s.stop)
            ]
            goal = progress.goals[pulling_digits[0]]
            assert goal.force_limit == PULL_FORCE_LIMIT_N
            assert goal.tension is not None
            assert goal.tension.sum() == goal.tension.max() == PULL_TENSION_N, (
                "one tendon at a time"
            )
        if progress.finished:
            return progress
    raise AssertionError("commissioning does not end")


@pytest.mark.parametrize("lost_reading_fraction", [0.0, 0.3])
def test_tares_and_zeros_are_found(model: HandModel, lost_reading_fraction: float) -> None:
    progress = run_commissioning(
        model, tensions_without_fault(model), lost_reading_fraction=lost_reading_fraction
    )
    assert not progress.failure
    measured_calibration = calibration_of_result(model, progress, "2024-01-01T00:00:00+00:00")
    np.testing.assert_allclose(
        measured_calibration.tare_tensions(model.hand), CELL_BIAS_N, atol=0.15
    )
    np.testing.assert_allclose(
        measured_calibration.motor_zeros(model.hand) * model.tendon_constants.spool_radius,
        TAUT_TRAVEL_M,
        atol=5e-6,
    )
    for row in measured_calibration.tendon.values():
        assert row.answer_N == pytest.approx(PULL_TENSION_N, abs=0.25)
        assert row.crosstalk_N < 0.3, "noise is no crosstalk"
    assert (measured_calibration.hand, measured_calibration.identity) == (
        model.hand.name,
        model.hand.identity,
    )


def test_a_tendon_that_stays_slack_is_named(model: HandModel) -> None:
    progress = run_commissioning(model, tensions_without_fault(model), slack_tendon=1)
    assert progress.failure.startswith(model.hand.tendon_names[1])
    assert "taut" in progress.failure
    assert {goal.kind for goal in progress.goals} == {GoalKind.LIMP}, "let go"


def test_a_load_cell_that_does_not_answer_is_named(model: HandModel) -> None:
    last_tendon = model.tendon_count - 1
    tensions_during_pull = tensions_without_fault(model)
    progress = run_commissioning(model, lambda i: tensions_during_pull(i) * (i != last_tendon))
    assert progress.failure.startswith(model.hand.tendon_names[last_tendon])
    assert "answers" in progress.failure


def test_two_load_cells_that_answer_together_are_refused(model: HandModel) -> None:
    """Tension in the second tendon also changes the reading of the first load cell.

    Crosstalk of two load cells has two possible causes: their tendons touch each other, or one load
    cell is connected to two channels.
    """

    def tensions_during_pull(i: int) -> np.ndarray:
        tension = tensions_without_fault(model)(i)
        if i == 1:
            tension[0] = 0.5 * PULL_TENSION_N
        return tension

    progress = run_commissioning(model, tensions_during_pull)
    assert progress.failure.startswith(model.hand.tendon_names[1])
    assert "another load cell" in progress.failure


@pytest.fixture(scope="module")
def fifteen_motor_model() -> HandModel:
    return HandModel.from_hand(
        hand_from_content(fifteen_motor_hand(), "a hand of 15 motors"), Gains(), 50.0
    )


@pytest.mark.parametrize("seed", NOISE_SEEDS)
def test_many_load_cells_may_drift_while_one_tendon_after_the_other_is_pulled(
    fifteen_motor_model: HandModel, seed: int
) -> None:
    """In this test, the load cells drift twice as fast as those of packaged hands.

    At the end of the commissioning, the zeros of the load cells have drifted by 0.9 N rms. The
    commissioning accepts at most 0.9 N of crosstalk between load cells.
    """
    progress = run_commissioning(
        fifteen_motor_model,
        tensions_without_fault(fifteen_motor_model),
        cell_drift_N=2.0,
        seed=seed,
    )
    assert not progress.failure
    calibrated_tendons = calibration_of_result(
        fifteen_motor_model, progress, "2024-01-01T00:00:00+00:00"
    ).tendon
    assert (
        max(row.crosstalk_N for row in calibrated_tendons.values())
        < MAX_CROSSTALK_FRACTION * PULL_TENSION_N
    )
    assert [row.answer_N for row in calibrated_tendons.values()] == pytest.approx(
        [PULL_TENSION_N] * 15, abs=1.0
    )


def test_each_tare_is_measured_just_before_its_pull(jamia: HandModel) -> None:
    """The tare of a tendon is the zero of its load cell just before the pull of this tendon.

    In this test, the zeros of all load cells drift by 0.1 N/s from the first tick.
    """
    cell_drift_N = [0.0]

    def tensions_during_pull(i: int) -> np.ndarray:
        cell_drift_N[0] += 0.1 * jamia.period
        return tensions_without_fault(jamia)(i) + cell_drift_N[0]

    progress = run_commissioning(jamia, tensions_during_pull, noise=0.0)
    assert not progress.failure
    tare = (
        calibration_of_result(jamia, progress, "2024-01-01T00:00:00+00:00").tare_tensions(
            jamia.hand
        )
        - CELL_BIAS_N
    )
    assert np.diff(tare) == pytest.approx(np.full(3, np.diff(tare).mean()), abs=0.01), (
        "each a pull later than the last"
    )
    assert 0.1 < np.diff(tare).mean() < 0.2, "a pull takes 1.7 s"


def test_crosstalk_is_found_while_load_cells_drift(fifteen_motor_model: HandModel) -> None:
    def tensions_during_pull(i: int) -> np.ndarray:
        tension = tensions_without_fault(fifteen_motor_model)(i)
        tension[2] += 0.6 * PULL_TENSION_N * (i == 9)
        return tension

    progress = run_commissioning(fifteen_motor_model, tensions_during_pull, cell_drift_N=1.0)
    assert progress.failure.startswith(fifteen_motor_model.hand.tendon_names[9])
    assert "another load cell" in progress.failure


def test_tension_that_friction_holds_after_a_pull_is_no_crosstalk(jamia: HandModel) -> None:
    """In this test, the tension of a tendon falls slowly, at 2 N/s, after the pull of this tendon.

    Just before another tendon is pulled, the load cell of the first tendon still reads 1.4 N. While
    the other tendon is pulled, the load cell of the first tendon reads 0 N.
    """
    tension_held_by_friction = np.zeros(jamia.tendon_count)

    def tensions_during_pull(i: int) -> np.ndarray:
        tension_held_by_friction[:] = np.maximum(
            tension_held_by_friction - 2.0 * jamia.period,
            PULL_TENSION_N * (np.arange(jamia.tendon_count) == i),
        )
        return tension_held_by_friction.copy()

    progress = run_commissioning(jamia, tensions_during_pull)
    assert not progress.failure
    calibrated_tendons = calibration_of_result(jamia, progress, "2024-01-01T00:00:00+00:00").tendon
    assert max(row.crosstalk_N for row in calibrated_tendons.values()) < 0.5


def test_a_load_cell_that_falls_below_its_tare_in_another_pull_is_refused(jamia: HandModel) -> None:
    """A load-cell reading must not fall below the tare while another tendon is pulled.

    While a tendon relaxes after its own pull, the reading of its load cell is allowed to fall by
    the remaining tension.
    """

    def tensions_during_pull(i: int) -> np.ndarray:
        return tensions_without_fault(jamia)(i) - 0.5 * PULL_TENSION_N * (i == 2) * (
            np.arange(jamia.tendon_count) == 0
        )

    progress = run_commissioning(jamia, tensions_during_pull)
    assert progress.failure.startswith(jamia.hand.tendon_names[2])
    assert "another load cell" in progress.failure


def test_an_inverted_load_cell_is_refused(model: HandModel) -> None:
    progress = run_commissioning(model, lambda i: -tensions_without_fault(model)(i))
    assert progress.failure.startswith(model.hand.tendon_names[0])


@pytest.fixture(scope="module")
def jamia_at_200_hz() -> HandModel:
    """Return the model of ``jamia`` at a control rate at which its tension loop does not oscillate."""
    return HandModel.from_hand(load_hand("jamia"), Gains(), 200.0)


@pytest.fixture
def commissioning_bench(jamia_at_200_hz: HandModel) -> ControllerBench:
    """Return a test bench whose controller runs the commissioning program on a hand with scripted motors."""
    return make_controller_bench(jamia_at_200_hz, CommissionProgram())


@pytest.mark.parametrize(
    "cell_bias_N",
    [-2.0, *(pytest.param(bias, marks=pytest.mark.nightly) for bias in (0.0, 2.0)), 4.5],
)
def test_load_cells_that_were_never_tared_are_no_hindrance(
    commissioning_bench: ControllerBench, cell_bias_N: float
) -> None:
    """After the load cells are tared, the tension loop uses load-cell readings minus their tares.

    With raw load-cell readings, the tension of a pulled tendon would be wrong by the bias of its
    load cell.
    """
    commissioning_bench.toy_hand.cell_bias[:] = np.array([1.0, -1.0, 0.5, 0.0]) + cell_bias_N
    commissioning_bench.run_until_mode(HandMode.DONE, 30.0)
    assert not commissioning_bench.state.failure
    model = commissioning_bench.controller.model
    measured_calibration = calibration_of_result(
        model, commissioning_bench.state.progress, "2024-01-01T00:00:00+00:00"
    )
    np.testing.assert_allclose(
        measured_calibration.tare_tensions(model.hand),
        commissioning_bench.toy_hand.cell_bias,
        atol=0.05,
    )
    np.testing.assert_allclose(
        measured_calibration.motor_zeros(model.hand) * model.tendon_constants.spool_radius,
        0.3e-3,
        atol=1e-5,
    )


def test_a_load_cell_beyond_taring_is_named(commissioning_bench: ControllerBench) -> None:
    commissioning_bench.toy_hand.cell_bias[2] = 25.0
    commissioning_bench.run_until_mode(HandMode.DONE, 30.0)
    expected = (
        "ring_tendon: load cell reads 25.0 N without tension, which can be tared from -4 to 6 N"
    )
    assert commissioning_bench.state.failure == expected


@pytest.mark.parametrize(
    ("tare_N", "is_refused"), [(-4.1, True), (-3.9, False), (5.9, False), (6.1, True)]
)
def test_a_tare_too_near_to_an_end_of_the_range_is_refused(
    model: HandModel, tare_N: float, is_refused: bool
) -> None:
    """The message about a refused tare names the load cell that is nearest to an end of its range.

    The message does not name another load cell whose reading is larger.
    """

    def tensions_during_pull(i: int) -> np.ndarray:
        tension = tensions_without_fault(model)(i) - CELL_BIAS_N
        tension[0] += tare_N
        tension[1] += 3.95
        return tension

    progress = (
        run_commissioning(model, tensions_during_pull, noise=0.0)
        if is_refused
        else progress_after_tare(model, tensions_during_pull)
    )
    assert progress.failure == (
        f"{model.hand.tendon_names[0]}: load cell reads {tare_N:.1f} N without tension,"
        " which can be tared from -4 to 6 N"
        if is_refused
        else ""
    )


def progress_after_tare(
    model: HandModel, tensions_during_pull: TensionsDuringPull
) -> ProgramProgress:
    """Run the commissioning program until it has tared the load cells, and return the state of the program."""
    program, progress, k = CommissionProgram(), CommissionProgram().initial_progress(model), 0
    while progress.step == 0 and not progress.finished:
        measured = empty_readings(model)._replace(tension=tensions_during_pull(-1) + CELL_BIAS_N)
        progress, _ = program.advance(
            model, progress, slack_hand_estimate(model), measured, k * model.period
        )
        k += 1
    return progress


def test_swapped_load_cells_are_found_and_both_named(commissioning_bench: ControllerBench) -> None:
    commissioning_bench.toy_hand.tendon_of_channel = [1, 0, 2, 3]
    commissioning_bench.run_until_mode(HandMode.DONE, 30.0)
    assert commissioning_bench.state.failure.startswith("index_tendon")
    assert "middle_tendon" in commissioning_bench.state.failure
    assert "swapped" in commissioning_bench.state.failure
    commanded_forces = (
        np.array(
            [out.telemetry.motor_torque_goal for _, _, out in commissioning_bench.tick_history]
        )
        / commissioning_bench.controller.model.tendon_constants.spool_radius
    )
    assert commanded_forces.max() <= PULL_FORCE_LIMIT_N * 1.001, (
        "a cell that does not answer does not unleash the motor"
    )


def test_a_motor_that_turns_the_other_way_is_found(commissioning_bench: ControllerBench) -> None:
    real = commissioning_bench.toy_hand.step

    def reversed_motor(t_ns: int, frames: list[Frame]) -> list[Frame]:
        turned = []
        for frame in frames:
            word = int.from_bytes(frame.data, "big")
            if frame.can_id == 1 and frame.data[:7] != b"\xff" * 7:
                word = word & ~0xFFF | 0xFFF - (word & 0xFFF)
            turned.append(frame._replace(data=word.to_bytes(len(frame.data), "big")))
        return real(t_ns, turned)

    commissioning_bench.toy_hand.step = reversed_motor  # type: ignore[method-assign]
    commissioning_bench.run_until_mode(HandMode.DONE, 30.0)
    assert commissioning_bench.state.failure == "fault N17 index_motor", (
        "safety is there before the rope would have to be taut"
    )


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    ("name", "protocol", "first", "second"),
    [
        ("t42", "odrive", "left", "right"),
        ("jamia", "odrive", "index", "thumb"),
        ("jamia", "mit", "middle", "ring"),
    ],
)
@pytest.mark.parametrize("fault", ["", "swap", "cross"])
def test_exchanged_drives_are_refused_and_both_tendons_named(
    name: str, protocol: str, first: str, second: str, fault: str, seed: int
) -> None:
    """Reproduce a defect: the commissioning succeeded, although the encoders of two drives were exchanged.

    In the simulator, an exchange of two encoders is the fault ``swap``. The resulting calibration
    assigned the zeros to the wrong motors.
    """
    hand = hand_with_protocol(name, protocol)
    rate = default_control_rate(hand)
    controller = make_controller(hand, packaged_gains(name), rate, CommissionProgram(), None, True)
    with SimulatorSettings(hand, None, seed).begin_run(controller) as run:
        if fault:
            run.simulated_hand.inject(f"{fault} node={first}_motor with={second}_motor")
        assert run.run_until(lambda out: out.mode == HandMode.DONE, 30.0)
        failure = run.state.failure
    assert bool(failure) == bool(fault)
    if fault:
        assert [
            tendon_name in failure
            for tendon_name in hand.tendon_names
            if tendon_name.startswith((first, second))
        ] == [
            True,
            True,
        ]
        assert ("exchanged?" if fault == "swap" else "swapped?") in failure


@pytest.fixture
def calibration(model: HandModel) -> Calibration:
    return calibration_of_result(
        model, run_commissioning(model, tensions_without_fault(model)), "2024-01-01T00:00:00+00:00"
    )


def test_the_file_is_read_back_as_it_was_written(
    model: HandModel, calibration: Calibration, tmp_path
) -> None:  # type: ignore[no-untyped-def]
    from handctl.session.calibration import write_calibration

    path = tmp_path / "c.toml"
    write_calibration(path, calibration)
    repeated_calibration = load_calibration(path, model.hand)
    np.testing.assert_allclose(
        repeated_calibration.tare_tensions(model.hand),
        calibration.tare_tensions(model.hand),
        rtol=1e-12,
    )
    np.testing.assert_allclose(
        repeated_calibration.motor_zeros(model.hand),
        calibration.motor_zeros(model.hand),
        rtol=1e-12,
    )
    assert repeated_calibration.made == calibration.made


def test_a_calibration_of_another_hand_or_with_a_tendon_missing_is_refused(
    jamia: HandModel, jamia11: HandModel, tmp_path
) -> None:  # type: ignore[no-untyped-def]
    from handctl.session.calibration import write_calibration

    path = tmp_path / "c.toml"
    measured_calibration = calibration_of_result(
        jamia, run_commissioning(jamia, tensions_without_fault(jamia)), "2024-01-01T00:00:00+00:00"
    )
    write_calibration(path, measured_calibration)
    with pytest.raises(ConfigError, match="handctl commission again"):
        load_calibration(path, jamia11.hand)
    write_calibration(
        path,
        measured_calibration.model_copy(
            update={
                "tendon": {k: v for k, v in measured_calibration.tendon.items() if "ring" not in k}
            }
        ),
    )
    with pytest.raises(ConfigError, match="ring_tendon"):
        load_calibration(path, jamia.hand)


@pytest.mark.parametrize(
    ("tare_text", "is_accepted"), [("-4.1", False), ("-4.0", True), ("6.0", True), ("6.1", False)]
)
def test_a_tare_that_hides_an_end_of_the_range_is_refused(
    jamia: HandModel, tmp_path, tare_text: str, is_accepted: bool
) -> None:  # type: ignore[no-untyped-def]
    from handctl.session.calibration import write_calibration

    path = tmp_path / "c.toml"
    write_calibration(
        path,
        calibration_of_result(
            jamia,
            run_commissioning(jamia, tensions_without_fault(jamia)),
            "2024-01-01T00:00:00+00:00",
        ),
    )
    path.write_text(re.sub(r"tare_N = .*", f"tare_N = {tare_text}", path.read_text(), count=1))
    if is_accepted:
        assert load_calibration(path, jamia.hand).tare_tensions(jamia.hand)[0] == float(tare_text)
        return
    with pytest.raises(ConfigError) as refused:
        load_calibration(path, jamia.hand)
    expected_message = (
        f"tendon.index_tendon.tare_N: {tare_text}; "
        "expected -4 to 6 N: adjust the load cell, then commission again"
    )
    assert str(refused.value) == f"{path}: {expected_message}"
