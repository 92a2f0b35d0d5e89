"""Test the example hand in the folder examples/hands.

`config check` accepts the hand file and the gains file of the example hand. The command in
examples/README.md makes the example hand grasp an object.
"""

import json
import shlex
import shutil
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.core.gains.gains import load_gains_file
from handctl.hand.hand_loading import load_hand
from tests.docs.code_blocks import REPOSITORY_ROOT, read_code_blocks

HANDS_FOLDER = REPOSITORY_ROOT / "examples" / "hands"
OBJECT_MOTION_MM = (1.5, 3.5)
"""Bounds of the motion of the object while ``shadow_like`` holds it [mm].

The digits of ``shadow_like`` yield sideways, so the object moves by 2.4 mm. If the object moves
less than the lower bound, the page docs/evidence/hands.md is out of date.
"""


@pytest.fixture
def hands_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Copy the folder examples/hands, and change to the copy.

    Relative to the temporary folder, the copy has the same path as the original has in the
    repository.
    """
    (tmp_path / "logs").mkdir()
    folder = tmp_path / "examples" / "hands"
    shutil.copytree(HANDS_FOLDER, folder)
    monkeypatch.chdir(folder)
    return folder


def documented_demo_arguments() -> list[str]:
    """Return the words after ``handctl`` in the demo command that examples/README.md shows."""
    blocks = read_code_blocks(REPOSITORY_ROOT / "examples" / "README.md")
    (line,) = (
        line
        for block in blocks
        for line in block.text.splitlines()
        if line.startswith("handctl demo")
    )
    return shlex.split(line)[1:]


def test_the_example_hand_is_valid_with_its_gains(
    hands_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", "check", "--hand", "shadow_like.toml"]) == 0
    assert "gains: shadow_like.gains.toml; all files are valid" in capsys.readouterr().out
    hand = load_hand("shadow_like.toml")
    assert (len(hand.digit), len(hand.joints), len(hand.tendon)) == (7, 24, 20)
    assert hand.is_pair.all()
    gains = load_gains_file(Path("shadow_like.gains.toml")).gains
    assert {tendon_gains.name for tendon_gains in gains.tendon} <= set(hand.tendon_names)


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_the_demo_of_the_example_hand_grasps_and_releases(
    hands_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*documented_demo_arguments(), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["failure"] == ""
    assert result["missed"] == result["frames_lost"] == 0
    assert min(result["contact_force_n"][name] for name in ("index", "middle", "thumb")) > 1.0
    assert OBJECT_MOTION_MM[0] < result["object_motion_mm"] < OBJECT_MOTION_MM[1]
    assert max(result["tracking_rmse_deg"].values()) < 1.0
