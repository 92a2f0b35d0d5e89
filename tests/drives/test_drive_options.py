"""Test the drive options that a hand file is allowed to contain.

Every accepted option value must give finite numbers in the computations of the drive.
"""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from handctl.core.tendon_constants import collect_tendon_constants
from handctl.drives.protocol_registry import PROTOCOL_ENTRIES, make_drive
from handctl.errors import ConfigError
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand
from tests.drives.protocol_bench import hand_file, motor_on_bench

CIA402_OPTIONS = {"rated_torque_N_m": 0.5, "counts_per_turn": 4096}


@pytest.mark.parametrize(
    ("protocol", "drive_options", "option_key", "accepted_text"),
    [
        (
            "cia402",
            CIA402_OPTIONS | {"counts_per_turn": 0.4},
            "counts_per_turn",
            "a whole number from 1 to 16777216",
        ),
        (
            "cia402",
            CIA402_OPTIONS | {"heartbeat_ms": 0.3},
            "heartbeat_ms",
            "a whole number from 1 to 1000",
        ),
        (
            "cia402",
            CIA402_OPTIONS | {"heartbeat_ms": True},
            "heartbeat_ms",
            "a whole number from 1 to 1000",
        ),
        (
            "cia402",
            CIA402_OPTIONS | {"rated_torque_N_m": 4e-4},
            "rated_torque_N_m",
            "at least one mN_m",
        ),
        ("odrive", {"heartbeat_ms": 1e-7}, "heartbeat_ms", "a whole number from 1 to 1000"),
        (
            "odrive",
            {"encoder_period_ms": 2.5},
            "encoder_period_ms",
            "a whole number from 1 to 1000",
        ),
        ("odrive", {"gear_ratio": 0.0}, "gear_ratio", "a number above 0, at most 1000"),
    ],
)
def test_a_number_that_rounds_to_nothing_is_refused(
    protocol: str, drive_options: dict[str, object], option_key: str, accepted_text: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        make_drive(motor_on_bench(protocol, 1, 0.01, drive_options), 0)
    assert option_key in str(refused.value)
    assert accepted_text in str(refused.value)


@pytest.mark.parametrize("heartbeat_s", [1, 50.0, 1000])
def test_a_whole_number_may_be_written_with_a_point(heartbeat_s: float) -> None:
    for protocol, options in (("cia402", CIA402_OPTIONS), ("odrive", {})):
        drive = make_drive(
            motor_on_bench(protocol, 1, 0.01, options | {"heartbeat_ms": heartbeat_s}), 0
        )
        assert drive.background_frames[0][2] > 999.0 / heartbeat_s, (
            "at least as often as configured"
        )


def test_position_step_is_reported() -> None:
    """The filter that estimates tensions needs the resolution of the position that a drive reports.

    In this test, the encoder has 1000 counts per turn, which is coarser than the 16 bits of a
    position report.
    """
    coarse_encoder_options = CIA402_OPTIONS | {"counts_per_turn": 1000, "gear_ratio": 2.0}
    assert make_drive(
        motor_on_bench("cia402", 1, 0.01, coarse_encoder_options), 0
    ).position_step == pytest.approx(math.pi / 1000)
    assert make_drive(motor_on_bench("mit", 1, 0.01, {}), 0).position_step == pytest.approx(
        25.0 / 65535
    )
    assert make_drive(motor_on_bench("odrive", 1, 0.01, {}), 0).position_step == 0.0


@pytest.mark.parametrize(
    ("counts_per_turn", "expected_step_m"), [(1000, math.tau / 1000), (1 << 20, 25.0 / 65535)]
)
def test_the_filter_counts_with_the_drive_s_encoder(
    tmp_path: Path, counts_per_turn: int, expected_step_m: float
) -> None:
    path = hand_file(tmp_path, ["cia402"])
    path.write_text(
        path.read_text().replace("counts_per_turn = 65536", f"counts_per_turn = {counts_per_turn}")
    )
    hand = load_hand(path)
    tendons = collect_tendon_constants(
        hand, tuple(DigitModel.from_hand(hand, name) for name in hand.digit_names)
    )
    np.testing.assert_allclose(tendons.encoder_step, expected_step_m * tendons.spool_radius)


REQUIRED_OPTIONS = {
    "cia402": CIA402_OPTIONS,
    "robstride": {"motor_type": "rs05"},
    "robstride_mit": {"motor_type": "rs05"},
    "cubemars": {"motor_type": "ak80-6"},
}


@pytest.mark.parametrize("protocol", PROTOCOL_ENTRIES)
def test_an_unknown_option_is_refused_with_the_declared_options(protocol: str) -> None:
    options = REQUIRED_OPTIONS.get(protocol, {}) | {"speed": 1}
    with pytest.raises(ConfigError, match="speed: unknown key") as refused:
        make_drive(motor_on_bench(protocol, 1, 0.01, options), 0)
    assert all(key in str(refused.value) for key in PROTOCOL_ENTRIES[protocol].options)


@pytest.mark.parametrize(
    ("protocol", "option_key"),
    [(name, key) for name, entry in PROTOCOL_ENTRIES.items() for key in entry.options],
)
def test_a_declared_option_is_known(protocol: str, option_key: str) -> None:
    """If an option has a wrong value, the error message names the option.

    The error message for a wrong option value does not call the option unknown.
    """
    options = REQUIRED_OPTIONS.get(protocol, {}) | {option_key: "wrong"}
    with pytest.raises(ConfigError, match=option_key) as refused:
        make_drive(motor_on_bench(protocol, 1, 0.01, options), 0)
    assert "unknown key" not in str(refused.value)


def test_every_option_that_a_drive_reads_is_declared() -> None:
    folder = Path(__file__).parents[2] / "src" / "handctl" / "drives"
    # The options for drive modes are options of ``handctl jog``. A hand file must not contain
    # options of ``handctl jog``.
    files = [path for path in folder.glob("*/*.py") if path.name != "modes.py"]
    read_options = {
        key for path in files for key in re.findall(r'options\.pop\(\s*"(\w+)"', path.read_text())
    }
    declared_options = {key for entry in PROTOCOL_ENTRIES.values() for key in entry.options}
    assert read_options <= declared_options
    assert len(read_options) > 10
