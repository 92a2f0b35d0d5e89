"""Test the identification of hands whose parameters differ from those in the hand file."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks.identify import PARAMETER_TOLERANCES, measure_digit, summarise_results
from handctl.cli.tuning.tune_files import load_tuned_hand
from handctl.core.calibration import Calibration, TendonCalibration
from handctl.core.identified_parameters import (
    PARAMETER_UNITS,
    IdentifiedParameters,
    identified_hand,
    torque_gain,
)
from handctl.errors import ConfigError
from handctl.hand.dynamics import DigitModel
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand
from handctl.log.read.reader import RunLog
from handctl.session.calibration import load_calibration, write_calibration
from handctl.tune.identify.excitation import excitation_steps, lift_off_tension
from handctl.tune.identify.fit_load import DigitLoad, LoadParameters, SignalBins
from handctl.tune.identify.fit_motor import (
    HALF_WINDOW_S,
    _window_curvature,
    _window_integral,
    _window_slope,
    _window_value,
)
from handctl.tune.identify.fit_tendon import PARAMETER_NAMES
from handctl.tune.identify.identifiability import _lacks_needed_encoders, _reason_not_identified
from handctl.tune.identify.identification_figure import _draw_parameters
from handctl.tune.identify.identify import identify_tendons, result_table
from tests.hand.link_contacts import LinkContacts

SPRING_DIGIT_PARAMETERS = PARAMETER_TOLERANCES.keys() - {"moment_arm", "pretension"}
"""Parameters that the identification estimates for digits with return springs."""
GOLDEN_LOGS = Path(__file__).parents[2] / "logs" / "golden"
SEED_COUNT = 100
MIN_COVERED_PERCENT = 90


WEAK_MOTOR, STIFF_MOTOR = (23, "thumb"), (39, "thumb")


@pytest.mark.parametrize(
    ("seed", "digit"),
    [
        WEAK_MOTOR,
        *(
            pytest.param(*hand, marks=pytest.mark.nightly)
            for hand in (STIFF_MOTOR, (60, "index"), (4, "index"))
        ),
    ],
)
def test_parameters_wrong_by_thirty_percent_are_identified_with_detuned_gains(
    tmp_path: Path, seed: int, digit: str
) -> None:
    """The identification can distinguish a motor with 29 % less torque from a wrong load cell.

    In this test, a motor with high friction still makes enough force to move its tendon.
    """
    row = measure_digit(seed, digit, tmp_path)
    assert "failure" not in row
    assert {parameter["name"] for parameter in row["parameters"]} == SPRING_DIGIT_PARAMETERS
    assert [parameter for parameter in row["parameters"] if not parameter["within"]] == []
    assert [
        parameter
        for parameter in row["parameters"]
        if abs(parameter["error"]) > 1.6 * parameter["half_width"]
    ] == []


def test_springs_behind_several_tendons_are_found_by_the_joint_encoders(tmp_path: Path) -> None:
    """In a digit with several tendons, the identification of the spring stiffness needs joint encoders.

    At 200 Hz, inertia and friction of a motor are identified less accurately than at higher control
    rates, and have wider confidence intervals.
    """
    row = measure_digit(3, "thumb", tmp_path, "jamia11")
    assert {parameter["name"] for parameter in row["parameters"]} == SPRING_DIGIT_PARAMETERS
    assert [
        parameter
        for parameter in row["parameters"]
        if abs(parameter["error"]) > 1.6 * parameter["half_width"]
    ] == []
    assert [
        parameter["within"]
        for parameter in row["parameters"]
        if parameter["name"] == "spring_stiffness"
    ] == [True]


def test_fingers_that_could_touch_each_other_are_identified_without_a_contact(
    tmp_path: Path,
) -> None:
    """Reproduce two defects of the identification of the hand t42.

    The sweeps bent a finger by 32 deg, but the finger touched the other finger at 16 deg. Therefore
    no parameter was kept. The stretch of a tendon moved its motor encoder by only three counts.
    Because of the rounding to counts, the identified stiffness of the tendon was 12 % too small on
    average.
    """
    rows = [measure_digit(seed, "left", tmp_path, "t42") for seed in range(1, 5)]
    assert [row.get("failure", row["refused"]) for row in rows] == [[]] * len(rows)
    stiffness_errors = [
        parameter["error"]
        for row in rows
        for parameter in row["parameters"]
        if parameter["name"] == "tendon_stiffness"
    ]
    assert abs(np.mean(stiffness_errors)) < 0.06


@pytest.mark.parametrize("hand_name", ["t42", "jamia", "n_plus_1", "orca_like"])
def test_a_sweep_ends_before_a_contact(hand_name: str) -> None:
    """In the posture at the end of a sweep, the links of the moved digit are away from the other digits."""
    hand = load_hand(hand_name)
    steps = [step for step in excitation_steps(hand, hand.digit_names) if step.name == "sweep"]
    contacts = LinkContacts(hand)
    for step in steps:
        digit = DigitModel.from_hand(hand, step.digit)
        coordinates = step.targets or (step.target,) * digit.coupling.shape[1]
        q = contacts.open_angles.copy()
        q[digit.joints] = digit.coupling @ np.array(coordinates)
        assert contacts.new_contacts(q) == set(), step


@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_intervals_cover_the_parameters_of_a_hundred_hands(tmp_path: Path) -> None:
    digits = load_hand("jamia").digit_names
    figures = summarise_results(
        [measure_digit(seed, digits[seed % 4], tmp_path) for seed in range(1, SEED_COUNT + 1)]
    )
    assert figures["failed"] == []
    parameters = {name: figures["parameters"][name] for name in SPRING_DIGIT_PARAMETERS}
    assert {
        name: coverage["covered"]
        for name, coverage in parameters.items()
        if coverage["covered"] < MIN_COVERED_PERCENT
    } == {}
    assert {
        name: coverage["within"]
        for name, coverage in parameters.items()
        if coverage["within"] < MIN_COVERED_PERCENT
    } == {}
    assert figures["all_covered_all_at_once"] >= MIN_COVERED_PERCENT


def test_the_window_is_smooth_and_its_derivatives_are_its_derivatives() -> None:
    s = np.linspace(-1.2, 1.2, 24001)
    h = s[1] - s[0]
    assert np.trapezoid(_window_value(s), s) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(np.gradient(_window_value(s), h), _window_slope(s), atol=1e-6)
    np.testing.assert_allclose(np.gradient(_window_slope(s), h), _window_curvature(s), atol=1e-2)
    np.testing.assert_allclose(np.gradient(_window_integral(s), h), _window_value(s), atol=1e-6)
    assert HALF_WINDOW_S > 0


def test_the_load_model_balances_every_joint() -> None:
    """With the tensions that the load model computes, the torques at every joint are in balance."""
    digit = DigitModel.from_hand(load_hand("jamia"), "index")
    load = DigitLoad.from_digit(digit)
    p = LoadParameters(1e5, 1.1, 0.9, 0.1, 1.0, 1.0, 2e-4)
    signal_bins = SignalBins(
        np.zeros(2), np.array([4e-3, 4e-3]), np.zeros(2), np.array([0.01, -0.01]), np.zeros(2), 5
    )
    for tension, sign in zip(
        load.expected_tension(p, signal_bins).tolist(), (1.0, -1.0), strict=True
    ):
        angle, excursion = float(digit.wrap[0]), 0.0
        for arm, k, pre, b in zip(load.arms, load.spring, load.preload, load.damping, strict=True):
            rate = sign * 0.01 / load.arms.sum()
            grid = np.linspace(0.0, 1.5, 150001)
            torque_imbalance = (
                arm * tension * np.exp(-0.1 * sign * (angle + grid))
                - 1.1 * k * (grid + 0.9 * pre)
                - b * rate
            )
            q = float(grid[np.abs(torque_imbalance).argmin()])
            angle, excursion = angle + q, excursion + arm * q
        assert excursion + tension / 1e5 + 2e-4 == pytest.approx(4e-3, abs=2e-6)


def test_the_excitation_keeps_within_the_hand_s_limits() -> None:
    hand = load_hand("jamia")
    steps = excitation_steps(hand, hand.digit_names)
    for digit in hand.digit_names:
        digit_steps = [step for step in steps if step.digit == digit]
        assert sum(step.duration_s for step in digit_steps) < 21.0
        assert (
            max(step.target for step in digit_steps if step.kind in ("tension", "taut"))
            <= 0.5 * 110.0
        )
        stretch = [step.target for step in digit_steps if step.name == "stretch"]
        assert max(stretch) < 0.7 * lift_off_tension(hand, digit)
    with pytest.raises(ConfigError, match="pinky"):
        excitation_steps(hand, ("pinky",))


def identified_parameters(**parameter_values: float) -> IdentifiedParameters:
    n = len(parameter_values)
    rows = tuple(tuple(1e-6 if i == j else 0.0 for j in range(n)) for i in range(n))
    return IdentifiedParameters(
        names=tuple(parameter_values),
        values=tuple(parameter_values.values()),
        half_widths=(0.1,) * n,
        covariance=rows,
        log=("a.mcap",),
    )


def test_the_controller_s_hand_is_the_identified_one() -> None:
    hand = load_hand("jamia")
    identified = {
        "thumb_tendon": identified_parameters(
            tendon_stiffness=8e4, motor_inertia=1e-4, spring_stiffness=1.2, torque_gain=0.9
        )
    }
    controller_hand = identified_hand(hand, identified)
    assert controller_hand.tendon[3].stiffness_N_per_m == 8e4
    assert controller_hand.motor_of_tendon("thumb_tendon").inertia_kg_m2 == 1e-4
    assert controller_hand.digit_named("thumb").spring_stiffness_N_m_per_rad == pytest.approx(
        (0.036, 0.036)
    )
    assert controller_hand.tendon[:3] == hand.tendon[:3]
    assert torque_gain(hand, identified).tolist() == [1.0, 1.0, 1.0, 0.9]
    assert set(identified["thumb_tendon"].names) <= PARAMETER_UNITS.keys()


def test_a_name_of_an_earlier_version_is_still_read() -> None:
    parameters = identified_parameters(tendon_stiffness=8e4, delay=1e-4)
    renamed_content = parameters.model_dump() | {"names": ("rope_stiffness", "delay")}
    assert IdentifiedParameters.model_validate(renamed_content) == parameters


def test_a_calibration_keeps_what_was_identified(tmp_path: Path) -> None:
    hand = load_hand("jamia")
    tendon_calibration = TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=3.0, crosstalk_N=0.0)
    rows = dict.fromkeys(hand.tendon_names, tendon_calibration)
    identified = {"ring_tendon": identified_parameters(capstan=0.09, delay=1e-4)}
    calibration = Calibration(
        hand="jamia",
        identity=hand.identity,
        made="2026-01-01T00:00:00+00:00",
        tendon=rows,
        identified=identified,
    )
    path = tmp_path / "c.toml"
    write_calibration(path, calibration)
    assert load_calibration(path, hand) == calibration
    path.write_text(path.read_text().replace("identified.ring_tendon", "identified.pinky_tendon"))
    with pytest.raises(ConfigError, match="no such tendon"):
        load_calibration(path, hand)


def test_tuning_uses_the_identified_hand(tmp_path: Path) -> None:
    """The hand model uses the identified parameters, and the hands of the ensemble vary around the hand model.

    The tuned gains refer to the hand file by its identity (a hash of its content). A hand with
    identified parameters has another identity than the hand file.
    """
    hand, path = load_hand("jamia"), tmp_path / "c.toml"
    rows = dict.fromkeys(
        hand.tendon_names,
        TendonCalibration(tare_N=0.0, zero_rad=0.0, answer_N=3.0, crosstalk_N=0.0),
    )
    calibration = Calibration(
        hand="jamia", identity=hand.identity, made="2026-01-01T00:00:00+00:00", tendon=rows
    )
    write_calibration(
        path,
        calibration.model_copy(
            update={"identified": {"ring_tendon": identified_parameters(capstan=0.04)}}
        ),
    )
    tuned_hand = load_tuned_hand("jamia", path)
    assert tuned_hand.hand.identity == hand.identity != tuned_hand.identified_hand.identity
    assert [rope.friction_coefficient for rope in tuned_hand.identified_hand.tendon] == [
        0.08,
        0.08,
        0.04,
        0.08,
    ]
    assert tuned_hand.half_width_by_factor.keys() == {"friction"}
    assert load_tuned_hand("jamia", None).identified_hand.identity == hand.identity
    write_calibration(path, calibration)
    with pytest.raises(ConfigError, match="holds nothing identified"):
        load_tuned_hand("jamia", path)


def test_delay_is_judged_by_an_absolute_limit() -> None:
    """The width of a delay's confidence interval is compared with an absolute limit.

    For all other parameters, the largest allowed width is a fraction of the parameter value. A
    delay can be zero, and a fraction of zero would refuse every confidence interval.
    """
    rows = np.ones((3, len(PARAMETER_NAMES)))
    assert (
        _reason_not_identified(rows, "delay")
        == "the 95 % interval is wider than 0.5 ms to either side"
    )
    assert "50 % of the value" in _reason_not_identified(rows, "capstan")
    assert "no data depend" in _reason_not_identified(0.0 * rows, "delay")


@pytest.mark.parametrize("parameter_name", ["jamia", "jamia11"])
def test_each_parameter_has_one_row_with_its_value_or_the_reason(parameter_name: str) -> None:
    """Reproduce two defects.

    Earlier defect: a parameter without a value had two rows in the report. Earlier defect: in a row
    without a value, the unit "1" looked like a value.
    """
    hand = load_hand(parameter_name)
    with RunLog(GOLDEN_LOGS / f"{parameter_name}-grasp.mcap") as log:
        results = identify_tendons(log, hand)
    lines = result_table(results)
    assert lines[0].startswith("coherence: fraction of the motion")
    header = next(line for line in lines if "why not" in line)
    unit, reason = header.index("unit"), header.index("why not")
    for key in PARAMETER_UNITS:
        rows = [line for line in lines if line.split()[0] == key]
        assert len(rows) == (0 if key == "pretension" else len(results)), key
        for row in rows:
            assert (row.split()[1] == "-") == bool(row[reason:].strip()), row
            assert row[unit:].split()[0] != "1" or row.split()[1] == "-", row
    assert not any("combinations" in line or "stop_softness" in line for line in lines)
    assert any("combinations" in line for line in result_table(results, is_verbose=True))


@pytest.mark.parametrize("with_joint_encoders", [False, True])
def test_springs_of_a_digit_with_several_tendons_need_joint_encoders(
    with_joint_encoders: bool,
) -> None:
    """Reproduce a defect: the report gave the wrong reason why spring parameters were not identified.

    The wrong reason was "no data depend on this parameter". For a digit with several tendons and
    without joint encoders, the report must give the reason "needs joint encoders".
    """
    content = hand_content("jamia11")
    node = content["sensor_node"]
    content["sensor_node"] = node | {"joints": node["joints"] if with_joint_encoders else []}
    hand = hand_from_content(content, "test")
    assert _lacks_needed_encoders(hand, "index") != with_joint_encoders
    assert not _lacks_needed_encoders(load_hand("jamia"), "index")


def test_a_picture_shows_what_is_far_from_the_hand_file() -> None:
    parameter_scales = np.ones(len(PARAMETER_NAMES))
    parameter_values = dict.fromkeys(PARAMETER_NAMES, 1.0) | {"capstan": 2.5, "torque_gain": 0.3}
    fit = SimpleNamespace(
        parameter_values=parameter_values,
        half_widths=dict.fromkeys(PARAMETER_NAMES, 0.1),
        problem=SimpleNamespace(parameter_scales=parameter_scales),
    )
    axis = Figure().subplots()
    _draw_parameters(
        axis,
        SimpleNamespace(fit=fit, identifiability=SimpleNamespace(names=("capstan", "torque_gain"))),
    )
    assert axis.get_xlim() == pytest.approx((0.2, 2.6))
    rows = [*axis.get_yticks()]
    assert min(rows) > min(axis.get_ylim())
    assert max(rows) < max(axis.get_ylim())


def test_parameters_missing_in_a_new_run_keep_their_earlier_values() -> None:
    old_parameters = identified_parameters(
        tendon_stiffness=8e4, motor_inertia=1e-4, capstan=0.2
    ).model_copy(update={"covariance": ((4.0, 0.5, 0.25), (0.5, 1.0, 0.0), (0.25, 0.0, 9.0))})
    new_parameters = identified_parameters(motor_inertia=2e-4, torque_gain=0.9).model_copy(
        update={"log": ("b.mcap",)}
    )
    merged_parameters = IdentifiedParameters.model_validate(
        new_parameters.merge_older_parameters(old_parameters).model_dump()
    )
    assert dict(zip(merged_parameters.names, merged_parameters.values, strict=True)) == {
        "motor_inertia": 2e-4, "torque_gain": 0.9, "tendon_stiffness": 8e4, "capstan": 0.2,
    }  # fmt: skip
    assert merged_parameters.covariance == (
        (1e-6, 0, 0, 0),
        (0, 1e-6, 0, 0),
        (0, 0, 4.0, 0.25),
        (0, 0, 0.25, 9.0),
    )
    assert merged_parameters.log == ("b.mcap", "a.mcap")
    assert new_parameters.merge_older_parameters(None) is new_parameters
    assert merged_parameters.merge_older_parameters(old_parameters) is merged_parameters
