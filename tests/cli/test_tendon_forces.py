"""Test gains with a separate force weight for one tendon.

The tests cover the gain file, the bounds of the gains, the design of the controller, and changes of
gains during a run.
"""

from pathlib import Path

import numpy as np
import pytest

from handctl.cli.main import main
from handctl.controller.gain_change import DesignCache, gain_change_events
from handctl.controller.pending_gains import PendingGains
from handctl.core.gains.gain_bounds import (
    changed_gain_values,
    checked_gain_bounds,
    gains_with_values,
    values_by_key,
)
from handctl.core.gains.gains import (
    Gains,
    GainsProvenance,
    gains_text,
    load_gains_file,
    packaged_gains,
)
from handctl.core.gains.motion_design import design_motion
from handctl.core.hand_model import HandModel
from handctl.errors import ConfigError
from handctl.hand.hand_loading import load_hand

MOTION_FORCE_KEY = "tendon.index_tendon.motion_force_N"
FORCES_FILE_TEXT = '[[tendon]]\nname = "index_tendon"\nmotion_force_N = 5.0\n'


@pytest.fixture(scope="module")
def jamia_model() -> HandModel:
    """Return the model of the hand jamia with the default gains."""
    return HandModel.from_hand(load_hand("jamia"), Gains(), 500.0)


def gains_with_tendon_force(force_N: float) -> Gains:
    """Return gains with a separate force weight [N] for the tendon of jamia's index finger."""
    return gains_with_values(Gains(), {MOTION_FORCE_KEY: force_N}, "test")


def test_a_tendon_with_a_force_of_its_own_differs_from_the_others(jamia_model: HandModel) -> None:
    default_design = design_motion(jamia_model.tendon_constants, Gains(), jamia_model.period)
    tendon_force_design = design_motion(
        jamia_model.tendon_constants, gains_with_tendon_force(5.0), jamia_model.period
    )
    design_with_common_force = design_motion(
        jamia_model.tendon_constants,
        gains_with_values(Gains(), {"motion.force_N": 5.0}, "test"),
        jamia_model.period,
    )
    assert (
        tendon_force_design.stiffness[0]
        == design_with_common_force.stiffness[0]
        < default_design.stiffness[0]
    )
    assert np.array_equal(tendon_force_design.stiffness[1:], default_design.stiffness[1:])
    assert np.array_equal(tendon_force_design.tension, default_design.tension)
    tension = gains_with_values(Gains(), {"tendon.index_tendon.tension_force_N": 2.0}, "test")
    tension_force_design = design_motion(jamia_model.tendon_constants, tension, jamia_model.period)
    assert tension_force_design.tension[0] < default_design.tension[0]
    assert np.array_equal(tension_force_design.stiffness, default_design.stiffness)


def test_the_text_of_the_gains_reads_back(tmp_path: Path) -> None:
    gains = gains_with_values(
        gains_with_tendon_force(5.0),
        {"tendon.thumb_tendon.tension_force_N": 2.0, "motion.force_N": 9.0},
        "test",
    )
    path = tmp_path / "gains.toml"
    path.write_text(gains_text(gains, GainsProvenance(hand="jamia")))
    assert load_gains_file(path).gains == gains
    assert values_by_key(gains)[MOTION_FORCE_KEY] == 5.0
    assert gains_with_values(gains, values_by_key(gains), "test") == gains


def test_a_tendon_without_its_own_force_uses_the_common_force() -> None:
    assert changed_gain_values(Gains(), gains_with_tendon_force(5.0)) == {
        MOTION_FORCE_KEY: (Gains().motion.force_N, 5.0)
    }
    assert changed_gain_values(gains_with_tendon_force(5.0), Gains()) == {
        MOTION_FORCE_KEY: (5.0, Gains().motion.force_N)
    }
    assert changed_gain_values(Gains(), gains_with_tendon_force(Gains().motion.force_N)) == {}
    events = gain_change_events(Gains(), gains_with_tendon_force(5.0))
    assert [(event.where, event.text) for event in events] == [
        (MOTION_FORCE_KEY, "5.0"),
        ("", "taken over: 1 changed"),
    ]


@pytest.mark.parametrize(
    ("gain_text", "expected_message"),
    [
        (FORCES_FILE_TEXT + FORCES_FILE_TEXT, "tendon 'index_tendon' is there twice"),
        (
            FORCES_FILE_TEXT.replace("5.0", "0.0"),
            "tendon[index_tendon].motion_force_N: greater than 0",
        ),
        (
            FORCES_FILE_TEXT.replace("5.0", "501.0"),
            "tendon[index_tendon].motion_force_N: less than or equal to 500",
        ),
        (FORCES_FILE_TEXT.replace("motion_force_N", "motion_farce_N"), "motion_force_N?"),
        (FORCES_FILE_TEXT.replace('name = "index_tendon"\n', ""), "missing"),
        (FORCES_FILE_TEXT.replace("index_tendon", "index_tendom"), "no tendon 'index_tendom'"),
    ],
)
def test_a_wrong_entry_is_refused_in_one_line(
    work_folder: Path, capsys: pytest.CaptureFixture[str], gain_text: str, expected_message: str
) -> None:
    (work_folder / "new.toml").write_text("schema = 1\n" + gain_text)
    assert main(["gains", "apply", "new.toml", "--hand", "jamia"]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    for message_part in expected_message.split(": "):
        assert message_part in line
    assert not (work_folder / "jamia.gains.toml").exists()


@pytest.mark.parametrize(
    "gain_key",
    [
        "tendon.index_tendon",
        "tendon..motion_force_N",
        "tendon.motion_force_N",
        "tendon.index_tendon.force_N",
    ],
)
def test_a_key_that_no_tendon_can_have_is_unknown(gain_key: str) -> None:
    with pytest.raises(ConfigError, match="no such gain"):
        checked_gain_bounds(gain_key, 5.0, "test")


def test_a_running_controller_refuses_a_tendon_of_another_hand(jamia_model: HandModel) -> None:
    gains = gains_with_values(
        Gains(), {"tendon.wrist_flex.motion_force_N": 5.0}, "test", is_live=True
    )
    progress = DesignCache().design_next_loop(jamia_model, PendingGains(gains))
    assert progress is not None
    assert progress.pending_gains is None
    assert "no tendon 'wrist_flex'" in progress.events[0].text


def test_a_hand_with_packaged_gains_shows_them(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["gains", "show", "--hand", "orca_like", "-q"]) == 0
    shown_text = capsys.readouterr().out
    force = values_by_key(packaged_gains("orca_like"))["tendon.index_pip.motion_force_N"]
    assert f"{'tendon.index_pip.motion_force_N':<38} {force:<10g} packaged" in shown_text
    assert main(["gains", "diff", "--hand", "orca_like"]) == 0
    assert "0 of" in capsys.readouterr().out
    (work_folder / "all.toml").write_text("schema = 1\n")
    assert main(["gains", "apply", "all.toml", "--hand", "orca_like"]) == 0
    capsys.readouterr()
    assert main(["gains", "diff", "--hand", "orca_like"]) == 0
    assert (
        f"{'tendon.index_pip.motion_force_N':<38} {force:g} -> {Gains().motion.force_N:g}"
        in capsys.readouterr().out
    )
    assert main(["gains", "rollback", "--to", "0", "--hand", "orca_like"]) == 0
    assert load_gains_file(work_folder / "orca_like.gains.toml").gains == packaged_gains(
        "orca_like"
    )
