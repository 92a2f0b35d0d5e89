"""Test the warnings about drives that are too strong for the tendons and joints of a hand."""

import json
import tomllib

import pytest

from handctl.cli.main import main
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_from_content, load_hand, packaged_hands
from handctl.hand.tendon_strength import (
    MIN_STRENGTH_RATIO,
    largest_safe_force,
    runaway_tension,
    strength_warnings,
)


def hand_with_ratings(
    hand: Hand,
    *,
    rated_torque: float | None = None,
    peak_torque: float | None = None,
    breaking_strength: float | None = None,
) -> Hand:
    """Return a hand whose joints all have the rating ``rated_torque`` [N m].

    All motors of the hand have the torque ``peak_torque`` [N m]. All tendons of the hand have the
    breaking force ``breaking_strength`` [N].
    """
    digits, motors, tendons = hand.digit, hand.motor, hand.tendon
    if rated_torque is not None:
        digits = tuple(
            d.model_copy(update={"joint_rated_torque_N_m": (rated_torque,) * len(d.joints)})
            for d in digits
        )
    if peak_torque is not None:
        motors = tuple(
            motor.model_copy(update={"torque_peak_N_m": peak_torque}) for motor in motors
        )
    if breaking_strength is not None:
        tendons = tuple(
            tendon.model_copy(update={"rated_breaking_force_N": breaking_strength})
            for tendon in tendons
        )
    return hand.model_copy(update={"digit": digits, "motor": motors, "tendon": tendons})


@pytest.mark.parametrize(
    "hand_name", [name for name in packaged_hands() if name.startswith("jamia")]
)
def test_check_warns_of_each_jamia_and_accepts_it(hand_name, capsys):
    """`config check` warns that a runaway drive of a jamia hand could break its tendon.

    A motor of a jamia hand can pull with 250 N or more. If the drive of the motor runs away, the
    momentum of the rotor raises the tension to 500 N or more. At a tension of 500 N, the safety
    factor 1.5 requires a breaking force of 750 N, but the tendon breaks at 620 N.
    """
    assert main(["config", "check", "--hand", hand_name]) == 0
    warning_lines = [
        line for line in capsys.readouterr().out.splitlines() if line.startswith("# warning: ")
    ]
    assert any(
        "torque_peak_N_m" in line and "limit the drive to 207 N = 1.03 N m" in line
        for line in warning_lines
    )
    assert main(["config", "check", "--hand", hand_name, "--json"]) == 0
    assert [
        f"# warning: {text}" for text in json.loads(capsys.readouterr().out)["warnings"]
    ] == warning_lines


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_the_bound_is_exact(hand_name):
    hand = load_hand(hand_name)
    spool = hand.motor[0].spool_radius_m
    for breaking_force in (400.0, 900.0):
        max_force = largest_safe_force(breaking_force)
        assert breaking_force == pytest.approx(MIN_STRENGTH_RATIO * runaway_tension(max_force))
        for factor, warning_lines in ((0.999, False), (1.001, True)):
            other_hand = hand_with_ratings(
                hand, peak_torque=factor * max_force * spool, breaking_strength=breaking_force
            )
            assert (
                any("torque_peak_N_m" in line for line in strength_warnings(other_hand))
                == warning_lines
            )


def test_a_drive_limit_too_high_is_reported_with_the_right_one():
    hand = hand_with_ratings(load_hand("jamia"), breaking_strength=470.0)
    (line,) = [line for line in strength_warnings(hand) if "drive_limit_N" in line]
    assert line.startswith(
        "index_tendon, middle_tendon and 2 more: drive_limit_N (160 N at the tendon) makes 320 N"
    )
    assert "The strength of 470 N is 1.47 times this tension" in line
    assert line.endswith("expected a factor of 1.5: limit the drive to 157 N = 0.783 N m")


def test_joints_without_rating_are_reported_and_weak_ones_by_name():
    hand = load_hand("jamia")
    assert any("joint_rated_torque_N_m is missing" in line for line in strength_warnings(hand))
    strong, weak = (
        hand_with_ratings(hand, rated_torque=2.26),
        hand_with_ratings(hand, rated_torque=2.24),
    )  # 500 N at a moment arm of 3 mm make 1.5 N m, and 1.5 times this torque is 2.25 N m
    assert not any(
        "joint_rated" in line or "its rating" in line for line in strength_warnings(strong)
    )
    (line,) = [line for line in strength_warnings(weak) if "its rating" in line]
    assert line.startswith("index_j1, index_j2 and 9 more: ")
    assert "1.5 N m" in line


def test_a_hand_without_a_rating_keeps_its_identity():
    hand = load_hand("jamia")
    assert "joint_rated_torque_N_m" not in hand.content["digit"][0]
    digits = hand.content["digit"]
    rated = [
        digit | {"joint_rated_torque_N_m": (1.0,) * len(digit["link_length_m"])} for digit in digits
    ]
    other_hand = hand_from_content(hand.content | {"digit": rated}, "rated")
    assert other_hand.content["digit"][0]["joint_rated_torque_N_m"] == (1.0, 1.0, 1.0)
    assert (
        hand_from_content(tomllib.loads(other_hand.to_toml()), "again").identity
        == other_hand.identity
        != hand.identity
    )
    with pytest.raises(
        ConfigError, match="joint_rated_torque_N_m: 1 values; expected 3, one per link_length_m"
    ):
        hand_from_content(
            hand.content | {"digit": [{**rated[0], "joint_rated_torque_N_m": (1.0,)}, *rated[1:]]},
            "short",
        )
